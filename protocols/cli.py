"""``python -m spdz match``: two terminals, two tapes, descriptors from ``.npy`` files."""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from protocols.catalog import Purpose
from protocols.matching import Matches, check, match
from spdz.connect import open_session
from spdz.errors import SpdzError
from spdz.progress import progress_bar
from spdz.session import Session
from spdz.tape import Tape

_EPILOG = """\
example, in two terminals (either may start first):
  python -m spdz match --tape mission/alice/bob.tape --listen 127.0.0.1:9000 \\
      --descriptors a.npy --threshold 0.8
  python -m spdz match --tape mission/bob/alice.tape --connect 127.0.0.1:9000 \\
      --descriptors b.npy --threshold 0.8

Both robots learn which pairs of descriptors match (and how many descriptors the other has), nothing else.
Exit status: 0 done, 1 the run failed, 2 bad input; with --json an error is one JSON object as well.
"""


def add_match(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the ``match`` command."""
    arguments = commands.add_parser(
        "match",
        help="compare descriptors with another robot",
        description="Compare all of this robot's descriptors with all of another robot's, privately.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = arguments.add_argument
    add("--tape", type=Path, required=True, help="this robot's tape for the other robot")
    where = arguments.add_mutually_exclusive_group(required=True)
    where.add_argument("--listen", metavar="HOST:PORT", help="accept the other robot here")
    where.add_argument("--connect", metavar="HOST:PORT", help="reach the other robot there")
    add("--descriptors", type=Path, required=True, metavar="FILE.npy", help="array of shape (n, N)")
    add("--threshold", type=float, help="public; the same on both sides (omit if the tapes reveal scores)")
    add("--credentials", type=Path, metavar="DIR", help="folder of the certificates (default: the tape's)")
    add("--wait", type=float, default=60.0, metavar="S", help="seconds to wait for the other robot (60)")
    add("--timeout", type=float, default=30.0, metavar="S", help="seconds that one round may take (30)")
    add("--state-dir", type=Path, metavar="DIR", help="where used tapes are recorded a second time")
    add(
        "--insecure-plain-tcp",
        action="store_true",
        help="no TLS: anybody on the network can pose as a robot; for closed test networks only",
    )
    add("--json", action="store_true", help="one JSON object on standard output")
    add("--quiet", action="store_true", help="no progress bar")
    arguments.set_defaults(run=run_match)


def load_descriptors(path: Path) -> npt.NDArray[Any]:
    """Read an array from a ``.npy`` file; pickled objects are refused."""
    try:
        array = np.load(path, allow_pickle=False)
    except OSError as error:
        raise ValueError(f"cannot read descriptors from {path}: {error.strerror or error}") from None
    except (ValueError, EOFError):
        raise ValueError(
            f"cannot read descriptors from {path}: not a .npy file of numbers (write one with numpy.save)"
        ) from None
    if not isinstance(array, np.ndarray):
        raise ValueError(f"cannot read descriptors from {path}: an .npz; save one array with numpy.save")
    return array


def run_match(options: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    try:
        descriptors = load_descriptors(options.descriptors)
        state_dir = options.state_dir
        with Tape.open(options.tape, state_dir=state_dir) as tape:
            check(tape.header, descriptors, options.threshold)
            if not options.quiet:
                where = f"on {options.listen}" if options.listen else f"at {options.connect}"
                print(f"waiting for {tape.header.peer} {where}, up to {options.wait:g} s", file=sys.stderr)
        with open_session(
            options.tape,
            listen=options.listen,
            connect=options.connect,
            credentials=options.credentials,
            insecure=options.insecure_plain_tcp,
            wait=options.wait,
            timeout=options.timeout,
            state_dir=state_dir,
        ) as session:
            if session.rolled_back:
                print("note: this tape is an older copy of itself; its used part is skipped", file=sys.stderr)
            started = time.perf_counter()
            with progress_bar("comparing", quiet=options.quiet) as report:
                matches = match(session, descriptors, options.threshold, progress=report)
            _print(options, session, matches, time.perf_counter() - started)
    except (SpdzError, ValueError, OSError) as error:
        status = 1 if isinstance(error, SpdzError) else 2
        if options.json:
            print(json.dumps({"error": type(error).__name__, "message": str(error)}))
        else:
            print(f"python -m spdz match: {type(error).__name__}: {error}", file=sys.stderr)
        return status
    return 0


def _print(options: argparse.Namespace, session: Session, matches: Matches, seconds: float) -> None:
    purpose = Purpose.from_json(session.header.program)
    bits = purpose.reveal == "bit"
    found = [(int(i), int(j)) for i, j in np.argwhere(matches.decisions)] if bits else []
    if options.json:
        summary = {
            "robot": session.header.name,
            "peer": session.header.peer,
            "security": session.header.security,
            "score": purpose.score,
            "threshold": options.threshold,
            "shape": list(matches.decisions.shape),
            "ms": round(seconds * 1e3, 3),
            "jobs": matches.jobs,
            "jobs_left": session.remaining,
            **matches.stats.as_dict(),
        }
        summary |= {"matches": found} if bits else {"scores": matches.decisions.tolist()}
        print(json.dumps(summary))
        return
    own, theirs = matches.decisions.shape
    if bits:
        for i, j in found:
            print(f"match: {session.header.name} {i}  {session.header.peer} {j}")
        print(f"{len(found)} of {own} x {theirs} pairs match ({purpose.score}, {session.header.security})")
    else:
        for i, row in enumerate(matches.decisions):
            print(f"{session.header.name} {i}: " + " ".join(f"{score:.6g}" for score in row))
    print(
        f"{seconds * 1e3:.1f} ms, {matches.stats.bytes_sent / 1e6:.3f} MB sent, {matches.stats.rounds} "
        f"rounds; {session.remaining} jobs left on the tape"
    )
