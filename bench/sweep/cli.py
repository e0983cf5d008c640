"""``python -m bench sweep``: the paper's whole experiment, resumable."""

from __future__ import annotations

import argparse
import json
import shlex
import shutil
import statistics
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from bench.sweep.ahead import ABOUT as ABOUT_AHEAD
from bench.sweep.baseline import Baseline, compiled, compiler_version, find_compiler
from bench.sweep.cells import PROTOCOLS, QUICK_TRIALS, SIZES, TRIALS, Cell, cells
from bench.sweep.floor import WARM_UP
from bench.sweep.machine import commit, machine, source_digest
from bench.sweep.measuring import Bench
from bench.sweep.results import About, Results, ResultsError, Trial
from bench.sweep.standing import StandingPair
from bench.sweep.stands import STATEMENT
from protocols.scores import SCORES
from spdz.console.command import FAILED, CommandParser, run_command, say_error

_NAME = "python -m bench sweep"
DEFAULT_FOLDER = Path("bench-results")
NOTE = (
    "Scores are opened, as in the paper, which measures scores because a candidate's bit only adds a "
    "comparison with a threshold."
)

_EPILOG = f"""\
{STATEMENT}

Two processes, pinned to a core each where the system allows it, stay up for all cells. They compare over
loopback TCP, {WARM_UP} times uncounted, then --trials times, each with other unit vectors, from plain floats
to the opened and (malicious) MAC-checked score. A time is that of the slower party. Not timed: dealing and
connecting. Beside every time stands its floor: the same frames, in sizes and order, over the same kind of
socket in bare Python with nothing computed (the median of replays). One more trial runs under a profiler, to
say where the time goes: its shares are rough, and it is in no other figure.
The C++ baseline is compiled with the system's compiler ($CXX, or g++, clang++, c++) at -O3 and timed inside;
without a compiler it is left out.

{ABOUT_AHEAD}
It is ahead_ms in every trial's line, one figure a cell; numpy and cpp have none. It is not in ms. Neither
holds compile_ms: reading and compiling the program, once a session.

Results go into a folder: sweep.json, trials.jsonl, sweep.csv. A sweep that is stopped or killed goes on
where it was when the same command is given again; scores, sizes and protocols can be added to the same
folder. `python -m bench report` reads it.

examples:
  python -m bench sweep --quick
  python -m bench sweep
  python -m bench sweep --scores S10 S6 --sizes 1536 --protocols malicious cpp --trials 50 --out mine --json
"""


def parser() -> argparse.ArgumentParser:
    """The arguments of ``python -m bench sweep``."""
    arguments = CommandParser(
        prog=_NAME,
        description="Measure every score at every length with every protocol of the paper, as it does.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = arguments.add_argument
    add("--scores", nargs="+", default=list(SCORES), choices=SCORES, metavar="S", help="scores (all ten)")
    sizes = " ".join(map(str, SIZES))
    add("--sizes", nargs="+", type=int, default=list(SIZES), metavar="N", help=f"lengths ({sizes})")
    add(
        "--protocols",
        nargs="+",
        default=list(PROTOCOLS),
        choices=PROTOCOLS,
        metavar="P",
        help=f"{', '.join(PROTOCOLS)} (all)",
    )
    add("--trials", type=int, help=f"counted trials of a cell ({TRIALS}; with --quick {QUICK_TRIALS})")
    add("--quick", action="store_true", help="only the cells that the paper's table prints, a minute or two")
    add("--seed", type=int, default=1, help="seed of the descriptors (1)")
    add(
        "--out",
        type=Path,
        default=DEFAULT_FOLDER,
        metavar="DIR",
        help=f"folder of results ({DEFAULT_FOLDER})",
    )
    add("--json", action="store_true", help="one JSON object a line, a cell each")
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    arguments = parser()
    options = arguments.parse_args(argv)
    words = list(sys.argv[1:] if argv is None else argv)
    if options.trials is None:
        options.trials = QUICK_TRIALS if options.quick else TRIALS
    if options.trials < 1 or min(options.sizes) < 1 or options.seed < 0:
        arguments.error("--trials and --sizes must be positive, and --seed not negative")
    for name in ("scores", "sizes", "protocols"):
        setattr(options, name, list(dict.fromkeys(getattr(options, name))))
    todo = list(cells(options.scores, options.sizes, options.protocols, quick=options.quick))
    if not todo:
        arguments.error(
            "--quick measures none of these: leave it out, or see `PRINTED` in bench/sweep/cells.py"
        )
    return run_command(
        _NAME, lambda: _run(options, shlex.join([*_NAME.split(), *words]), todo), as_json=options.json
    )


def _run(options: argparse.Namespace, command: str, todo: Sequence[Cell]) -> int:
    try:
        with _baseline(options) as (baseline, compiler):
            wanted = [cell for cell in todo if baseline is not None or cell.protocol != "cpp"]
            with Results(options.out, _about(options, command, compiler)) as results:
                _measure(options, results, baseline, wanted)
                results.finish(_now())
        if not options.json:
            print(f"{len(wanted)} cells in {options.out}. Next: python -m bench report", flush=True)
        return 0
    except subprocess.CalledProcessError as error:
        said = (error.stderr or b"").decode(errors="replace").strip()
        say_error(_NAME, "CalledProcessError", f"{error}\n{said}".strip(), as_json=options.json)
    except (ResultsError, RuntimeError, ValueError, OSError, subprocess.SubprocessError) as error:
        say_error(_NAME, type(error).__name__, str(error), as_json=options.json)
    return FAILED


def _measure(
    options: argparse.Namespace, results: Results, baseline: Baseline | None, wanted: Sequence[Cell]
) -> None:
    missing = [cell for cell in wanted if cell not in results.done]
    if len(missing) < len(wanted) and not options.json:
        print(f"{len(wanted) - len(missing)} of {len(wanted)} cells are in {options.out} already", flush=True)
    if not missing:
        return
    if not options.json:
        print(
            "{:12}{:>5}{:>6}{:>14}{:>10}{:>10}{:>10}{:>7}{:>9}".format(
                "protocol", "score", "N", "ms", "floor ms", "ahead ms", "bytes", "rounds", "error"
            )
        )
    with StandingPair() as pair, ExitStack() as stack:
        folder = stack.enter_context(_scratch(results.folder))
        bench = Bench(pair, baseline, folder, options.trials, options.seed, quiet=options.json)
        for number, cell in enumerate(missing, len(wanted) - len(missing) + 1):
            place = f"{number}/{len(wanted)}"
            trials = bench.measure(cell, place)
            results.add(trials)
            _print(trials, place, as_json=options.json)


def _print(trials: Sequence[Trial], place: str, *, as_json: bool) -> None:
    row = summary(trials)
    if as_json:
        print(json.dumps(row), flush=True)
        return
    floor, ahead = ("-" if one is None else f"{one:.3f}" for one in (row["floor_ms"], row["ahead_ms"]))
    print(
        f"{row['protocol']:12}{row['score']:>5}{row['n']:6}{row['median_ms']:14.6f}{floor:>10}{ahead:>10}"
        f"{max(row['bytes_sent']):10}{row['rounds']:7}{row['max_abs_error']:9.1e}  {place}",
        flush=True,
    )


def summary(trials: Sequence[Trial]) -> dict[str, Any]:
    """One cell: medians and deviation of its trials, and what is the same in all of them."""
    counted = [trial for trial in trials if not trial.profiled]
    times = [trial.ms for trial in counted]
    first = counted[0]
    return {
        "protocol": first.protocol,
        "score": first.score,
        "n": first.n,
        "trials": len(counted),
        "median_ms": statistics.median(times),
        "mean_ms": statistics.fmean(times),
        "std_ms": statistics.stdev(times) if len(times) > 1 else 0.0,
        "floor_ms": first.floor_ms,
        "ahead_ms": first.ahead_ms,
        "compile_ms": first.compile_ms,
        "bytes_sent": first.bytes_sent,
        "rounds": first.rounds,
        "messages": first.messages,
        "tape_bytes": first.tape_bytes,
        "max_abs_error": max(trial.error or 0.0 for trial in counted),
        "phases": next((trial.phases for trial in trials if trial.profiled), None),
    }


def _about(options: argparse.Namespace, command: str, compiler: str | None) -> About:
    head, dirty = commit()
    return About(
        command=command,
        commit=head,
        dirty=dirty,
        started=_now(),
        finished=None,
        machine={**machine(), "compiler": compiler},
        quick=options.quick,
        trials=options.trials,
        warm_up=WARM_UP,
        seed=options.seed,
        source=source_digest(),
        threshold_note=NOTE,
    )


@contextmanager
def _baseline(options: argparse.Namespace) -> Iterator[tuple[Baseline | None, str | None]]:
    """The compiled baseline and what compiled it; None and a sentence where it is wanted and cannot be."""
    if "cpp" not in options.protocols:
        yield None, None
        return
    compiler = find_compiler()
    if compiler is None:
        print(f"{_NAME}: no C++ compiler here, so the baseline in C++ is left out", file=sys.stderr)
        yield None, None
        return
    with compiled(compiler) as baseline:
        yield baseline, compiler_version(compiler)


@contextmanager
def _scratch(folder: Path) -> Iterator[Path]:
    """Where tapes lie while they are used; what a killed sweep left there goes first."""
    scratch = folder / "tapes"
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir()
    try:
        yield scratch
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _now() -> str:
    return datetime.now(timezone.utc).isoformat(timespec="seconds")
