"""What ends a dealing that can be gone on with."""

from __future__ import annotations

from spdz.foundations.errors import SpdzError


class DealingStopped(SpdzError):
    """Workers were lost. What was dealt stays, and the same command goes on."""
