"""A side of a gallery that lies wherever it can, against the real session on the other side.

It rushes (sees the honest frame of every exchange before it sends its own), keeps a transcript of what it
really sent, and follows its lie, or denies it, as :mod:`insider` does for jobs.
"""

import secrets
from dataclasses import dataclass
from typing import Any

import numpy as np
from gallery_session_helpers import cables, unit_vectors
from insider import Ledger
from insider_frames import elements, frame_of

from spdz.arithmetic.field import P
from spdz.channels import FrameKind
from spdz.foundations.errors import SpdzError
from spdz.rounds.coroutine import Check
from spdz.session.agreement import Agreement
from spdz.session.gallery import GallerySession

SHORT = 5.0
"""Seconds that a side waits for the other's frame."""


def tell_the_truth(number, own, theirs):
    return own


@dataclass
class Lies:
    """What an insider does.

    Attributes:
        frame: ``frame(number, own, theirs)``: the payload of exchange ``number``, in bytes.
        control: ``control(number, message)``: the JSON object to send in exchange ``number``.
        raw: ``raw(number, own, theirs)``: the bytes of a control message, which it does not hash.
        vectors: Raw vectors that it brings, unchecked, instead of honest ones.
        follow: Whether its state follows what it lied in an opening.
    """

    frame: Any = tell_the_truth
    control: Any = lambda number, message: message
    raw: Any = tell_the_truth
    vectors: Any = None
    follow: bool = True

    def __call__(self, *args):
        return Liar(*args, lies=self)


class Liar(GallerySession):
    """The insider."""

    def __init__(self, tape, ledger, channel, terms, *, lies):
        self._lies = lies
        channel.say = lambda number, kind, own, theirs: (
            lies.raw if kind == FrameKind.CONTROL else lies.frame
        )(number, own, theirs)
        super().__init__(tape, ledger, channel, terms)

    def _meet(self):
        self._agreement = _Crooked(self._channel, self.party, self._agreement._id, self._alpha)
        self._agreement.lies = self._lies
        super()._meet()

    def step(self, on_block=lambda block: None):
        if self._lies.vectors is not None:
            self._filling.waiting = list(self._lies.vectors)
        return super().step(on_block)

    def _refuse_unproved(self, owner, slots, proofs):
        """It does not refuse itself."""

    def run(self, protocol, stats):
        check, reply = self._agreement.mac_check, None
        try:
            while True:
                request = protocol.send(reply)
                reply = None
                if isinstance(request, Check):
                    if check is not None:
                        theirs = self._channel.exchange(FrameKind.CHECK, [check.message()], 16)
                        check.believe(bytes(theirs))
                    continue
                own = b"".join(request.payload)
                theirs = bytes(self._channel.exchange(FrameKind.DATA, request.payload, request.expect))
                said = self._channel.said
                if check is not None:
                    check.absorb([said], theirs)
                if self._lies.follow and said != own:
                    theirs = _followed(own, said, theirs, request.elements)
                reply = memoryview(theirs)
        except StopIteration as done:
            return done.value


def _followed(own, said, theirs, field_elements):
    if field_elements:
        numbers = zip(elements(own), elements(said), elements(theirs), strict=True)
        return frame_of((t + s - o) % P for o, s, t in numbers)
    return bytes(o ^ s ^ t for o, s, t in zip(own, said, theirs, strict=True))


class BelievingCheck(Ledger):
    """It goes on whatever the honest hash is."""

    def believe(self, theirs):
        super().believe(theirs)
        self._same = None  # also where nothing was recorded since


class _Crooked(Agreement):
    lies: Lies

    def control(self, message, *keys):
        number = self._channel.rounds + self._channel.control_rounds
        answer = super().control(self.lies.control(number, dict(message)), *keys)
        if "heads" in keys:
            answer = dict(message)  # it goes on whatever the honest side holds
        if self._alpha is not None:
            self.mac_check = BelievingCheck(self._alpha, self._party, self._id)
        return answer


@dataclass
class Duel:
    """What the honest side did against an insider.

    Attributes:
        outcome: Its steps, or what it raised.
        seen: The blocks that its caller saw.
        frames: The exchanges that went through: kind, what it sent, what it got.
        destroyed: Whether its tape and ledger are.
        insider: The insider's outcome.
        mission: What is left on both disks.
    """

    outcome: Any
    seen: list[Any]
    frames: list[Any]
    insider: Any
    mission: Any
    evil: int

    @property
    def caught(self):
        return isinstance(self.outcome, SpdzError)

    @property
    def error(self):
        return type(self.outcome).__name__

    @property
    def destroyed(self):
        return self.mission.destroyed(1 - self.evil)


def duel(mission, data, evil, lies=None, cuts=None, timeout=SHORT):
    """One session of steps; ``cuts`` is how many descriptors each step brings, a side."""
    lies = lies or Lies()
    ends, seen = cables(timeout), []
    cuts = cuts or ((len(data[0]),), (len(data[1]),))

    def work(session):
        steps, at = [], 0
        for count in cuts[session.party]:
            if session.party != evil or lies.vectors is None:
                session.add(data[session.party][at : at + count])
            at += count
            show = (lambda block: None) if session.party == evil else seen.append
            steps.append(session.step(show))
        return steps

    kinds = [GallerySession, GallerySession]
    kinds[evil] = lies
    outcomes = mission.meet(work, channels=ends, kinds=kinds)
    return Duel(outcomes[1 - evil], seen, ends[1 - evil].frames, outcomes[evil], mission, evil)


def vectors(counts=(3, 4), dim=4, seed=5):
    rng = np.random.default_rng(seed)
    return [unit_vectors(rng, count, dim) for count in counts]


def at_element(exchange, index, change):
    """Lie in one field element of one exchange: ``change(own, theirs)``."""

    def frame(number, own, theirs):
        if number != exchange:
            return own
        said, other = elements(own), elements(theirs)
        said[index] = change(said[index], other[index]) % P
        return frame_of(said)

    return frame


def at_bit(exchange, bit):
    """Flip one bit of one exchange."""

    def frame(number, own, theirs):
        said = bytearray(own)
        if number == exchange:
            said[bit // 8] ^= 1 << bit % 8
        return bytes(said)

    return frame


def instead(exchange, change):
    """Say ``change(own, theirs)`` in one exchange."""
    return lambda number, own, theirs: change(own, theirs) if number == exchange else own


def random_element():
    return secrets.randbelow(P - 1) + 1
