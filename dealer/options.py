"""The arguments of the dealer's command."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from dealer.team.options import add_mission
from protocols.catalog import parse_resolution
from protocols.scores import SCORES
from spdz.console.command import CommandParser
from spdz.version import __version__

NAME = "python -m spdz.dealer"
SPARE = 3  # interruptions that maps are dealt for unless the user says otherwise

_USAGE = """\
%(prog)s mission.toml (--out DIR | --plan)
       [--workers N | --scheduler ADDRESS [--tls-ca FILE --tls-cert FILE --tls-key FILE]]
   or: %(prog)s --agents NAME NAME ... --score S --dim N (--slots RxC | --maps MxK | --count C)
       (--out DIR | --plan) [options]"""

_DESCRIPTION = """\
Deal what robots need to compare descriptors privately on a mission: one folder a robot, with a tape of
one-time correlations for every other robot and a certificate."""

_EPILOG = """\
examples:
  a team, from a plan (docs/how-to.md): what it takes, and deal it; the same command goes on after a stop:
    python -m spdz.dealer mission.toml --plan
    python -m spdz.dealer mission.toml --out mission/

  100 comparisons of 1536-dimensional unit descriptors between two robots:
    python -m spdz.dealer --agents alice bob --score S10 --dim 1536 --count 100 --max-norm 1 --out mission/

  what it costs that alice's map of 200 and bob's of 300 descriptors meet once, tile by tile (writes nothing):
    python -m spdz.dealer --agents alice bob --score S10 --dim 1200 --maps 200x300 --max-norm 1 --plan

  and deal for it, with the tile that the plan marks:
    python -m spdz.dealer --agents alice bob --score S10 --dim 1200 --maps 200x300 --max-norm 1 --out mission/

  and for ten such meetings over a bad radio, with room for 20 interruptions in all:
    python -m spdz.dealer --agents alice bob --score S10 --dim 1200 --maps 200x300 --meetings 10 --spare 20 \\
        --max-norm 1 --out mission/

  three robots, every pair; jobs of 16 x 16 descriptors, which send each descriptor once:
    python -m spdz.dealer --agents alice bob carol --score S10 --dim 1200 \\
        --tile 16x16 --count 4096 --max-norm 1 --out mission/

  a gallery, for robots that bring descriptors as they drive: each of up to 300 of either robot is sent once
  and compared with all that the other has and will have; first what it costs, then deal:
    python -m spdz.dealer --agents alice bob --score S10 --dim 1536 --slots 300x300 --plan
    python -m spdz.dealer --agents alice bob --score S10 --dim 1536 --slots 300x300 --out mission/

  a gallery for Euclidean distances of unit vectors, where a zero vector must not pass as near to all:
    python -m spdz.dealer --agents alice bob --score S6 --dim 128 --slots 1000x500 --min-norm 0.99 \\
        --out mission/

scores (docs/scores.md); similarities match at or above the threshold, distances at or below it:
  S10 dot product, S7 S8 S9 cosine (similarities); S6 squared Euclidean, S4 Euclidean, S2 L1 (distances);
  S5 S3 S1 are S6 S4 S2 of descriptors that are normalised inside.
  Normalise on the robot if you can: then S10 is the cosine, and with --max-norm 1 by far the cheapest.
  S5 and S6 are *squared* distances: for a Euclidean threshold t give t*t to `python -m spdz match`.
  S1 and S2 store a key for each coordinate of each pair: see the plan first.

Give each robot its own folder (mission/alice, ...) and nothing else. Whoever holds two robots' folders,
or this machine's memory while it deals, can read what those two robots compare.
Exit status: 0 dealt or planned, 1 it failed, 2 bad input; with --json an error is one JSON object as well.
"""


def tile(text: str) -> tuple[int, int]:
    """Parse ``MxK``."""
    rows, cross, columns = text.lower().partition("x")
    digits = rows.isascii() and columns.isascii() and rows.isdigit() and columns.isdigit()
    if not (cross and digits and len(text) < 24 and int(rows) and int(columns)):
        raise argparse.ArgumentTypeError(f"expected MxK with positive numbers, such as 16x16, not {text!r}")
    return int(rows), int(columns)


def resolution(text: str) -> str:
    """A power of two, or ``exact``."""
    try:
        parse_resolution(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return text


def score(text: str) -> str:
    """A score by its identifier or the paper's name, in any case."""
    for known in SCORES.values():
        if text.lower() in (known.name.lower(), known.title.lower()):
            return known.name
    names = ", ".join(f"{known.name} {known.title}" for known in SCORES.values())
    raise argparse.ArgumentTypeError(f"there is no score {text!r}; there are {names} (docs/scores.md)")


def parser() -> argparse.ArgumentParser:
    """The arguments of ``python -m spdz.dealer``."""
    arguments = CommandParser(
        prog=NAME,
        usage=_USAGE,
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_mission(arguments)
    add = arguments.add_argument
    add(
        "--agents",
        nargs="+",
        metavar="NAME",
        help="two or more robots; every pair is dealt; the one that is named earlier is the pair's first",
    )
    add("--score", type=score, metavar="S", help="score function, S1 to S10 (see below)")
    add("--dim", type=int, metavar="N", help="length of a descriptor")
    amount = arguments.add_mutually_exclusive_group()
    amount.add_argument("--count", type=int, metavar="C", help="comparisons for every pair of robots")
    amount.add_argument(
        "--maps",
        type=tile,
        metavar="MxK",
        help="instead of --count (and --tile): at most M descriptors of a pair's first robot meet at most K "
        "of its second, all with all (--agents alice bob --maps 200x300: 200 of alice's, 300 of bob's). A "
        "larger map costs a whole row of tiles more",
    )
    amount.add_argument(
        "--slots",
        type=tile,
        metavar="RxC",
        help="instead of --count: a gallery for R descriptors of a pair's first robot and C of its second. "
        "They may come one by one, over as many meetings as it takes; each is sent once and compared with "
        "all of the other robot's",
    )
    add("--meetings", type=int, metavar="N", help="how many times such maps are matched (default 1)")
    add(
        "--spare",
        type=int,
        metavar="S",
        help="deal spare jobs for S interruptions of the radio, in all meetings together (default "
        f"{SPARE} with --maps, 0 with --count; 0: none). One interruption costs the jobs under way, at most "
        "twice those that share rounds; the plan says how many",
    )
    add(
        "--security",
        choices=("malicious", "semi-honest"),
        help="malicious (default): a robot that deviates is caught; semi-honest: robots that follow the "
        "protocol learn nothing, one that deviates can falsify results",
    )
    add(
        "--reveal",
        choices=("bit", "score"),
        help="what a comparison tells both robots: whether it is past a threshold (default), or the score",
    )
    add(
        "--tile",
        type=tile,
        metavar="MxK",
        help="descriptors of the first and of the second robot in one job (default 1x1; with --maps the "
        "one that the plan marks). A job is used as a whole; large tiles send each descriptor once for many "
        "comparisons",
    )
    add(
        "--max-norm",
        type=float,
        metavar="R",
        help="largest L2 norm of a descriptor (default 2^22, with --slots 1; 1 for normalised descriptors "
        "makes tapes for bits less than half as large)",
    )
    add(
        "--resolution",
        type=resolution,
        metavar="2^-F",
        help="with --slots: what of a score a comparison looks at (default 2^-16; or exact, which takes more "
        "tape). A score nearer to the threshold than half of it may be decided either way",
    )
    add(
        "--min-norm",
        type=float,
        metavar="R",
        help="with --slots or --norm-proof: smallest L2 norm of a descriptor (default 0)",
    )
    add(
        "--norm-proof",
        action="store_true",
        help="with --count or --maps: every job proves that its descriptors' norms are in range, as a "
        "gallery does once a descriptor; two rounds and two checks more, 2 KB of tape a descriptor",
    )
    add(
        "--no-norm-proof",
        action="store_true",
        help="with --slots: do not prove that every descriptor's norm is in range, as the malicious mode "
        "does; a peer may then probe with vectors of any length",
    )
    add("--plan", action="store_true", help="show what it will cost, tile by tile; deal and write nothing")
    add("--out", type=Path, metavar="DIR", help="folder to write the robots' folders into; made if missing")
    add("--json", action="store_true", help="print JSON instead of text: one object, or one for each tile")
    add("--quiet", action="store_true", help="no progress bar and no notes")
    add("--version", action="version", version=f"spdz {__version__}")
    return arguments


def misplaced(options: argparse.Namespace) -> str | None:
    """Why options that are right one by one do not go together, or None."""
    if options.slots is None:
        for name, given in (
            ("--resolution", options.resolution is not None),
            ("--min-norm", options.min_norm is not None and not options.norm_proof),
            ("--no-norm-proof", options.no_norm_proof),
        ):
            if given:
                return f"{name} is for galleries: give --slots as well, or leave it out"
        return None
    if options.norm_proof:
        return "--norm-proof is for jobs: a gallery proves norms unless --no-norm-proof says otherwise"
    if options.meetings is not None:
        return "--meetings is for maps: a gallery is there for as many as it takes, so leave it out"
    if options.tile is not None:
        return "--tile is for jobs: a gallery compares any descriptors, so leave it out"
    if options.spare is not None:
        return (
            "--spare is for jobs: a gallery goes on after an interruption (S3, S4, S8 and S9 without the "
            "results that it cut off), so leave it out"
        )
    return None


def note(options: argparse.Namespace, text: str | None) -> None:
    """A line for people, unless they asked for quiet."""
    if text is not None and not options.quiet:
        print(f"note: {text}", file=sys.stderr)
