"""Deal one pair's two tapes, for any program."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path

from dealer.limits import check_job
from dealer.randomness import random_mac_key
from dealer.recipe import deal_job
from spdz.arithmetic.prf import job_key, next_chain
from spdz.foundations.types import Json, Security, Shape
from spdz.readings.meter import Plan, measure
from spdz.readings.program import Program
from spdz.tape import TapeHeader, TapeWriter
from spdz.tape.format import MAX_JOBS, Layout, encode_header

_ID_DIGITS = 32


def deal_tapes(
    paths: tuple[Path, Path],
    agents: tuple[str, str],
    program: Program,
    shapes: tuple[Shape, Shape],
    jobs: int,
    security: Security = "malicious",
    *,
    mission: str | None = None,
    description: Mapping[str, Json] | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> None:
    """Deal for a program and write both parties' tapes, job by job; nothing is kept in memory.

    Args:
        paths: Where party 0's and party 1's tape go.
        agents: Their names.
        program: The program that the tapes serve; public constants that it adds may change later.
        shapes: Both inputs' shapes in one job.
        jobs: How many jobs to deal.
        security: The security model.
        mission: Hex id of the dealing run; a fresh one if not given.
        description: What error messages and users call the program.
        progress: Called with the number of jobs dealt.

    Raises:
        ValueError: if one job would need a frame that is too large to be sent, or more memory than there is.
    """
    plan = measure(program, shapes, security)
    check_job(plan)
    mac_key = random_mac_key() if security == "malicious" else None
    chains = [secrets.token_bytes(32), secrets.token_bytes(32)]
    mission, tape = mission or secrets.token_hex(_ID_DIGITS // 2), secrets.token_hex(_ID_DIGITS // 2)
    with ExitStack() as stack:
        writers = []
        for party in (0, 1):
            header = tape_header(
                plan,
                agents,
                party,
                shapes,
                jobs,
                security,
                mission=mission,
                tape=tape,
                description=description,
            )
            alpha = bytes(16) if mac_key is None else mac_key.shares[party].to_bytes(16, "little")
            writers.append(stack.enter_context(TapeWriter(paths[party], header, chains[party], alpha)))
        for job in range(jobs):
            keys = (job_key(chains[0]), job_key(chains[1]))
            corrections = deal_job(program, plan, security, keys, mac_key)
            for party in (0, 1):
                writers[party].append(corrections[party])
            chains = [next_chain(chain) for chain in chains]
            progress(job + 1)


def tape_header(
    plan: Plan,
    agents: tuple[str, str],
    party: int,
    shapes: tuple[Shape, Shape],
    jobs: int,
    security: Security,
    *,
    mission: str,
    tape: str,
    description: Mapping[str, Json] | None,
) -> TapeHeader:
    """One party's header; arguments as for :func:`deal_tapes`, with the meter's plan and the tapes' id."""
    return TapeHeader(
        mission=mission,
        tape=tape,
        agents=agents,
        party=party,
        security=security,
        fingerprint=plan.recipe,
        program={**(description or {}), "shapes": [list(shape) for shape in shapes]},
        jobs=jobs,
        pad_bytes=plan.pad_bytes[party],
        correction_bytes=plan.correction_bytes[party],
    )


def tape_bytes(
    plan: Plan,
    agents: tuple[str, str],
    shapes: tuple[Shape, Shape],
    jobs: int,
    security: Security,
    *,
    description: Mapping[str, Json] | None = None,
) -> tuple[int, int]:
    """Sizes of both tape files, exact; arguments as for :func:`deal_tapes`, with the meter's plan.

    Raises:
        ValueError: for more jobs than a tape can have.
    """
    if jobs > MAX_JOBS:
        raise ValueError(
            f"{jobs} jobs are more than a tape can have ({MAX_JOBS}): deal fewer comparisons or larger tiles"
        )
    first, second = (
        Layout.of(header, encode_header(header)).end
        for header in (
            tape_header(
                plan,
                agents,
                party,
                shapes,
                jobs,
                security,
                mission="0" * _ID_DIGITS,
                tape="0" * _ID_DIGITS,
                description=description,
            )
            for party in (0, 1)
        )
    )
    return first, second
