"""What the commands that run an agent have in common: reading options, telling what happens."""

from __future__ import annotations

import importlib
import json
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, TextIO

from protocols.agent.events import Event
from protocols.agent.keyframe import Verify

_WRITING = threading.Lock()


def add_agent_options(add: Callable[..., Any]) -> None:
    """Add what every command that runs an agent takes."""
    add(
        "--mission",
        type=Path,
        required=True,
        metavar="DIR",
        help="this robot's folder, such as mission/alice",
    )
    add("--listen", metavar="HOST:PORT", help="the agent's one port for all peers (default: the plan's)")
    add(
        "--peer",
        action="append",
        default=[],
        metavar="NAME=HOST:PORT",
        help="where a peer listens, if not as planned",
    )
    add("--verify", metavar="MODULE:FUNCTION", help="what says whether two keyframes show the same place")


def peer_address(text: str) -> tuple[str, str]:
    """Read ``NAME=HOST:PORT``.

    Raises:
        ValueError: for anything else.
    """
    name, equals, address = text.partition("=")
    if not (name and equals and address):
        raise ValueError(f"--peer is NAME=HOST:PORT, such as alice=192.168.1.10:9000, not {text!r:.60}")
    return name, address


def verify_function(text: str | None) -> Verify | None:
    """Import ``MODULE:FUNCTION``; the current folder is looked in first.

    Raises:
        ValueError: if there is no such function.
    """
    if text is None:
        return None
    module, colon, name = text.partition(":")
    try:
        if not colon:
            raise ValueError("expected MODULE:FUNCTION")
        sys.path.insert(0, str(Path.cwd()))
        found: Any = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"--verify {text:.60}: {error}") from None
    if not callable(found):
        raise ValueError(f"--verify {text:.60} is not a function")
    verify: Callable[..., Any] = found
    return verify


def say_event(event: Event, *, as_json: bool, quiet: bool = False) -> None:
    """Tell an event: one JSON object on standard output, or a sentence on standard error."""
    if as_json:
        write_line(sys.stdout, json.dumps(event.as_json()))
    elif not quiet:
        write_line(sys.stderr, event.text)


def write_line(stream: TextIO, line: str) -> None:
    """Write a line as a whole: several threads do."""
    with _WRITING:
        stream.write(line + "\n")
        stream.flush()
