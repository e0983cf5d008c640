"""Foreign programs, run together under one time limit, and nothing of them left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

_POLL = 0.05


@dataclass(frozen=True, slots=True)
class Finished:
    """What became of the commands.

    Attributes:
        statuses: Exit status of each; None for one that had to be killed.
        outputs: What each wrote to standard output and error.
    """

    statuses: list[int | None]
    outputs: list[str]

    @property
    def worked(self) -> bool:
        """True if every command ended by itself with status 0."""
        return all(status == 0 for status in self.statuses)


def run_together(
    commands: Sequence[Sequence[str]], folder: Path, environment: Mapping[str, str], timeout: float
) -> Finished:
    """Run commands at the same time until all have ended, one has failed, or the time is up.

    Each is in a process group of its own; whatever is left of a group at the end is killed.

    Args:
        commands: The commands, each with its arguments.
        folder: The folder that they run in.
        environment: Variables to set beside the present ones.
        timeout: Seconds for all of them.

    Raises:
        OSError: if a command cannot be started.
    """
    deadline = time.monotonic() + timeout
    processes: list[subprocess.Popen[bytes]] = []
    with tempfile.TemporaryDirectory(prefix="spdz-bench-") as logs:
        paths = [Path(logs, str(number)) for number in range(len(commands))]
        try:
            for command, path in zip(commands, paths, strict=True):
                processes.append(_start(command, path, folder, environment))
            while time.monotonic() < deadline:
                statuses = [process.poll() for process in processes]
                if None not in statuses or any(statuses):
                    break
                time.sleep(_POLL)
            ended = [process.poll() for process in processes]
        finally:
            for process in processes:
                _kill_group(process)
        return Finished(ended, [path.read_text(encoding="utf-8", errors="replace") for path in paths])


def _start(
    command: Sequence[str], log: Path, folder: Path, environment: Mapping[str, str]
) -> subprocess.Popen[bytes]:
    """Start a command that writes to a file: a full pipe would stall it."""
    with log.open("wb") as output:
        return subprocess.Popen(
            command,
            cwd=folder,
            env={**os.environ, **environment},
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )


def _kill_group(process: subprocess.Popen[bytes]) -> None:
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):  # the group has ended (macOS says the latter of zombies)
        pass
    process.wait()
