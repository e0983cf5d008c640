"""From a gallery of the plan to what a gallery's tape is dealt for: the one place that knows both."""

from __future__ import annotations

from collections.abc import Sequence

from protocols.catalog import GalleryPurpose
from protocols.mission.descriptors import DescriptorPlan
from protocols.mission.errors import PlanError
from spdz.foundations.types import Security
from spdz.readings.gallery import Terms


def gallery_purpose(name: str, descriptors: Sequence[DescriptorPlan], rule: str) -> GalleryPurpose:
    """What a gallery of these descriptors is dealt for.

    Raises:
        PlanError: for what is not dealt yet.
    """
    first, *others = descriptors
    if others or first.turns > 1 or first.name != name:
        raise PlanError(
            "several descriptors a place, and several turns of one, are not dealt yet: leave [places] out, "
            "and turns at 1",
            field=name,
        )
    return first.purpose


def gallery_terms(name: str, descriptors: Sequence[DescriptorPlan], rule: str, security: Security) -> Terms:
    """What slots and pairs of such a gallery are read with, the thresholds included.

    Raises:
        PlanError: for what is not dealt yet.
    """
    return gallery_purpose(name, descriptors, rule).terms(descriptors[0].threshold, security)
