"""What a keyframe must be to be taken: checked against the plan before anything is kept of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy.typing as npt

from protocols.agent.keyframe import Keyframe, check_id, is_stamp
from protocols.agent.keyframes import Described
from protocols.agent.showing import MAX_PAYLOAD
from protocols.mission import GalleryPlan, Mission
from spdz.readings.gallery import Terms
from spdz.session.admission import quantised


class Intake:
    """Checks keyframes for a plan.

    Args:
        plan: The mission's.
    """

    def __init__(self, plan: Mission) -> None:
        self.galleries: dict[str, GalleryPlan] = {gallery.name: gallery for gallery in plan.galleries}
        self.terms: dict[str, Terms] = {
            name: gallery.terms(plan.security) for name, gallery in self.galleries.items()
        }

    def check(
        self, keyframe: object, descriptors: object, payload: object, stamp: Any
    ) -> tuple[Keyframe, dict[str, Described]]:
        """Check one; arguments as of :meth:`protocols.agent.Agent.add`.

        Returns:
            The keyframe, and its vector for every gallery that it has all descriptors of.

        Raises:
            ValueError: for what does not suit the plan, naming it.
        """
        number = check_id(keyframe)
        try:
            described = self._described(descriptors)
            return Keyframe(number, None, _payload(payload), _stamp(stamp)), described
        except ValueError as error:
            raise ValueError(f"keyframe {number}: {error}") from error

    def _described(self, descriptors: object) -> dict[str, Described]:
        known = {one.name for gallery in self.galleries.values() for one in gallery.descriptors}
        names = ", ".join(sorted(known))
        if not isinstance(descriptors, Mapping):
            raise ValueError(f"descriptors are given by name, such as {{{names.split(', ')[0]!r}: vector}}")
        if unknown := [name for name in descriptors if name not in known]:
            raise ValueError(f"the plan has no descriptor {unknown[0]!r:.40}; it has {names}")
        described, lacking = {}, list[str]()
        for name, gallery in self.galleries.items():
            missing = [one.name for one in gallery.descriptors if one.name not in descriptors]
            if missing:
                lacking.append(f"{name} needs {' and '.join(missing)}")
                continue
            given: dict[str, npt.ArrayLike] = {one.name: descriptors[one.name] for one in gallery.descriptors}
            vector = gallery.vector(given)
            described[name] = Described(vector, quantised(self.terms[name], vector[None])[0])
        if not described:
            raise ValueError(f"it can be compared with nothing: {'; '.join(lacking)}")
        return described


def _payload(payload: object) -> bytes:
    if not isinstance(payload, (bytes, bytearray, memoryview)):
        raise ValueError(f"a payload is bytes, not {type(payload).__name__}")
    if len(payload) > MAX_PAYLOAD:
        raise ValueError(f"a payload is at most {MAX_PAYLOAD >> 20} MiB of bytes")
    return bytes(payload)


def _stamp(stamp: Any) -> float | None:
    if stamp is None:
        return None
    if isinstance(stamp, (str, bytes)) or not is_stamp(stamp):
        raise ValueError("its stamp is not a finite number of seconds")
    return float(stamp)
