"""The abstract engine: what a protocol sees, and the three ways in which a gate can be read.

A *protocol* is an ``async def`` over values; it calls gates (:mod:`spdz.gates`) and linear operations.
A *gate* is the unit that needs dealt correlations or openings. It is written three times in one class,
side by side: what the dealer deals for it, what a party evaluates, and what it means in the clear. The
meter reads the dealer's text without data. An engine is one *reading*:

- :class:`Recipe` -- the dealer's (masks only) and the meter's (shapes only);
- :class:`Evaluation` -- a party's, on masked values and shares;
- :class:`ClearText` -- plain integers: the insecure baseline and the oracle of the tests.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from spdz.arithmetic.bound import Bound
from spdz.arithmetic.public import Raw
from spdz.arithmetic.rings import Ring
from spdz.dcf import Keys
from spdz.foundations.types import Block, FieldArray, IntArray, Security, Shape
from spdz.values import input_mask
from spdz.values.party_ring import PartyRing
from spdz.values.trees import TreeKey, TreePads
from spdz.values.value import Value


@dataclass(frozen=True, slots=True)
class Input:
    """One party's private input as a program sees it.

    Attributes:
        owner: The party (0 or 1) whose input it is.
        shape: Its public shape.
        norm: Largest honest L2 norm along the last axis, in raw units.
        proved: Whether its norm is proved, for which its words must be short enough.
        data: The raw integers at the owner (int64), else None.
    """

    owner: int
    shape: Shape
    norm: int
    proved: bool = False
    data: IntArray | None = dataclass_field(default=None, repr=False)


class Engine(ABC):
    """One reading of a protocol."""

    ring: Ring
    security: Security
    resolution: int | None = None
    """Fractional bits that a comparison which goes straight to the output looks at; None: all of them."""
    slot_bits: int | None = None
    """Bits of a word where inputs stand in a gallery; None: as an input's shape and norm ask."""

    @property
    def malicious(self) -> bool:
        """Whether values carry MACs."""
        return self.security == "malicious"

    def input_mask_bits(self, source: Input) -> int:
        """How long the mask of an input is (:mod:`spdz.values.input_mask`)."""
        if self.slot_bits is not None:
            return self.slot_bits
        bits = input_mask.job_bits(source.shape, source.norm)
        return min(bits, input_mask.provable_bits(source.shape[-1])) if source.proved else bits

    def read(self, gate: Gate, *operands: Any) -> Any:
        """Read a gate in this engine's way (a coroutine for interactive gates)."""
        if gate.decides:
            for operand in operands:
                if isinstance(operand, Value):
                    operand.decide()
        return self._read(gate, *operands)

    @abstractmethod
    def _read(self, gate: Gate, *operands: Any) -> Any:
        """Read a gate whose operands are known."""

    @abstractmethod
    def shared(self, x: Value) -> Value:
        """Turn ``<x>`` into ``[[x]]``; a shared value is returned as it is."""

    @abstractmethod
    def plus(self, x: Value, raw: Raw) -> tuple[Any, ...]:
        """The parts of x plus public raw integers, whose shape broadcasts to x's (:meth:`Value.plus_raw`)."""

    @abstractmethod
    def remasked(self, x: Value, raw: int) -> tuple[Any, ...]:
        """The parts of ``<x> = (eps + raw, r - raw)``: the same number behind another mask."""

    @property
    @abstractmethod
    def has_unchecked_openings(self) -> bool:
        """Whether anything was opened since the last MAC check (always False without MACs)."""


class Recipe(Engine):
    """The reading on masks alone: names each correlation in the order in which a party will draw it."""

    @abstractmethod
    def shared_value(
        self, kind: str, of: tuple[Value, ...], shape: Shape, frac: int, bound: Bound, *, is_bit: bool = False
    ) -> Value:
        """The result ``[[z]]`` of gate ``kind`` on operands ``of``."""

    @abstractmethod
    def masked_value(
        self,
        kind: str,
        of: tuple[Value, ...],
        shape: Shape,
        frac: int,
        bound: Bound,
        make: Callable[[], FieldArray],
        *,
        mask_bits: int = 127,
        span: int = 0,
        count: tuple[str, int] | None = None,
    ) -> Value:
        """Deal [[r]] for the mask ``r = make()`` of the result ``<z>`` of gate ``kind``; returns ``<z>``."""

    @abstractmethod
    def input_mask(self, source: Input) -> Value:
        """Deal r to the owner and [[r]] to both; returns ``<x>``."""

    @abstractmethod
    def authenticated(
        self,
        shape: Shape,
        make: Callable[[], FieldArray],
        *,
        of: tuple[Value, ...] = (),
        count: tuple[str, int] | None = None,
        stored_by: int = 1,
    ) -> None:
        """Deal [[v]] for ``v = make()``, a function of operands ``of``.

        Args:
            shape: Of v.
            make: Computes v, from the masks of ``of``.
            of: Operands.
            count: Books correlations.
            stored_by: Which party stores its share of v; the other's is a pad.
        """

    @abstractmethod
    def triple(
        self,
        kind: str,
        shape: Shape,
        product_shape: Shape,
        product: Callable[[FieldArray, FieldArray], FieldArray],
    ) -> None:
        """Deal one Beaver triple ([[a]], [[b]], [[product(a, b)]]) with a, b uniform of ``shape``."""

    @abstractmethod
    def uniform_below(self, limit: int, shape: Shape) -> FieldArray:
        """Dealer's randomness: uniform in [0, limit). The meter returns no data: use it in ``make`` only."""

    @abstractmethod
    def comparison_key(
        self, shape: Shape, bits: int, width: int, make: Callable[[], tuple[FieldArray, FieldArray]]
    ) -> None:
        """Deal DCF keys for ``make() = (thresholds below 2**bits, payload)`` (:mod:`spdz.dcf`).

        The payload has shape ``shape + (width,)`` and is given without MAC; the dealer appends alpha times
        it in malicious mode.
        """

    @abstractmethod
    def tree(
        self,
        kind: str,
        z: Value,
        levels: int,
        make: Callable[[TreePads], tuple[Block, Block, Block | None]],
        *,
        top: bool,
    ) -> None:
        """Deal half-tree keys, one an entry of z: ``make`` gives party 0's ``first``, the words, and ``top``.

        Args:
            kind: Of the correlation.
            z: The masked value that the keys are for.
            levels: Of the trees.
            make: Deals, in the order of the keys.
            top: Whether there is an XOR-shared block beside each tree.
        """

    @abstractmethod
    async def opening_bits(self, bits: int) -> None:
        """One round that opens so many bits."""

    @abstractmethod
    async def round(self, sent: tuple[int, int]) -> None:
        """One round in which party i sends ``sent[i]`` field elements of its own inputs."""

    @abstractmethod
    async def opening(self, elements: int) -> None:
        """One round that opens so many shared elements."""


Share: TypeAlias = tuple[FieldArray, FieldArray | None]
"""A party's (value, MAC) shares of something dealt; the MAC is None in semi-honest mode."""

Triple: TypeAlias = tuple[Share, Share, Share]
"""A party's shares of a Beaver triple (a, b, c)."""


class Evaluation(Engine):
    """A party's reading, on masked values and shares."""

    index: int
    alpha: int | None
    ring: PartyRing

    @abstractmethod
    def authenticated(
        self, shape: Shape, *, count: tuple[str, int] | None = None, stored_by: int = 1
    ) -> Share:
        """Draw this party's (value, MAC) shares of a dealt value; MAC is None in semi-honest mode."""

    @abstractmethod
    def input_mask(self, source: Input) -> tuple[FieldArray | None, FieldArray | None]:
        """Draw this party's (value, MAC) shares of an input mask; the value is None at the peer."""

    @abstractmethod
    def triple(self, kind: str, shape: Shape, product_shape: Shape) -> Triple:
        """Draw this party's shares of one Beaver triple."""

    @property
    @abstractmethod
    def fully_drawn(self) -> bool:
        """Whether everything that was dealt for the job has been drawn."""

    @abstractmethod
    def comparison_key(self, shape: Shape, bits: int, width: int) -> Keys:
        """Draw this party's DCF keys."""

    @abstractmethod
    def tree(self, kind: str, shape: Shape, levels: int, *, top: bool) -> TreeKey:
        """Draw this party's half-tree keys."""

    @abstractmethod
    async def open_bits(self, shares: Block, delta: Block, n: int) -> npt.NDArray[np.bool_]:
        """Open n bits from shares of ``bit * Delta``, shape (n, 2), recording them for the MAC check."""

    @abstractmethod
    def plus_public(self, x: Value, public: FieldArray) -> Value:
        """Add public field elements of x's shape to a shared value."""

    @abstractmethod
    async def open(self, *values: Value) -> list[FieldArray]:
        """Open shared values in one round, recording them for the MAC check."""


class ClearText(Engine):
    """The reading on plain integers: insecure, for baselines and tests."""

    index: int

    @abstractmethod
    def value(
        self, raw: Any, frac: int, bound: Bound, *, masked: bool = False, is_bit: bool = False
    ) -> Value:
        """Wrap exact raw integers; ``masked`` if the gate's result is masked in the secure readings."""


class Gate(ABC):
    """One gate in its three readings. Interactive gates return coroutines from all three."""

    decides: bool = True
    """Whether an operand that is an undecided comparison is decided first (:meth:`Value.decide`)."""

    @abstractmethod
    def deal(self, recipe: Recipe, *operands: Any) -> Any:
        """What the dealer deals (and the meter counts), in drawing order."""

    @abstractmethod
    def evaluate(self, party: Evaluation, *operands: Any) -> Any:
        """What a party computes and opens."""

    @abstractmethod
    def clear(self, engine: ClearText, *operands: Any) -> Any:
        """The gate's meaning on plain integers."""
