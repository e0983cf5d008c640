"""The dealer's command line."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from dealer.mission import deal_mission, mission_bytes
from protocols.catalog import Purpose
from protocols.scores import SCORES
from spdz.command import run_command
from spdz.fixed_point import MAX_NORM
from spdz.progress import progress_bar

_EPILOG = """\
examples:
  100 comparisons of 1536-dimensional unit descriptors between two robots:
    python -m spdz.dealer --agents alice bob --score S10 --dim 1536 --count 100 --max-norm 1 --out mission/

  three robots, every pair; jobs of 16 x 16 descriptors, which send each descriptor once:
    python -m spdz.dealer --agents alice bob carol --score S10 --dim 1200 \\
        --tile 16x16 --count 4096 --max-norm 1 --out mission/

Give each robot its own folder (mission/alice, ...) and nothing else. Whoever holds two robots' folders,
or this machine's memory while it deals, can read what those two robots compare.
"""


def tile(text: str) -> tuple[int, int]:
    """Parse ``MxK``."""
    rows, cross, columns = text.lower().partition("x")
    if not (cross and rows.isdigit() and columns.isdigit() and int(rows) and int(columns)):
        raise argparse.ArgumentTypeError("expected MxK with positive numbers, such as 16x16")
    return int(rows), int(columns)


def parser() -> argparse.ArgumentParser:
    """The arguments of ``python -m spdz.dealer``."""
    arguments = argparse.ArgumentParser(
        prog="python -m spdz.dealer",
        description="Deal what robots need to compare descriptors privately on a mission: one folder a "
        "robot, with a tape of one-time correlations for every other robot and a certificate.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = arguments.add_argument
    add("--agents", nargs="+", required=True, metavar="NAME", help="two or more robots; every pair is dealt")
    add("--score", required=True, choices=SCORES, help="score function (see docs/scores.md)")
    add("--dim", type=int, required=True, metavar="N", help="length of a descriptor")
    add("--count", type=int, required=True, metavar="C", help="comparisons for every pair of robots")
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
        default=(1, 1),
        metavar="MxK",
        help="descriptors of the first and of the second robot in one job (default 1x1). A job is used as a "
        "whole; large tiles send each descriptor once for many comparisons",
    )
    add(
        "--max-norm",
        type=float,
        default=MAX_NORM,
        metavar="R",
        help="largest L2 norm of a descriptor (default 2^22; 1 for normalised descriptors makes tapes for "
        "bits less than half as large)",
    )
    add("--out", type=Path, required=True, metavar="DIR", help="folder to write the robots' folders into")
    add("--json", action="store_true", help="print one JSON object instead of text")
    add("--quiet", action="store_true", help="no progress bar")
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    """Run the dealer; returns the exit status."""
    return run_command("python -m spdz.dealer", lambda: _deal(argv))


def _deal(argv: Sequence[str] | None) -> int:
    arguments = parser()
    options = arguments.parse_args(argv)
    started = time.perf_counter()
    try:
        purpose = Purpose(
            score=options.score,
            dim=options.dim,
            reveal=options.reveal,
            tile=options.tile,
            max_norm=options.max_norm,
        )
        size = mission_bytes(len(options.agents), purpose, options.count, options.security)
        if size > 100e6 and not options.quiet:
            print(f"writing about {size / 1e9:.1f} GB in all", file=sys.stderr)
        with progress_bar("dealing", quiet=options.quiet) as report:
            dealt = deal_mission(
                options.out, options.agents, purpose, options.count, options.security, progress=report
            )
    except (ValueError, OSError) as error:
        if options.json:
            print(json.dumps({"error": type(error).__name__, "message": str(error)}))
        else:
            print(f"{arguments.prog}: {error}", file=sys.stderr)
        return 2
    seconds = time.perf_counter() - started
    if options.json:
        print(
            json.dumps(
                {
                    "comparisons": dealt.comparisons,
                    "jobs": dealt.jobs,
                    "pairs": dealt.pairs,
                    "security": options.security,
                    "seconds": round(seconds, 3),
                    "bytes": {str(folder): size for folder, size in dealt.folders.items()},
                }
            )
        )
        return 0
    each = f"{dealt.comparisons} comparisons in {dealt.jobs} jobs for each of {dealt.pairs} pair(s) of robots"
    print(f"dealt {each}, {options.security}, in {seconds:.1f} s")
    for folder, size in dealt.folders.items():
        print(f"  {folder}: {size / 1e6:.3f} MB")
    print("copy each folder to its robot, and keep no other copy of it")
    return 0


if __name__ == "__main__":
    sys.exit(main())
