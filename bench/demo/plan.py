"""The plan of the demo's mission: what the dealer is given."""

from __future__ import annotations

from bench.demo.places import DEFAULT_THRESHOLD, Robot
from spdz.foundations.types import Security

DESCRIPTOR = "lidar"
"""The descriptor's name."""
STRIKES = 12
"""Matches that may fail to verify before a robot stops comparing: corridors need more than the usual three."""


def plan_text(alice: Robot, bob: Robot, security: Security) -> str:
    """``mission.toml`` of both robots."""
    return f"""name = "corridors"
security = "{security}"

[[agents]]
name = "{alice.name}"

[[agents]]
name = "{bob.name}"

[descriptors.{DESCRIPTOR}]
kind = "D5"  # Scan Context: S10 of {alice.descriptors.shape[1]} numbers
threshold = {DEFAULT_THRESHOLD}
keyframes = {{ {alice.name} = {len(alice.descriptors)}, {bob.name} = {len(bob.descriptors)} }}

[budgets]
strikes = {STRIKES}  # matches that may fail to verify: here one in four does
"""
