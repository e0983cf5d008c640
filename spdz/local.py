"""Two parties in one process, in lock-step in one thread: for development, tests and first steps.

Deterministic: each round, party 0's frame and then party 1's are taken, shown to the ``tamper`` hook, and
delivered. Everything but the transport is what networked parties run.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Generator, Sequence
from typing import Any

import numpy.typing as npt

from spdz.channels.frames import HEADER_BYTES
from spdz.foundations.errors import ProtocolViolation
from spdz.foundations.stats import Outcome, Stats
from spdz.foundations.types import IntArray, Security, Shape
from spdz.readings.clear import Clear
from spdz.readings.meter import measure, measure_stock
from spdz.readings.party import Party
from spdz.readings.program import Program, declare, quantise, run
from spdz.readings.stock import Stock, StockedParty
from spdz.readings.streams import JobStream
from spdz.rounds.coroutine import Exchange, Protocol
from spdz.rounds.mac_check import MacCheck, drive
from spdz.values.engine import Evaluation

Tamper = Callable[[int, int, bytes], bytes]
"""``tamper(round, sender, frame) -> frame``: may change what ``sender`` (0 or 1) sends in a round."""


def run_local(
    program: Program,
    x: npt.ArrayLike,
    y: npt.ArrayLike,
    security: Security = "malicious",
    *,
    stock: Stock | None = None,
    tamper: Tamper | None = None,
) -> Outcome:
    """Deal for a program, run both parties in this process, and return what they learn.

    Args:
        program: The program, e.g. ``protocols.scores.S10`` or ``protocols.is_candidate(S10, 0.8)``.
        x: Party 0's input: real numbers of shape S + (N,).
        y: Party 1's input: real numbers of shape T + (N,).
        security: ``"malicious"`` or ``"semi-honest"``.
        stock: Deal this stock of Beaver triples instead of dealing for the program.
        tamper: Test hook that sees, and may change, every frame's payload.

    Returns:
        The opened value and either party's costs.

    Raises:
        ValueError: if an input is not finite, has a wrong shape or dtype, or is out of range.
        MacCheckFailed: if a frame was tampered with (malicious mode).
        ProtocolViolation: if a tampered frame is not even well-formed.
        TapeExhausted: if the program needs more than the stock holds.

    Example:
        >>> from protocols.scores import S10
        >>> run_local(S10, [0.5, 0.5], [1.0, -2.0]).value
        -0.5
    """
    data = _quantised(program, x, y)
    shapes = (data[0].shape, data[1].shape)
    stats = (Stats(), Stats())
    parties = _deal_in_process(program, shapes, security, stock, stats)
    protocols = [
        run(party, program, declare(program, shapes, {party.index: data[party.index]}))
        for party, _ in parties
    ]
    return Outcome(lock_step(protocols, [check for _, check in parties], stats, tamper), stats)


def run_clear(program: Program, x: npt.ArrayLike, y: npt.ArrayLike) -> Outcome:
    """Run a program with no security at all: both parties see both inputs.

    Args:
        program: The program.
        x: Party 0's input.
        y: Party 1's input.

    Returns:
        The exact result on the quantised inputs, and what sending descriptors in the clear costs.
    """
    data = _quantised(program, x, y)
    shapes = (data[0].shape, data[1].shape)
    stats = (Stats(), Stats())
    protocols = [
        run(Clear(index), program, declare(program, shapes, {index: data[index]})) for index in (0, 1)
    ]
    return Outcome(lock_step(protocols, (None, None), stats, None), stats)


def _quantised(program: Program, x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[IntArray, IntArray]:
    return quantise(program, x, "x"), quantise(program, y, "y")


def _deal_in_process(
    program: Program,
    shapes: tuple[Shape, Shape],
    security: Security,
    stock: Stock | None,
    stats: tuple[Stats, Stats],
) -> list[tuple[Evaluation, MacCheck | None]]:
    """Deal one job and give each party its half. This is a door to the dealer, as ``spdz.dealer`` is."""
    from dealer.randomness import random_mac_key
    from dealer.recipe import deal_job, deal_stock

    mac_key = random_mac_key() if security == "malicious" else None
    keys = (secrets.token_bytes(32), secrets.token_bytes(32))
    if stock is None:
        plan = measure(program, shapes, security)
        pad_bytes, corrections = plan.pad_bytes, deal_job(program, plan, security, keys, mac_key)
    else:
        pad_bytes = measure_stock(stock, security)
        corrections = deal_stock(stock, pad_bytes, security, keys, mac_key)
    session = secrets.token_bytes(32)
    parties: list[tuple[Evaluation, MacCheck | None]] = []
    for index in (0, 1):
        alpha = None if mac_key is None else mac_key.shares[index]
        mac_check = None if alpha is None else MacCheck(alpha, index, session)
        stream = JobStream(keys[index], pad_bytes[index], corrections[index])
        if stock is None:
            party = Party(index, security, stream, mac_check, alpha, stats[index])
        else:
            party = StockedParty(stock, index, security, stream, mac_check, alpha, stats[index])
        parties.append((party, mac_check))
    return parties


def lock_step(
    protocols: Sequence[Protocol[Any]],
    mac_checks: Sequence[MacCheck | None],
    stats: tuple[Stats, Stats],
    tamper: Tamper | None = None,
) -> Any:
    """Step both parties round by round until both return; returns party 0's result."""
    lanes = [drive(protocol, check) for protocol, check in zip(protocols, mac_checks, strict=True)]
    try:
        steps = [_step(lane, None) for lane in lanes]
        number = 0
        while requests := [step for step in steps if isinstance(step, Exchange)]:
            if len(requests) != len(lanes):
                raise ProtocolViolation("one party finished before the other")
            frames = [b"".join(request.payload) for request in requests]
            for sender in (0, 1):
                stats[sender].rounds += 1
                stats[sender].bytes_sent += HEADER_BYTES + len(frames[sender])
                stats[sender].field_elements_sent += requests[sender].elements
                if tamper is not None:
                    frames[sender] = tamper(number, sender, frames[sender])
            for receiver in (0, 1):
                if len(frames[1 - receiver]) != requests[receiver].expect:
                    raise ProtocolViolation(
                        f"round {number}: party {receiver} expected {requests[receiver].expect} bytes, "
                        f"got {len(frames[1 - receiver])}"
                    )
            steps = [_step(lane, memoryview(frames[1 - i])) for i, lane in enumerate(lanes)]
            number += 1
        return next(step[0] for step in steps if not isinstance(step, Exchange))
    finally:
        for lane, protocol in zip(lanes, protocols, strict=True):
            lane.close()
            protocol.close()  # a lane that was never started does not close it


def _step(lane: Generator[Exchange, memoryview, Any], reply: memoryview | None) -> Exchange | tuple[Any]:
    """Step one party: its next request, or its result in a 1-tuple."""
    try:
        return next(lane) if reply is None else lane.send(reply)
    except StopIteration as done:
        return (done.value,)
