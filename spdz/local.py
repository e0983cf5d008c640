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
from spdz.clear import Clear
from spdz.coroutine import Exchange
from spdz.engine import Evaluation
from spdz.errors import ProtocolViolation
from spdz.mac_check import MacCheck, drive
from spdz.meter import Plan, measure
from spdz.party import JobStream, Party
from spdz.program import Program, declare, quantise, run
from spdz.stats import Outcome, Stats
from spdz.types import IntArray, Security

Tamper = Callable[[int, int, bytes], bytes]
"""``tamper(round, sender, frame) -> frame``: may change what ``sender`` (0 or 1) sends in a round."""


def run_local(
    program: Program,
    x: npt.ArrayLike,
    y: npt.ArrayLike,
    security: Security = "malicious",
    *,
    tamper: Tamper | None = None,
) -> Outcome:
    """Deal for a program, run both parties in this process, and return what they learn.

    Args:
        program: The program, e.g. ``protocols.scores.S10`` or ``protocols.is_candidate(S10, 0.8)``.
        x: Party 0's input: real numbers of shape S + (N,).
        y: Party 1's input: real numbers of shape T + (N,).
        security: ``"malicious"`` or ``"semi-honest"``.
        tamper: Test hook that sees, and may change, every frame's payload.

    Returns:
        The opened value and either party's costs.

    Raises:
        ValueError: if an input is not finite, has a wrong shape or dtype, or is out of range.
        MacCheckFailed: if a frame was tampered with (malicious mode).
        ProtocolViolation: if a tampered frame is not even well-formed.

    Example:
        >>> from protocols.scores import S10
        >>> run_local(S10, [0.5, 0.5], [1.0, -2.0]).value
        -0.5
    """
    data = _quantised(program, x, y)
    shapes = (data[0].shape, data[1].shape)
    plan = measure(program, shapes, security)
    stats = (Stats(), Stats())
    parties = _deal_in_process(program, plan, security, stats)
    lanes = [
        drive(run(party, program, declare(program, shapes, {party.index: data[party.index]})), mac_check)
        for party, mac_check in parties
    ]
    return Outcome(_lock_step(lanes, stats, tamper), stats)


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
    lanes = [
        drive(run(Clear(index), program, declare(program, shapes, {index: data[index]})), None)
        for index in (0, 1)
    ]
    return Outcome(_lock_step(lanes, stats, None), stats)


def _quantised(program: Program, x: npt.ArrayLike, y: npt.ArrayLike) -> tuple[IntArray, IntArray]:
    return quantise(program, x, "x"), quantise(program, y, "y")


def _deal_in_process(
    program: Program, plan: Plan, security: Security, stats: tuple[Stats, Stats]
) -> list[tuple[Evaluation, MacCheck | None]]:
    """Deal one job and give each party its half. This is a door to the dealer, as ``spdz.dealer`` is."""
    from dealer.randomness import random_mac_key
    from dealer.recipe import deal_job

    mac_key = random_mac_key() if security == "malicious" else None
    keys = (secrets.token_bytes(32), secrets.token_bytes(32))
    corrections = deal_job(program, plan, security, keys, mac_key)
    session = secrets.token_bytes(32)
    parties: list[tuple[Evaluation, MacCheck | None]] = []
    for index in (0, 1):
        alpha = None if mac_key is None else mac_key.shares[index]
        mac_check = None if alpha is None else MacCheck(alpha, index, session)
        stream = JobStream(keys[index], plan.pad_bytes[index], corrections[index])
        parties.append((Party(index, security, stream, mac_check, alpha, stats[index]), mac_check))
    return parties


def _lock_step(
    lanes: Sequence[Generator[Exchange, memoryview, Any]],
    stats: tuple[Stats, Stats],
    tamper: Tamper | None,
) -> Any:
    """Step both parties round by round until both return; returns their common result."""
    try:
        requests = [next(lane) for lane in lanes]
        number = 0
        while True:
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
            requests = [step for step in steps if isinstance(step, Exchange)]
            if not requests:
                return next(step[0] for step in steps if not isinstance(step, Exchange))
            if len(requests) != len(lanes):
                raise ProtocolViolation("one party finished before the other")
            number += 1
    finally:
        for lane in lanes:
            lane.close()


def _step(lane: Generator[Exchange, memoryview, Any], reply: memoryview) -> Exchange | tuple[Any]:
    """Step one party: its next request, or its result in a 1-tuple."""
    try:
        return lane.send(reply)
    except StopIteration as done:
        return (done.value,)
