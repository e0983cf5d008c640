"""Tapes: what the dealer wrote for one pair of robots, used once whatever happens."""

from spdz.tape.format import TapeHeader
from spdz.tape.tape import Job, Tape
from spdz.tape.writer import TapeWriter

__all__ = ["Job", "Tape", "TapeHeader", "TapeWriter"]
