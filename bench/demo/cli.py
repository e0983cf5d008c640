"""``python -m spdz demo``: two robots, real laser scans, two processes, TLS."""

from __future__ import annotations

import argparse
import importlib
import json
import shlex
import shutil
import sys
from pathlib import Path

NEEDS = ("rtb-data>=1.0", "matplotlib>=3.8.4", "rich>=13", "scipy>=1.13")
"""The extra ``demo``."""
SOLVERS: dict[str, tuple[str, ...]] = {"scipy": (), "gtsam": ("gtsam",)}
"""What each solver needs beyond it."""


def add_demo(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the ``demo`` command."""
    arguments = commands.add_parser(
        "demo",
        help="two robots, real laser scans, private matches, one merged map (needs the extra spdz[demo])",
        description="Deals tapes, starts two robots as separate processes that compare real laser-scan "
        "descriptors over TLS on loopback and verify what matched, merges both maps, and shows what was "
        "found, what it cost and what leaked.",
    )
    add = arguments.add_argument
    add("--out", type=Path, default=Path("demo-output"), metavar="DIR", help="where the page goes")
    add("--security", choices=("malicious", "semi-honest"), default="malicious")
    add("--solver", choices=tuple(SOLVERS), default="scipy", help="of the pose graph (default: scipy)")
    add("--json", action="store_true", help="one JSON object on standard output")
    arguments.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    """Run the demo; what it needs beyond the base install is imported here only."""
    try:
        importlib.import_module("scipy")  # the solvers load it late, when both robots have done their work
        importlib.import_module(options.solver)
        from bench.demo.exchange import DemoFailed
        from bench.demo.report import show
        from bench.demo.run import run_demo
    except ImportError as error:
        return _missing(error, options.solver)
    try:
        report = run_demo(options.out, options.security, options.solver)
    except ImportError as error:
        return _missing(error, options.solver)
    except (DemoFailed, OSError) as error:
        print(f"python -m spdz demo: {error}", file=sys.stderr)
        return 1
    if options.json:
        print(json.dumps(report.as_dict()))
        return 0
    show(report, shutil.get_terminal_size().columns)
    return 0


def _missing(error: ImportError, solver: str) -> int:
    """Say what to install: the packages by name, which holds for a clone, an editable install and a wheel."""
    command = shlex.join([sys.executable, "-m", "pip", "install", *NEEDS, *SOLVERS[solver]])
    print(f"python -m spdz demo: {error}. The demo needs more than the engine: {command}", file=sys.stderr)
    return 1
