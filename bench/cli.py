"""``python -m bench``: what a comparison costs, beside the textbook protocol and no security at all.

More commands measure something else, each in a file or folder of its own: ``COMMANDS``.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

import bench.accuracy
import bench.agents.cli
import bench.attacks.cli
import bench.check.cli
import bench.gallery
import bench.links.cli
import bench.oracle
import bench.report.cli
import bench.sweep.cli
import bench.versus
from bench.pair import Measured, measure_clear, measure_secure
from bench.recorded import recorded
from bench.sweep.ahead import ABOUT
from protocols import is_candidate
from protocols.scores import SCORES
from protocols.textbook import TEXTBOOK
from spdz.console.command import CommandParser, run_command
from spdz.local import run_clear
from spdz.readings.program import Program

_EPILOG = f"""\
Two processes on this machine, pinned to a core each where the system allows it, over loopback TCP. Every
engine is measured in the same run, so that ratios hold on a noisy machine; times are medians of single
comparisons from plain floats to the opened and (malicious) MAC-checked result. Not timed: dealing, starting
up, and reading and compiling the program, once a session.

{ABOUT}
It is the column "ahead ms", in JSON ahead_ms; it is not in median_ms. The clear exchange has none.

--compare adds what compiled engines need for the same score, length and model, where it was recorded, and how
many times ours that is. It was recorded on another machine: bytes compare exactly, times roughly.

further commands, each with a --help of its own:
  python -m bench sweep       the paper's whole experiment: every protocol, length and score, resumable
  python -m bench report      tables and plots of a results folder, beside the paper's and MP-SPDZ's figures
  python -m bench agents      a team of agents as processes, killed and watched
  python -m bench gallery     many descriptors against many that stand: pairs a second, delay, memory
  python -m bench links       the same over thin, slow, far and lossy links
  python -m bench accuracy    how far secure scores are from the true ones
  python -m bench attacks     what a compromised robot gains, with and without private comparisons
  python -m bench oracle      the same scores by MP-SPDZ, live, where you have it
  python -m bench versus      this tree against another commit, in one run
  python -m bench check       is it still as quick as the committed ratios say (make bench-check)

examples:
  python -m bench --score S10 --dim 8192 --security malicious --trials 10 --json
  python -m bench --score S6 S10 --dim 16 1536 8192 --engine spdz --compare
"""

COMMANDS: dict[str, Callable[[Sequence[str]], int]] = {
    "accuracy": bench.accuracy.main,
    "agents": bench.agents.cli.main,
    "attacks": bench.attacks.cli.main,
    "check": bench.check.cli.main,
    "gallery": bench.gallery.main,
    "links": bench.links.cli.main,
    "oracle": bench.oracle.main,
    "report": bench.report.cli.main,
    "sweep": bench.sweep.cli.main,
    "versus": bench.versus.main,
}
"""The commands beside the one without a name."""


@dataclass(frozen=True, slots=True)
class Row:
    """One measured cell. bytes_sent is the larger of the two parties'; a round is one exchange.

    ahead_ms is a job's part of what is done before its inputs are known (:mod:`bench.sweep.ahead`); no other
    time includes it.
    """

    score: str
    n: int
    security: str
    engine: str
    reveal: str
    trials: int
    median_ms: float
    min_ms: float
    ahead_ms: float | None
    bytes_sent: int
    rounds: int
    tape_bytes: int
    max_abs_error: float
    correlations: dict[str, int]


def descriptors(dim: int, seed: int) -> tuple[Any, Any]:
    """Two unit vectors, reproducible."""
    generator = np.random.default_rng(seed)
    x, y = generator.standard_normal((2, dim))
    return x / np.linalg.norm(x), y / np.linalg.norm(y)


def _row(
    cell: tuple[str, int, str, str, str], figures: tuple[Measured, Measured], tape_bytes: int, exact: Any
) -> Row:
    score, n, security, engine, reveal = cell
    slower = [max(pair) * 1e3 for pair in zip(figures[0].seconds, figures[1].seconds, strict=True)]
    error = max(abs(float(figure.value) - float(exact)) for figure in figures)
    stats = figures[0].stats
    ahead = [figure.ahead.a_job for figure in figures if figure.ahead is not None]
    return Row(
        score=score,
        n=n,
        security=security,
        engine=engine,
        reveal=reveal,
        trials=len(slower),
        median_ms=round(statistics.median(slower), 4),
        min_ms=round(min(slower), 4),
        ahead_ms=round(max(ahead) * 1e3, 4) if ahead else None,
        bytes_sent=max(figure.stats.bytes_sent for figure in figures),
        rounds=stats.rounds,
        tape_bytes=tape_bytes,
        max_abs_error=error,
        correlations=dict(stats.correlations),
    )


def sweep(options: argparse.Namespace) -> Iterator[Row]:
    """Measure every asked-for cell with every asked-for engine."""
    for name in options.score:
        for n in options.dim:
            inputs = descriptors(n, options.seed)
            score = SCORES[name].within(options.max_norm)
            bit = options.reveal == "bit"
            program: Program = is_candidate(score, options.threshold) if bit else score
            exact = run_clear(program, *inputs).value
            for security in options.security:
                engines: dict[str, Program | None] = {"spdz": program, "clear": None}
                if name in TEXTBOOK and not bit:
                    engines["textbook"] = TEXTBOOK[name].within(options.max_norm)
                for engine in options.engine or engines:
                    if engine not in engines:
                        continue
                    cell = (name, n, security, engine, options.reveal)
                    run = engines[engine]
                    if run is None:
                        yield _row(cell, measure_clear(program, inputs, options.trials), 0, exact)
                    else:
                        *figures, stored = measure_secure(run, inputs, security, options.trials)
                        yield _row(cell, (figures[0], figures[1]), stored, exact)


def parser() -> argparse.ArgumentParser:
    """The arguments of ``python -m bench``."""
    arguments = CommandParser(
        prog="python -m bench",
        description="Measure time, bytes and rounds of one comparison between two processes.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = arguments.add_argument
    add("--score", nargs="+", default=["S10"], choices=SCORES, metavar="S", help="score functions (S10)")
    add("--dim", nargs="+", type=int, default=[1536], metavar="N", help="descriptor lengths (1536)")
    add("--security", nargs="+", default=["malicious"], choices=("malicious", "semi-honest"))
    add("--engine", nargs="+", choices=("spdz", "textbook", "clear"), help="default: all that there are")
    add("--reveal", choices=("score", "bit"), default="score", help="open the score (default) or the bit")
    add("--threshold", type=float, default=0.8, help="for --reveal bit (0.8)")
    add("--max-norm", type=float, default=1.0, help="largest norm that the tapes serve (1)")
    add("--trials", type=int, default=10, help="counted runs (10)")
    add("--seed", type=int, default=1, help="seed of the descriptors (1)")
    add("--compare", action="store_true", help="beside them, recorded figures of compiled engines")
    add("--json", action="store_true", help="one JSON object a line")
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    """Run the benchmark, or the command that the first word names; returns the exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    if words and words[0] in COMMANDS:
        return COMMANDS[words[0]](words[1:])
    arguments = parser()
    options = arguments.parse_args(words)
    if options.trials < 1 or min(options.dim) < 1 or options.seed < 0:
        arguments.error("--trials and --dim must be positive, and --seed not negative")
    if "textbook" in (options.engine or ()) and options.reveal == "bit":
        arguments.error("there is no textbook protocol for the bit: leave out --engine textbook")
    try:
        rows = sweep(options)
        return run_command("python -m bench", lambda: _print(rows, options))
    except ValueError as error:
        arguments.error(str(error))


def _print(rows: Iterator[Row], options: argparse.Namespace) -> int:
    if not options.json:
        print(f"{'score':6}{'N':>6}  {'security':12}{'engine':10}", end="")
        print(f"{'ms':>9}{'ahead ms':>10}{'bytes':>10}{'rounds':>8}{'tape B':>10}", flush=True)
    for row in rows:
        others = _beside(row) if options.compare else []
        if options.json:
            extra = {"recorded": others} if options.compare else {}
            print(json.dumps({**asdict(row), **extra}), flush=True)
        else:
            ahead = "-" if row.ahead_ms is None else f"{row.ahead_ms:.3f}"
            print(
                f"{row.score:6}{row.n:6}  {row.security:12}{row.engine:10}{row.median_ms:9.3f}{ahead:>10}"
                f"{row.bytes_sent:10}{row.rounds:8}{row.tape_bytes:10}",
                flush=True,
            )
            _print_others(others)
    return 0


def _beside(row: Row) -> list[dict[str, Any]]:
    """What was recorded for a row: only our own engine's opened scores have counterparts."""
    if (row.engine, row.reveal) != ("spdz", "score"):
        return []
    figures = recorded(row.score, row.n, row.security)
    return [figure.beside(row.median_ms, row.bytes_sent, row.rounds) for figure in figures]


def _print_others(others: Sequence[dict[str, Any]]) -> None:
    for other in others:
        rounds = "-" if other["rounds"] is None else other["rounds"]
        print(
            f"{other['engine'] + ', ' + other['protocol']:>36}{other['ms']:9.3f}{'':10}"
            f"{other['bytes_sent']:10}{rounds:>8}{'':10}  "
            f"{other['ms_factor']:.1f} x time, {other['bytes_factor']:.1f} x bytes",
            flush=True,
        )


if __name__ == "__main__":
    sys.exit(main())
