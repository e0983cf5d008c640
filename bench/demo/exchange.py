"""Both robots at work: two processes compare all keyframes privately; of pairs that match, submaps are shown.

The processes are ``python -m spdz match``; the submaps of pairs that matched go from hand to hand here.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.demo.local_map import describes
from bench.demo.places import Robot
from bench.demo.scan_context import Background
from bench.parties import free_port
from protocols.geometry.verification import Verified, verify_submaps

TIMEOUT = 300.0
"""Seconds after which a robot's process counts as hung."""


class DemoFailed(RuntimeError):
    """A robot's process failed; the message is its error."""


@dataclass(frozen=True, slots=True, eq=False)
class Exchanged:
    """What both robots came to know, and what it took.

    Attributes:
        decisions: ``(n_alice, n_bob)``, descriptor by descriptor: which pairs match.
        verdicts: Of the pairs that match, by Alice's and Bob's keyframe; transforms are of Bob's keyframe in
            Alice's frame.
        bytes_sent: By Alice and by Bob, for the comparisons.
        rounds: Of the comparisons.
        milliseconds: Of the comparisons, the slower robot's.
        shown: Keyframes whose submap Alice and Bob showed.
        payload_bytes: Of these submaps.
        verifying: Milliseconds that one verdict takes.
    """

    decisions: npt.NDArray[np.bool_] = field(repr=False)
    verdicts: dict[tuple[int, int], Verified] = field(repr=False)
    bytes_sent: tuple[int, int]
    rounds: int
    milliseconds: float
    shown: tuple[int, int]
    payload_bytes: tuple[int, int]
    verifying: float


def exchange(folder: Path, alice: Robot, bob: Robot, threshold: float, public: Background) -> Exchanged:
    """Run both robots.

    Raises:
        DemoFailed: a robot's process fails, or the two report different things.
    """
    first, second = _match(folder, (alice, bob), threshold)
    decisions = _decisions(first)
    if sorted((j, i) for i, j in second["matches"]) != sorted(map(tuple, first["matches"])):
        raise DemoFailed("the two robots report different matches")
    started = time.perf_counter()
    verdicts = {}
    for i, j in np.argwhere(bob.fold(decisions)).tolist():
        own, other = alice.local.payloads[i], bob.local.payloads[j]
        if not describes(public, other, bob.descriptors[j * bob.turns]):
            raise DemoFailed("a submap does not give the descriptor that was compared")
        verdicts[i, j] = verify_submaps(own, other)
    seconds = time.perf_counter() - started
    shown = {i for i, _ in verdicts}, {j for _, j in verdicts}
    return Exchanged(
        decisions=decisions,
        verdicts=verdicts,
        bytes_sent=(first["bytes_sent"], second["bytes_sent"]),
        rounds=first["rounds"],
        milliseconds=max(first["ms"], second["ms"]),
        shown=(len(shown[0]), len(shown[1])),
        payload_bytes=(
            sum(len(alice.local.payloads[i]) for i in shown[0]),
            sum(len(bob.local.payloads[j]) for j in shown[1]),
        ),
        verifying=seconds * 1e3 / max(1, len(verdicts)),
    )


def _decisions(answer: dict[str, Any]) -> npt.NDArray[np.bool_]:
    """Which pairs match, descriptor by descriptor, from one robot's answer, which numbers slots."""
    decisions = np.zeros((len(answer["new"]), len(answer["peer_new"])), dtype=np.bool_)
    rows, columns = ({slot: i for i, slot in enumerate(answer[name])} for name in ("new", "peer_new"))
    for own, peer in answer["matches"]:
        decisions[rows[own], columns[peer]] = True
    return decisions


def _match(folder: Path, robots: tuple[Robot, Robot], threshold: float) -> list[dict[str, Any]]:
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
