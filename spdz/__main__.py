"""``python -m spdz``: a door to the commands, which live above this package."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from spdz.command import run_command
from spdz.version import __version__


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status."""
    from bench.demo.cli import add_demo
    from protocols.cli import add_match

    parser = argparse.ArgumentParser(
        prog="python -m spdz",
        description="Two robots learn whether two place descriptors match, and nothing else.",
        epilog="To deal tapes before a mission: python -m spdz.dealer --help",
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    add_match(commands)
    add_demo(commands)
    parser.add_argument("--version", action="version", version=f"spdz {__version__}")
    options = parser.parse_args(argv)
    return run_command("python -m spdz", lambda: int(options.run(options)))


if __name__ == "__main__":
    sys.exit(main())
