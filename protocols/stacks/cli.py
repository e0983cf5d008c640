"""``python -m spdz ros``: an agent on a robot's ROS graph; ``python -m spdz replay``: one fed from a bag."""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, TypeVar

from protocols.agent import Agent, Event, Match
from protocols.agent.options import add_agent_options, peer_address, say_event, verify_function, write_line
from protocols.mission import Folder
from protocols.stacks.bag import Bag
from protocols.stacks.bridge import Bridge
from protocols.stacks.dds import Dds
from protocols.stacks.messages import KEYFRAMES
from protocols.stacks.replay import Replay
from protocols.stacks.role import role_of
from protocols.stacks.swarm_slam import SwarmSlam
from protocols.stacks.topics import Topics, check_domain, remapped, topics
from protocols.stacks.transport import Transport
from protocols.stacks.zenoh import Zenoh
from spdz.console.command import say_error
from spdz.foundations.errors import SpdzError

Source = TypeVar("Source", Transport, Bag)

_REFUSED = "refused: "

_ROS = """\
Takes the place of Swarm-SLAM's loop-closure detection node: reads this robot's own descriptors
(cslam_common_interfaces/msg/GlobalDescriptors), compares them privately with those of the peers, and
publishes /cslam/inter_robot_matches and /cslam/inter_robot_loop_closure. No ROS is needed here.
docs/swarm-slam.md has topics, types and QoS, and what to change in a launch file.

DDS is bound to the loopback interface unless CYCLONEDDS_URI is set; a Zenoh session meets the robot's own
router unless ZENOH_SESSION_CONFIG_URI is set. Where the graph reaches other robots too, add --shared-graph.

example, for the robot whose nodes are in the namespace /r0:
  python -m spdz ros --mission mission/alice --namespace /r0 --verify my_verification:verify
"""

_REPLAY = """\
Reads cslam_common_interfaces/msg/GlobalDescriptors from a bag of ROS 2 (or ROS 1) and gives those of this
robot to its agent, at the pace of the recording. No ROS is needed.

example, in two terminals, with one bag in which both robots were recorded:
  python -m spdz replay run --mission mission/alice --speed 10 --listen 127.0.0.1:9000
  python -m spdz replay run --mission mission/bob --speed 10 --peer alice=127.0.0.1:9000
"""


def add_ros(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the ``ros`` command."""
    arguments = commands.add_parser(
        "ros",
        help="match a ROS 2 robot's keyframes privately, in place of Swarm-SLAM's detection node",
        description="Runs one robot's agent on its ROS 2 graph.",
        epilog=_ROS,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = arguments.add_argument
    add("--transport", choices=("dds", "zenoh"), default="dds", help="what the graph is on (dds)")
    add("--namespace", default="/", metavar="/r0", help="the robot's namespace (/)")
    add("--domain", type=int, metavar="N", help="the ROS domain (default: ROS_DOMAIN_ID, or 0)")
    add(
        "--remap",
        action="append",
        default=[],
        metavar="NAME:=TOPIC",
        help="another topic in the place of one, as in ROS; relative names are in the namespace",
    )
    add(
        "--keys",
        choices=("rmw", "bridge"),
        default="rmw",
        help="zenoh: rmw_zenoh's keys, or zenoh-bridge-ros2dds's",
    )
    add(
        "--announce",
        choices=("verified", "candidate"),
        default="verified",
        help="which matches are published",
    )
    add(
        "--shared-graph",
        action="store_true",
        help="the graph reaches other robots: one robot publishes a closure",
    )
    _add_common(add)
    arguments.set_defaults(run=run_ros)


def add_replay(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the ``replay`` command."""
    arguments = commands.add_parser(
        "replay",
        help="match recorded keyframes privately, from a ROS bag",
        description="Feeds one robot's agent from a bag.",
        epilog=_REPLAY,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = arguments.add_argument
    add("bag", type=Path, metavar="BAG", help="the bag's folder or file")
    add(
        "--topic",
        metavar="TOPIC",
        help="read descriptors from this topic alone (default: from all that have them)",
    )
    add("--speed", type=_speed, default=1.0, metavar="X", help="times the recorded pace, or max (1)")
    add(
        "--until-quiet",
        dest="quiet_seconds",
        type=float,
        default=10.0,
        metavar="S",
        help="after the last message, end when nothing new has come for so long, and every peer is settled "
        "or not connected (10)",
    )
    add("--for", dest="seconds", type=float, metavar="S", help="end after so many seconds, whatever is left")
    _add_common(add)
    arguments.set_defaults(run=run_replay)


def _add_common(add: Callable[..., Any]) -> None:
    add_agent_options(add)
    add("--descriptor", metavar="NAME", help="the plan's name of the descriptors (default: its only one)")
    add("--normalise", action="store_true", help="divide each descriptor by its norm: S10 is then the cosine")
    add(
        "--payload",
        choices=tuple(KEYFRAMES),
        help="what a peer is shown of a match: this message of the keyframe",
    )
    add("--json", action="store_true", help="every event and match as one JSON object a line")
    add("--quiet", action="store_true", help="matches alone")


def run_ros(options: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""

    def work(transport: Transport, agent: Agent, adapter: SwarmSlam, ended: threading.Event) -> None:
        names = _names(options)
        _tell(options, "joined", f"reading {names.descriptors}: {transport.where}")
        Bridge(
            agent,
            adapter,
            transport,
            names,
            say=lambda sentence: _tell(options, "waiting", sentence),
            show=lambda match: _show(options, match),
        ).run(ended)

    how = {"announce": options.announce, "shared": options.shared_graph}
    return _run(options, "python -m spdz ros", lambda: _transport(options), work, **how)


def run_replay(options: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""

    def work(bag: Bag, agent: Agent, adapter: SwarmSlam, ended: threading.Event) -> None:
        _tell(options, "reading", f"reading {', '.join(bag.topics)} of {bag.path}")
        replay = Replay(agent, adapter, options.speed, show=lambda match: _show(options, match))
        with _ending_after(options.seconds, ended):
            replay.feed(bag, ended)
            _tell(options, "fed", f"{adapter.counts['added']} keyframes of the bag are with the agent")
            replay.linger(options.quiet_seconds, ended)

    def bag() -> Bag:
        return Bag(options.bag, options.topic, _payload(options))

    return _run(options, "python -m spdz replay", bag, work, team=True)


@contextmanager
def _ending_after(seconds: float | None, ended: threading.Event) -> Iterator[None]:
    """Within the context ``ended`` is set after so many seconds, if any are given."""
    if seconds is None:
        yield
        return
    timer = threading.Timer(seconds, ended.set)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _run(
    options: argparse.Namespace,
    name: str,
    opened: Callable[[], Source],
    work: Callable[[Source, Agent, SwarmSlam, threading.Event], None],
    **how: Any,
) -> int:
    """Work with a source of keyframes and an agent, from the folder to the last sentence."""
    ended = threading.Event()
    try:
        folder = Folder.open(options.mission)
        role = role_of(folder.mission, folder.robot, options.descriptor)
        verify, peers = verify_function(options.verify), dict(map(peer_address, options.peer))
        with (
            closing(opened()) as source,
            Agent(options.mission, verify=verify, listen=options.listen, peers=peers) as agent,
        ):
            adapter = SwarmSlam(
                agent,
                role,
                normalise=options.normalise,
                payloads=options.payload is not None,
                on_event=lambda sentence: _tell(options, "refused", sentence),
                **how,
            )
            teller = threading.Thread(target=_tell_events, args=(agent, options), daemon=True)
            teller.start()
            for number in (signal.SIGINT, signal.SIGTERM):
                signal.signal(number, lambda *_: ended.set())
            work(source, agent, adapter, ended)
        teller.join(timeout=5.0)
        _report(options, adapter.report(agent.status()), adapter.untold)
    except (ValueError, OSError, SpdzError) as error:
        say_error(name, type(error).__name__, str(error), as_json=options.json)
        return 1 if isinstance(error, SpdzError) else 2
    return 0


def _names(options: argparse.Namespace) -> Topics:
    return topics(options.namespace, **remapped(options.remap))


def _transport(options: argparse.Namespace) -> Transport:
    names = _names(options)
    domain = options.domain
    if domain is None:
        text = os.environ.get("ROS_DOMAIN_ID", "0")
        if not (text.isascii() and text.isdigit()):
            raise ValueError(f"ROS_DOMAIN_ID is a number, not {text!r:.40}")
        domain = int(text)
    check_domain(domain)
    if options.transport == "zenoh":
        return Zenoh(names, domain, payload=_payload(options), keys=options.keys)
    return Dds(names, domain, payload=_payload(options))


def _payload(options: argparse.Namespace) -> type | None:
    return None if options.payload is None else KEYFRAMES[options.payload]


def _speed(text: str) -> float:
    try:
        return math.inf if text == "max" else float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected a number or max, not {text!r:.40}") from None


def _tell_events(agent: Agent, options: argparse.Namespace) -> None:
    from protocols.agent.events import MATCH_STATES

    for event in agent.events():
        if event.name not in MATCH_STATES:
            say_event(event, as_json=options.json, quiet=options.quiet)


def _tell(options: argparse.Namespace, name: str, sentence: str) -> None:
    say_event(Event(name, sentence), as_json=options.json, quiet=options.quiet)


def _show(options: argparse.Namespace, match: Any) -> None:
    shown: Match = match
    write_line(sys.stdout, json.dumps(Event.of(shown).as_json()) if options.json else str(shown))


def _report(options: argparse.Namespace, report: dict[str, Any], untold: int) -> None:
    if options.json:
        print(json.dumps({"event": "report", **report}), flush=True)
    elif not options.quiet:
        print(f"in all: {_counts(report['counts'], untold) or 'nothing came'}", file=sys.stderr)
        for peer, states in report["matches"].items():
            found = ", ".join(f"{count} {state}" for state, count in states.items())
            print(f"matches with {peer}: {found or 'none'}", file=sys.stderr)
        for why in report["why"].values():
            print(why["text"], file=sys.stderr)


def _counts(counts: Mapping[str, int], untold: int) -> str:
    """Counts in words; whatever was refused is one of them."""
    refused = sum(count for what, count in counts.items() if what.startswith(_REFUSED))
    told = [f"{count} {what}" for what, count in counts.items() if count and not what.startswith(_REFUSED)]
    more = f" ({untold} more than is told above)" if untold else ""
    return ", ".join([*told, *([f"{refused} refused{more}"] if refused else [])])
