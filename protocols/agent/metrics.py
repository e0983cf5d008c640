"""An agent's state as numbers for machines: the text format that Prometheus and its like read from a file."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

_GAUGES = {
    "keyframes": "Keyframes of this robot.",
    "held": "Slots that hold a descriptor of this robot's.",
    "peer_held": "Slots that hold a descriptor of the peer's.",
    "slots_left": "Slots that are left for this robot.",
    "pairs": "Pairs compared.",
    "strikes": "Matches that the peer has not followed with a keyframe that verifies.",
    "bytes_sent": "Bytes sent for comparisons since the agent began.",
    "rounds": "Rounds of comparisons since the agent began.",
}


def metrics(status: Mapping[str, Any]) -> str:
    """The text of a status."""
    return "\n".join(_lines(status)) + "\n"


def write_metrics(path: Path, status: Mapping[str, Any]) -> None:
    """Write them so that a reader sees the old file or the new one.

    Raises:
        OSError: if it cannot be written.
    """
    fresh = path.with_name(f".{path.name}.new")
    fresh.write_text(metrics(status))
    os.replace(fresh, path)


def _lines(status: Mapping[str, Any]) -> Iterator[str]:
    galleries = [(f'robot="{status["robot"]}",peer="{one["peer"]}",gallery="{one["gallery"]}"', one)
                 for one in status["galleries"]]  # fmt: skip
    for name, about in _GAUGES.items():
        yield f"# HELP spdz_{name} {about}"
        yield f"# TYPE spdz_{name} gauge"
        yield from (
            f"spdz_{name}{{{labels}}} {one[name]}" for labels, one in galleries if one[name] is not None
        )
    yield "# HELP spdz_connected Whether the peer is connected."
    yield "# TYPE spdz_connected gauge"
    yield from (f"spdz_connected{{{labels}}} {int(one['state'] == 'connected')}" for labels, one in galleries)
    yield "# HELP spdz_matches Matches by what became of them."
    yield "# TYPE spdz_matches gauge"
    for labels, one in galleries:
        yield from (
            f'spdz_matches{{{labels},state="{state}"}} {n}' for state, n in sorted(one["matches"].items())
        )
