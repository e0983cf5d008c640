"""A malicious *party*, and the honest one that runs against it.

A hook that changes frames in transit models the network: the two transcripts differ, and a check fails
whatever was opened. An insider is stronger. It

- rushes: it sees the honest frame of every exchange, checks included, before it sends its own;
- keeps its own transcript, of what it really sent and got;
- *follows* its lie (goes on with what the honest party now takes for opened) or *denies* it (goes on with
  what would have been opened);
- answers a check as it likes.

The honest party is the real one: programs, gates, lanes, ``drive``, ``MacCheck``.
"""

import secrets
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from insider_frames import Layout, reduced

from dealer.randomness import MacKey, random_mac_key
from dealer.recipe import deal_job, deal_stock
from spdz import run_clear
from spdz.foundations.errors import MacCheckFailed, ProtocolViolation, SpdzError, Wrapped
from spdz.foundations.stats import Stats
from spdz.readings.meter import measure, measure_stock
from spdz.readings.party import Party
from spdz.readings.program import declare, quantise, run
from spdz.readings.stock import StockedParty
from spdz.readings.streams import JobStream
from spdz.rounds.coroutine import Check, Exchange, parallel
from spdz.rounds.mac_check import DIGEST_BYTES, MacCheck, drive
from spdz.values import input_mask

SESSION = b"a session"


class Ledger(MacCheck):
    """The insider's MAC check: it believes whatever it gets, and tells what its hash would be otherwise."""

    def __init__(self, alpha, party, session):
        super().__init__(alpha, party, session)
        self.history = []
        """For each check so far, its own true hash and the honest one."""

    def believe(self, theirs):
        self.history.append((self.message(), theirs))
        self._checks += 1
        self._opened.clear()
        self._same = None

    def as_if(self, **other):
        """Its hash, had it another ``party``, ``opened``, ``transcript``, ``checks`` or ``prefix``."""
        changed = copy(self)
        changed._same = None
        for name, value in other.items():
            setattr(changed, f"_{name}", value)
        return changed.message()


def truth(number, own, theirs):
    """The lie that is none: what the protocol says."""
    return own


def own_hash(ledger, theirs):
    """The forgery that is none: the hash of the own sigmas."""
    return ledger.message()


class Insider:
    """A party that lies.

    Args:
        protocol: What it pretends to run.
        ledger: The MAC check in which that protocol records.
        lie: ``lie(number, own, theirs)``: the numbers to send in DATA exchange ``number`` (0: the inputs)
            instead of ``own``, knowing ``theirs``: elements, words (of inputs, of one kind for both parties),
            and bits.
        forge: ``forge(ledger, theirs)``: what to send in a check, knowing the honest hash.
        follow: Whether its state follows what it lied in an opening. (It never follows a lie about its input:
            for that, its program must add the same to its input.)
        bits: Entries of an array of bits, where the program opens any.
    """

    def __init__(self, protocol, ledger, lie=truth, forge=own_hash, follow=True, bits=1):
        self._protocol, self._ledger = protocol, ledger
        self._lie, self._forge, self._follow, self._bits = lie, forge, follow, bits
        self._number = 0
        self.lied = self._over = False
        self.since = None
        """The DATA exchange with its first lie."""
        self._advance(None)

    def answer(self, theirs, check=False):
        """This party's frame, made in sight of the honest one, which may be a check before it is time."""
        due = isinstance(self.request, Check)
        if due or check:
            frame = self._forge(self._ledger, bytes(theirs))
            self.lied |= frame != self._ledger.message()
            self._ledger.believe(bytes(theirs))
            if due and not self._over:
                self._advance(None)
            return frame
        layout = Layout.of(self.request, self._bits, inputs=self._number == 0)
        own, honest = layout.numbers(b"".join(self.request.payload)), layout.numbers(theirs)
        said = self._lie(self._number, own, honest)
        if said != own and not self.lied:
            self.lied, self.since = True, self._number
        frame = layout.frame(said)
        self._ledger.absorb([frame], theirs)
        if self._follow and self._number and len(said) == len(own):
            theirs = layout.frame([reduced(t + s - o, o) for o, t, s in zip(own, honest, said, strict=True)])
        self._number += 1
        self._advance(memoryview(theirs))
        return frame

    def _advance(self, reply):
        try:
            self.request = self._protocol.send(reply)
        except Wrapped:  # what its lie made; the honest party checks now
            self.request, self._over = Check(), True
        except (StopIteration, ProtocolViolation):  # its own result may be nonsense
            self.request = None

    def frames(self):
        """For a channel that asks :meth:`answer`: requests as ``drive`` makes them, of the right lengths."""
        while self.request is not None:
            if isinstance(self.request, Check):
                yield Exchange([bytes(DIGEST_BYTES)], DIGEST_BYTES, 0, is_check=True)
            else:
                yield self.request

    def close(self):
        self._protocol.close()


@dataclass
class Duel:
    """What the honest party did.

    Attributes:
        results: Its output, if it came to one: a list of one item.
        error: What it raised instead.
        sent: For each of its frames, how many numbers, or None for a check.
        bits: DATA exchanges in which nothing but bits is opened.
        lied: Whether the insider deviated at all.
        since: The DATA exchange in which it first did; None of a check.
    """

    results: list[Any] = field(default_factory=list)
    error: SpdzError | None = None
    sent: list[int | None] = field(default_factory=list)
    bits: set[int] = field(default_factory=set)
    lied: bool = False
    since: int | None = None

    @property
    def accepted(self):
        return self.error is None and len(self.results) == 1

    @property
    def caught(self):
        return type(self.error) is MacCheckFailed and not self.results

    @property
    def value(self):
        (value,) = self.results
        return value

    @property
    def openings(self):
        """Numbers of each DATA exchange after the inputs, by its number."""
        return dict(enumerate(self._exchanges[1:], 1))

    def see(self, request, bits):
        """Count a frame that the honest party is about to send."""
        if request.is_check:
            self.sent.append(None)
            return
        number = len(self._exchanges)
        layout = Layout.of(request, bits, inputs=number == 0)
        self.sent.append(layout.count)
        if layout.all_bits:
            self.bits.add(number)

    @property
    def _exchanges(self):
        return [size for size in self.sent if size is not None]

    def position(self, number):
        """Which of its frames DATA exchange ``number`` was."""
        return [at for at, size in enumerate(self.sent) if size is not None][number]

    def frames_until_checked(self, number):
        """How many frames an honest party may send if exchange ``number`` was a lie: up to the next check."""
        return self.sent.index(None, self.position(number)) + 1


class Dealt:
    """Jobs of one program, dealt once and run as often as a test likes (each time from the start).

    Args:
        program: The program.
        pairs: For each lane, the inputs of party 0 and party 1.
        stock: Deal this stock instead.
        shares: The shares of the MAC key, if they are not to be random.
    """

    def __init__(self, program, *pairs, stock=None, shares=None):
        self.program, self._stock = program, stock
        self.data = [tuple(quantise(program, one, "input") for one in pair) for pair in pairs]
        self._shapes = tuple(one.shape for one in self.data[0])
        self._bits = np.size(run_clear(program, *pairs[0]).value)
        self.mac_key = random_mac_key() if shares is None else MacKey(shares)
        self._keys = [(secrets.token_bytes(32), secrets.token_bytes(32)) for _ in pairs]
        if stock is None:
            plan = measure(program, self._shapes, "malicious")
            self._pad_bytes = plan.pad_bytes
            self._corrections = [deal_job(program, plan, "malicious", k, self.mac_key) for k in self._keys]
        else:
            self._pad_bytes = measure_stock(stock, "malicious")
            self._corrections = [
                deal_stock(stock, self._pad_bytes, "malicious", k, self.mac_key) for k in self._keys
            ]

    @cached_property
    def word_bits(self):
        """Bits of the words of inputs of party 0, as of party 1; ``input_mask.LONG`` for elements."""
        source = declare(self.program, self._shapes)[0]
        return input_mask.LONG if self._stock else input_mask.job_bits(source.shape, source.norm)

    @cached_property
    def norm(self):
        """The largest magnitude of an honest coordinate, in raw units."""
        return declare(self.program, self._shapes)[0].norm

    @cached_property
    def honest(self):
        """What a run without a lie looks like."""
        return self.duel()

    def mac_check(self, index, kind=MacCheck):
        return kind(self.mac_key.shares[index], index, SESSION)

    def protocol(self, index, mac_check, program=None):
        """All lanes of one party under one MAC check, as a session runs them."""
        program, alpha, lanes = program or self.program, self.mac_key.shares[index], []
        for data, keys, corrections in zip(self.data, self._keys, self._corrections, strict=True):
            stream = JobStream(keys[index], self._pad_bytes[index], corrections[index])
            if self._stock is None:
                party = Party(index, "malicious", stream, mac_check, alpha, Stats())
            else:
                party = StockedParty(self._stock, index, "malicious", stream, mac_check, alpha, Stats())
            lanes.append(run(party, program, declare(program, self._shapes, {index: data[index]})))
        return _all(lanes)

    def duel(self, evil=1, lie=truth, *, forge=own_hash, follow=True, program=None):
        """Run the honest party, which is 1 - ``evil``, against an insider that really runs ``program``."""
        mac_check, ledger = self.mac_check(1 - evil), self.mac_check(evil, Ledger)
        honest = drive(self.protocol(1 - evil, mac_check), mac_check)
        insider = Insider(self.protocol(evil, ledger, program), ledger, lie, forge, follow, self._bits)
        duel = Duel()
        try:
            request = next(honest)
            while True:
                frame = b"".join(request.payload)
                duel.see(request, self._bits)
                answer = insider.answer(frame, request.is_check)
                if len(answer) != request.expect:
                    raise ProtocolViolation("a frame of another length, which no channel lets through")
                request = honest.send(memoryview(answer))
        except StopIteration as done:
            duel.results.append(done.value)
        except SpdzError as error:
            duel.error = error
        finally:
            duel.lied, duel.since = insider.lied, insider.since
            honest.close()
            insider.close()
        return duel

    def try_lie(self, evil, number, lie, *, follow=True, forge=own_hash, what=""):
        """Whether it was a lie, in ``number`` or later; if so, the first check after it has caught it."""
        duel = self.duel(evil, lie, follow=follow, forge=forge)
        what = f"{self.program}: party {evil} {'follows' if follow else 'denies'} {what} in {number}: {duel}"
        if duel.lied:
            assert duel.caught, what
            # A number that may have wrapped is checked at once.
            since = number if duel.since is None else duel.since
            assert len(duel.sent) <= self.honest.frames_until_checked(since), what
        else:
            assert duel.accepted, what
        return duel.lied


async def _all(lanes):
    return [await lanes[0]] if len(lanes) == 1 else await parallel(*lanes)
