"""Verifications that an agent can be given as they are: ``--verify protocols.geometry.verifiers:laser``."""

from __future__ import annotations

from protocols.agent.keyframe import Meeting, Verdict
from protocols.geometry.verification import verify_submaps


def laser(meeting: Meeting) -> Verdict:
    """Align the 2-D laser submaps that two robots have shown each other.

    The payloads are :class:`~protocols.geometry.submap.Submap`. Whether the peer's gives the descriptor that
    was compared depends on how descriptors are made, and is not looked at here: who can make the descriptor
    of a submap checks that first, as ``bench/demo/robot.py`` does.
    """
    return Verdict(*verify_submaps(meeting.own.payload, meeting.other.payload))
