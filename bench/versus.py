"""``python -m bench versus COMMIT``: this tree against another commit of its own history, in one run."""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from math import exp, log
from pathlib import Path

from bench.commits import HistoryError, own_tree, resolve, tree_of
from bench.out import out_folder
from bench.recorded_ratios import Cell, recorded_ratios
from bench.sweep.machine import commit
from protocols.scores import SCORES
from spdz.console.command import CommandParser, run_command, say_error
from spdz.console.progress import Report, progress_bar

FORMAT = 1
_NAME = "python -m bench versus"
_EPILOG = """\
Checks the commit out into a temporary folder (git worktree, removed afterwards) and measures both trees
by their own `python -m bench --engine spdz --max-norm 1`, cell by cell: base and this tree, then this
tree and base, and so on, so that what slows the machine slows both. The speed-up of a cell is the median
of its repetitions' ratios; the milliseconds are medians; "of least" is the speed-up of the least times,
which no neighbour on the machine disturbed. Neither --score nor --dim: the cells of
bench/recorded_ratios.json (ten scores at N = 16, S10 S6 S4 S2 at 1536 and 8192), about ten minutes.

Against the commit that was measured beside MP-SPDZ (bench/recorded_ratios.json says how), two more
columns: what MP-SPDZ's time was, in times of the base, and that times the speed-up: MP-SPDZ's time over
this tree's. Above 1 this tree is quicker.

Milliseconds are from the input to the result, each tree's own. This one does ahead, when jobs are reserved
with their program, some of what ff69b37 did in that time; `python -m bench` shows how long that takes.

The base needs the packages that it imports: those of this environment are used for both.

examples:
  python -m bench versus ff69b37
  python -m bench versus HEAD~1 --score S10 S4 --dim 16 1536 --security malicious --repetitions 5
  python -m bench versus ff69b37 --trials 30 --out bench-results --json
"""


class MeasuringError(Exception):
    """A tree could not be measured."""


@dataclass(frozen=True, slots=True)
class VersusRow:
    """One cell: the median of every repetition in milliseconds, and what follows from it.

    Attributes:
        speedup: How many times quicker this tree is: the median of base over ours, repetition by repetition.
        least_speedup: The same from the least time of all trials of either: what no neighbour disturbed.
        mp_spdz_to_base: MP-SPDZ's time over the base's, where it was recorded.
        mp_spdz_to_ours: The same over ours: the speed-up times that.
    """

    score: str
    n: int
    security: str
    base_ms: list[float]
    ours_ms: list[float]
    speedup: float
    least_speedup: float
    mp_spdz_to_base: float | None
    mp_spdz_to_ours: float | None


@dataclass(frozen=True, slots=True)
class Trees:
    """What is measured: the two folders, and how."""

    base: Path
    ours: Path
    trials: int
    repetitions: int
    recorded: dict[Cell, float] = field(default_factory=dict)


Times = tuple[float, float]
"""The median and the least milliseconds of a comparison."""

Measure = Callable[[Path, Cell, int], Times]
"""``measure(tree, cell, trials)``."""


def _python(tree: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run Python in a tree, with its packages first on the path."""
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    return subprocess.run(
        [sys.executable, *words], cwd=tree, env=environment, capture_output=True, text=True, check=False
    )


def measure_tree(tree: Path, cell: Cell, trials: int) -> Times:
    """Run a tree's own benchmark.

    Raises:
        MeasuringError: if it fails.
    """
    score, n, security = cell
    words = ["--score", score, "--dim", str(n), "--security", security, "--engine", "spdz", "--max-norm", "1"]
    done = _python(tree, "-m", "bench", *words, "--trials", str(trials), "--json")
    if done.returncode:
        said = (done.stderr.strip() or done.stdout.strip() or "nothing").splitlines()[-1]
        raise MeasuringError(f"{tree.name}: {score}, N = {n}, {security} failed: {said}")
    row = json.loads(done.stdout)
    return float(row["median_ms"]), float(row["min_ms"])


def check_tree(tree: Path) -> None:
    """See that a tree's benchmark runs that tree's engine, and no other that is installed.

    Raises:
        MeasuringError: if it does not.
    """
    done = _python(tree, "-c", "import bench.cli, spdz; print(bench.__file__); print(spdz.__file__)")
    if done.returncode:
        raise MeasuringError(f"{tree.name} has no benchmark that runs here: {done.stderr.strip()}")
    if not all(Path(line).resolve().is_relative_to(tree) for line in done.stdout.split("\n") if line):
        raise MeasuringError(f"{tree.name}: another installed copy comes first: {done.stdout.split()}")


def compare(trees: Trees, cells: Sequence[Cell], measure: Measure, report: Report) -> Iterator[VersusRow]:
    """Measure cell by cell, both trees in turn; the order turns with every repetition."""
    total = len(cells) * trees.repetitions
    for number, cell in enumerate(cells):
        times: dict[Path, list[Times]] = {trees.base: [], trees.ours: []}
        for repetition in range(trees.repetitions):
            report(number * trees.repetitions + repetition, total)
            order = [trees.base, trees.ours] if repetition % 2 == 0 else [trees.ours, trees.base]
            for tree in order:
                times[tree].append(measure(tree, cell, trees.trials))
        yield row_of(cell, times[trees.base], times[trees.ours], trees.recorded.get(cell))
    report(total, total)


def row_of(cell: Cell, base: list[Times], ours: list[Times], recorded: float | None) -> VersusRow:
    """A cell's row from its repetitions."""
    ratio = statistics.median(b / o for (b, _), (o, _) in zip(base, ours, strict=True))
    least = min(one for _, one in base) / min(one for _, one in ours)
    product = None if recorded is None else round(recorded * ratio, 2)
    return VersusRow(
        *cell,
        base_ms=[median for median, _ in base],
        ours_ms=[median for median, _ in ours],
        speedup=round(ratio, 3),
        least_speedup=round(least, 3),
        mp_spdz_to_base=recorded,
        mp_spdz_to_ours=product,
    )


def summary(rows: Sequence[VersusRow]) -> dict[str, dict[str, float | str | None]]:
    """By security: geometric means, and the least cell (by MP-SPDZ's time over ours, where it is known)."""
    found: dict[str, dict[str, float | str | None]] = {}
    for security in dict.fromkeys(row.security for row in rows):
        own = [row for row in rows if row.security == security]
        known = [row for row in own if row.mp_spdz_to_ours is not None]
        least = min(known or own, key=lambda row: row.mp_spdz_to_ours or row.speedup)
        found[security] = {
            "cells": len(own),
            "speedup": _geometric_mean([row.speedup for row in own]),
            "least_speedup": _geometric_mean([row.least_speedup for row in own]),
            "mp_spdz_to_ours": _geometric_mean([row.mp_spdz_to_ours or 0.0 for row in known]),
            "least": f"{least.score} at N = {least.n}",
            "least_is": least.mp_spdz_to_ours or least.speedup,
        }
    return found


def _geometric_mean(numbers: Sequence[float]) -> float | None:
    return round(exp(sum(map(log, numbers)) / len(numbers)), 3) if numbers else None


def parser() -> argparse.ArgumentParser:
    """The arguments of ``python -m bench versus``."""
    arguments = CommandParser(
        prog=_NAME,
        description="Measure this tree against another commit of its history, interleaved in one run.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = arguments.add_argument
    add("commit", help="what git knows it by: a hash, a tag, a branch, HEAD~3")
    add("--score", nargs="+", choices=SCORES, metavar="S", help="score functions (with --dim alone: S10)")
    add("--dim", nargs="+", type=int, metavar="N", help="descriptor lengths (with --score alone: 1536)")
    both = ["malicious", "semi-honest"]
    add("--security", nargs="+", default=both, choices=both, help="default: both")
    add("--trials", type=int, default=20, help="counted comparisons of a run (20)")
    add("--repetitions", type=int, default=3, help="runs of either tree for a cell (3)")
    add("--out", type=Path, metavar="FOLDER", help="write FOLDER/versus.json, cell by cell")
    add("--json", action="store_true", help="one JSON object a line: cells, then the summary")
    return arguments


def asked_cells(options: argparse.Namespace) -> list[Cell]:
    """The cells that were asked for: all combinations, or the recorded table's."""
    if options.score is None and options.dim is None:
        return [cell for cell in recorded_ratios().ratios if cell[2] in options.security]
    scores, dims = options.score or ["S10"], options.dim or [1536]
    return [(score, n, security) for score in scores for n in dims for security in options.security]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    arguments = parser()
    options = arguments.parse_args(argv)
    if min(options.trials, options.repetitions, *(options.dim or [1])) < 1:
        arguments.error("--trials, --repetitions and --dim must be positive")
    return run_command(_NAME, lambda: _run(options), as_json=options.json)


def _run(options: argparse.Namespace) -> int:
    ours = own_tree()
    try:
        base = resolve(ours, options.commit)
        if options.out is not None:
            out_folder(options.out)
        with tree_of(ours, base) as folder, progress_bar("versus", quiet=options.json) as report:
            trees = Trees(folder, ours, options.trials, options.repetitions, recorded_ratios().of(base))
            check_tree(trees.base)
            check_tree(trees.ours)
            rows: list[VersusRow] = []
            for row in compare(trees, asked_cells(options), measure_tree, report):
                rows.append(row)
                _print_row(row, as_json=options.json, first=len(rows) == 1)
                if options.out is not None:
                    _write(options.out / "versus.json", base, trees, rows)
    except HistoryError as error:
        say_error(_NAME, "HistoryError", str(error), as_json=options.json)
        return 2
    except (MeasuringError, OSError) as error:
        say_error(_NAME, type(error).__name__, str(error), as_json=options.json)
        return 1
    _print_summary(summary(rows), as_json=options.json)
    return 0


def _write(path: Path, base: str, trees: Trees, rows: Sequence[VersusRow]) -> None:
    """Write all rows so far, at once."""
    own, dirty = commit()
    data = {"format": FORMAT, "base": base[:7], "commit": own, "dirty": dirty}
    data |= {"trials": trees.trials, "repetitions": trees.repetitions, "rows": [asdict(row) for row in rows]}
    draft = path.with_suffix(".new")
    draft.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    draft.replace(path)


def _print_row(row: VersusRow, *, as_json: bool, first: bool) -> None:
    if as_json:
        print(json.dumps(asdict(row)), flush=True)
        return
    if first:
        print(f"{'score':6}{'N':>6}  {'security':12}{'base ms':>9}{'ours ms':>9}{'speed-up':>10}", end="")
        print(f"{'of least':>10}{'MP-SPDZ/base':>14}{'MP-SPDZ/ours':>14}")
    base, ours = statistics.median(row.base_ms), statistics.median(row.ours_ms)
    print(f"{row.score:6}{row.n:6}  {row.security:12}{base:9.3f}{ours:9.3f}{row.speedup:10.2f}", end="")
    mp_spdz = f"{_number(row.mp_spdz_to_base):>14}{_number(row.mp_spdz_to_ours):>14}"
    print(f"{row.least_speedup:10.2f}{mp_spdz}", flush=True)


def _print_summary(found: dict[str, dict[str, float | str | None]], *, as_json: bool) -> None:
    if as_json:
        print(json.dumps({"summary": found}), flush=True)
        return
    for security, figures in found.items():
        print(f"{security}, {figures['cells']} cells, geometric means: speed-up {figures['speedup']}", end="")
        print(f" (of least times {figures['least_speedup']})", end="")
        if figures["mp_spdz_to_ours"] is not None:
            print(f", MP-SPDZ/ours {figures['mp_spdz_to_ours']}", end="")
        print(f"; least: {figures['least_is']} ({figures['least']})", flush=True)


def _number(number: float | None) -> str:
    return "-" if number is None else f"{number:.2f}"


if __name__ == "__main__":
    sys.exit(main())
