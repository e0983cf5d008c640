"""Reading a program once, on slots."""

from __future__ import annotations

from math import prod
from typing import Any

from spdz.compiled.dealt import TracedStream
from spdz.compiled.ring import Received, TracedRing
from spdz.compiled.slots import FEW, Form, NotCompiled, Slot
from spdz.compiled.source import written
from spdz.compiled.straight import Straight
from spdz.compiled.trace import Trace
from spdz.foundations.stats import Stats
from spdz.foundations.types import Security, Shape
from spdz.readings.meter import Plan
from spdz.readings.party import Party, draw_tree
from spdz.readings.program import Program, min_norm, run
from spdz.rounds.coroutine import Check, Exchange
from spdz.values.engine import Input


class TracedCheck:
    """Stands for the session's MAC check: what is opened is written down as a step of its next hash.

    Whether anything is pending is known when the code is made, although the session's check is shared by all
    lanes of a run: they run the same code, so that each has pending what every other has.
    """

    def __init__(self, ring: TracedRing, alpha: Slot, party: int) -> None:
        self._ring, self._alpha, self._party = ring, alpha, party
        self.pending = False

    def record(self, opened: Slot, mac: Slot) -> None:
        """An opened array and this party's MAC shares."""
        ring, trace, self.pending = self._ring, self._ring.trace, True
        if opened.size == 0 or opened.size > FEW:
            trace.do("mac_check.record({0}, {1})", ring.array(opened), ring.array(mac), kind="record")
            return
        sigma = ring.sub(mac, ring.scaled(opened, self._alpha))
        same = ring.encoded(sigma if self._party == 0 else ring.neg(sigma))
        trace.do(f"mac_check.record_same({opened.size}, {{0}})", same, kind="record")

    def record_bits(self, sigma: Slot) -> None:
        """The MACs of opened bits."""
        self.pending = True
        self._ring.trace.do("mac_check.record_bits({0})", sigma, kind="record")


class TracedParty(Party):
    """A party whose numbers are slots."""

    def __init__(self, index: int, security: Security, ring: TracedRing, stream: Any, stats: Stats) -> None:
        alpha = Slot("alpha", "one", (), early=True)
        malicious = security == "malicious"
        check: Any = TracedCheck(ring, alpha, index) if malicious else None
        super().__init__(index, security, stream, check, alpha if malicious else None, stats)  # type: ignore[arg-type]
        self.ring = ring

    def tree(self, kind: str, shape: Shape, levels: int, *, top: bool) -> Any:
        """Half-tree keys, drawn as they are by a party."""
        self._stats.book(kind, prod(shape))
        return self._stream.drawn(draw_tree, self.index, shape, levels, top)  # type: ignore[union-attr]


def compiled(program: Program, plan: Plan, party: int, security: Security) -> Straight:
    """A party's code for a program.

    Args:
        program: The program.
        plan: The meter's plan of it.
        party: 0 or 1.
        security: The security model.

    Raises:
        NotCompiled: if it takes more than one vector a party, or looks at numbers on its way.
    """
    if any(prod(source.shape[:-1]) != 1 for source in plan.inputs):
        raise NotCompiled("only single vectors are compared by compiled code")
    trace = Trace()
    ring = TracedRing(trace)
    stats = Stats()
    stream = TracedStream(trace, plan.pad_bytes[party], plan.correction_bytes[party])
    reader = TracedParty(party, security, ring, stream, stats)
    inputs = [_with_data(trace, source) if source.owner == party else source for source in plan.inputs]
    result = _read(run(reader, program, inputs), trace, reader)
    sizes = (plan.pad_bytes[party], plan.correction_bytes[party])
    own = plan.inputs[party]
    shape = own.shape if prod(own.shape) <= FEW else None
    limit = -1 if min_norm(program) else own.norm**2
    return Straight(written(trace, result), security, sizes, stats.correlations, shape, limit)


def _with_data(trace: Trace, source: Input) -> Input:
    """The own input: a list of integers, or an array of them."""
    size, bits = prod(source.shape), source.norm.bit_length()
    form: Form = "one" if size == 1 else "few" if size <= FEW else "words"
    text = "data[0]" if form == "one" else "data"
    data: Any = trace.note(text, form=form, shape=source.shape, bits=bits, reduced=False, kind="effect")
    return Input(source.owner, source.shape, source.norm, source.proved, data)


def _read(protocol: Any, trace: Trace, party: TracedParty) -> Slot:
    """Run the text; every request becomes a line that yields it."""
    reply: Any = None
    try:
        while True:
            request = protocol.send(reply)
            if isinstance(request, Check):
                trace.do("yield Check()", kind="check")
                party._mac_check.pending = False  # type: ignore[union-attr,misc]
                reply = None
            elif isinstance(request, Exchange):
                payload: Any = request.payload
                buffers = ", ".join(f"{{{i}}}" for i in range(len(payload)))
                text = f"yield Exchange([{buffers}], {request.expect}, {request.elements})"
                frame = trace.note(text, *payload, form="other", kind="exchange")
                reply = Received(party.ring, frame, request.expect)  # type: ignore[arg-type]
    except StopIteration as done:
        if not isinstance(done.value, Slot):
            raise NotCompiled("the result is not one of the code's") from None
        return done.value
    finally:
        protocol.close()
