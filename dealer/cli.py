"""The dealer's command line."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import replace

from dealer import gallery_cli, report
from dealer.folders import check_agents
from dealer.mission import deal_mission, mission_bytes
from dealer.options import NAME, SPARE, misplaced, note, parser
from dealer.plan import (
    Impossible,
    TilePlan,
    advice,
    jobs_for,
    pick,
    plan_maps,
    plan_tile,
    with_dealing_seconds,
)
from dealer.report import Wanted
from dealer.team import cli as team
from dealer.team.options import settle
from dealer.words import counted, each_pair, in_seconds
from protocols.catalog import Purpose
from protocols.memory import in_bytes
from spdz.arithmetic.fixed_point import MAX_NORM
from spdz.console.command import FAILED, run_command, say_error, wants_json
from spdz.console.progress import progress_bar
from spdz.foundations.errors import SpdzError


def main(argv: Sequence[str] | None = None) -> int:
    """Run the dealer; returns the exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    return run_command(NAME, lambda: _run(words), as_json=wants_json(words))


def _run(words: Sequence[str]) -> int:
    arguments = parser()
    options = arguments.parse_args(words)
    if (wrong := settle(options)) is not None:
        arguments.error(wrong)
    if options.out is None and not options.plan:
        arguments.error("say where to write with --out DIR, or ask for a --plan")
    if options.mission is not None:
        return _deal_plan(options)
    if (wrong := misplaced(options)) is not None:
        arguments.error(wrong)
    if options.meetings is not None and options.maps is None:
        arguments.error("--meetings says how many times --maps meet: give --maps, or a larger --count")
    try:
        check_agents(options.agents)
        if options.slots is not None:
            gallery_cli.run(options)
            return 0
        if options.count is not None and options.count < 1:
            raise ValueError("deal at least one comparison")
        purpose = Purpose(
            score=options.score,
            dim=options.dim,
            reveal=options.reveal,
            tile=options.tile or (1, 1),
            max_norm=MAX_NORM if options.max_norm is None else options.max_norm,
            min_norm=options.min_norm or 0.0,
            proof=options.norm_proof,
        )
        note(options, advice(purpose, options.security))
        if options.plan:
            _show(options, purpose)
        else:
            _deal(options, purpose)
    except (ValueError, OSError) as error:
        say_error(NAME, type(error).__name__, _sentence(error), as_json=options.json)
        return 2
    return 0


def _deal_plan(options: argparse.Namespace) -> int:
    try:
        team.run(options)
    except (ValueError, OSError) as error:
        say_error(NAME, type(error).__name__, _sentence(error), as_json=options.json)
        return 2
    except SpdzError as error:
        say_error(NAME, type(error).__name__, str(error), as_json=options.json)
        return FAILED
    return 0


def _sentence(error: Exception) -> str:
    """What the system says of a file, without its number and Python's quotes."""
    if isinstance(error, OSError) and error.strerror and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return str(error)


def _wanted(options: argparse.Namespace) -> Wanted:
    spare = options.spare if options.spare is not None else SPARE * (options.maps is not None)
    meetings = 1 if options.meetings is None else options.meetings
    return Wanted(options.agents, options.maps, meetings, spare)


def _plans(
    options: argparse.Namespace, purpose: Purpose
) -> tuple[list[TilePlan | Impossible], TilePlan, str]:
    """All plans, the picked one, and why."""
    wanted = _wanted(options)
    room = {"meetings": wanted.meetings, "interruptions": wanted.interruptions}
    if options.maps is not None and options.tile is None:
        plans = plan_maps(options.agents, purpose, options.maps, options.security, **room)
        return plans, *pick(plans)
    jobs = (
        -(-options.count // purpose.pairs) if options.maps is None else jobs_for(options.maps, purpose.tile)
    )
    plan = plan_tile(options.agents, purpose, jobs, options.maps, options.security, **room)
    return [plan], plan, "the tile that was given" if options.tile else "the default; --tile gives another"


def _show(options: argparse.Namespace, purpose: Purpose) -> None:
    plans, picked, why = _plans(options, purpose)
    plans = with_dealing_seconds(plans, purpose, options.security)
    if options.json:
        lines = report.as_json(plans, picked, why, purpose, options.security)
    else:
        dealt = replace(purpose, tile=picked.tile)
        total = mission_bytes(options.agents, dealt, picked.comparisons, options.security)
        lines = report.as_text(plans, picked, why, purpose, options.security, _wanted(options), total)
    for line in lines:
        print(line, flush=True)


def _deal(options: argparse.Namespace, purpose: Purpose) -> None:
    started = time.perf_counter()
    wanted = _wanted(options)
    _, picked, why = _plans(options, purpose)
    purpose, count = replace(purpose, tile=picked.tile), picked.comparisons
    if options.maps is not None:
        note(options, f"jobs of {picked.tile[0]} x {picked.tile[1]} descriptors: {why}")
    size = mission_bytes(options.agents, purpose, count, options.security)
    if size > 100e6:
        note(options, f"writing about {in_bytes(size)} in all")
    with progress_bar("dealing", quiet=options.quiet) as progress:
        dealt = deal_mission(options.out, options.agents, purpose, count, options.security, progress=progress)
    seconds = time.perf_counter() - started
    if options.json:
        print(
            json.dumps(
                {
                    "comparisons": dealt.comparisons,
                    "jobs": dealt.jobs,
                    "spare_jobs": picked.spare_jobs,
                    "meetings": wanted.meetings if wanted.maps else None,
                    "interruptions": wanted.interruptions,
                    "pairs": dealt.pairs,
                    "tile": list(purpose.tile),
                    "security": options.security,
                    "seconds": round(seconds, 3),
                    "bytes": {str(folder): size for folder, size in dealt.folders.items()},
                }
            )
        )
        return
    what = f"{counted(dealt.comparisons, 'comparison')} in {counted(dealt.jobs, 'job')}"
    print(f"dealt {what} {each_pair(dealt.pairs)}, {options.security}, in {in_seconds(seconds)}")
    for folder, size in dealt.folders.items():
        print(f"  {folder}: {in_bytes(size)}")
    print(report.enough_for(picked, wanted))
    print("copy each folder to its robot, and keep no other copy of it")


if __name__ == "__main__":
    sys.exit(main())
