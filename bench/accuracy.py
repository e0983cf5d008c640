"""``python -m bench accuracy``: how far a secure score is from the true one."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from bench.exact import exact_score, raw, units
from bench.inputs import KINDS, draw
from bench.recorded_accuracy import compare_with_recorded, print_recorded
from protocols.scores import SCORES, Score
from spdz.arithmetic.fixed_point import MAX_NORM
from spdz.console.command import CommandParser, run_command
from spdz.console.progress import Report, progress_bar
from spdz.foundations.types import FloatArray, Security
from spdz.local import run_local

SECURITIES: tuple[Security, ...] = ("malicious", "semi-honest")
JOB_COORDINATES = 1 << 14
"""At most about so many coordinates in one job, to bound memory."""

_EPILOG = """\
Dealer and both parties run in this process, on random pairs of descriptors. The opened score is compared
with the true score of the same quantised descriptors, computed with integers and square roots of 200 bits.
A unit is 2^-16, one step of the inputs. The error of rounding the inputs is not part of it. "Scaled" divides
the error by the score where the score is above 1.

kinds of pairs:
{kinds}

A kind is measured with every --max-norm that its vectors keep to.

examples:
  python -m bench accuracy --score S4 S7 --dim 16 1536
  python -m bench accuracy --kind near --max-norm 1 --json
  python -m bench accuracy --vectors tests/vectors/mp_spdz.json
"""


@dataclass(frozen=True, slots=True)
class AccuracyRow:
    """One cell: errors of so many random pairs, in units of 2^-16.

    ``max_scaled`` divides the error by the score where the score is above 1, as relative precision would.
    """

    score: str
    n: int
    kind: str
    max_norm: float
    security: str
    trials: int
    max_units: float
    mean_units: float
    max_scaled: float


def secure_scores(score: Score, x: FloatArray, y: FloatArray, security: Security) -> list[float]:
    """The opened score of each pair; x and y have shape (pairs, n)."""
    step = max(1, JOB_COORDINATES // x.shape[1])
    found: list[float] = []
    for start in range(0, len(x), step):
        rows = slice(start, start + step)
        found += np.asarray(run_local(score, x[rows], y[rows], security).value).ravel().tolist()
    return found


def exact_scores(name: str, x: FloatArray, y: FloatArray) -> list[Fraction]:
    """The true score of each quantised pair; x and y have shape (pairs, n)."""
    return [exact_score(name, raw(a), raw(b)) for a, b in zip(x, y, strict=True)]


def cells(options: argparse.Namespace) -> list[tuple[str, int, str, float, Security]]:
    """Score, length, kind, largest norm, and security of every cell that was asked for and can be."""
    return [
        (score, n, kind, max_norm, security)
        for score in options.score
        for n in options.dim
        for kind in options.kind
        for max_norm in options.max_norm
        for security in options.security
        if KINDS[kind].largest_norm(n) <= max_norm
    ]


def measure(options: argparse.Namespace, report: Report) -> Iterator[AccuracyRow]:
    """Measure every cell."""
    todo = cells(options)
    for done, (name, n, kind, max_norm, security) in enumerate(todo):
        report(done, len(todo))
        x, y = draw(kind, options.trials, n, options.seed)
        exact = exact_scores(name, x, y)
        values = secure_scores(SCORES[name].within(max_norm), x, y, security)
        errors = [units(value, true) for value, true in zip(values, exact, strict=True)]
        scaled = [error / max(1.0, abs(float(true))) for error, true in zip(errors, exact, strict=True)]
        yield AccuracyRow(
            name,
            n,
            kind,
            max_norm,
            security,
            trials=len(errors),
            max_units=round(max(errors), 4),
            mean_units=round(sum(errors) / len(errors), 4),
            max_scaled=round(max(scaled), 4),
        )


def parser() -> argparse.ArgumentParser:
    """The arguments of ``python -m bench accuracy``."""
    kinds = "\n".join(f"  {kind.name:9}{kind.what}" for kind in KINDS.values())
    arguments = CommandParser(
        prog="python -m bench accuracy",
        description="Measure how far secure scores are from the true ones.",
        epilog=_EPILOG.format(kinds=kinds),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = arguments.add_argument
    add("--score", nargs="+", default=list(SCORES), choices=SCORES, metavar="S", help="scores (all)")
    add("--dim", nargs="+", type=int, default=[1, 2, 16, 256, 1536, 8192], metavar="N", help="lengths")
    add("--kind", nargs="+", default=list(KINDS), choices=KINDS, metavar="KIND", help="see below (all)")
    add("--security", nargs="+", default=list(SECURITIES), choices=SECURITIES, help="models (both)")
    add("--max-norm", nargs="+", type=float, default=[1.0, MAX_NORM], metavar="R", help="norms (1 and 2^22)")
    add("--trials", type=int, default=8, help="random pairs a cell (8)")
    add("--seed", type=int, default=1, help="seed of the pairs (1)")
    add(
        "--vectors",
        type=Path,
        metavar="FILE",
        help="use recorded inputs instead, and compare with their outputs",
    )
    add("--json", action="store_true", help="one JSON object a line")
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    arguments = parser()
    options = arguments.parse_args(argv)
    if options.trials < 1 or min(options.dim) < 1 or options.seed < 0:
        arguments.error("--trials and --dim must be positive, and --seed not negative")
    if not all(0 < norm <= MAX_NORM for norm in options.max_norm):
        arguments.error(f"--max-norm must be above 0 and at most {MAX_NORM:.0f}")
    try:
        if options.vectors is not None:
            return run_command("python -m bench accuracy", lambda: _recorded(options))
        if not cells(options):
            arguments.error("no kind of pair keeps to this --max-norm; see --help")
        return run_command("python -m bench accuracy", lambda: _random(options))
    except (ValueError, OSError) as error:
        arguments.error(str(error))


def _recorded(options: argparse.Namespace) -> int:
    with progress_bar("measuring", quiet=options.json) as report:
        rows = list(compare_with_recorded(options.vectors, options.score, options.security, report))
    print_recorded(rows, as_json=options.json)
    return 0


def _random(options: argparse.Namespace) -> int:
    with progress_bar("measuring", quiet=options.json) as report:
        rows = []
        for row in measure(options, report):
            rows.append(row)
            if options.json:
                print(json.dumps(asdict(row)), flush=True)
    if not options.json:
        _print_table(rows)
        _print_summary(rows)
    return 0


def _print_table(rows: Sequence[AccuracyRow]) -> None:
    print(f"{'score':6}{'N':>6}  {'kind':9}{'max norm':>9}  {'security':12}", end="")
    print(f"{'trials':>6}{'largest':>10}{'mean':>9}{'scaled':>9}")
    for row in rows:
        print(
            f"{row.score:6}{row.n:6}  {row.kind:9}{row.max_norm:9.7g}  {row.security:12}"
            f"{row.trials:6}{row.max_units:10.3f}{row.mean_units:9.3f}{row.max_scaled:9.3f}"
        )


def _print_summary(rows: Sequence[AccuracyRow]) -> None:
    """The largest error of each score by kind, and the largest scaled one, in Markdown."""
    kinds = list(dict.fromkeys(row.kind for row in rows))
    print("\nLargest error of each kind, and scaled over all kinds, in units of 2^-16:\n")
    print("| " + " | ".join(["score", *kinds, "scaled"]) + " |\n|" + "---|" * (len(kinds) + 2))
    for score in dict.fromkeys(row.score for row in rows):
        own = [row for row in rows if row.score == score]
        largest = [max((row.max_units for row in own if row.kind == kind), default=None) for kind in kinds]
        shown = ["" if error is None else f"{error:.2f}" for error in largest]
        print("| " + " | ".join([score, *shown, f"{max(row.max_scaled for row in own):.2f}"]) + " |")


if __name__ == "__main__":
    sys.exit(main())
