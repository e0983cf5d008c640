"""Tapes: what the dealer wrote for one pair of robots, used once whatever happens."""

from spdz.tape.format import TapeHeader
from spdz.tape.status import TapeStatus, tape_status
from spdz.tape.tape import Job, Tape
from spdz.tape.verify import verify_corrections
from spdz.tape.writer import TapeWriter

__all__ = [
    "Job",
    "Tape",
    "TapeHeader",
    "TapeStatus",
    "TapeWriter",
    "tape_status",
    "verify_corrections",
]
