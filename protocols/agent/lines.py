"""Keyframes as JSON: ``{"keyframe": 17, "descriptors": {"lidar": [...]}, "stamp": 1.5, "payload": ...}``."""

from __future__ import annotations

import base64
import binascii
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from protocols.agent.keyframe import check_id, is_stamp
from protocols.mission.fields import nearest, shown
from spdz.foundations.types import FloatArray

_FIELDS = ("keyframe", "descriptors", "payload", "stamp")
MAX_LINE = 64 << 20
"""Most bytes of a line."""


@dataclass(frozen=True, slots=True)
class Given:
    """A keyframe as a program or a file gives it: the arguments of :meth:`protocols.agent.Agent.add`."""

    keyframe: int
    descriptors: dict[str, FloatArray] = field(repr=False)
    payload: bytes = field(default=b"", repr=False)
    stamp: float | None = None


def read_line(line: str | bytes) -> Given:
    """Read one line.

    Raises:
        ValueError: saying what is wrong with it; numbers that are not finite are left to the agent to refuse.
    """
    try:
        entry = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"a line is not JSON: {error!s:.80}") from None
    if not isinstance(entry, dict):
        raise ValueError('a line is an object such as {"keyframe": 17, "descriptors": {"lidar": [0.1, ...]}}')
    for name in entry:
        if name not in _FIELDS:
            raise ValueError(f"a line has no {shown(name)}; {nearest(str(name), _FIELDS)}")
    for name in _FIELDS[:2]:
        if name not in entry:
            raise ValueError(f"a line needs {name}")
    number = check_id(entry["keyframe"])
    try:
        return Given(
            number, _arrays(entry["descriptors"]), _payload(entry.get("payload")), _stamp(entry.get("stamp"))
        )
    except ValueError as error:
        raise ValueError(f"keyframe {number}: {error}") from None


def standard_input() -> Iterator[bytes]:
    """The lines of standard input.

    Read past Python's buffer, which a thread that waits for input would hold locked when the process ends.

    Raises:
        ValueError: for a line that is too long.
    """
    rest = b""
    while octets := os.read(0, 1 << 16):
        *lines, rest = (rest + octets).split(b"\n")
        yield from lines
        if len(rest) > MAX_LINE:
            raise ValueError(
                f"a line of standard input is longer than {MAX_LINE >> 20} MiB: the rest is not read"
            )
    if rest:
        yield rest


def _arrays(value: Any) -> dict[str, FloatArray]:
    if not isinstance(value, dict) or not value:
        raise ValueError('descriptors are an object such as {"lidar": [0.1, ...]}')
    return {str(name): _array(name, numbers) for name, numbers in value.items()}


def _array(name: str, numbers: Any) -> FloatArray:
    try:
        array = np.asarray(numbers)
        if array.dtype.kind not in "if":
            raise ValueError
    except ValueError:
        raise ValueError(f"the descriptor {name!r:.40} is not an array of numbers") from None
    return array.astype(np.float64)


def _payload(value: Any) -> bytes:
    if value is None:
        return b""
    try:
        return base64.b64decode(value, validate=True)
    except (TypeError, ValueError, binascii.Error):
        raise ValueError("its payload is not base64") from None


def _stamp(value: Any) -> float | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not is_stamp(value):
        raise ValueError("its stamp is not a number of seconds")
    return float(value)
