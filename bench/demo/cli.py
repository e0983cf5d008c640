"""``python -m spdz demo``: two robots, real laser scans, two processes, TLS."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from pathlib import Path


def add_demo(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the ``demo`` command."""
    arguments = commands.add_parser(
        "demo",
        help="match real descriptors of two robots (needs the extra spdz[demo])",
        description="Deals tapes, starts two robots as separate processes that compare real laser-scan "
        "descriptors over TLS on loopback, and shows what was found, what it cost and what leaked.",
    )
    add = arguments.add_argument
    add("--out", type=Path, default=Path("demo-output"), metavar="DIR", help="where the picture goes")
    add("--security", choices=("malicious", "semi-honest"), default="malicious")
    add("--json", action="store_true", help="one JSON object on standard output")
    arguments.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    """Run the demo; what it needs beyond the base install is imported here only."""
    try:
        from bench.demo.report import show
        from bench.demo.run import DemoFailed, run_demo
    except ImportError as error:
        print(
            f"python -m spdz demo: {error}; install the demo's extras: pip install -e '.[demo]'",
            file=sys.stderr,
        )
        return 1
    try:
        report = run_demo(options.out, options.security)
    except (DemoFailed, ImportError) as error:
        print(f"python -m spdz demo: {error}", file=sys.stderr)
        return 1
    if options.json:
        print(json.dumps(report.as_dict()))
        return 0
    show(report, shutil.get_terminal_size().columns)
    return 0
