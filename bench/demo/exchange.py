"""Both robots at work: two processes, an agent each, that meet over TLS on loopback.

They compare all keyframes privately. Of pairs that match, and of no others, each shows the other its submap
and verifies what it is shown (:mod:`bench.demo.robot`).
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.demo.places import Robot
from bench.demo.robot import write_bag
from bench.demo.scan_context import Background
from bench.parties import free_port
from protocols.geometry.poses import Pose
from protocols.geometry.verification import Verified

TIMEOUT = 300.0
"""Seconds after which a robot's process counts as hung."""


class DemoFailed(RuntimeError):
    """A robot's process failed; the message is its error."""


@dataclass(frozen=True, slots=True, eq=False)
class Exchanged:
    """What both robots came to know, and what it took; pairs are Alice's, Bob's.

    Attributes:
        decisions: ``(n_alice, n_bob)``, which pairs match.
        verdicts: Of the pairs that match, by Alice's and Bob's keyframe; transforms are of Bob's keyframe in
            Alice's frame.
        bytes_sent: For the comparisons.
        rounds: Of the comparisons.
        milliseconds: From the connection until all was compared, shown and verified; the slower robot's.
        shown: Keyframes whose submap a robot has shown.
        payload_bytes: Of these submaps.
        verifying: Milliseconds of it that the slower robot verified.
    """

    decisions: npt.NDArray[np.bool_] = field(repr=False)
    verdicts: dict[tuple[int, int], Verified] = field(repr=False)
    bytes_sent: tuple[int, int]
    rounds: int
    milliseconds: float
    shown: tuple[int, int]
    payload_bytes: tuple[int, int]
    verifying: float


def exchange(mission: Path, alice: Robot, bob: Robot, public: Background) -> Exchanged:
    """Run both robots, each with its own dealt folder and its own scans only.

    Raises:
        DemoFailed: a robot's process fails, or the two report different things.
    """
    np.savez(mission / "public.npz", mean=public.mean, whitening=public.whitening)
    address = f"127.0.0.1:{free_port()}"
    calls = ["--listen", address], ["--call", f"{alice.name}={address}"]
    commands = []
    for robot, peer, call in ((alice, bob, calls[0]), (bob, alice, calls[1])):
        bag = mission / robot.name / "bag.npz"
        write_bag(bag, robot.descriptors, robot.local.payloads)
        command = [sys.executable, "-m", "bench.demo.robot", str(mission / robot.name), "--bag", str(bag)]
        command += ["--public", str(mission / "public.npz"), "--expect", str(len(peer.descriptors)), *call]
        commands.append(command)
    first, second = _run(commands)
    verdicts = _verdicts(first)
    others = {pair[::-1]: verdict for pair, verdict in _verdicts(second).items()}
    if {pair: one.accepted for pair, one in verdicts.items()} != {
        pair: one.accepted for pair, one in others.items()
    }:
        raise DemoFailed("the two robots report different matches or verdicts")
    decisions = np.zeros((len(alice.descriptors), len(bob.descriptors)), dtype=np.bool_)
    for pair in verdicts:
        decisions[pair] = True
    return Exchanged(
        decisions=decisions,
        verdicts=verdicts,
        bytes_sent=(first["bytes_sent"], second["bytes_sent"]),
        rounds=first["rounds"],
        milliseconds=max(first["ms"], second["ms"]),
        # Each counts what it was shown.
        shown=(second["shown"], first["shown"]),
        payload_bytes=(second["shown_bytes"], first["shown_bytes"]),
        verifying=max(first["verify_ms"], second["verify_ms"]),
    )


def _verdicts(answer: dict[str, Any]) -> dict[tuple[int, int], Verified]:
    """By own and peer's keyframe."""
    verdicts = {}
    for own, peer, state, why, transform, weight in answer["matches"]:
        if state not in ("verified", "rejected"):
            raise DemoFailed(f"keyframe {own} matches, but the peer's was not shown: {why}")
        pose: Pose | None = None if transform is None else (transform[0], transform[1], transform[2])
        verdicts[own, peer] = Verified(state == "verified", why, pose, 0.0 if weight is None else weight)
    return verdicts


def _run(commands: list[list[str]]) -> list[dict[str, Any]]:
    """Run the robots' processes until both have told what they found; then let both end."""
    processes = [
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for command in commands
    ]
    watch = threading.Timer(TIMEOUT, _end, [processes])
    watch.start()
    try:
        answers = []
        for process in processes:
            assert process.stdout is not None
            line = process.stdout.readline()
            try:
                answer = json.loads(line or "{}")
            except ValueError:
                raise DemoFailed(f"a robot's process said what is no answer: {line!r:.80}") from None
            if "matches" not in answer:
                raise DemoFailed(f"a robot's process failed: {answer.get('error', 'see above')}")
            answers.append(answer)
        for process in processes:
            process.communicate("")
        return answers
    finally:
        watch.cancel()
        _end(processes)
        for process in processes:
            process.wait()
            for stream in (process.stdin, process.stdout):
                if stream is not None:
                    stream.close()


def _end(processes: list[subprocess.Popen[str]]) -> None:
    for process in processes:
        process.kill()
