"""The demo's plot: scans to maps, deal, two processes that compare and verify, one map, the telling."""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from bench.demo import dataset, places
from bench.demo.exchange import DemoFailed, exchange
from bench.demo.mapping import PublicMap
from bench.demo.merged import merge
from bench.demo.page import Story, page
from bench.demo.picture import draw_before, draw_merged
from bench.demo.plan import plan_text
from bench.demo.result import Report
from bench.demo.scene import views
from bench.out import out_folder
from dealer.team.deal import deal_team
from protocols.geometry.pose_graph import Solver
from protocols.mission import Mission
from protocols.scores import S10
from spdz.console.progress import progress_bar
from spdz.foundations.types import Security
from spdz.local import run_clear


def run_demo(out: Path, security: Security = "malicious", solver: Solver = "scipy") -> Report:
    """Run the whole demo.

    Args:
        out: Folder for the page, the pictures and the maps; created if need be.
        security: The security model.
        solver: Of the pose graph.

    Raises:
        DemoFailed: if a robot's process fails, or no candidate is verified.
        ImportError: if the extra ``spdz[demo]`` is not installed.
        OSError: if the files or the tapes cannot be written.
    """
    _say("reading 3,873 laser scans; two robots map and describe what they see")
    run = dataset.load()
    out_folder(out)
    public = PublicMap.of(run, places.SPACING)
    alice, bob = places.robots(run, public=public)
    with tempfile.TemporaryDirectory(prefix="spdz-demo-") as folder:
        _say("dealing, as the trusted dealer does before the mission")
        (out / "mission.toml").write_text(plan_text(alice, bob, security), encoding="utf-8")
        mission, dealing_room = Mission.load(out / "mission.toml"), Path(folder, "mission")
        started = time.perf_counter()
        with progress_bar("dealing") as bar:
            dealt = deal_team(dealing_room, mission, workers=1, progress=bar)
        dealing = time.perf_counter() - started
        _say("two agents compare all keyframes and verify what matches: two processes, TLS 1.3 on loopback")
        told = exchange(dealing_room, alice, bob, public.background)
    _say("merging both maps")
    try:
        merged = merge(run, alice, bob, told.verdicts, solver)
    except ValueError as error:
        raise DemoFailed(f"the maps cannot be merged: {error}") from error
    (gallery,) = mission.galleries
    truth = places.truth(alice, bob)
    scores = run_clear(S10.within(1.0), alice.descriptors[:, None], bob.descriptors[None]).value
    exact = scores >= places.DEFAULT_THRESHOLD
    clear_cut = (
        np.abs(scores - places.DEFAULT_THRESHOLD)
        > 2.0 ** -(gallery.descriptors[0].purpose.resolution or 64) / 2
    )
    private, clear = bob.fold(told.decisions), bob.fold(exact)
    verified = np.zeros_like(private)
    for pair, verdict in told.verdicts.items():
        verified[pair] = verdict.accepted
    names = ("map.png", "before.png", "mission.toml")
    files = merged.write(out, run, alice, bob) + [out / name for name in names]
    report = Report(
        security=security,
        keyframes=(len(alice.descriptors) // alice.turns, len(bob.descriptors) // bob.turns),
        dimension=alice.descriptors.shape[1],
        threshold=places.DEFAULT_THRESHOLD,
        pairs=int(told.decisions.size),
        candidates=int(private.sum()),
        clear_candidates=int(clear.sum()),
        verified=int(verified.sum()),
        private_quality=places.precision_recall(private, truth),
        clear_quality=places.precision_recall(clear, truth),
        verified_quality=places.precision_recall(verified, truth),
        same_places=int((truth == 1).sum()),
        disagreements=int(((told.decisions != exact) & clear_cut).sum()),
        errors=merged.errors,
        dealt_slots=gallery.slots((alice.name, bob.name)),
        dealing_seconds=dealing,
        folder_bytes=(dealt.folders[dealing_room / alice.name], dealt.folders[dealing_room / bob.name]),
        bytes_sent=told.bytes_sent,
        rounds=told.rounds,
        milliseconds=told.milliseconds,
        shown=told.shown,
        payload_bytes=told.payload_bytes,
        verifying_milliseconds=told.verifying,
        clear_bytes=(alice.descriptors.nbytes, bob.descriptors.nbytes),
        clear_milliseconds=_clear_milliseconds(alice, bob),
        page=str(out / "index.html"),
        picture=str(out / "map.png"),
        files=tuple(path.name for path in files),
    )
    _say("drawing")
    local, n = (alice.local, bob.local), len(alice.local.poses)
    story = Story(
        report=report,
        alice=alice,
        bob=bob,
        verdicts=told.verdicts,
        alone=[views(run, (own,), (own.poses,))[0] for own in local],
        merged=views(run, local, (merged.poses[:n], merged.poses[n:])),
        careless=views(run, local, (merged.unverified[:n], merged.unverified[n:])),
    )
    _write(out, story)
    return report


def _write(out: Path, story: Story) -> None:
    """The page and the pictures."""
    report = story.report
    (out / "index.html").write_text(page(story), encoding="utf-8")
    pairs = [pair for pair, verdict in story.verdicts.items() if verdict.accepted]
    draw_merged(
        out / "map.png", story.merged, pairs,
        f"Laser scans from MIT's corridors. {report.pairs:,} private comparisons, one bit each; "
        f"{report.shown[0]} of {report.keyframes[0]} and {report.shown[1]} of {report.keyframes[1]} submaps "
        "shown.",
    )  # fmt: skip
    draw_before(
        out / "before.png", story.alone,
        f"Trajectory errors of {report.errors.alice_alone:.1f} and {report.errors.bob_alone:.1f} m; "
        f"merged, {report.errors.merged:.1f} m.",
    )  # fmt: skip


def _say(text: str) -> None:
    print(f"... {text}", file=sys.stderr, flush=True)


def _clear_milliseconds(alice: places.Robot, bob: places.Robot) -> float:
    """Time of the decision itself once Bob has Alice's descriptors in the clear; the second of two runs."""
    for _ in range(2):
        started = time.perf_counter()
        _ = alice.descriptors @ bob.descriptors.T >= places.DEFAULT_THRESHOLD
        seconds = time.perf_counter() - started
    return seconds * 1e3
