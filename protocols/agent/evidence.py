"""What an agent keeps of its peers: the matches, what was shown of them, and what is held against whom.

It is kept for people who want to know why a peer was stopped. It convinces nobody else: a MAC is checked with
a key of which either robot has a share, and no third one anything.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from protocols.agent.matches import Matches
from protocols.agent.news import News
from protocols.agent.records import FILE, Records
from protocols.agent.strikes import Strikes
from protocols.mission import Folder
from spdz.console.command import say_error

NAME = "python -m spdz evidence"


def add_evidence(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the ``evidence`` command."""
    arguments = commands.add_parser(
        "evidence",
        help="what an agent has seen of its peers: matches, what they showed, strikes",
        description="Lists an agent's matches and every peer's strikes; with --out it writes what peers have "
        "shown. The agent must not be running.",
        epilog="It convinces nobody but you: MACs are no signatures.",
    )
    add = arguments.add_argument
    add(
        "--mission", type=Path, required=True, metavar="DIR", help="the robot's folder, such as mission/alice"
    )
    add("--peer", metavar="NAME", help="of one peer alone")
    add(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="write MATCH.npz with the keyframe, vector and payload that the peer has shown",
    )
    add("--json", action="store_true", help="one JSON object a line")
    arguments.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    try:
        folder = Folder.open(options.mission)
        peers = folder.peers if options.peer is None else [options.peer]
        if not set(peers) <= set(folder.peers):
            raise ValueError(f"{options.peer!r:.40} is no peer of {folder.robot}: {', '.join(folder.peers)}")
        if not (folder.path / FILE).exists():
            raise ValueError(f"no agent has worked in {folder.path} yet")
        records = Records(folder.path, folder.mission_id)
    except (ValueError, OSError) as error:
        say_error(NAME, type(error).__name__, str(error), as_json=options.json)
        return 2
    try:
        for entry in evidence(records, peers):
            print(json.dumps(entry) if options.json else _text(entry), flush=True)
        if options.out is not None:
            options.out.mkdir(mode=0o700, parents=True, exist_ok=True)
            write(records, peers, options.out)
    finally:
        records.close()
    return 0


def evidence(records: Records, peers: list[str]) -> Iterator[dict[str, Any]]:
    """The last news of every match, then every strike; JSON-ready."""
    last = {one.match: one for one in News(records).after(0, 1 << 60) if one.peer in peers}
    for one in last.values():
        yield {
            "match": one.match,
            "peer": one.peer,
            "gallery": one.gallery,
            "keyframe": one.keyframe,
            "peer_keyframe": one.peer_keyframe,
            "state": one.state,
            "why": one.why,
            "peer_state": one.peer_state,
        }
    for peer in peers:
        for why in Strikes(records, peer).reasons:
            yield {"strike": peer, "why": why}


def write(records: Records, peers: list[str], out: Path) -> None:
    """Write a file for every match whose other half was shown."""
    query = "SELECT match, peer, gallery, peer_slot FROM matches JOIN links USING (link)"
    for match, peer, gallery, slot in records.all(query):
        theirs = Matches(records, peer, gallery).theirs(slot) if peer in peers else None
        if theirs is not None and theirs.vector is not None:
            payload = np.frombuffer(theirs.payload, dtype=np.uint8)
            np.savez(out / f"{match}.npz", keyframe=theirs.id, vector=theirs.vector, payload=payload)


def _text(entry: dict[str, Any]) -> str:
    if "strike" in entry:
        return f"strike: {entry['strike']}: {entry['why']}"
    theirs = "?" if entry["peer_keyframe"] is None else entry["peer_keyframe"]
    why = f" ({entry['why']})" if entry["why"] else ""
    said = f"; {entry['peer']} says {entry['peer_state']}" if entry["peer_state"] else ""
    return (
        f"match {entry['match']}: {entry['gallery']} keyframe {entry['keyframe']} and "
        f"{entry['peer']}'s {theirs}: {entry['state']}{why}{said}"
    )
