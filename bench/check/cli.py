"""``python -m bench check`` (``make bench-check``): is a comparison still as quick as it was?"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from bench.check import ratios
from bench.check.measuring import BLOCKS, CELLS, Cell, keys_of, measure
from bench.check.ratios import TOLERANCE, Key, RatiosError, Verdict
from bench.sweep.machine import commit, machine
from spdz.console.command import CommandParser, run_command, say_error
from spdz.console.progress import progress_bar

_NAME = "python -m bench check"
_EPILOG = """\
Two processes, a core each, over loopback, as in `python -m bench`. Of every cell (all scores at N = 16, some
at 1536 and 8192, both models) it measures, in the same processes and one after the other:
  ours        from floats to the opened and checked result
  floor       the same frames over a bare socket, with nothing computed
  textbook    S6 and S10: the protocol with Beaver triples that textbooks have
and divides ours by the others, the least time of all trials by the least: what no neighbour disturbed. Such
ratios are held to bench/check/ratios.json. A cell whose ratio is more than --tolerance times the committed
one is measured again, and fails if it is so three times. About a minute (--update: two), on a machine that
does little else.

Processors differ in these ratios too, if less than in milliseconds. On another kind of machine than the file
names, first run --update on a commit that you trust, and then check yours.

It is not part of make test: a shared machine may fail it for no fault of the code. What can be exact is a
test instead: rounds, bytes, tape and correlations (tests/test_counts.py).

exit status: 0 as quick as committed, 1 worse or it failed, 2 no committed ratios or bad usage.

examples:
  python -m bench check
  python -m bench check --score S10 S4 --tolerance 1.3 --json
  python -m bench check --update       measure, and write bench/check/ratios.json
"""

ATTEMPTS = 3
"""How often a ratio has to be past the tolerance before it fails."""

Measure = Callable[[Iterable[Cell], int, Callable[[Cell], None]], dict[Key, float]]
"""``measure(cells, blocks, on_cell)``, as :func:`bench.check.measuring.measure`."""


def check(
    cells: Sequence[Cell],
    committed: Mapping[Key, float],
    tolerance: float,
    measuring: Measure,
    on_cell: Callable[[Cell], None] = lambda cell: None,
) -> list[Verdict]:
    """Measure and judge; what is worse is measured again, twice if need be, and the best of all counts."""
    measured = measuring(cells, BLOCKS, on_cell)
    for _ in range(ATTEMPTS - 1):
        suspects = {one.key for one in ratios.judge(measured, committed, tolerance) if one.worse}
        if not suspects:
            break
        again = [cell for cell in cells if suspects.intersection(keys_of(cell))]
        for key, ratio in measuring(again, BLOCKS, on_cell).items():
            if key in suspects:
                measured[key] = min(measured[key], ratio)
    return ratios.judge(measured, committed, tolerance)


def parser() -> argparse.ArgumentParser:
    """The arguments of ``python -m bench check``."""
    arguments = CommandParser(
        prog=_NAME,
        description="Hold the engine's speed, as ratios within one run, to the committed ratios.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = arguments.add_argument
    scores = list(dict.fromkeys(cell[0] for cell in CELLS))
    add("--score", nargs="+", default=scores, choices=scores, metavar="S", help="only these scores (all)")
    add("--tolerance", type=float, default=TOLERANCE, help=f"times the committed ratio ({TOLERANCE:g})")
    add("--update", action="store_true", help="write what is measured as the committed ratios")
    add("--json", action="store_true", help="one JSON object a line")
    return arguments


def main(argv: Sequence[str] | None = None, measuring: Measure = measure) -> int:
    """Run the command; returns the exit status."""
    arguments = parser()
    options = arguments.parse_args(argv)
    if not options.tolerance > 1:
        arguments.error("--tolerance must be above 1")
    return run_command(_NAME, lambda: _run(options, measuring), as_json=options.json)


def _run(options: argparse.Namespace, measuring: Measure) -> int:
    cells = [cell for cell in CELLS if cell[0] in options.score]
    try:
        committed = _committed(options.update)
        with progress_bar("bench check", quiet=options.json) as report:
            done = 0

            def on_cell(cell: Cell) -> None:
                nonlocal done
                report(done, max(len(cells) * BLOCKS * (1 + options.update), done + 1))
                done += 1

            if options.update:
                measured = measuring(cells, 2 * BLOCKS, on_cell)
                ratios.write({**committed, **measured}, _about())
                verdicts = ratios.judge(measured, committed, options.tolerance)
            else:
                verdicts = check(cells, committed, options.tolerance, measuring, on_cell)
    except RatiosError as error:
        say_error(_NAME, "RatiosError", str(error), as_json=options.json)
        return 2
    except (OSError, RuntimeError) as error:
        say_error(_NAME, type(error).__name__, str(error), as_json=options.json)
        return 1
    _tell(verdicts, as_json=options.json)
    if options.update:
        if not options.json:
            print(f"written to {ratios.FILE}: commit it")
        return 0
    worse = any(one.worse for one in verdicts)
    for paragraph in [*ratios.advice(verdicts), *([_load()] if worse else [])]:
        print(paragraph, file=sys.stderr)
    return int(worse)


def _load() -> str:
    """How busy the machine is, where it says so: the first thing to doubt."""
    busy = f"{os.getloadavg()[0]:.1f} processes" if hasattr(os, "getloadavg") else "an unknown number"
    return f"In the last minute {busy} ran on {os.cpu_count()} cores; this command is two. Others disturb it."


def _committed(update: bool) -> dict[Key, float]:
    try:
        return ratios.read()
    except RatiosError:
        if update:
            return {}
        raise


def _about() -> dict[str, Any]:
    own, dirty = commit()
    return {"command": f"{_NAME} --update", "commit": own, "dirty": dirty, "machine": machine()}


def _tell(verdicts: Sequence[Verdict], *, as_json: bool) -> None:
    if not as_json:
        print(
            f"{'score':6}{'N':>6}  {'security':12}{'against':10}{'ratio':>8}{'committed':>11}{'at most':>9}"
        )
    for one in verdicts:
        if as_json:
            fields = {"ratio": one.measured, "committed": one.committed, "tolerance": one.tolerance}
            print(json.dumps({**asdict(one.key), **fields, "verdict": one.word.lower()}), flush=True)
            continue
        key, known = one.key, one.committed
        print(f"{key.score:6}{key.n:6}  {key.security:12}{key.against:10}{one.measured:8.2f}", end="")
        print(f"{'-':>11}{'-':>9}" if known is None else f"{known:11.2f}{known * one.tolerance:9.2f}", end="")
        print(f"  {one.word}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
