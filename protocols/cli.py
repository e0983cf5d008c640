"""``python -m spdz match``: two terminals, two tapes, descriptors from ``.npy`` files."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path

import numpy as np

from protocols.batch import Matches
from protocols.catalog import Purpose, threshold_warning
from protocols.descriptors import load_descriptors
from protocols.gallery_cli import run_gallery, say
from protocols.matcher import Matcher
from spdz.console.command import say_error
from spdz.console.progress import progress_bar
from spdz.foundations.errors import SpdzError, TapeDestroyed, TapeExhausted, TapeInUse
from spdz.tape.envelope import is_gallery

_EPILOG = """\
example, in two terminals (either may start first):
  python -m spdz match --tape mission/alice/bob.tape --listen 127.0.0.1:9000 \\
      --descriptors a.npy --threshold 0.8
  python -m spdz match --tape mission/bob/alice.tape --connect 127.0.0.1:9000 \\
      --descriptors b.npy --threshold 0.8

On a gallery's tape (dealt with --slots) give the map with what is new at its end, again and again: only pairs
that are new are compared, and a number is that of a slot of the gallery.

Both robots learn which pairs of descriptors match (and how many descriptors the other has), nothing else.
If the line breaks, both look for each other for --wait seconds and go on where they were. If that fails, or
Ctrl-C is pressed, what has been decided is printed all the same.
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
    add(
        "--threshold",
        type=float,
        metavar="T",
        help="public, the same on both sides: a match is a similarity of at least T, or a distance of at "
        "most T (squared for S5 and S6); leave it out if the tapes reveal scores",
    )
    add("--credentials", type=Path, metavar="DIR", help="folder of the certificates (default: the tape's)")
    add("--wait", type=float, default=60.0, metavar="S", help="seconds to look for the other robot (60)")
    add("--timeout", type=float, default=30.0, metavar="S", help="seconds that one round may take (30)")
    add("--state-dir", type=Path, metavar="DIR", help="where used tapes are recorded a second time")
    add(
        "--insecure-plain-tcp",
        action="store_true",
        help="no TLS: anybody on the network can pose as a robot; for closed test networks only",
    )
    add("--json", action="store_true", help="one JSON object on standard output")
    add(
        "--append",
        action="store_true",
        help="gallery: these descriptors are new, instead of the whole map with what is new at its end",
    )
    add("--all", action="store_true", help="gallery: print the matches of earlier runs as well")
    add("--quiet", action="store_true", help="no progress bar")
    arguments.set_defaults(run=run_match)


def run_match(options: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    if is_gallery(options.tape):
        return run_gallery(options)
    matcher = None
    try:
        descriptors = load_descriptors(options.descriptors)
        with progress_bar("comparing", quiet=options.quiet) as progress:
            matcher = Matcher(
                options.tape,
                options.threshold,
                listen=options.listen,
                connect=options.connect,
                credentials=options.credentials,
                insecure=options.insecure_plain_tcp,
                wait=options.wait,
                timeout=options.timeout,
                state_dir=options.state_dir,
                on_event=lambda sentence: say(sentence, options.quiet),
                progress=progress,
            )
            if matcher.rolled_back:
                say("note: this tape is an older copy of itself; its used part is skipped")
            matcher.check(descriptors)
            if len(descriptors) and not matcher.remaining:
                raise TapeExhausted(
                    f"every job of {options.tape} has been used; deal more: {matcher.header.dealer_command}"
                )
            if warning := threshold_warning(Purpose.from_json(matcher.header.program), options.threshold):
                say(f"warning: {warning}")
            say(f"{matcher.rule}: looking for {matcher.header.peer} for {options.wait:g} s", options.quiet)
            with closing(matcher):
                matcher.connect()
                started = time.perf_counter()
                matches = matcher.match(descriptors)
                seconds = time.perf_counter() - started
                try:
                    _print(options, matcher, matches, {"ms": round(seconds * 1e3, 3)})
                finally:
                    matcher.finish()
    except (SpdzError, ValueError, OSError, KeyboardInterrupt) as error:
        _print_failure(options, matcher, error)
        if isinstance(error, KeyboardInterrupt):
            raise
        unusable = matcher is None and not isinstance(error, (TapeInUse, TapeDestroyed))
        return 1 if isinstance(error, SpdzError) and not unusable else 2
    return 0


def _print_failure(options: argparse.Namespace, matcher: Matcher | None, error: BaseException) -> None:
    """Print what there is, and why there is no more."""
    partial = None if matcher is None else matcher.partial
    kind, message = type(error).__name__, str(error) or "stopped before the end"
    if matcher is not None and partial is not None and (partial.pairs or options.json):
        _print(options, matcher, partial, {"error": kind, "message": message} if options.json else {})
        if options.json:
            return
    if not isinstance(error, KeyboardInterrupt) or options.json:
        text = message if options.json else f"{kind}: {message}"
        say_error("python -m spdz match", kind, text, as_json=options.json)


def _span(positions: range) -> str:
    last = positions.stop - 1
    return f"{positions.start}" if positions.start == last else f"{positions.start} to {last}"


def _print(
    options: argparse.Namespace, matcher: Matcher, matches: Matches, more: Mapping[str, float | str]
) -> None:
    """Print a result, or what there is of it."""
    header = matcher.header
    purpose = Purpose.from_json(header.program)
    bits = purpose.reveal == "bit"
    own, theirs = matches.decisions.shape
    found = [(int(i), int(j)) for i, j in np.argwhere(matches.decisions)] if bits else []
    if options.json:
        summary = {
            "robot": header.name,
            "peer": header.peer,
            "security": header.security,
            "score": purpose.score,
            "threshold": options.threshold,
            "shape": [own, theirs],
            "decided": matches.pairs,
            "decided_blocks": [
                [rows.start, rows.stop, columns.start, columns.stop] for rows, columns in matches.blocks
            ],
            "jobs": matches.jobs,
            "jobs_left": matcher.remaining,
            **matches.stats.as_dict(),
            **more,
        }
        if bits:
            print(json.dumps(summary | {"matches": found}))
        else:
            scores = matches.decisions.astype(object)
            scores[~matches.decided] = None
            print(json.dumps(summary | {"scores": scores.tolist()}))
        return
    if bits:
        for i, j in found:
            print(f"match: {header.name} {i}  {header.peer} {j}")
        print(f"{len(found)} of {own} x {theirs} pairs match ({matcher.rule}, {header.security})")
    else:
        for i, row in enumerate(matches.decisions):
            known = zip(row, matches.decided[i], strict=True)
            print(
                f"{header.name} {i}: " + " ".join(f"{score:.6g}" if there else "?" for score, there in known)
            )
    if not matches.complete:
        print(f"only {matches.pairs} of {own * theirs} pairs were compared: broken off. These were:")
        for rows, columns in matches.blocks:
            print(f"  {header.name} {_span(rows)} with {header.peer} {_span(columns)}")
    spent = f"{more['ms']:.1f} ms, " if "ms" in more else ""
    print(
        f"{spent}{matches.stats.bytes_sent / 1e6:.3f} MB sent, {matches.stats.rounds} rounds; "
        f"{matcher.remaining} jobs left on the tape"
    )
