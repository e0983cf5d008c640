"""``python -m bench attacks``: what a compromised robot gains, with and without private comparisons."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from bench.out import out_folder
from spdz.console.command import CommandParser, run_command, say_error

NEEDS = ("rtb-data>=1.0", "matplotlib>=3.8.4")
"""What the attacks need beyond the engine; both are in the extra ``demo``."""

_EPILOG = """\
A compromised robot, Bob, against Alice, on the corridor scans of the demo:

  paths    where Alice was: from all her descriptors, broadcast as robots do today, and from this exchange,
           which tells him which pairs of keyframes match and reveals the descriptors of those
  scans    what Alice saw: a ridge regression from the descriptor back to the occupied cells around the place,
           fitted on Bob's own scans
  probes   what unit vectors of his choice tell him, bit by bit, on clear bits decided as the engine decides;
           that longer vectors, really sent by a modified robot, are refused by the proof of norm; what
           strikes leave

--out gets a picture of each and attacks.html, which needs no other file. Everything random has the seed.
Exit status: 0 done, 1 it failed, 2 bad arguments.

examples:
  python -m bench attacks
  python -m bench attacks --only probes --json
  python -m bench attacks --quick --out /tmp/attacks
"""


def parser() -> argparse.ArgumentParser:
    """The arguments of ``python -m bench attacks``."""
    arguments = CommandParser(
        prog="python -m bench attacks",
        description="Show what a compromised robot gains from descriptors, and from private comparisons.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = arguments.add_argument
    add("--only", choices=("paths", "scans", "probes"), help="one of the three")
    add(
        "--out",
        type=Path,
        default=Path("attacks-output"),
        metavar="DIR",
        help="for pictures and attacks.html",
    )
    add("--quick", action="store_true", help="fewer scans, targets and bits: rough figures in seconds")
    add("--seed", type=int, default=1, help="of everything random (1)")
    add("--json", action="store_true", help="one JSON object a line")
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    """Run the attacks; returns the exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    arguments = parser()
    options = arguments.parse_args(words)
    if options.seed < 0:
        arguments.error("--seed must not be negative")
    return run_command("python -m bench attacks", lambda: _run(options), as_json=options.json)


def _run(options: argparse.Namespace) -> int:
    name = "python -m bench attacks"
    try:
        from bench.attacks.page import write_page
        from bench.attacks.pictures import draw
        from bench.attacks.report import show
        from bench.attacks.run import FULL, PARTS, QUICK, run_attacks

        out_folder(options.out)
        parts = PARTS if options.only is None else (options.only,)
        found = run_attacks(parts, QUICK if options.quick else FULL, options.seed)
        draw(options.out, found)
        page = write_page(options.out, found)
    except ImportError as error:
        command = shlex.join([sys.executable, "-m", "pip", "install", *NEEDS])
        message = f"{error}. The attacks need more than the engine: {command}"
        say_error(name, "ImportError", message, as_json=options.json)
        return 1
    except (OSError, RuntimeError) as error:
        say_error(name, type(error).__name__, str(error), as_json=options.json)
        return 1
    if options.json:
        for row in found.rows():
            print(json.dumps(row))
        return 0
    print("\n".join(show(found)))
    print(f"\npictures and the whole report: {page}")
    return 0
