"""What of a plan will not do what its writer wants, though it can be dealt."""

from __future__ import annotations

from collections.abc import Iterator

from protocols.mission import KINDS, Mission
from protocols.thresholds import resolution_warning, threshold_warning

_ZERO_IS_NEAR = ("S2", "S3", "S4", "S5", "S6")


def advice(mission: Mission) -> Iterator[str]:
    """Sentences about single descriptors, each with its name."""
    for one in mission.descriptors:
        purpose = one.purpose
        name = one.name if one.kind is None else f"{one.name}, {KINDS[one.kind].label}"
        for text in (threshold_warning(purpose, one.threshold), resolution_warning(purpose)):
            if text is not None:
                yield f"{name}: {text}"
        if mission.security == "malicious" and purpose.score in _ZERO_IS_NEAR and not purpose.min_norm:
            yield (
                f"{name}: a short vector is near to all in {purpose.score}, and a peer may bring one: "
                "with min_norm every descriptor is proved to be no shorter, at no cost"
            )
