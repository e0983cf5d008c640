"""What a session does before its inputs are known, timed: in no time of a comparison, and shown beside it."""

from __future__ import annotations

import time
from dataclasses import dataclass

from spdz.readings.program import Program
from spdz.session import Session

ABOUT = """\
Not in a comparison's time, and shown beside it, is what is done ahead, before the inputs are known: the
seconds of one call that reserves all jobs, over the jobs, of the slower party. It holds reading the tape, one
durable sync for all jobs, the AES expansion of their pads, and what the program computes of the tape alone.
The sync is a disk's and varies; the more jobs are reserved at once, the less of it falls to each."""
"""For a command's help."""


@dataclass(frozen=True, slots=True)
class Ahead:
    """Seconds before the first job.

    Attributes:
        compiling: Of reading and compiling the program, once a session.
        a_job: Of reserving, by the number of jobs.
    """

    compiling: float
    a_job: float


def reserved(session: Session, jobs: int, program: Program) -> Ahead:
    """Reserve jobs of a program.

    Args:
        session: A session that has reserved nothing.
        jobs: How many, at least one.
        program: What they will run.

    Raises:
        TapeExhausted: if fewer are left.
        TapeMismatch: if the tape was not dealt for the program.
    """
    started = time.perf_counter()
    session.reserve(0, program)
    compiled = time.perf_counter()
    session.reserve(jobs, program)
    return Ahead(compiled - started, (time.perf_counter() - compiled) / jobs)
