"""``python -m spdz``: a door to the commands, which live above this package."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from spdz.console.command import CommandParser, run_command, wants_json
from spdz.version import __version__


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    return run_command("python -m spdz", lambda: _main(words), as_json=wants_json(words))


def parser() -> argparse.ArgumentParser:
    """The arguments of every command."""
    from bench.demo.cli import add_demo
    from protocols.agent.cli import add_agent
    from protocols.agent.evidence import add_evidence
    from protocols.check.cli import add_check
    from protocols.cli import add_match
    from protocols.stacks.cli import add_replay, add_ros
    from protocols.tape_cli import add_tape

    arguments: argparse.ArgumentParser = CommandParser(
        prog="python -m spdz",
        description="Two robots learn whether two place descriptors match, and nothing else.",
        epilog="To deal tapes before a mission: python -m spdz.dealer --help",
    )
    commands = arguments.add_subparsers(required=True, metavar="COMMAND")
    add_match(commands)
    add_agent(commands)
    add_evidence(commands)
    add_ros(commands)
    add_replay(commands)
    add_tape(commands)
    add_check(commands)
    add_demo(commands)
    arguments.add_argument("--version", action="version", version=f"spdz {__version__}")
    return arguments


def _main(words: Sequence[str]) -> int:
    options = parser().parse_args(words)
    return int(options.run(options))


if __name__ == "__main__":
    sys.exit(main())
