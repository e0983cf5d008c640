"""How many jobs share rounds: what makes rounds few and keeps memory and losses small.

Both robots, and the dealer's plan, must come to the same number, so it depends on public numbers alone.
"""

from __future__ import annotations

from spdz.rounds.wire import ELEMENT_BYTES

MASKED_BYTES = 2 << 20
"""Jobs share rounds up to about this many bytes of masked descriptors of a robot,"""

DEALT_BYTES = 64 << 20
"""this many dealt bytes, which are read ahead,"""

MOST_JOBS = 64
"""and this many jobs, so that a broken connection, which costs two such runs at most, costs little."""


def jobs_together(tile: tuple[int, int], dim: int, correction_bytes: tuple[int, int]) -> int:
    """How many jobs travel in the same rounds; at least one, however large.

    Args:
        tile: Descriptors of party 0 and of party 1 in a job.
        dim: Length of a descriptor.
        correction_bytes: What either party stores for a job (of the meter's plan).
    """
    masked = ELEMENT_BYTES * dim * max(tile)
    return max(1, min(MOST_JOBS, MASKED_BYTES // masked, DEALT_BYTES // max(*correction_bytes, 1)))
