"""``python -m spdz agent``: a robot's agent as a process of its own."""

from __future__ import annotations

import argparse
import json
import signal
import sys
import threading
import time
from pathlib import Path
from types import FrameType

from protocols.agent.agent import Agent
from protocols.agent.events import MATCH_STATES, Event
from protocols.agent.folder_watch import FolderWatch
from protocols.agent.lines import Given, read_line, standard_input
from protocols.agent.metrics import write_metrics
from protocols.agent.options import add_agent_options, peer_address, say_event, verify_function, write_line
from protocols.agent.status_line import StatusLine
from spdz.console.command import say_error
from spdz.foundations.errors import SpdzError

NAME = "python -m spdz agent"
_POLL = 0.1
"""Seconds between looks at a watched folder."""
_METRICS_EVERY = 2.0

_EPILOG = """\
Keyframes come from Python (docs/how-to.md), from a folder (--watch) or as JSON lines (--stdin):
  {"keyframe": 17, "stamp": 1.5, "descriptors": {"lidar": [0.1, ...]}, "payload": "<base64>"}
A watched folder takes 17.npz (an array for each descriptor; perhaps payload and stamp), 17.npy (where the
plan has one descriptor) and files of such lines. A file that is half written is read when it is whole.

Matches are printed one a line, with --json as JSON, each once over all restarts:
  candidate   the descriptors match: both robots now show each other this one keyframe, and nothing else
  verified    --verify has accepted it (without --verify: the peer has shown its half)
  rejected    --verify has not; withheld: the peer has not shown its half. Both are strikes.

examples, in three terminals, after `python -m spdz.dealer mission.toml --out mission/`:
  python -m spdz agent --mission mission/alice --watch alice-keyframes/
  python -m spdz agent --mission mission/bob --watch bob-keyframes/ --peer alice=192.168.1.10:9000
  python -m spdz agent --mission mission/carol --stdin --json < carol.jsonl
"""


def add_agent(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the ``agent`` command."""
    arguments = commands.add_parser(
        "agent",
        help="stream keyframes, match them with all peers, and verify what matches",
        description="Runs one robot of a mission: takes keyframes, compares their descriptors\n"
        "privately with those of all peers, shows them the keyframes of what matches, and goes on\n"
        "after lost links and restarts.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = arguments.add_argument
    add_agent_options(add)
    add("--watch", type=Path, metavar="FOLDER", help="take keyframes from a folder")
    add("--stdin", action="store_true", help="take keyframes as JSON lines from standard input")
    add("--strikes", type=int, metavar="N", help="strikes until a peer is stopped (default: the plan's)")
    add("--forgive", metavar="PEER", help="forget a stopped peer's strikes and go on with it")
    add("--again", action="store_true", help="print all matches of earlier runs as well")
    add(
        "--grace", type=float, default=30.0, metavar="S", help="seconds a peer may take to show its half (30)"
    )
    add("--timeout", type=float, default=30.0, metavar="S", help="seconds that one round may take (30)")
    add("--for", dest="seconds", type=float, metavar="S", help="end after so many seconds (default: Ctrl-C)")
    add(
        "--until-quiet",
        dest="quiet_seconds",
        type=float,
        metavar="S",
        help="end when nothing new has come for so many seconds, and nothing waits for a peer that is there",
    )
    add("--state-dir", type=Path, metavar="DIR", help="where the second record of what was used is kept")
    add(
        "--metrics",
        type=Path,
        metavar="FILE",
        help="keep numbers for machines in a file (Prometheus' text format)",
    )
    add("--json", action="store_true", help="every event and match as one JSON object a line")
    add("--quiet", action="store_true", help="matches alone")
    arguments.set_defaults(run=run_agent)


def run_agent(options: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    try:
        for name, seconds in (("--for", options.seconds), ("--until-quiet", options.quiet_seconds)):
            if seconds is not None and not seconds > 0:
                raise ValueError(f"{name} takes a positive number of seconds, not {seconds:g}")
        agent = Agent(
            options.mission,
            verify=verify_function(options.verify),
            listen=options.listen,
            peers=dict(map(peer_address, options.peer)),
            strikes=options.strikes,
            forgive=() if options.forgive is None else (options.forgive,),
            grace=options.grace,
            timeout=options.timeout,
            state_dir=options.state_dir,
        )
    except (ValueError, OSError, SpdzError) as error:
        say_error(NAME, type(error).__name__, str(error), as_json=options.json)
        return 1 if isinstance(error, SpdzError) else 2
    with agent:
        _Run(agent, options).until_the_end()
    return 0


class _Run:
    """An agent at work in the foreground."""

    def __init__(self, agent: Agent, options: argparse.Namespace) -> None:
        self._agent, self._options = agent, options
        self._ended = threading.Event()
        self._line = StatusLine(quiet=options.quiet or options.json)
        self._state: list[tuple[str, int, int, int]] = []
        self._since = time.monotonic()
        self._taken: list[int] = []  # since it was last told

    def until_the_end(self) -> None:
        """Feed it and print what it tells until it is to end."""
        agent, options = self._agent, self._options
        for name in (signal.SIGINT, signal.SIGTERM):
            signal.signal(name, self._end)
        threads = [threading.Thread(target=self._print_events, daemon=True)]
        if options.watch is not None:
            threads.append(threading.Thread(target=self._watch, daemon=True))
        if options.stdin:
            threads.append(threading.Thread(target=self._read, daemon=True))
        for thread in threads:
            thread.start()
        deadline = None if options.seconds is None else time.monotonic() + options.seconds
        numbers_due = 0.0
        while not self._ended.is_set():
            self._print_matches(_POLL)
            now = time.monotonic()
            if now >= numbers_due:
                numbers_due = now + _METRICS_EVERY
                self._show_numbers()
            if (deadline is not None and now >= deadline) or self._is_quiet(now):
                break
        agent.stop()
        self._print_matches(0.05)
        self._line.clear()
        self._report()

    def _end(self, number: int, frame: FrameType | None) -> None:
        self._ended.set()

    # -- what it is given ----------------------------------------------------------------------------

    def _add(self, given: Given) -> None:
        self._agent.add(given.keyframe, given.descriptors, given.payload, given.stamp)
        self._taken.append(given.keyframe)

    def _refuse(self, why: str) -> None:
        self._show(Event("refused", why))

    def _watch(self) -> None:
        names = [one.name for one in self._agent.folder.mission.descriptors]
        only = names[0] if len(names) == 1 else None
        folder = self._options.watch
        watch, told = FolderWatch(folder, only, self._add, self._refuse), ""
        while not self._ended.is_set():
            trouble = "" if folder.is_dir() else f"{folder} is no folder (yet): waiting for it"
            try:
                watch.look()
            except OSError as error:
                trouble = trouble or f"the folder {folder} cannot be read: {error.strerror or error}"
            if trouble and trouble != told:
                self._refuse(trouble)
            told = trouble
            self._ended.wait(_POLL)

    def _read(self) -> None:
        number = 0
        try:
            for line in standard_input():
                number += 1
                if self._ended.is_set():
                    return
                if line.strip():
                    self._take(number, line)
        except (OSError, ValueError) as error:
            self._refuse(f"standard input ends at line {number}: {error}")

    def _take(self, number: int, line: bytes) -> None:
        try:
            self._add(read_line(line))
        except (ValueError, OSError) as error:
            self._refuse(f"line {number} is left out: {error}")

    def _is_quiet(self, now: float) -> bool:
        """Whether nothing new has come for as long as was asked for, and nothing waits for who is there."""
        if self._options.quiet_seconds is None:
            return False
        galleries = self._agent.status()["galleries"]
        state = [(one["state"], one["keyframes"], one["held"], one["peer_held"]) for one in galleries]
        busy = any(one["state"] == "connected" and not one["settled"] for one in galleries)
        if busy or state != self._state:
            self._state, self._since = state, now
        return bool(now - self._since >= self._options.quiet_seconds)

    # -- what it tells -------------------------------------------------------------------------------

    def _print_matches(self, seconds: float) -> None:
        for match in self._agent.matches(seconds, again=self._options.again):
            self._line.clear()
            as_json = self._options.json
            write_line(sys.stdout, json.dumps(Event.of(match).as_json()) if as_json else str(match))
        self._options.again = False

    def _print_events(self) -> None:
        for event in self._agent.events():
            if event.name not in MATCH_STATES:
                self._show(event)

    def _show(self, event: Event) -> None:
        self._line.clear()
        say_event(event, as_json=self._options.json, quiet=self._options.quiet)

    def _show_numbers(self) -> None:
        taken, self._taken = self._taken, []
        if taken:
            many = (
                f"{len(taken)} keyframes ({taken[0]} to {taken[-1]})" if taken[1:] else f"keyframe {taken[0]}"
            )
            self._show(Event("taken", f"took {many}", fields={"keyframes": len(taken)}))
        status = self._agent.status()
        self._line.show(status)
        if self._options.metrics is not None:
            try:
                write_metrics(self._options.metrics, status)
            except OSError as error:
                self._refuse(f"the metrics are not written: {error}")

    def _report(self) -> None:
        """Say at the end why nothing matched, where nothing did."""
        told = set[str]()
        for one in self._agent.status()["galleries"]:
            text, fields = one["why"]["text"], {"code": one["why"]["code"]}
            if text and (self._options.json or text not in told):
                told.add(text)
                self._show(Event("why", text, one["peer"], one["gallery"], fields))
