"""``python -m bench oracle``: the same scores by MP-SPDZ, live, and the errors of both engines."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path

from bench.accuracy import exact_scores, secure_scores
from bench.exact import ONE, raw, units
from bench.inputs import KINDS, draw
from bench.mp_spdz import PROTOCOLS, VERSION, MpSpdz, MpSpdzError, MpSpdzMissing
from bench.mpc import BODIES
from protocols.scores import SCORES
from spdz.arithmetic.fixed_point import MAX_NORM
from spdz.console.command import CommandParser, run_command
from spdz.foundations.types import FloatArray

_EPILOG = f"""\
Needs MP-SPDZ {VERSION}, built, which this package neither contains nor installs. For each score a program is
written to its Programs/Source/spdz_S*.mpc, compiled, and run by two parties on this machine, with live
preprocessing, which takes from seconds to minutes a score (S1 and S3 to S9 divide or take roots in a prime of
192 or 256 bits). Both engines get the same quantised descriptors; ours runs in this process, in the same
security model: mascot is malicious, hemi is semi-honest.

Errors are in units of 2^-16 against the true score. MP-SPDZ rounds at random: its errors change with every
run.

examples:
  python -m bench oracle --mp-spdz ~/MP-SPDZ
  python -m bench oracle --mp-spdz ~/MP-SPDZ --score S4 S7 --dim 256 --protocol hemi --json
"""


@dataclass(frozen=True, slots=True)
class OracleRow:
    """Both engines on the same pairs: largest errors, and largest difference, in units of 2^-16."""

    score: str
    n: int
    kind: str
    protocol: str
    security: str
    pairs: int
    ours: float
    theirs: float
    apart: float


def compare(options: argparse.Namespace) -> Iterator[OracleRow]:
    """Compute every asked-for cell with both engines."""
    theirs = MpSpdz(options.mp_spdz.expanduser().resolve(), options.protocol, options.timeout)
    theirs.check()
    for score in options.score:
        for n in options.dim:
            compiled = theirs.compile(score, n, options.trials)
            for kind in options.kind:
                x, y = draw(kind, options.trials, n, options.seed)
                pairs = [raw(vector) for vector in x], [raw(vector) for vector in y]
                yield _row(score, n, kind, options.protocol, (x, y), theirs.run(compiled, *pairs))


def _row(
    score: str, n: int, kind: str, protocol: str, pairs: tuple[FloatArray, FloatArray], outputs: list[int]
) -> OracleRow:
    security = PROTOCOLS[protocol]
    exact = exact_scores(score, *pairs)
    values = secure_scores(SCORES[score], *pairs, security)
    theirs = [Fraction(output, ONE) for output in outputs]
    return OracleRow(
        score,
        n,
        kind,
        protocol,
        security,
        pairs=len(exact),
        ours=round(max(map(units, values, exact)), 4),
        theirs=round(max(map(units, theirs, exact)), 4),
        apart=round(max(map(units, values, theirs)), 4),
    )


def parser() -> argparse.ArgumentParser:
    """The arguments of ``python -m bench oracle``."""
    scores = [name for name in SCORES if name in BODIES]
    arguments = CommandParser(
        prog="python -m bench oracle",
        description="Compute scores with MP-SPDZ and with this engine, and compare both with the true ones.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = arguments.add_argument
    add("--mp-spdz", type=Path, required=True, metavar="PATH", help=f"folder of a built MP-SPDZ {VERSION}")
    add("--score", nargs="+", default=scores, choices=scores, metavar="S", help="scores (all)")
    add("--dim", nargs="+", type=int, default=[16], metavar="N", help="descriptor lengths (16)")
    add("--kind", nargs="+", default=list(KINDS), choices=KINDS, metavar="KIND", help="as in accuracy (all)")
    add("--protocol", choices=PROTOCOLS, default="mascot", help="MP-SPDZ's protocol (mascot)")
    add("--trials", type=int, default=5, help="pairs of each kind (5)")
    add("--seed", type=int, default=1, help="seed of the pairs (1)")
    add(
        "--timeout", type=float, default=900.0, metavar="S", help="seconds for each compilation and run (900)"
    )
    add("--json", action="store_true", help="one JSON object a line")
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    arguments = parser()
    options = arguments.parse_args(argv)
    if options.trials < 1 or min(options.dim) < 1 or options.seed < 0 or not options.timeout > 0:
        arguments.error("--trials, --dim and --timeout must be positive, and --seed not negative")
    if any(KINDS[kind].largest_norm(n) > MAX_NORM for kind in options.kind for n in options.dim):
        arguments.error("--dim is too large for these kinds of pairs")
    try:
        return run_command("python -m bench oracle", lambda: _print(compare(options), as_json=options.json))
    except (MpSpdzError, ValueError, OSError) as error:
        print(f"python -m bench oracle: {error}", file=sys.stderr)
        return 2 if isinstance(error, MpSpdzMissing) else 1


def _print(rows: Iterator[OracleRow], *, as_json: bool) -> int:
    for number, row in enumerate(rows):
        if as_json:
            print(json.dumps(asdict(row)), flush=True)
            continue
        if not number:
            print(f"{'score':6}{'N':>6}  {'kind':9}{'protocol':10}{'pairs':>5}", end="")
            print(f"{'ours':>10}{'MP-SPDZ':>10}{'apart':>10}")
        print(
            f"{row.score:6}{row.n:6}  {row.kind:9}{row.protocol:10}{row.pairs:5}"
            f"{row.ours:10.3f}{row.theirs:10.3f}{row.apart:10.3f}",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
