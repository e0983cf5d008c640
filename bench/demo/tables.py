"""The demo's numbers as tables, for the terminal and the page: found, merged, cost, learned, overheard."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bench.demo.places import DIFFERENT, SAME, Quality
from bench.demo.result import Report
from protocols.geometry.icp import LEAST_SHARE, NEAR


@dataclass(frozen=True, slots=True)
class Table:
    """A title, the names of the columns, and rows of as many words; numbers are aligned to the right."""

    title: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    numbers: bool = True


def tables(report: Report) -> list[Table]:
    """All of them, in the order of the story."""
    return [found(report), merged(report), cost(report), learned(report), overheard(report)]


def found(report: Report) -> Table:
    """Candidates, and which of them are right."""
    alice, bob = report.keyframes
    private, clear, verified = report.private_quality, report.clear_quality, report.verified_quality
    rows = [
        ("pairs compared", f"{report.pairs:,}", f"{report.pairs:,}", ""),
        (
            f"candidates (score >= {report.threshold})",
            f"{report.candidates:,}",
            f"{report.clear_candidates:,}",
            f"{report.verified:,}",
        ),
        (
            f"right: at most {SAME:.0f} m apart",
            *(str(q.true_positives) for q in (private, clear, verified)),
        ),
        (
            f"near: {SAME:.0f} to {DIFFERENT:.0f} m, not counted",
            _neither(report.candidates, private),
            _neither(report.clear_candidates, clear),
            _neither(report.verified, verified),
        ),
        (
            "wrong: another place",
            *(str(q.false_positives) for q in (private, clear, verified)),
        ),
        ("precision, near ones left out", *(f"{q.precision:.2f}" for q in (private, clear, verified))),
        (
            f"recall, of {report.same_places} right pairs",
            *(f"{q.recall:.2f}" for q in (private, clear, verified)),
        ),
        ("decided unlike in the clear", str(report.disagreements), "", ""),
    ]
    title = f"Found: {alice} x {bob} keyframes, {report.dimension}-D Scan Context"
    return Table(title, ("", "private", "in the clear", "of these verified"), rows)


def _neither(candidates: int, quality: Quality) -> str:
    return str(candidates - quality.true_positives - quality.false_positives)


def merged(report: Report) -> Table:
    """Trajectory errors, before and after."""
    errors = report.errors
    rows = [
        ("Alice alone, by odometry", f"{errors.alice_alone:.2f} m"),
        ("Bob alone, by odometry", f"{errors.bob_alone:.2f} m"),
        ("merged, every candidate believed", f"{errors.unverified:.2f} m"),
        ("the same with a robust kernel", f"{errors.kernel_only:.2f} m"),
        (f"merged, the {report.verified} verified candidates", f"{errors.merged:.2f} m"),
        ("Alice's part of it", f"{errors.alice_merged:.2f} m"),
        ("Bob's part of it", f"{errors.bob_merged:.2f} m"),
    ]
    title = (
        f"Merged: {report.verified} candidates verified, {report.candidates - report.verified} rejected "
        f"(at least {LEAST_SHARE:.0%} of the points within {NEAR:.0f} m must agree)"
    )
    return Table(title, ("", "trajectory error"), rows)


def cost(report: Report) -> Table:
    """Bytes, rounds and time."""
    slots, sent, clear = report.dealt_slots, sum(report.bytes_sent), sum(report.clear_bytes)
    shown, verifying = sum(report.payload_bytes), report.verifying_milliseconds
    rows = [
        ("sent by both to compare, in all", f"{sent / 1e6:.2f} MB", f"{clear / 1e6:.2f} MB (float64)"),
        ("sent to compare, a pair", f"{sent / report.pairs:,.0f} B", f"{clear / report.pairs:,.0f} B"),
        ("rounds", str(report.rounds), "1"),
        ("submaps shown by both, in all", f"{shown / 1e6:.2f} MB", f"{shown / 1e6:.2f} MB"),
        (
            "time from meeting to the last verdict, the agents' pauses and verification included",
            f"{report.milliseconds / 1e3:.1f} s",
            "below 0.1 s, and verifying"
            if report.clear_milliseconds < 100
            else f"{report.clear_milliseconds / 1e3:.1f} s, and verifying",
        ),
        ("of that, verifying all candidates", f"{verifying / 1e3:.1f} s", "the same"),
        ("verifying one candidate", f"{verifying / max(1, report.candidates) / 1e3:.2f} s", "the same"),
        ("dealt before the mission", f"a gallery of {slots[0]} x {slots[1]}", "-"),
        ("dealing took", f"{report.dealing_seconds:.1f} s", "-"),
        ("folder dealt to a robot", f"{max(report.folder_bytes) / 1e6:.1f} MB", "-"),
    ]
    title = f"Cost: two agents, two processes, TLS on loopback, {report.security}"
    return Table(title, ("", "private", "descriptors in the clear"), rows)


def learned(report: Report) -> Table:
    """What a robot knows of the other in the end."""
    (alice, bob), shown = report.keyframes, report.shown
    proved = "at most 1, as was proved" if report.security == "malicious" else "no"
    rows = [
        ("number of keyframes", f"yes ({alice}, {bob})", "yes"),
        ("which pairs match", f"yes ({report.candidates} of {report.pairs:,})", "yes"),
        ("how alike a pair is", "no", "yes"),
        ("a vector's norm", proved, "yes"),
        (
            "descriptor and submap of a place that matched",
            f"yes ({shown[0]} of {alice}, {shown[1]} of {bob})",
            "yes",
        ),
        ("any other submap", "no", "no"),
        ("any other descriptor, hence images and paths", "no", f"yes, all {report.dimension} numbers"),
        ("the path, once there is one map", "yes, to who merges", "yes"),
    ]
    return Table(
        "Learned by a robot about the other", ("", "private", "descriptors in the clear"), rows, False
    )


def overheard(report: Report) -> Table:
    """What a listener on the radio would have had."""
    sent = sum(report.bytes_sent) + sum(report.payload_bytes)
    clear = sum(report.clear_bytes) + sum(report.payload_bytes)
    rows = [
        (
            "that two robots talk, when, and how much",
            f"yes (about {sent / 1e6:.0f} MB)",
            f"yes (about {clear / 1e6:.0f} MB)",
        ),
        ("how many keyframes and submaps", "roughly, from the amounts", "yes"),
        ("descriptors", "no", f"yes, all {sum(report.keyframes)}"),
        ("submaps of places that matched", "no", f"yes, all {sum(report.shown)}"),
    ]
    columns = ("", "private, over TLS", "in the clear, as broadcast")
    return Table("Overheard by a listener on the network", columns, rows, False)
