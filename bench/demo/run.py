"""The demo's plot: scans to descriptors, deal, two processes, compare with the clear and with the truth."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.demo import dataset, places
from bench.demo.picture import draw_map
from bench.parties import free_port
from dealer.gallery_mission import deal_galleries
from protocols.catalog import GalleryPurpose
from protocols.scores import S10
from spdz.console.progress import progress_bar
from spdz.foundations.types import Security
from spdz.local import run_clear

TIMEOUT = 300.0
"""Seconds after which a robot's process counts as hung."""


class DemoFailed(RuntimeError):
    """A robot's process failed; the message is its error."""


@dataclass(frozen=True, slots=True)
class Report:
    """What the demo measured. Times are milliseconds, sizes bytes."""

    security: str
    keyframes: tuple[int, int]
    dimension: int
    threshold: float
    pairs: int
    candidates: int
    clear_candidates: int
    private_quality: places.Quality
    clear_quality: places.Quality
    disagreements: int
    dealt_slots: tuple[int, int]
    dealing_seconds: float
    folder_bytes: tuple[int, int]
    bytes_sent: tuple[int, int]
    rounds: int
    milliseconds: float
    clear_bytes: tuple[int, int]
    clear_milliseconds: float
    picture: str

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return asdict(self) | {
            "private_quality": self.private_quality._asdict(),
            "clear_quality": self.clear_quality._asdict(),
        }


def run_demo(out: Path, security: Security = "malicious") -> Report:
    """Run the whole demo.

    Args:
        out: Folder for the picture; created if need be.
        security: The security model.

    Raises:
        DemoFailed: if a robot's process fails.
        ImportError: if the extra ``spdz[demo]`` is not installed.
        OSError: if the picture or the tapes cannot be written.
    """
    _say("reading 3,873 laser scans and describing the keyframes of two robots")
    run = dataset.load()
    out.mkdir(parents=True, exist_ok=True)
    alice, bob = places.robots(run)
    with tempfile.TemporaryDirectory(prefix="spdz-demo-") as folder:
        purpose = GalleryPurpose("S10", dim=alice.descriptors.shape[1])
        slots = len(alice.descriptors), len(bob.descriptors)
        _say("dealing, as the trusted dealer does before the mission")
        started = time.perf_counter()
        with progress_bar("dealing") as bar:
            dealt = deal_galleries(
                Path(folder), (alice.name, bob.name), purpose, slots, security, progress=bar
            )
        dealing = time.perf_counter() - started
        _say("two robots compare all keyframes: two processes, TLS 1.3 on loopback")
        first, second = _match(Path(folder), (alice, bob), places.DEFAULT_THRESHOLD)
    decisions = _decisions(first)
    if sorted((j, i) for i, j in second["matches"]) != sorted(map(tuple, first["matches"])):
        raise DemoFailed("the two robots report different matches")
    truth = places.truth(alice, bob)
    scores = run_clear(S10.within(1.0), alice.descriptors[:, None], bob.descriptors[None]).value
    exact = scores >= places.DEFAULT_THRESHOLD
    clear_cut = np.abs(scores - places.DEFAULT_THRESHOLD) > 2.0 ** -(purpose.resolution or 64) / 2
    private, clear = bob.fold(decisions), bob.fold(exact)
    picture = out / "map.png"
    draw_map(picture, run, alice, bob, private, truth)
    return Report(
        security=security,
        keyframes=(len(alice.descriptors) // alice.turns, len(bob.descriptors) // bob.turns),
        dimension=alice.descriptors.shape[1],
        threshold=places.DEFAULT_THRESHOLD,
        pairs=int(decisions.size),
        candidates=int(private.sum()),
        clear_candidates=int(clear.sum()),
        private_quality=places.precision_recall(private, truth),
        clear_quality=places.precision_recall(clear, truth),
        disagreements=int(((decisions != exact) & clear_cut).sum()),
        dealt_slots=dealt.capacity,
        dealing_seconds=dealing,
        folder_bytes=(dealt.folders[Path(folder, alice.name)], dealt.folders[Path(folder, bob.name)]),
        bytes_sent=(first["bytes_sent"], second["bytes_sent"]),
        rounds=first["rounds"],
        milliseconds=max(first["ms"], second["ms"]),
        clear_bytes=(alice.descriptors.nbytes, bob.descriptors.nbytes),
        clear_milliseconds=_clear_milliseconds(alice, bob),
        picture=str(picture),
    )


def _decisions(answer: dict[str, Any]) -> npt.NDArray[np.bool_]:
    """Which pairs match, descriptor by descriptor, from one robot's answer, which numbers slots."""
    decisions = np.zeros((len(answer["new"]), len(answer["peer_new"])), dtype=np.bool_)
    rows, columns = ({slot: i for i, slot in enumerate(answer[name])} for name in ("new", "peer_new"))
    for own, peer in answer["matches"]:
        decisions[rows[own], columns[peer]] = True
    return decisions


def _say(text: str) -> None:
    print(f"... {text}", file=sys.stderr, flush=True)


def _match(folder: Path, robots: tuple[places.Robot, places.Robot], threshold: float) -> list[dict[str, Any]]:
    """Run ``python -m spdz match`` once a robot, each with its own folder only."""
    address = f"127.0.0.1:{free_port()}"
    processes = []
    for robot, peer, role in ((*robots, "--listen"), (*robots[::-1], "--connect")):
        own = folder / robot.name
        np.save(own / "descriptors.npy", robot.descriptors)
        command = [sys.executable, "-m", "spdz", "match", "--json", role, address]
        command += ["--tape", str(own / f"{peer.name}.tape"), "--threshold", repr(threshold)]
        command += ["--descriptors", str(own / "descriptors.npy"), "--state-dir", str(own / "state")]
        if role == "--connect":
            command.append("--quiet")
        processes.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
    try:
        results = []
        for process in processes:
            output, _ = process.communicate(timeout=TIMEOUT)
            answer = json.loads(output or "{}")
            if process.returncode != 0 or "matches" not in answer:
                raise DemoFailed(f"a robot's process failed: {answer.get('message', 'see above')}")
            results.append(answer)
        return results
    except subprocess.TimeoutExpired:
        raise DemoFailed(f"a robot's process did not finish within {TIMEOUT:.0f} s") from None
    finally:
        for process in processes:
            process.kill()
            process.wait()


def _clear_milliseconds(alice: places.Robot, bob: places.Robot) -> float:
    """Time of the decision itself once Bob has Alice's descriptors in the clear; the second of two runs."""
    for _ in range(2):
        started = time.perf_counter()
        _ = alice.descriptors @ bob.descriptors.T >= places.DEFAULT_THRESHOLD
        seconds = time.perf_counter() - started
    return seconds * 1e3
