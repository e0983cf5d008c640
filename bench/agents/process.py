"""One robot's agent as a process: fed line by line, listened to, killed and started again."""

from __future__ import annotations

import base64
import json
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from spdz.foundations.types import FloatArray

_ENDING = 60.0


@dataclass(slots=True)
class Heard:
    """What an agent printed.

    Attributes:
        candidates: By the match's number: when its bit was known.
        matches: By the match's number: own keyframe, the peer, its keyframe.
        numbers: Numbers of news, as often as they were printed.
        others: Events that are no matches.
    """

    candidates: dict[int, float] = field(default_factory=dict)
    matches: dict[int, tuple[int, str, int]] = field(default_factory=dict)
    numbers: list[int] = field(default_factory=list)
    others: list[dict[str, Any]] = field(default_factory=list)


class Robot:
    """A robot of the bench.

    Args:
        folder: Its dealt folder.
        descriptors: Its keyframes, shape (n, N); their numbers are the rows.
        gallery: What they are called in the plan.
    """

    def __init__(self, folder: Path, descriptors: FloatArray, gallery: str) -> None:
        self.name, self.heard = folder.name, Heard()
        self.came: dict[int, float] = {}
        self._folder, self._lines = (
            folder,
            [
                json.dumps(
                    {
                        "keyframe": number,
                        "descriptors": {gallery: vector.tolist()},
                        "payload": base64.b64encode(f"{folder.name} {number}".encode()).decode(),
                    }
                ).encode()
                + b"\n"
                for number, vector in enumerate(descriptors)
            ],
        )
        self._process: subprocess.Popen[bytes] | None = None
        self._reader: threading.Thread | None = None

    def start(self, *extra: str) -> None:
        """Begin, or begin again."""
        command = [sys.executable, "-m", "spdz", "agent", "--mission", str(self._folder), "--stdin", "--json"]
        command += ["--state-dir", str(self._folder / "state"), *extra]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self._reader = threading.Thread(target=self._listen, args=(self._process,), daemon=True)
        self._reader.start()
        for number in sorted(self.came):  # whoever feeds it need not know what it has kept
            self._write(self._lines[number])

    def bring(self, number: int) -> None:
        """Give it a keyframe."""
        self.came[number] = time.monotonic()
        self._write(self._lines[number])

    def kill(self) -> None:
        """Kill it as a power cut would."""
        if self._process is not None and self._reader is not None:
            self._process.kill()
            self._process.wait()
            self._reader.join(_ENDING)
            self._close()

    def stop(self) -> int:
        """End it as its user would; returns its status."""
        if self._process is None or self._reader is None:
            return 0
        self._process.terminate()
        status = self._process.wait(_ENDING)
        self._reader.join(_ENDING)
        self._close()
        return status

    @property
    def memory(self) -> float:
        """Its resident memory in MB; 0 where the system does not tell."""
        try:
            text = Path(f"/proc/{self._process.pid if self._process else 0}/status").read_text()
        except OSError:
            return 0.0
        return next((int(line.split()[1]) / 1024 for line in text.splitlines() if "VmRSS" in line), 0.0)

    def _write(self, line: bytes) -> None:
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.write(line)
            self._process.stdin.flush()

    def _close(self) -> None:
        if self._process is not None:
            for pipe in (self._process.stdin, self._process.stdout):
                if pipe is not None:
                    pipe.close()
        self._process = None

    def _listen(self, process: subprocess.Popen[bytes]) -> None:
        for line in process.stdout or ():
            try:
                self._hear(json.loads(line))
            except ValueError:  # it was killed in the middle of a line
                continue

    def _hear(self, event: dict[str, Any]) -> None:
        if "number" not in event:
            self.heard.others.append(event)
            return
        self.heard.numbers.append(event["number"])
        if event["state"] == "candidate":
            self.heard.candidates.setdefault(event["match"], time.monotonic())
        if event["peer_keyframe"] is not None:
            self.heard.matches[event["match"]] = event["keyframe"], event["peer"], event["peer_keyframe"]
