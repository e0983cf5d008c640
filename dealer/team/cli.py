"""The dealer's command for a mission's plan."""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

from dealer.options import note
from dealer.team import report
from dealer.team.advice import advice
from dealer.team.cluster import Cluster
from dealer.team.deal import Dealt, deal_team, look_round
from dealer.team.forecast import forecast
from dealer.words import counted, in_seconds
from protocols.memory import in_bytes
from protocols.mission import Mission
from spdz.console.progress import progress_bar


def run(options: argparse.Namespace) -> None:
    """Plan or deal.

    Raises:
        ValueError: for a broken plan, or what there is no room for.
        OSError: if the folders cannot be written, or the mission is dealt already.
        DealingStopped: if workers were lost.
    """
    mission = Mission.load(options.mission)
    for text in advice(mission):
        note(options, text)
    if not options.plan:
        _deal(options, mission)
        return
    cost = forecast(mission, options.workers)
    here = look_round(options.out or Path(), mission, workers=options.workers, cluster=_cluster(options))
    for line in (
        [report.as_json(mission, cost, here)] if options.json else report.as_text(mission, cost, here)
    ):
        print(line, flush=True)


def _deal(options: argparse.Namespace, mission: Mission) -> None:
    started = time.perf_counter()
    with progress_bar("dealing", quiet=options.quiet) as progress:
        try:
            dealt = deal_team(
                options.out, mission, workers=options.workers, cluster=_cluster(options), progress=progress
            )
        except KeyboardInterrupt:
            note(options, "what was dealt stays: give the same command to go on")
            raise
    seconds = time.perf_counter() - started
    if options.json:
        print(json.dumps(_fields(mission, dealt, seconds)))
        return
    if dealt.resumed:
        note(
            options,
            f"{dealt.resumed} of {counted(dealt.tasks, 'gallery', 'galleries')} had been dealt before",
        )
    print(
        f"dealt {counted(dealt.tasks, 'gallery', 'galleries')} for {counted(len(mission.pairs), 'pair')} of "
        f"robots, {mission.security}, in {in_seconds(seconds)}"
    )
    for folder, size in dealt.folders.items():
        print(f"  {folder}: {in_bytes(size)}")
    print("copy each folder to its robot, and keep no other copy of it")


def _fields(mission: Mission, dealt: Dealt, seconds: float) -> dict[str, object]:
    return {
        "mission": dealt.mission_id,
        "digest": mission.digest,
        "pairs": len(mission.pairs),
        "galleries": dealt.tasks,
        "resumed": dealt.resumed,
        "security": mission.security,
        "seconds": round(seconds, 3),
        "bytes": {str(folder): size for folder, size in dealt.folders.items()},
    }


def _cluster(options: argparse.Namespace) -> Cluster | None:
    if options.scheduler is None:
        return None
    return Cluster(
        options.scheduler,
        options.tls_ca,
        options.tls_cert,
        options.tls_key,
        plain=options.insecure_plain_tcp,
        workers=options.workers or 0,
    )
