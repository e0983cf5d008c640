"""The dealer's command line."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from dealer import report
from dealer.mission import check_agents, deal_mission, mission_bytes
from dealer.plan import (
    Impossible,
    TilePlan,
    advice,
    jobs_for,
    pick,
    plan_maps,
    plan_tile,
    with_dealing_seconds,
)
from dealer.report import Wanted
from protocols.catalog import Purpose
from protocols.scores import SCORES
from spdz.arithmetic.fixed_point import MAX_NORM
from spdz.console.command import CommandParser, run_command, say_error, wants_json
from spdz.console.progress import progress_bar
from spdz.version import __version__

_NAME = "python -m spdz.dealer"
_SPARE = 3  # interruptions that maps are dealt for unless the user says otherwise

_EPILOG = """\
examples:
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
        prog=_NAME,
        description="Deal what robots need to compare descriptors privately on a mission: one folder a "
        "robot, with a tape of one-time correlations for every other robot and a certificate.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = arguments.add_argument
    add(
        "--agents",
        nargs="+",
        required=True,
        metavar="NAME",
        help="two or more robots; every pair is dealt; the one that is named earlier is the pair's first",
    )
    add("--score", type=score, required=True, metavar="S", help="score function, S1 to S10 (see below)")
    add("--dim", type=int, required=True, metavar="N", help="length of a descriptor")
    amount = arguments.add_mutually_exclusive_group(required=True)
    amount.add_argument("--count", type=int, metavar="C", help="comparisons for every pair of robots")
    amount.add_argument(
        "--maps",
        type=tile,
        metavar="MxK",
        help="instead of --count (and --tile): at most M descriptors of a pair's first robot meet at most K "
        "of its second, all with all (--agents alice bob --maps 200x300: 200 of alice's, 300 of bob's). A "
        "larger map costs a whole row of tiles more",
    )
    add("--meetings", type=int, metavar="N", help="how many times such maps are matched (default 1)")
    add(
        "--spare",
        type=int,
        metavar="S",
        help="deal spare jobs for S interruptions of the radio, in all meetings together (default "
        f"{_SPARE} with --maps, 0 with --count; 0: none). One interruption costs the jobs under way, at most "
        "twice those that share rounds; the plan says how many",
    )
    add(
        "--security",
        choices=("malicious", "semi-honest"),
        default="malicious",
        help="malicious (default): a robot that deviates is caught; semi-honest: robots that follow the "
        "protocol learn nothing, one that deviates can falsify results",
    )
    add(
        "--reveal",
        choices=("bit", "score"),
        default="bit",
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
        default=MAX_NORM,
        metavar="R",
        help="largest L2 norm of a descriptor (default 2^22; 1 for normalised descriptors makes tapes for "
        "bits less than half as large)",
    )
    add("--plan", action="store_true", help="show what it will cost, tile by tile; deal and write nothing")
    add("--out", type=Path, metavar="DIR", help="folder to write the robots' folders into; made if missing")
    add("--json", action="store_true", help="print JSON instead of text: one object, or one for each tile")
    add("--quiet", action="store_true", help="no progress bar and no notes")
    add("--version", action="version", version=f"spdz {__version__}")
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    """Run the dealer; returns the exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    return run_command(_NAME, lambda: _run(words), as_json=wants_json(words))


def _run(words: Sequence[str]) -> int:
    arguments = parser()
    options = arguments.parse_args(words)
    if options.out is None and not options.plan:
        arguments.error("say where to write with --out DIR, or ask for a --plan")
    if options.meetings is not None and options.maps is None:
        arguments.error("--meetings says how many times --maps meet: give --maps, or a larger --count")
    try:
        check_agents(options.agents)
        if options.count is not None and options.count < 1:
            raise ValueError("deal at least one comparison")
        purpose = Purpose(
            score=options.score,
            dim=options.dim,
            reveal=options.reveal,
            tile=options.tile or (1, 1),
            max_norm=options.max_norm,
        )
        _note(options, advice(purpose, options.security))
        if options.plan:
            _show(options, purpose)
        else:
            _deal(options, purpose)
    except (ValueError, OSError) as error:
        say_error(_NAME, type(error).__name__, _sentence(error), as_json=options.json)
        return 2
    return 0


def _sentence(error: Exception) -> str:
    """What the system says of a file, without its number and Python's quotes."""
    if isinstance(error, OSError) and error.strerror and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return str(error)


def _note(options: argparse.Namespace, text: str | None) -> None:
    if text is not None and not options.quiet:
        print(f"note: {text}", file=sys.stderr)


def _wanted(options: argparse.Namespace) -> Wanted:
    spare = options.spare if options.spare is not None else _SPARE * (options.maps is not None)
    meetings = 1 if options.meetings is None else options.meetings
    return Wanted(options.agents, options.maps, meetings, spare)


def _plans(
    options: argparse.Namespace, purpose: Purpose
) -> tuple[list[TilePlan | Impossible], TilePlan, str]:
    """All plans, the picked one, and why."""
    wanted = _wanted(options)
    room = {"meetings": wanted.meetings, "interruptions": wanted.interruptions}
    if options.maps is not None and options.tile is None:
        plans = plan_maps(options.agents, purpose, options.maps, options.security, **room)
        return plans, *pick(plans)
    jobs = (
        -(-options.count // purpose.pairs) if options.maps is None else jobs_for(options.maps, purpose.tile)
    )
    plan = plan_tile(options.agents, purpose, jobs, options.maps, options.security, **room)
    return [plan], plan, "the tile that was given" if options.tile else "the default; --tile gives another"


def _show(options: argparse.Namespace, purpose: Purpose) -> None:
    plans, picked, why = _plans(options, purpose)
    plans = with_dealing_seconds(plans, purpose, options.security)
    if options.json:
        lines = report.as_json(plans, picked, why, purpose, options.security)
    else:
        dealt = replace(purpose, tile=picked.tile)
        total = mission_bytes(options.agents, dealt, picked.comparisons, options.security)
        lines = report.as_text(plans, picked, why, purpose, options.security, _wanted(options), total)
    for line in lines:
        print(line, flush=True)


def _deal(options: argparse.Namespace, purpose: Purpose) -> None:
    started = time.perf_counter()
    wanted = _wanted(options)
    _, picked, why = _plans(options, purpose)
    purpose, count = replace(purpose, tile=picked.tile), picked.comparisons
    if options.maps is not None:
        _note(options, f"jobs of {picked.tile[0]} x {picked.tile[1]} descriptors: {why}")
    size = mission_bytes(options.agents, purpose, count, options.security)
    if size > 100e6:
        _note(options, f"writing about {size / 1e9:.1f} GB in all")
    with progress_bar("dealing", quiet=options.quiet) as progress:
        dealt = deal_mission(options.out, options.agents, purpose, count, options.security, progress=progress)
    seconds = time.perf_counter() - started
    if options.json:
        print(
            json.dumps(
                {
                    "comparisons": dealt.comparisons,
                    "jobs": dealt.jobs,
                    "spare_jobs": picked.spare_jobs,
                    "meetings": wanted.meetings if wanted.maps else None,
                    "interruptions": wanted.interruptions,
                    "pairs": dealt.pairs,
                    "tile": list(purpose.tile),
                    "security": options.security,
                    "seconds": round(seconds, 3),
                    "bytes": {str(folder): size for folder, size in dealt.folders.items()},
                }
            )
        )
        return
    each = f"{dealt.comparisons} comparisons in {dealt.jobs} jobs for each of {dealt.pairs} pair(s) of robots"
    print(f"dealt {each}, {options.security}, in {seconds:.1f} s")
    for folder, size in dealt.folders.items():
        print(f"  {folder}: {size / 1e6:.3f} MB")
    print(report.enough_for(picked, wanted))
    print("copy each folder to its robot, and keep no other copy of it")


if __name__ == "__main__":
    sys.exit(main())
