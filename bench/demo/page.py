"""The demo as one page that tells the story: no script, no network, every picture in the file itself."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from html import escape
from importlib import resources

from bench.demo import drawing
from bench.demo.places import DIFFERENT, SAME, Robot
from bench.demo.plan import STRIKES
from bench.demo.result import Report
from bench.demo.scene import View
from bench.demo.tables import Table, cost, found, learned, overheard
from bench.offline_page import document
from protocols.geometry.icp import INLIER, LEAST_SHARE, NEAR
from protocols.geometry.verification import Verified


@dataclass(frozen=True, slots=True, eq=False)
class Story:
    """What the page shows.

    Attributes:
        report: The numbers.
        alice: With the submaps and the true positions.
        bob: The same.
        verdicts: Of the candidates, by Alice's and Bob's keyframe.
        alone: Each robot's map in a frame of its own.
        merged: Both in one.
        careless: Both, merged with every candidate by plain least squares.
    """

    report: Report
    alice: Robot = field(repr=False)
    bob: Robot = field(repr=False)
    verdicts: Mapping[tuple[int, int], Verified] = field(repr=False)
    alone: list[View] = field(repr=False)
    merged: list[View] = field(repr=False)
    careless: list[View] = field(repr=False)

    def apart(self, pair: tuple[int, int]) -> float:
        """Metres between the places of a pair, in truth."""
        x, y = self.alice.positions[pair[0]] - self.bob.positions[pair[1]]
        return float((x * x + y * y) ** 0.5)


def page(story: Story) -> str:
    """The whole page."""
    style = (resources.files("bench.demo") / "style.css").read_text(encoding="utf-8")
    parts = (_opening, _alone, _compared, _verified, _merged, _cost, _learned, _after)
    body = "\n".join(part(story) for part in parts)
    return document("Two robots, one map", style, body)


def _opening(story: Story) -> str:
    report = story.report
    (alice, bob), shown = report.keyframes, report.shown
    twice = ", since some matched more than once" if report.candidates > min(shown) else ""
    picture = drawing.merged_map(story.merged, _pairs(story, True), "The merged map of both robots")
    return f"""<h1>Two robots, one map, and only what matched was shown</h1>
<p class="lede">Alice and Bob drove through MIT's corridors, each on its own. They compared <b>{alice} x {
        bob
    }</b>
places without showing each other one, found <b>{
        report.candidates
    }</b> candidates, showed each other the laser
submaps of those alone (<b>{shown[0]}</b> keyframes of Alice's and <b>{shown[1]}</b> of Bob's{
        twice
    }), and made one
map of it.</p>
<figure class="merged">{picture}
{
        _legend(
            ("", "alice", "Alice's path"),
            ("", "bob", "Bob's path"),
            ("ring", "yes", "the same place, verified"),
            ("block", "alice-wall", "walls seen by Alice"),
            ("block", "bob-wall", "by Bob"),
            ("block", "both", "by both"),
        )
    }
</figure>"""


def _alone(story: Story) -> str:
    errors = story.report.errors
    figures = "".join(
        f"<figure>{drawing.own_map(view, name.lower(), f'{name}&#39;s map by odometry')}"
        f'<figcaption><b class="c-{name.lower()}">{name}</b>: off by {error:.1f} m</figcaption></figure>'
        for view, name, error in zip(
            story.alone, ("Alice", "Bob"), (errors.alice_alone, errors.bob_alone), strict=True
        )
    )
    return f"""<h2>1. Two maps that drift</h2>
<p>Each robot has its wheels' odometry and its laser. Corridors that are straight bend, and what should
close does not. Neither knows where the other started.</p>
<div class="pair">{figures}</div>"""


def _compared(story: Story) -> str:
    report = story.report
    picture = drawing.candidates(story.alone, story.verdicts, "Candidates between both robots' maps")
    return f"""<h2>2. Candidates, found in private</h2>
<p>Every {report.dimension}-number descriptor of Alice's was compared with every one of Bob's:
{report.pairs:,} comparisons under {report.security} security, of which one bit each was opened. For
{report.candidates} the bit says yes. Which lines are right, neither robot knows yet.</p>
<figure class="middling">{picture}
{_legend(("", "yes", "candidate, verified below"), ("dashed", "no", "candidate, rejected below"))}
<figcaption>Alice's map above, Bob's below, each as the robot itself has it.</figcaption></figure>
{_table(found(report))}"""


def _verified(story: Story) -> str:
    report, least = story.report, f"{LEAST_SHARE:.0%}"
    kinds = {pair: _kind(story.apart(pair)) for pair in story.verdicts}
    count = Counter(kinds.values())
    lost = Counter(kinds[pair] for pair in _pairs(story, False))
    rejected = report.candidates - report.verified
    proof = ", under a MAC that proves it to be the one that was compared,"
    proved = proof if report.security == "malicious" else ""
    strip = drawing.shares(story.verdicts, kinds, LEAST_SHARE)
    return f"""<h2>3. Submaps shown and verified, for candidates alone</h2>
<p>For a candidate, and for nothing else, both robots show each other the descriptor{proved} and what their
lasers saw around it.</p>
<p>Each computes the descriptor from the submap that came and holds one against the other,
so that nobody matches with one place and shows another. Then it lays the submaps upon each other
(point-to-line ICP): a candidate counts if at least {least} of the points within {NEAR:.0f} m have one of the
other's within {INLIER * 100:.0f} cm, both ways.</p>
<p><b>{report.verified} verified, {rejected} rejected</b>, among them {
        _all_of(lost["wrong"], "that lie elsewhere")
    }.
{_spared(lost)}After {STRIKES} that fail a robot compares no more with the other until it is
told to: who probes pays for each bit with a place that fits.</p>
<div class="pair overlay">{"".join(_overlay(story, pair) for pair in _examples(story))}</div>
<figure class="narrow">{strip}
{
        _legend(
            ("spot", "yes", f"in truth at most {SAME:.0f} m apart ({count['same']})"),
            ("ring", "yes", f"{SAME:.0f} to {DIFFERENT:.0f} m ({count['near']})"),
            ("ring", "no", f"another place ({count['wrong']})"),
        )
    }
<figcaption>The share of points that agree, a dot a candidate; left of the line it is rejected.</figcaption>
</figure>"""


def _kind(apart: float) -> str:
    """What a candidate is in truth, as the table of candidates counts it."""
    return "same" if apart <= SAME else "near" if apart <= DIFFERENT else "wrong"


def _spared(lost: Counter[str]) -> str:
    count = lost["same"] + lost["near"]
    if not count:
        return ""
    return (
        f"The other {count} would have been right ({lost['same']} of them at most {SAME:.0f} m apart, "
        f"{lost['near']} up to {DIFFERENT:.0f} m): a loop too few costs little. "
    )


def _all_of(count: int, words: str) -> str:
    return {0: f"none {words}", 1: f"the one {words}", 2: f"both {words}"}.get(count, f"all {count} {words}")


def _examples(story: Story) -> list[tuple[int, int]]:
    """The candidate that fits best, and the most convincing of those that were rejected and lie elsewhere."""

    def share(pair: tuple[int, int]) -> float:
        return story.verdicts[pair].weight

    wrong = [pair for pair in _pairs(story, False) if story.apart(pair) > DIFFERENT]
    return [max(group, key=share) for group in (_pairs(story, True), wrong) if group]


def _overlay(story: Story, pair: tuple[int, int]) -> str:
    verdict = story.verdicts[pair]
    if verdict.transform is None:
        return ""
    said = "verified" if verdict.accepted else "rejected"
    submaps = story.alice.local.payloads[pair[0]], story.bob.local.payloads[pair[1]]
    picture = drawing.two_submaps(*submaps, verdict.transform, f"Two submaps, {said}")
    kind = "yes" if verdict.accepted else "no"
    apart = story.apart(pair)
    return f"""<figure class="panel">{picture}
<figcaption><b class="c-{kind}">{said.capitalize()}</b>: {verdict.weight:.0%} of the points agree. In
truth the two places are {apart:.{0 if apart > DIFFERENT else 1}f} m apart.
<span class="c-alice">Alice's</span> and <span class="c-bob">Bob's</span> submap, {2 * drawing.AROUND:.0f}
m across.</figcaption></figure>"""


def _merged(story: Story) -> str:
    errors, report = story.report.errors, story.report
    careless = drawing.merged_map(story.careless, (), "The map with every candidate believed")
    picture = drawing.merged_map(story.merged, _pairs(story, True), "The map with verification")
    bars = [
        ("Alice alone, by odometry", errors.alice_alone, "alice"),
        ("Bob alone, by odometry", errors.bob_alone, "bob"),
        (f"merged, all {report.candidates} candidates believed", errors.unverified, "no"),
        ("the same, with a robust kernel", errors.kernel_only, "both"),
        (f"merged, the {report.verified} verified candidates", errors.merged, "yes"),
    ]
    most = max(error for _, error, _ in bars)
    rows = "".join(
        f'<div><span>{words}</span><span>{error:.2f} m</span><i class="c-{colour}" '
        f'style="width:{100 * error / most:.2f}%"></i></div>'
        for words, error, colour in bars
    )
    return f"""<h2>4. One map</h2>
<p>Both odometries and the verified candidates make a pose graph: least squares, with a kernel that gives
a wrong loop no weight. Below is the trajectory error: the root mean square distance of all scans from
where they were, after one turn and shift for both robots (of a robot alone: for itself). Of the merged
map, Alice's part is off by {errors.alice_merged:.2f} m and Bob's by {errors.bob_merged:.2f} m.</p>
<div class="bars">{rows}</div>
<p>Of {report.candidates} candidates {
        report.private_quality.false_positives
    } are wrong, few enough for the robust kernel
to outvote them without verification: {errors.kernel_only:.2f} m instead of {
        errors.merged:.2f} m. It has to have the
right ones in the majority. Verification adds that each candidate is judged by itself, however many are
wrong, and that both robots know which were: that is what strikes count.</p>
<div class="pair merged"><figure class="panel">{careless}<figcaption><b class="c-no">All {
        report.candidates
    } candidates
believed</b>, no robust kernel: wrong loops fold the building, off by {
        errors.unverified:.2f} m.</figcaption></figure>
<figure class="panel">{picture}<figcaption><b class="c-yes">The {
        report.verified
    } verified candidates</b>: off by {errors.merged:.2f}
m.</figcaption></figure></div>"""


def _cost(story: Story) -> str:
    return f"""<h2>5. What it cost</h2>
{_table(cost(story.report))}"""


def _learned(story: Story) -> str:
    return f"""<h2>6. What leaked</h2>
<p>A robot ends up with the other's submaps of places that matched, right or wrong, and of no others. The
merged map on this page is drawn by who ran the demo and holds all scans. Who merges needs both pose
graphs, hence both paths. The dealer, a program that runs once before the mission on a computer that both
robots trust, is absent during it; with a recording of the frames it could read the descriptors.</p>
{_table(learned(story.report))}
{_table(overheard(story.report))}"""


def _after(story: Story) -> str:
    names = ", ".join(f"<code>{escape(name)}</code>" for name in story.report.files)
    return f"""<h2>7. Files</h2>
<p>Beside this page: {names}. The scans are the Killian Court log of M. Bosse and J. Leonard. Its
optimised poses serve as the truth, to about 1 m; of them a robot has its first heading alone, which
stands for a compass.</p>"""


def _pairs(story: Story, accepted: bool) -> list[tuple[int, int]]:
    return [pair for pair, verdict in sorted(story.verdicts.items()) if verdict.accepted is accepted]


def _legend(*entries: tuple[str, str, str]) -> str:
    items = "".join(f'<li><i class="{shape} c-{colour}"></i>{words}</li>' for shape, colour, words in entries)
    return f'<ul class="legend">{items}</ul>'


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in table.columns)
    rows = "".join(f"<tr><th>{escape(row[0])}</th>{_cells(row[1:])}</tr>\n" for row in table.rows)
    kind = ' class="numbers"' if table.numbers else ""
    return f"""<table{kind}><caption>{escape(table.title)}</caption>
<thead><tr>{head}</tr></thead>
<tbody>
{rows}</tbody></table>"""


def _cells(words: Iterable[str]) -> str:
    return "".join(f"<td>{escape(word)}</td>" for word in words)
