"""The galleries of a plan: what is dealt once a pair of robots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from protocols.combining import RULES, Rule
from protocols.mission.descriptors import DescriptorPlan, check_gallery_name
from protocols.mission.fields import Table, nearest, shown
from protocols.mission.purposes import gallery_purpose, gallery_terms
from protocols.place_purpose import AnyPurpose
from spdz.arithmetic.fixed_point import encode
from spdz.foundations.types import FloatArray, Json, Security
from spdz.readings.gallery import Terms


@dataclass(frozen=True, slots=True)
class GalleryPlan:
    """A gallery: of one descriptor, or of places with several.

    Attributes:
        name: The descriptor's name, or the place's.
        descriptors: What a slot holds, in this order.
        rule: Whether any or all of them must match for a pair of places to match.
        keyframes: Keyframes expected of each agent.
    """

    name: str
    descriptors: tuple[DescriptorPlan, ...]
    rule: Rule
    keyframes: Mapping[str, int]

    @property
    def purpose(self) -> AnyPurpose:
        """What its tapes are dealt for."""
        return gallery_purpose(self.name, self.descriptors, self.rule)

    @property
    def is_place(self) -> bool:
        """Whether it has a name of its own."""
        return self.name not in {one.name for one in self.descriptors}

    def terms(self, security: Security) -> Terms:
        """What slots and pairs are read with, the threshold included."""
        return gallery_terms(self.name, self.descriptors, self.rule, security)

    def slots(self, couple: tuple[str, str]) -> tuple[int, int]:
        """Slots of a pair's first and of its second robot."""
        return self.keyframes[couple[0]], self.keyframes[couple[1]]

    def description(self) -> dict[str, Json]:
        """For the tapes' headers, which a handshake compares."""
        return {**self.purpose.as_json(), "gallery": self.name}

    def vector(self, descriptors: Mapping[str, npt.ArrayLike]) -> FloatArray:
        """One keyframe's slot: its descriptors, checked and one behind the other.

        Args:
            descriptors: By name: shape (dim,), or (turns, dim) where a place brings several turns.

        Returns:
            float64 of shape (terms.dim,).

        Raises:
            ValueError: for other names, shapes or types, numbers that are not finite, or norms out of range.
        """
        names = [one.name for one in self.descriptors]
        for name in descriptors:
            if name not in names:
                raise ValueError(f"{self.name} has no descriptor {shown(name)}; {nearest(str(name), names)}")
        for name in names:
            if name not in descriptors:
                raise ValueError(f"{name} is missing: {self.name} takes {', '.join(names)}")
        return np.concatenate([_checked(one, descriptors[one.name]) for one in self.descriptors])


def _checked(plan: DescriptorPlan, descriptor: npt.ArrayLike) -> FloatArray:
    dim, turns, purpose = plan.purpose.dim, plan.turns, plan.purpose
    try:
        array = np.asarray(descriptor)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{plan.name}: expected an array of real numbers") from error
    wanted = (turns, dim) if turns > 1 else (dim,)
    if array.shape != wanted and array.shape != (turns, dim):
        raise ValueError(f"{plan.name}: expected an array of shape {wanted}, got {array.shape}")
    if array.dtype.kind not in "iuf":
        raise ValueError(f"{plan.name}: expected real numbers, got dtype {array.dtype}")
    for turn in array.reshape(turns, dim):
        encode(turn, max_norm=purpose.max_norm, min_norm=purpose.min_norm, name=plan.name)
    return array.astype(np.float64).reshape(-1)


def read_galleries(
    root: Table, descriptors: Sequence[DescriptorPlan], agents: Sequence[str]
) -> tuple[GalleryPlan, ...]:
    """One for every descriptor that is in no place, then one for every place.

    Raises:
        PlanError: for unknown descriptors or rules, or one that is in two places.
    """
    places: list[GalleryPlan] = []
    by_name = {one.name: one for one in descriptors}
    used: dict[str, str] = {}
    for name, table in root.named_tables("places"):
        table.only("of", "rule")
        check_gallery_name(table, name, [*by_name, *(other.name for other in places)])
        of = table.texts("of")
        for part in of:
            if part not in by_name:
                raise table.error(
                    f"no descriptor is called {shown(part)}; {nearest(part, list(by_name))}", "of"
                )
            if part in used:
                raise table.error(f"{part} is in the place {used[part]!r} already", "of")
            used[part] = name
        if not of:
            raise table.error("a place has at least one descriptor", "of")
        parts = tuple(by_name[part] for part in of)
        most = {agent: max(part.keyframes[agent] for part in parts) for agent in agents}
        rule = cast(Rule, table.choice("rule", RULES))
        places.append(_possible(GalleryPlan(name, parts, rule, most), table))
    outer = root.table("descriptors")
    alone = [
        _possible(GalleryPlan(one.name, (one,), "any", one.keyframes), outer.table(one.name))
        for one in descriptors
        if one.name not in used
    ]
    return (*alone, *places)


def _possible(gallery: GalleryPlan, table: Table) -> GalleryPlan:
    """The gallery, if tapes can be dealt for it."""
    first, *others = gallery.descriptors
    for one in others:
        if one.purpose.resolution != first.purpose.resolution:
            raise table.error(
                f"the descriptors of a place are compared to one resolution: {first.name} has "
                f"{first.purpose.step_text} and {one.name} {one.purpose.step_text}",
                "of",
            )
    try:
        _ = gallery.purpose
    except ValueError as error:
        raise table.error(str(error)) from error
    return gallery


def places_as_json(galleries: Sequence[GalleryPlan]) -> dict[str, Any]:
    """The places as in the file."""
    return {
        one.name: {"of": [part.name for part in one.descriptors], "rule": one.rule}
        for one in galleries
        if one.is_place
    }
