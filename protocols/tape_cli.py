"""``python -m spdz tape``: what tapes are for and what is left of them, without touching them."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from protocols.catalog import Purpose
from protocols.gallery_tape_cli import ID_DIGITS, gallery_facts, gallery_text, printable
from protocols.memory import in_bytes
from spdz.console.progress import progress_bar
from spdz.foundations.errors import TapeError
from spdz.gallery.status import gallery_status, verify_gallery
from spdz.tape import TapeHeader, TapeStatus, tape_status, verify_corrections
from spdz.tape.envelope import is_gallery

_LARGE = 50_000_000  # bytes of a file that takes long enough to read for a progress bar

_EPILOG = """\
examples:
  python -m spdz tape mission/alice/bob.tape      one tape
  python -m spdz tape mission/                    every tape below a folder
  python -m spdz tape --verify mission/           and read every job that is left, to find damage
  python -m spdz tape --json ~/mission | jq .comparisons_left

Public facts only, no key and nothing that was compared. The tape is not changed and not locked: look at it
while a robot uses it ("in use"). Both robots' tapes of a pair carry the same tape id; tapes and certificates
of two dealer runs (mission ids) do not mix.

A gallery's tape is shown with what its ledger and mark say of slots and pairs.

A job is used as a whole. "Left" counts what this robot may still use; when the two robots meet, both go on
from the one of them that has used more.

Only header, state and size are checked, which is quick: a tape with a damaged job is shown as "ready", and
the damage is found when a robot comes to that job. --verify reads all jobs that are left now, and all
records of a gallery: do it after copying a tape to its robot.

Exit status: 0, or 2 if a file is missing, damaged or no tape (the others are shown all the same).
"""


def add_tape(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the ``tape`` command."""
    arguments = commands.add_parser(
        "tape",
        help="show what a tape is for and what is left of it",
        description="Show what tapes are for, how many comparisons are left, and how to deal more.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = arguments.add_argument
    add("files", nargs="+", type=Path, metavar="FILE", help="tapes, or folders to look for tapes in")
    add("--state-dir", type=Path, metavar="DIR", help="where used tapes are recorded a second time")
    add("--verify", action="store_true", help="also read and check every job that is left, or record")
    add("--json", action="store_true", help="one JSON object a line, for each tape")
    arguments.set_defaults(run=run_tape)


def run_tape(options: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    result = 0
    for path in options.files:
        try:
            for tape in _tapes(path):
                try:
                    print(_shown_gallery(tape, options) if is_gallery(tape) else _shown_jobs(tape, options))
                except TapeError as error:
                    result = _refuse(tape, type(error).__name__, str(error), as_json=options.json)
        except OSError as error:
            result = _refuse(path, type(error).__name__, f"{path}: {error.strerror}", as_json=options.json)
    return result


def _shown_jobs(tape: Path, options: argparse.Namespace) -> str:
    status = tape_status(tape, options.state_dir)
    if options.verify:
        with progress_bar(f"verifying {tape}", quiet=status.size < _LARGE) as progress:
            verify_corrections(tape, status, progress)
    facts = _facts(tape, status) | {"verified": options.verify}
    return json.dumps(facts) if options.json else _text(tape, status, options.verify)


def _shown_gallery(tape: Path, options: argparse.Namespace) -> str:
    status = gallery_status(tape, options.state_dir)
    if options.verify:
        with progress_bar(f"verifying {tape}", quiet=status.size < _LARGE) as progress:
            verify_gallery(tape, progress)
    facts = gallery_facts(tape, status) | {"verified": options.verify}
    return json.dumps(facts) if options.json else gallery_text(tape, status, options.verify)


def _tapes(path: Path) -> Iterator[Path]:
    """The file itself, or all tapes below a folder."""
    if not path.is_dir():
        yield path
        return
    found = sorted(path.rglob("*.tape"))
    if not found:
        raise FileNotFoundError(2, "no *.tape in this folder")
    yield from found


def _refuse(path: Path, kind: str, message: str, *, as_json: bool) -> int:
    if as_json:
        print(json.dumps({"file": str(path), "error": kind, "message": message}))
    else:
        print(f"python -m spdz tape: {kind}: {message}", file=sys.stderr)
    return 2


def _purpose(header: TapeHeader) -> Purpose | None:
    """What the dealer's command dealt the tape for; None for programs of the user's own."""
    try:
        return Purpose.from_json(header.program)
    except (KeyError, TypeError, ValueError, OverflowError):
        return None


def _facts(path: Path, status: TapeStatus) -> dict[str, Any]:
    header, purpose = status.header, _purpose(status.header)
    facts: dict[str, Any] = {
        "file": str(path),
        "robot": header.name,
        "peer": header.peer,
        "agents": list(header.agents),
        "security": header.security,
        **(purpose.as_json() if purpose else {"program": header.program}),
        "jobs": header.jobs,
        "used": status.used,
        "left": status.left,
        "bytes": status.size,
        "mission": header.mission[:ID_DIGITS],
        "tape": header.tape[:ID_DIGITS],
        "in_use": status.in_use,
        "destroyed": status.destroyed,
        "rolled_back": status.rolled_back,
    }
    if purpose is not None:
        facts |= {"comparisons_left": status.left * purpose.pairs, "dealer_command": header.dealer_command}
    return facts


def _text(path: Path, status: TapeStatus, verified: bool) -> str:
    header, purpose = status.header, _purpose(status.header)
    lines = [
        f"{path}",
        f"  robot     {header.name}, to compare with {header.peer} (pair {' '.join(header.agents)})",
        f"  purpose   {_shown(header, purpose)}, {header.security}",
        f"  left      {_left(status, purpose)}",
        f"  state     {_state(status)}",
        f"  checked   header and state, {'and every job that is left' if verified else 'no job (--verify)'}",
        f"  file      {in_bytes(status.size)}, mission {header.mission[:ID_DIGITS]}, "
        f"tape {header.tape[:ID_DIGITS]}",
    ]
    if purpose is not None:
        lines += [f"  note      {purpose.hint}"] if purpose.hint and purpose.reveal == "bit" else []
        lines.append(f"  deal more {header.dealer_command}")
    return printable(lines)


def _shown(header: TapeHeader, purpose: Purpose | None) -> str:
    if purpose is None:
        return f"a program of your own, inputs of shapes {header.program.get('shapes')}"
    return purpose.summary


def _left(status: TapeStatus, purpose: Purpose | None) -> str:
    jobs = f"{status.left} of {status.header.jobs} jobs"
    if purpose is None:
        return jobs
    (first, second), (rows, columns) = status.header.agents, purpose.tile
    tile = f"{rows} of {first} x {columns} of {second}"
    return f"{status.left * purpose.pairs} comparisons in {jobs} ({tile} descriptors a job)"


def _state(status: TapeStatus) -> str:
    if status.destroyed:
        return "destroyed after a failed MAC check: deal a new pair of tapes, and ask why it failed"
    if status.in_use:
        return "in use by a process right now"
    if status.rolled_back:
        return "an older copy of itself, or a run was interrupted: the jobs in between count as used"
    return "used up" if not status.left else "unused" if not status.used else "ready"
