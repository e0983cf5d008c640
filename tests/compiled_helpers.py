"""One job read by the ordinary party and by compiled code: the same tape, the same replies of the peer."""

import secrets
from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from unittest.mock import patch

import numpy as np

from dealer.randomness import random_mac_key
from dealer.recipe import deal_job
from spdz import measure
from spdz.channels import FrameKind
from spdz.compiled.programs import Programs
from spdz.compiled.record import compiled
from spdz.compiled.straight import Straight
from spdz.foundations.errors import ProtocolViolation, SpdzError
from spdz.foundations.stats import Stats
from spdz.local import lock_step
from spdz.readings.party import Party
from spdz.readings.program import declare, quantise, run
from spdz.readings.streams import JobStream
from spdz.rounds.mac_check import MacCheck, drive
from spdz.session.driver import ChannelRounds

SESSION = b"s" * 32
SECURITIES = ("malicious", "semi-honest")
FORGED = object()
"""A reply: the message that a check accepts, whatever was opened."""


@dataclass(frozen=True)
class Outcome:
    """What one party did with a job, and how it ended."""

    frames: list
    requests: list
    value: object
    error: object
    correlations: dict
    check: object


class Lane:
    """One party's run of a job; ``code`` None is the ordinary reading, ``raw`` None the job's own input."""

    def __init__(self, job, index, code=None, raw=None):
        self.index = index
        alpha = None if job.mac is None else job.mac.shares[index]
        self.check = None if job.mac is None else MacCheck(alpha, index, SESSION)
        self.stats = Stats()
        raw = job.raw(index) if raw is None else raw
        if code is None:
            party = Party(index, job.security, job.stream(index), self.check, alpha, self.stats)
            self.protocol = run(party, job.program, declare(job.program, job.shapes, {index: raw}))
        else:
            early = code.ahead(job.stream(index), alpha)
            self.protocol = code.run(early, alpha, self.check, code.taken(raw), self.stats)

    def replay(self, replies):
        """Answer from a list, in which FORGED stands for what passes the check; break off at its end."""
        frames, requests, value, error = [], [], None, None
        lane = drive(self.protocol, self.check)
        try:
            request = next(lane)
            for reply in [*replies, None]:
                frames.append(b"".join(request.payload))
                requests.append((request.expect, request.elements, request.is_check))
                if reply is None:
                    break
                if reply is FORGED:
                    reply = self.check._hash(1 - self.index)
                request = lane.send(memoryview(bytearray(reply)))
        except StopIteration as done:
            value = done.value
        except SpdzError as raised:
            error = raised
        finally:
            lane.close()
        return Outcome(frames, requests, value, error, dict(self.stats.correlations), state(self.check))


class Answering:
    """A channel to a peer whose frames are known; it breaks off where they end."""

    def __init__(self, replies, check, index):
        self.replies, self.check, self.index = [*replies, None], check, index
        self.frames, self.requests = [], []
        self.rounds = self.bytes_sent = 0

    def post(self, kind, payload, expect):
        self.frames.append(b"".join(payload))
        self.requests.append((expect, kind == FrameKind.CHECK))

    def exchange(self, kind, payload, expect):
        self.post(kind, payload, expect)
        return self.take()

    def take(self):
        reply = self.replies[len(self.frames) - 1]
        if reply is None:
            raise BrokenOff
        return memoryview(bytearray(self.check._hash(1 - self.index) if reply is FORGED else reply))


class BrokenOff(Exception):
    """The replies have ended."""


def alone(job, index, code, replies, raw):
    """What a party's code does by calls, which is how a session runs a single job."""
    alpha = None if job.mac is None else job.mac.shares[index]
    check = None if job.mac is None else MacCheck(alpha, index, SESSION)
    channel, value, error = Answering(replies, check, index), None, None
    early, rounds = code.ahead(job.stream(index), alpha), ChannelRounds(channel, check)
    used = {}
    try:
        value = code.run_alone(early, alpha, code.taken(raw), rounds)
        used = dict(rounds.stats(code.correlations).correlations)
    except BrokenOff:
        pass
    except SpdzError as raised:
        error = raised
    return Outcome(channel.frames, channel.requests, value, error, used, state(check))


def state(check):
    """What a MAC check has in its next hash."""
    if check is None:
        return None
    return check._same_at_both(), check._transcript.digest(), check._checks, check.pending, check._failed


@dataclass(frozen=True)
class Job:
    """One dealt job."""

    program: object
    data: tuple
    security: str
    mac: object
    keys: tuple
    corrections: tuple
    plan: object

    @property
    def shapes(self):
        return tuple(np.shape(one) for one in self.data)

    def raw(self, index):
        return quantise(self.program, self.data[index], "input")

    def stream(self, index):
        return JobStream(self.keys[index], self.plan.pad_bytes[index], self.corrections[index])

    def code(self, index):
        return compiled(self.program, self.plan, index, self.security)

    @cached_property
    def codes(self):
        return self.code(0), self.code(1)

    @cached_property
    def frames(self):
        """What either party sends in an honest run, by sender."""
        sent = ([], [])

        def watch(number, sender, frame):
            sent[sender].append(frame)
            return frame

        self.together(tamper=watch)
        return sent

    def together(self, codes=(None, None), tamper=None):
        """Both parties, live."""
        lanes = [Lane(self, index, codes[index]) for index in (0, 1)]
        return lock_step(
            [lane.protocol for lane in lanes],
            [lane.check for lane in lanes],
            tuple(lane.stats for lane in lanes),
            tamper,
        )

    def read(self, index, code=None, replies=None, raw=None):
        """One party's run with the peer's frames, the honest ones if none are given."""
        return Lane(self, index, code, raw).replay(self.frames[1 - index] if replies is None else replies)


def deal(program, data, security="malicious"):
    """Deal a job for a program and two inputs."""
    plan = measure(program, tuple(np.shape(one) for one in data), security)
    mac = random_mac_key() if security == "malicious" else None
    keys = (secrets.token_bytes(32), secrets.token_bytes(32))
    return Job(program, tuple(data), security, mac, keys, deal_job(program, plan, security, keys, mac), plan)


def unit_vectors(n, seed=1, length=1.0):
    """Two vectors of a length a little below the one asked for, neither alike nor opposite."""
    x, y = np.random.default_rng(seed).standard_normal((2, n))
    x, y = (length * (1 - 1e-9) * one / np.linalg.norm(one) for one in (x, (x + y if n > 1 else y)))
    return x, y


def turned(frame, bit):
    """A frame with one bit turned over."""
    octets = bytearray(frame)
    octets[bit // 8] ^= 1 << bit % 8
    return bytes(octets)


def same(one, other):
    """Hold two outcomes to each other, frame by frame."""
    assert one.frames == other.frames
    assert one.requests == other.requests or [(a, c) for a, _, c in one.requests] == other.requests
    assert (type(one.error), str(one.error)) == (type(other.error), str(other.error))
    if not isinstance(one.error, ProtocolViolation):  # code records while the next frame travels
        assert one.check == other.check
    if one.value is not None:
        assert one.correlations == other.correlations
        assert type(one.value) is type(other.value)
        assert np.array_equal(one.value, other.value)


def hold(job, index, replies=None, raw=None):
    """The code to the ordinary reading, for one party and the same replies; returns how both ended."""
    ordinary = job.read(index, None, replies, raw)
    same(ordinary, job.read(index, job.codes[index], replies, raw))
    replies = job.frames[1 - index] if replies is None else replies
    same(ordinary, alone(job, index, job.codes[index], replies, job.raw(index) if raw is None else raw))
    return ordinary


def hold_honest(job):
    """Both parties' code to the ordinary reading, which reaches a value."""
    outcomes = [hold(job, index) for index in (0, 1)]
    assert [one.error for one in outcomes] == [None, None]
    assert [one.frames for one in outcomes] == list(job.frames)
    assert np.array_equal(outcomes[0].value, outcomes[1].value)
    return outcomes[0].value


# -- sessions -------------------------------------------------------------------------------------------


@contextmanager
def readings():
    """Counts, by party, the jobs that are read, that run as code, and that are computed ahead."""
    seen = Counter()
    party, run, run_alone, ahead = Party.__init__, Straight.run, Straight.run_alone, Straight.ahead

    def reading(self, index, *rest):
        if type(self) is Party:
            seen["read", index] += 1
        party(self, index, *rest)

    def running(self, *rest):
        seen["run"] += 1
        return run(self, *rest)

    def running_alone(self, *rest):
        seen["run"] += 1
        return run_alone(self, *rest)

    def computing(self, *rest):
        seen["ahead"] += 1
        return ahead(self, *rest)

    with (
        patch.object(Party, "__init__", reading),
        patch.object(Straight, "run", running),
        patch.object(Straight, "run_alone", running_alone),
        patch.object(Straight, "ahead", computing),
    ):
        yield seen


@contextmanager
def one_reads(index):
    """This party's sessions compile nothing."""
    ready = Programs.ready

    def never(self, program, *, again=False):
        plan, code = ready(self, program, again=again)
        return plan, None if self._party == index else code

    with patch.object(Programs, "ready", never):
        yield
