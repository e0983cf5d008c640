"""Several comparisons of a pair, one bit: any of them, or all, and none of them is opened.

Every comparison is decided as a shared bit (:func:`spdz.decided`); then one number that is linear in the
bits has to be 0 or more, and only this comparison is opened:

- any of k bits: ``sum b_i - 1 >= 0``;
- all of n bits: ``-sum (1 - b_i) >= 0``;
- all of n bits, and any of t more: ``sum b_i - t (number of misses among the n) - 1 >= 0``.

So nothing but a rule of several sums (all of several parts, each of several turns) takes another round of
decisions, for all of its sums but the largest.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from operator import add
from typing import Literal, TypeAlias

from spdz import Value, decided, nonnegative, parallel

Rule: TypeAlias = Literal["any", "all"]
RULES: tuple[Rule, Rule] = ("any", "all")


async def combined(groups: Sequence[Sequence[Value]], rule: Rule) -> Value:
    """The comparison that decides: a bit that is to be opened, and nothing else.

    Args:
        groups: Comparisons of one shape; of each group one has to be true.
        rule: Whether any of the groups, or all.
    """
    flat = [bit for group in groups for bit in group]
    if len(flat) == 1:
        return flat[0]
    bits = iter(await decided(*flat))
    sums = [[next(bits) for _ in group] for group in groups]
    if rule == "any":
        return await _any([bit for group in sums for bit in group])
    single = [group[0] for group in sums if len(group) == 1]
    *others, last = sorted((group for group in sums if len(group) > 1), key=len) or [[]]
    single += await decided(*await parallel(*(_any(group) for group in others))) if others else []
    if not single:
        return await _any(last)
    misses = reduce(add, [1 - bit for bit in single])
    if not last:
        return await nonnegative(-misses, len(single))
    most = len(last)
    return await nonnegative(reduce(add, last) - misses * most - 1, most * len(single) + 1)


async def _any(bits: Sequence[Value]) -> Value:
    return await nonnegative(reduce(add, bits) - 1, len(bits) - 1)
