"""A networked party: one tape, one connection, plain blocking calls.

::

    with open_session("mission/alice/bob.tape", listen="0.0.0.0:9000") as session:
        outcome = session.run(program, descriptor)

A session is a state machine with one way out: after any error it is dead, its connection closed, and what
it had reserved stays burnt. After a failed MAC check its tape is destroyed as well.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from operator import index
from typing import Any

import numpy.typing as npt

from spdz.channels import Channel, FrameKind
from spdz.channels.frames import MAX_FRAME
from spdz.compiled.programs import Programs
from spdz.compiled.straight import Straight
from spdz.foundations.errors import (
    TapeError,
    TapeExhausted,
    TapeMismatch,
)
from spdz.foundations.stats import Stats
from spdz.foundations.types import Shape
from spdz.readings.meter import Plan
from spdz.readings.party import Party
from spdz.readings.program import Program, declare, quantise, run
from spdz.readings.streams import JobStream
from spdz.rounds.coroutine import parallel
from spdz.rounds.mac_check import drive
from spdz.rounds.wire import ELEMENT_BYTES
from spdz.session.agreement import Agreement
from spdz.session.conversation import Conversing
from spdz.session.driver import ChannelRounds, poster, run_channel
from spdz.session.handshake import Hello, compare, session_id
from spdz.tape import Tape, TapeHeader
from spdz.tape.tape import Job


@dataclass(frozen=True, slots=True)
class Result:
    """What one run of a session returns.

    Attributes:
        value: The opened result of each job, or of the single one.
        stats: This party's cost.
    """

    value: Any
    stats: Stats


@dataclass(frozen=True, slots=True)
class _Reserved:
    """A job that was marked used, and what of it was computed ahead by which code."""

    index: int
    stream: JobStream
    code: Straight | None
    early: tuple[Any, ...] | None = dataclass_field(repr=False)

    def computed(self, code: Straight, alpha: int | None) -> tuple[Any, ...]:
        """What this code computes ahead, now if it was not."""
        if self.early is not None and self.code is code:
            return self.early
        return code.ahead(self.stream, alpha)


class Session(Conversing):
    """One party of a pair, connected to the other.

    Args:
        tape: This party's tape, open; the session closes it.
        channel: A connected channel; the session closes it.

    Raises:
        TapeMismatch: if the peer's tape does not belong to this one, saying why.
        ProtocolViolation: if the peer's greeting is malformed.
    """

    def __init__(self, tape: Tape, channel: Channel) -> None:
        super().__init__(channel, "session")
        self._tape = tape
        self._left = tape.remaining
        first, second = tape.header.program["shapes"]
        self._shapes: tuple[Shape, Shape] = (tuple(first), tuple(second))
        self._reserved: deque[_Reserved] = deque()
        self._fingerprint = tape.header.fingerprint
        self._programs = Programs(self.shapes, tape.header.security, tape.header.party, self._fingerprint)
        malicious = tape.header.security == "malicious"
        self._alpha = int.from_bytes(tape.alpha, "little") if malicious else None
        with self._guard:
            own = Hello.of(tape)
            peer = Hello.decode(bytes(channel.exchange(FrameKind.CONTROL, [own.encode()], None)))
            compare(own, peer)
            session = session_id(own, peer)
            tape.resume(peer.cursor)
            self._left = tape.remaining
            self._tag = int.from_bytes(session[:4], "little")
            channel.bind(self._tag)
            self._agreement = Agreement(channel, self.party, session, self._alpha)

    def __repr__(self) -> str:
        state = f"dead ({self._dead})" if self._dead else f"{self.remaining} jobs left"
        return f"<session of {self.header.name} with {self.header.peer}: {state}>"

    @property
    def header(self) -> TapeHeader:
        """The tape's header."""
        return self._tape.header

    @property
    def party(self) -> int:
        """0 or 1."""
        return int(self._tape.header.party)

    @property
    def rolled_back(self) -> bool:
        """Whether the tape file was an older copy of itself (its used part was skipped)."""
        return self._tape.rolled_back

    @property
    def remaining(self) -> int:
        """Jobs that can still be run; of a session that has ended, those that its tape still holds."""
        if self._dead is not None:
            return self._left
        return len(self._reserved) + self._tape.remaining

    @property
    def shapes(self) -> tuple[Shape, Shape]:
        """Input shapes of both parties in one job."""
        return self._shapes

    # -- running -------------------------------------------------------------------------------------

    def reserve(self, jobs: int, program: Program | None = None) -> None:
        """Read so many jobs ahead, mark them used, durably, in one go, and expand their pads.

        What is reserved and not run when the session ends is lost. Without a call, every run reserves
        what it needs, at the price of a disk flush.

        Args:
            jobs: How many.
            program: The program that they will run, if it is known: what depends on the tape alone is then
                computed now, and kept in memory (160 bytes a number of a descriptor, or so). The jobs serve
                other thresholds as well.

        Raises:
            TapeExhausted: if fewer jobs are left; nothing is consumed, and the session lives on.
            TapeMismatch: if the tape was not dealt for this program.
        """
        self._require_alive()
        jobs = index(jobs)  # a TypeError here costs nothing
        code = None
        if program is not None:
            _, code = self._ready(program, again=True)
        with self._turn:
            used = False
            try:
                reserved, used = self._tape.reserve(jobs), True
                self._keep(reserved, code)
            except BaseException as error:
                if used or not isinstance(error, (TapeExhausted, ValueError)):
                    self._die(error)  # some jobs may be used and not kept here, unlike at the peer
                raise

    def run(self, program: Program, data: npt.ArrayLike) -> Result:
        """Run one job on this party's input.

        Args:
            program: The program that the tapes were dealt for (thresholds may differ).
            data: This party's input, of the shape that one job takes.

        Raises:
            ValueError: for bad input; nothing is consumed and the session lives on.
            TapeMismatch: if the tape was dealt for another program, or the peer runs another one.
            TapeExhausted: if no job is left.
            MacCheckFailed: if the peer cheated; nothing is output and the tape is destroyed.
            ChannelError: if the connection fails.
        """
        self._require_alive()
        plan, code = self._ready(program)
        raw = self._quantise(program, code, data)
        if code is None or _largest_frame(plan, 1) > MAX_FRAME:
            (value,), stats = self._run_lanes(program, plan, None, [raw])
            return Result(value, stats)
        with self._guard:
            (job,) = self._next(program, plan, 1)
            rounds = ChannelRounds(self._channel, self._agreement.mac_check)
            value = code.run_alone(job.computed(code, self._alpha), self._alpha, raw, rounds)
            stats = rounds.stats(code.correlations)
        return Result(value, stats)

    def run_many(self, program: Program, data: Sequence[npt.ArrayLike]) -> Result:
        """Run several jobs in the same rounds; the result's value is a list."""
        self._require_alive()
        plan, code = self._ready(program)
        inputs = [self._quantise(program, code, one) for one in data]
        return Result(*self._run_lanes(program, plan, code, inputs))

    # -- the parts of a run --------------------------------------------------------------------------

    def _run_lanes(
        self, program: Program, plan: Plan, code: Straight | None, inputs: Sequence[Any]
    ) -> tuple[list[Any], Stats]:
        """Run a job for each input, in the same rounds."""
        if (largest := _largest_frame(plan, len(inputs))) > MAX_FRAME:
            raise ValueError(
                f"{len(inputs)} jobs at once could need frames of {largest >> 20} MB, above the limit of "
                f"{MAX_FRAME >> 20} MB: run fewer at once"
            )
        with self._guard:
            jobs = self._next(program, plan, len(inputs))
            stats = Stats()
            lanes = [
                self._lane(program, code, job, raw, stats) for job, raw in zip(jobs, inputs, strict=True)
            ]
            protocol = lanes[0] if len(lanes) == 1 else parallel(*lanes)
            frames = drive(protocol, self._agreement.mac_check, poster(self._channel))
            value = run_channel(frames, self._channel, stats)
        return [value] if len(lanes) == 1 else value, stats

    def _next(self, program: Program, plan: Plan, count: int) -> list[_Reserved]:
        """Agree with the peer, and take the next jobs."""
        self._agreement.program(plan.text, count, program)
        if count > len(self._reserved):
            self._keep(self._tape.reserve(count - len(self._reserved)))
        jobs = [self._reserved.popleft() for _ in range(count)]
        if jobs:  # frames of other jobs than the peer's are refused
            self._channel.bind((self._tag + jobs[0].index) & 0xFFFFFFFF)
        return jobs

    def _ready(self, program: Program, *, again: bool = False) -> tuple[Plan, Straight | None]:
        """The meter's plan, held against the tape, and the code if there is some."""
        plan, code = self._programs.ready(program, again=again)
        if plan.recipe != self._fingerprint:
            raise TapeMismatch(
                f"this tape was dealt for {_describe(self.header.program)}, which is not the program given; "
                "deal tapes for it, or run the program that the tapes were dealt for"
            )
        return plan, code

    def _quantise(self, program: Program, code: Straight | None, data: npt.ArrayLike) -> Any:
        """The input as whoever reads it takes it."""
        few = None if code is None else code.quantised(data)
        if few is not None:
            return few
        raw, expected = quantise(program, data, "input"), self._shapes[self.party]
        if raw.shape != expected:
            raise ValueError(f"a job of this tape takes an input of shape {expected}, got {raw.shape}")
        return raw if code is None else code.taken(raw)

    def _keep(self, jobs: Sequence[Job], code: Straight | None = None) -> None:
        """Expand the pads of jobs that were just marked used."""
        self._left = self._tape.remaining
        for job in jobs:
            stream = JobStream(job.key, self.header.pad_bytes, job.correction)
            early = None if code is None else code.ahead(stream, self._alpha)
            self._reserved.append(_Reserved(job.index, stream, code, early))

    def _lane(self, program: Program, code: Straight | None, job: _Reserved, raw: Any, stats: Stats) -> Any:
        alpha, mac_check = self._alpha, self._agreement.mac_check
        if code is not None:
            return code.run(job.computed(code, alpha), alpha, mac_check, raw, stats)
        party = Party(self.party, self._tape.header.security, job.stream, mac_check, alpha, stats)
        return run(party, program, declare(program, self.shapes, {self.party: raw}))

    # -- ending --------------------------------------------------------------------------------------

    def _note_end(self) -> None:
        with suppress(TapeError):
            self._left = self._tape.remaining

    def _destroy(self) -> None:
        self._left = 0
        self._tape.destroy()

    def _release(self) -> None:
        self._reserved.clear()
        self._tape.close()


def _largest_frame(plan: Plan, jobs: int) -> int:
    return ELEMENT_BYTES * jobs * max(plan.elements_sent)


def _describe(program: Any) -> str:
    return ", ".join(f"{name} {value}" for name, value in sorted(program.items()) if name != "shapes")
