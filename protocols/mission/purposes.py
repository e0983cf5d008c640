"""From a gallery of the plan to what a gallery's tape is dealt for: the one place that knows both."""

from __future__ import annotations

from collections.abc import Sequence

from protocols.catalog import GalleryPurpose
from protocols.combining import Rule
from protocols.mission.descriptors import DescriptorPlan
from protocols.place_purpose import AnyPurpose, Part, PlacePurpose
from spdz.foundations.types import Security
from spdz.readings.gallery import Terms


def gallery_purpose(name: str, descriptors: Sequence[DescriptorPlan], rule: Rule) -> AnyPurpose:
    """What a gallery of these descriptors is dealt for.

    A descriptor of one turn that is compared on its own takes a plain gallery, all else one of places. All
    descriptors have the resolution of the first.

    Raises:
        ValueError: if a place is too large for a gallery's words.
    """
    first, *others = descriptors
    if not others and first.name == name and first.turns == 1:
        return first.purpose
    parts = (
        Part(one.name, purpose.score, purpose.dim, one.turns, purpose.max_norm, purpose.min_norm)
        for one in descriptors
        for purpose in (one.purpose,)
    )
    return PlacePurpose(tuple(parts), rule, first.purpose.resolution)


def gallery_terms(name: str, descriptors: Sequence[DescriptorPlan], rule: Rule, security: Security) -> Terms:
    """What slots and pairs of such a gallery are read with, the thresholds included."""
    purpose = gallery_purpose(name, descriptors, rule)
    if isinstance(purpose, GalleryPurpose):
        return purpose.terms(descriptors[0].threshold, security)
    return purpose.terms({one.name: one.threshold for one in descriptors}, security)
