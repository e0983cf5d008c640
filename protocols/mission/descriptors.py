"""The descriptors of a plan: what is compared, how, and how many keyframes bring one."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from protocols.catalog import GalleryPurpose, parse_resolution
from protocols.mission.errors import PlanError
from protocols.mission.fields import Table, nearest, shown
from protocols.mission.presets import KINDS, Kind
from protocols.scores import SCORES
from protocols.thresholds import is_hopeless, threshold_warning
from spdz.arithmetic.fixed_point import MAX_NORM
from spdz.gallery.format import MAX_SLOTS

MOST_TURNS = 16
_MOST_DIM = 1 << 20
_NAME = re.compile(r"[A-Za-z0-9_-]{1,31}")
_FIELDS = (
    "kind",
    "score",
    "dim",
    "threshold",
    "resolution",
    "max_norm",
    "min_norm",
    "keyframes",
    "turns",
)


@dataclass(frozen=True, slots=True)
class DescriptorPlan:
    """One descriptor.

    Attributes:
        name: The plan's name for it.
        kind: The preset that it began with, or None.
        purpose: Score, length, norms and resolution, of one turn.
        threshold: In the score's units.
        keyframes: Keyframes expected of each agent.
        turns: Rotations that a place brings of it.
    """

    name: str
    kind: str | None
    purpose: GalleryPurpose
    threshold: float
    keyframes: Mapping[str, int]
    turns: int = 1

    def as_json(self) -> dict[str, Any]:
        """As in the file, with every field."""
        purpose = self.purpose
        return {
            **({} if self.kind is None else {"kind": self.kind}),
            "score": purpose.score,
            "dim": purpose.dim,
            "threshold": self.threshold,
            "resolution": purpose.step_text,
            "max_norm": purpose.max_norm,
            "min_norm": purpose.min_norm,
            "keyframes": dict(self.keyframes),
            "turns": self.turns,
        }


def read_descriptors(root: Table, agents: Sequence[str]) -> tuple[DescriptorPlan, ...]:
    """The descriptors, in the order of the file.

    Raises:
        PlanError: for none, or for what cannot be compared.
    """
    found: list[DescriptorPlan] = []
    for name, table in root.named_tables("descriptors"):
        check_gallery_name(table, name, [other.name for other in found])
        found.append(_descriptor(name, table, agents))
    if not found:
        raise root.error(
            "a mission compares something: add a table such as [descriptors.lidar]", "descriptors"
        )
    return tuple(found)


def check_gallery_name(table: Table, name: str, taken: Sequence[str]) -> None:
    """Refuse a name that no file can have, or that another descriptor or place has.

    Raises:
        PlanError: saying which names will do.
    """
    if not _NAME.fullmatch(name):
        raise table.error(f"a name is 1 to 31 letters, digits, '_' and '-', not {shown(name)}")
    if name.lower() in (other.lower() for other in taken):
        raise table.error(f"the name {name!r} is taken (case does not count): give another")


def _descriptor(name: str, table: Table, agents: Sequence[str]) -> DescriptorPlan:
    table.only(*_FIELDS)
    kind = None
    if "kind" in table:
        kind = _kind(table)
    purpose = _purpose(table, kind)
    threshold = table.number("threshold", kind.threshold if kind else None)
    if is_hopeless(purpose, threshold):
        why = threshold_warning(purpose, threshold) or "no pair can pass it"
        raise table.error(why if kind is None else f"{kind.label}: {why}", "threshold")
    return DescriptorPlan(
        name=name,
        kind=None if kind is None else kind.name,
        purpose=purpose,
        threshold=threshold,
        keyframes=_keyframes(table, agents),
        turns=table.whole("turns", 1, MOST_TURNS, 1),
    )


def _kind(table: Table) -> Kind:
    name = table.text("kind")
    if name not in KINDS:
        labels = ", ".join(kind.label for kind in KINDS.values())
        raise table.error(f"expected one of {labels}, not {shown(name)}", "kind")
    return KINDS[name]


def _purpose(table: Table, kind: Kind | None) -> GalleryPurpose:
    usual = GalleryPurpose("S10", 1)
    largest = table.number("max_norm", kind.max_norm if kind else usual.max_norm)
    if not 0 < largest <= MAX_NORM:
        raise table.error(f"expected a norm above 0 and at most {MAX_NORM:,.0f}, not {largest:g}", "max_norm")
    smallest = table.number("min_norm", kind.min_norm if kind else usual.min_norm)
    if not 0 <= smallest <= largest:
        raise table.error(f"expected a norm from 0 to max_norm = {largest:g}, not {smallest:g}", "min_norm")
    try:
        return GalleryPurpose(
            score=_score(table, kind),
            dim=table.whole("dim", 1, _MOST_DIM, kind.dim if kind else None),
            max_norm=largest,
            resolution=_resolution(table, kind.resolution if kind else usual.resolution),
            min_norm=smallest,
        )
    except PlanError:
        raise
    except ValueError as error:
        raise table.error(str(error)) from error


def _score(table: Table, kind: Kind | None) -> str:
    """By its identifier or the paper's name, in any case."""
    text = table.text("score", kind.score if kind else None)
    for known in SCORES.values():
        if text.lower() in (known.name.lower(), known.title.lower()):
            return known.name
    names = [f"{known.name} ({known.title})" for known in SCORES.values()]
    raise table.error(f"expected one of {', '.join(names)}, not {shown(text)}", "score")


def _resolution(table: Table, default: int | None) -> int | None:
    if "resolution" not in table:
        return default
    try:
        return parse_resolution(table.text("resolution"))
    except PlanError:
        raise
    except ValueError as error:
        raise table.error(str(error), "resolution") from error


def _keyframes(table: Table, agents: Sequence[str]) -> dict[str, int]:
    expected = table.values.get("keyframes")
    if not isinstance(expected, dict):
        each = table.whole("keyframes", 1, MAX_SLOTS)
        return dict.fromkeys(agents, each)
    for name in expected:
        if name not in agents:
            raise table.error(f"no robot is called {shown(name)}; {nearest(name, agents)}", "keyframes", name)
    for name in agents:
        if name not in expected:
            raise table.error(f"say how many {name} brings, as for the others", "keyframes")
    return {name: table.check_whole(expected[name], 1, MAX_SLOTS, "keyframes", name) for name in agents}
