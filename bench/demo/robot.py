"""One robot of the demo, a process of its own: an agent that is fed, shows submaps of matches, and verifies.

::

    python -m bench.demo.robot MISSION --bag FILE --public FILE --expect N --listen ADDRESS
    python -m bench.demo.robot MISSION --bag FILE --public FILE --expect N --call PEER=ADDRESS

It prints one line of JSON when all pairs are compared and all matches settled, and stays for its peer until
its standard input ends.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench.demo.local_map import describes
from bench.demo.plan import DESCRIPTOR
from bench.demo.scan_context import Background
from protocols.agent import Agent, Event, Meeting, Verdict
from protocols.geometry.verifiers import laser
from spdz.console.command import tune_process
from spdz.foundations.types import FloatArray

LOOK = 0.02
"""Seconds between two looks at how far the agent is."""
LONGEST = 240.0
"""Seconds after which it gives up."""
TROUBLE = ("lost", "refused", "bug", "violation", "cheated", "system", "records", "stopped", "verification")
"""Events that stop the demo."""


def write_bag(path: Path, descriptors: FloatArray, payloads: tuple[bytes, ...]) -> None:
    """What a robot has seen, as one file: a descriptor and a submap for each keyframe."""
    ends = np.cumsum([len(payload) for payload in payloads])
    blob = np.frombuffer(b"".join(payloads), dtype=np.uint8)
    np.savez(path, descriptors=descriptors, ends=ends, payloads=blob)


def read_bag(path: Path) -> Iterator[tuple[FloatArray, bytes]]:
    """The keyframes in order."""
    with np.load(path) as bag:
        blob, begin = bag["payloads"].tobytes(), 0
        for vector, end in zip(bag["descriptors"], bag["ends"], strict=True):
            yield vector, blob[begin:end]
            begin = int(end)


@dataclass(slots=True)
class Verification:
    """The demo's verification: is the submap of the place that was compared, and do the submaps fit?

    Attributes:
        public: What both robots' descriptors are made with.
        seconds: What each took.
        shown: Bytes of submaps that the peer has shown, by its keyframe.
        found: What it said, by own and peer's keyframe: of what it rejected, the agent keeps no transform.
    """

    public: Background
    seconds: list[float] = field(default_factory=list)
    shown: dict[int, int] = field(default_factory=dict)
    found: dict[tuple[int, int], Verdict] = field(default_factory=dict)

    def __call__(self, meeting: Meeting) -> Verdict:
        """Look at a match."""
        started = time.perf_counter()
        self.shown[meeting.other.id] = len(meeting.other.payload)
        verdict = self.found[meeting.own.id, meeting.other.id] = self._verdict(meeting)
        self.seconds.append(time.perf_counter() - started)
        return verdict

    def _verdict(self, meeting: Meeting) -> Verdict:
        vector = meeting.other.vector
        if vector is None or not describes(self.public, meeting.other.payload, vector):
            return Verdict(False, "the submap is not of the place that was compared")
        return laser(meeting)


class Clock:
    """When the peer was reached, and whether anything went wrong."""

    def __init__(self) -> None:
        self.connected: float | None = None
        self.trouble = ""

    def __call__(self, event: Event) -> None:
        """Take an event."""
        if event.name == "connected" and self.connected is None:
            self.connected = time.perf_counter()
        elif event.name in TROUBLE:
            self.trouble = self.trouble or event.text


def main() -> int:
    """Run a robot; exit status 1 if it did not come to an end."""
    arguments = argparse.ArgumentParser(prog="python -m bench.demo.robot")
    arguments.add_argument("mission", type=Path)
    arguments.add_argument("--bag", type=Path, required=True)
    arguments.add_argument("--public", type=Path, required=True)
    arguments.add_argument("--expect", type=int, required=True, help="keyframes of the peer")
    arguments.add_argument("--listen")
    arguments.add_argument("--call", help="PEER=ADDRESS")
    options = arguments.parse_args()
    tune_process()
    with np.load(options.public) as public:
        verification = Verification(Background(public["mean"], public["whitening"]))
    clock, peers = Clock(), dict([options.call.split("=", 1)] if options.call else [])
    with Agent(
        options.mission, verify=verification, listen=options.listen, peers=peers, on_event=clock,
        state_dir=options.mission / "state",
    ) as agent:  # fmt: skip
        for keyframe, (vector, payload) in enumerate(read_bag(options.bag)):
            agent.add(keyframe, {DESCRIPTOR: vector}, payload)
        answer = _result(agent, clock, verification, options.expect)
        print(json.dumps(answer), flush=True)
        sys.stdin.read()
    return 1 if "error" in answer else 0


def _result(agent: Agent, clock: Clock, verification: Verification, expected: int) -> dict[str, Any]:
    """Wait for the end, then say what was found."""
    began = time.perf_counter()
    while True:
        (link,) = agent.status()["galleries"]
        all_held = link["held"] == link["keyframes"] and link["peer_held"] == expected
        if all_held and link["pairs"] == link["keyframes"] * expected and link["settled"]:
            break
        if clock.trouble or time.perf_counter() > began + LONGEST:
            return {"error": clock.trouble or f"not at an end after {LONGEST:.0f} s: {link['why']['text']}"}
        time.sleep(LOOK)
    last = {news.match: news for news in agent.matches(timeout=0.0, again=True)}
    nothing = Verdict(False)
    matches = []
    for one in last.values():
        said = verification.found.get((one.keyframe or 0, one.peer_keyframe or 0), nothing)
        matches.append([one.keyframe, one.peer_keyframe, one.state, one.why, said.transform, said.weight])
    return {
        "matches": matches,
        "bytes_sent": link["bytes_sent"],
        "rounds": link["rounds"],
        "ms": (time.perf_counter() - (clock.connected or began)) * 1e3,
        "shown_bytes": sum(verification.shown.values()),
        "shown": len(verification.shown),
        "verify_ms": sum(verification.seconds) * 1e3,
    }


if __name__ == "__main__":
    sys.exit(main())
