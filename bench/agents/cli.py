"""The command ``python -m bench agents``."""

from __future__ import annotations

import json
from collections.abc import Sequence

from bench.agents.run import NAMES, Asked, Row, run
from spdz.console.command import CommandParser, run_command
from spdz.console.progress import progress_bar

_ABOUT = """\
Deals a mission and starts a robot's agent as a process of its own for each of the team (python -m spdz agent,
over TLS on loopback). Real keyframes (1,200-D Scan Context of laser scans in MIT's corridors) come to all of
them at a rate; the last robot is killed now and then and started again; all matches are held against those
of the clear computation.
"""


def parser() -> CommandParser:
    """The arguments of ``python -m bench agents``."""
    arguments = CommandParser(prog="python -m bench agents", description=_ABOUT)
    add = arguments.add_argument
    add("--robots", type=int, default=3, help="2 to 6 (3)")
    add("--keyframes", type=int, default=300, help="of each robot (300)")
    add("--rate", type=float, default=2.0, help="keyframes a second that come to each robot (2)")
    add("--kills", type=int, default=2, help="how often the last robot is killed and started again (2)")
    add(
        "--linger",
        type=float,
        default=30.0,
        metavar="S",
        help="seconds that memory is watched after that (30)",
    )
    add("--security", choices=("malicious", "semi-honest"), default="malicious")
    add("--json", action="store_true", help="one JSON object")
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    arguments = parser()
    options = arguments.parse_args(argv)
    good = options.keyframes >= 1 and options.kills >= 0 and options.rate > 0
    if not (good and 2 <= options.robots <= len(NAMES)):
        arguments.error("--robots is 2 to 6, --keyframes and --rate are positive, --kills is not negative")
    asked = Asked(
        options.robots, options.keyframes, options.rate, options.kills, options.linger, options.security
    )

    def work() -> int:
        with progress_bar("keyframes", quiet=options.json) as progress:
            row = run(asked, progress)
        print(json.dumps(row.as_dict()) if options.json else _text(row), flush=True)
        return 1 if row.missed or row.wrong else 0

    return run_command("python -m bench agents", work)


def _text(row: Row) -> str:
    median, most, largest = row.delay_seconds
    return f"""\
{row.robots} robots, {row.keyframes} keyframes each at {row.rate:g} a second, {row.security}
the last one was killed     {row.kills} times
dealt in                    {row.dealt_seconds:.1f} s
pairs compared              {row.pairs:,}
matches in the clear        {row.candidates:,}
  missed by a robot         {row.missed}
  found, not in the clear   {row.wrong}
  news printed twice        {row.repeated}
keyframe to match, seconds  median {median}, 95 % {most}, largest {largest}
memory of a robot, MB       {", ".join(f"{mb:.0f}" for mb in row.memory_mb)}
  growth after that, MB/h   {", ".join(f"{mb:+.0f}" for mb in row.memory_growth_mb_per_hour)}"""
