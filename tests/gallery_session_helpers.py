"""Two gallery sessions over channels that can be cut, watched and lied on, each side in its own thread."""

import shutil
import threading
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from dealer.gallery import deal_gallery
from spdz import dot, l2_normalised, mask, nonnegative
from spdz.channels import FrameKind
from spdz.channels.memory import MemoryChannel
from spdz.foundations.errors import ChannelClosed
from spdz.gallery.ledger import Ledger
from spdz.gallery.tape import GalleryTape
from spdz.readings.gallery import Terms
from spdz.session import filling
from spdz.session.gallery import GallerySession

AGENTS = ("alice", "bob")
PATIENCE = 20.0


@dataclass(frozen=True)
class Product:
    """[x . y >= threshold], or x . y where the threshold is None."""

    threshold: float | None = 0.5
    max_norm: float = 1.0

    async def prepare(self, engine, vectors):
        return ()

    async def compare(self, engine, x, y):
        z = dot(x[0], y[0])
        return z if self.threshold is None else await at_least(z, self.threshold)


@dataclass(frozen=True)
class Near:
    """[|x - y|^2 <= threshold], from squares that are prepared without an opening."""

    threshold: float = 1.0
    max_norm: float = 1.0

    async def prepare(self, engine, vectors):
        return (dot(vectors, vectors),)

    async def compare(self, engine, x, y):
        return await at_least(dot(x[0], y[0]) * 2 - x[1] - y[1], -self.threshold)


@dataclass(frozen=True)
class Cosine:
    """[x . y >= threshold |x| |y|]: normalising takes several openings a slot."""

    threshold: float = 0.5
    max_norm: float = 1.0

    async def prepare(self, engine, vectors):
        (unit,) = await l2_normalised(vectors)
        return tuple(await mask(unit))

    async def compare(self, engine, x, y):
        return await at_least(dot(x[1], y[1]), self.threshold)


@dataclass(frozen=True)
class Twice:
    """[x . y >= threshold] where the score is opened twice on the way: two openings a pair."""

    threshold: float = 0.5
    max_norm: float = 1.0

    async def prepare(self, engine, vectors):
        return ()

    async def compare(self, engine, x, y):
        (z,) = await mask(dot(x[0], y[0]))
        (again,) = await mask(z.plus_raw(0), fresh=True)
        return await at_least(again, self.threshold)


async def at_least(z, threshold):
    return await nonnegative(z.plus_raw(-round(threshold * (1 << z.frac))), 2 * z.bound.entry + 1)


def unit_vectors(rng, count, dim):
    """Random unit vectors, some of them alike, so that comparisons come out both ways."""
    vectors = rng.normal(size=(count, dim))
    vectors[::2] = rng.normal(size=dim) + 0.7 * vectors[::2]
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


@dataclass
class Mission:
    """A dealt gallery in a folder, and what the two robots keep beside it."""

    folder: Path
    terms: Terms

    def tape(self, party):
        return GalleryTape.open(self.tape_path(party), state_dir=self.state(party))

    def ledger(self, party, tape):
        return Ledger.open(
            self.folder / f"{AGENTS[party]}.ledger", tape.header.tape, party, state_dir=self.state(party)
        )

    def tape_path(self, party):
        return self.folder / f"{AGENTS[party]}.tape"

    def state(self, party):
        return self.folder / f"state-{AGENTS[party]}"

    def open(self, party, channel, kind=GallerySession, **changes):
        tape = self.tape(party)
        return kind(tape, self.ledger(party, tape), channel, changes.pop("terms", self.terms), **changes)

    def meet(self, *works, channels=None, kinds=(GallerySession, GallerySession)):
        """Open a session a side, run ``works[i](session)``, and give results or exceptions.

        Both sides end within ``PATIENCE`` and a little, or the test fails.
        """
        ends = channels or cables()
        works = works if len(works) == 2 else works * 2
        outcomes = [None, None]

        def side(index):
            try:
                with self.open(index, ends[index], kinds[index]) as session:
                    outcomes[index] = works[index](session)
            except BaseException as error:  # also a simulated crash
                outcomes[index] = error
            finally:
                ends[index].close()

        threads = [threading.Thread(target=side, args=(i,), daemon=True) for i in (0, 1)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(3 * PATIENCE)
        assert not any(thread.is_alive() for thread in threads), "a side hangs"
        return outcomes

    def copy(self, folder):
        """The same gallery as it is now, in another place."""
        shutil.copytree(self.folder, folder)
        return Mission(folder, self.terms)

    def destroyed(self, party):
        """Whether tape and ledger say that they were destroyed."""
        found = []
        for opening in (lambda: self.tape(party), lambda: self.ledger(party, _Named(self, party))):
            try:
                opening().close()
                found.append(False)
            except Exception as error:
                found.append(type(error).__name__ == "TapeDestroyed")
        assert found[0] == found[1], found
        return found[0]


class _Named:
    """Enough of a tape to open its ledger by."""

    def __init__(self, mission, party):
        marks = list(mission.state(party).glob(f"*-{party}.gallery"))
        self.header = self
        self.tape = marks[0].name.rsplit("-", 1)[0]


@dataclass
class Dealer:
    """Deals every gallery of a test module once, and hands out copies."""

    folder: Path
    dealt: dict = field(default_factory=dict)
    copies: int = 0

    def __call__(self, terms, slots):
        key = (terms, slots)
        if key not in self.dealt:
            folder = self.folder / f"dealt{len(self.dealt)}"
            folder.mkdir()
            self.dealt[key] = Mission(folder, terms)
            deal_gallery(tuple(self.dealt[key].tape_path(party) for party in (0, 1)), AGENTS, terms, slots)
        self.copies += 1
        return self.dealt[key].copy(self.folder / f"copy{self.copies}")


@pytest.fixture(scope="module")
def galleries(tmp_path_factory):
    return Dealer(tmp_path_factory.mktemp("galleries"))


@pytest.fixture
def no_sync(monkeypatch):
    """Nothing waits for the disk; what a process has written, another still sees."""
    for name in ("fsync", "fdatasync"):
        monkeypatch.setattr(f"spdz.tape.durable.os.{name}", lambda descriptor: None, raising=False)
    monkeypatch.setattr("spdz.gallery.store._SETTINGS", ("synchronous=OFF",))


class Cable(MemoryChannel):
    """A channel that writes down its frames, and that something can happen to.

    Attributes:
        frames: ``(kind, own payload, the peer's payload)`` of every exchange that went through.
        cut: ``(number, how)``: exchange ``number`` fails. How: ``"unsent"`` before anything is sent,
            ``"sent"`` after this side's frame is out, ``"torn"`` after half of it, bytes: instead of it.
        say: ``say(number, kind, own, theirs)`` gives the bytes to send instead; it has seen the peer's frame.
    """

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.frames, self.cut, self.say = [], None, None
        self.said = b""

    def exchange(self, kind, payload, expect, dtype=0):
        reply = super().exchange(kind, payload, expect)
        self.frames.append((kind.name, self.said, bytes(reply)))
        return reply

    def _begin(self, frame):
        self.frame = frame

    def _finish(self, reader, deadline):
        frame = self.frame
        number, own = self.rounds + self.control_rounds, b"".join(frame[1:])
        self.said = own
        if self.cut is not None and self.cut[0] == number:
            self._fail(self.cut[1], b"".join(frame))
        if self.say is None:
            super()._begin(frame)
            super()._finish(reader, deadline)
            return
        super()._finish(reader, deadline)
        self.said = self.say(number, FrameKind(frame[0][1]), own, bytes(reader.payload()))
        header = bytearray(frame[0])
        header[12:16] = len(self.said).to_bytes(4, "little")
        self._outgoing.put(bytes(header) + self.said)

    def _fail(self, how, frame):
        sent = {"unsent": b"", "sent": frame, "torn": frame[: len(frame) // 2]}.get(how, how)
        self._outgoing.put(sent)
        self._outgoing.put(None)
        raise ChannelClosed("cut")


def cables(timeout=PATIENCE):
    from queue import SimpleQueue

    there, back = SimpleQueue(), SimpleQueue()
    return Cable(back, there, timeout), Cable(there, back, timeout)


def table(session, blocks):
    """Blocks as one array (own slots, peer's slots) of -1 where there is no result; no pair comes twice."""
    own, peer = session.party, 1 - session.party
    capacity = session._tape.header.capacity
    found = np.full((capacity[own], capacity[peer]), -1.0)
    for block in blocks:
        part = found[block.own.start : block.own.stop, block.peer.start : block.peer.stop]
        assert block.results.shape == part.shape
        assert (part == -1.0).all(), "a pair twice"
        part[...] = block.results
    return found


def feed(parts, seen=None):
    """Bring parts of an array step by step; gives the steps, and appends every block to ``seen``."""

    def work(session):
        steps = []
        for part in parts:
            session.add(part)
            steps.append(session.step(lambda block: None if seen is None else seen.append(block)))
        return steps

    return work


def no_errors(outcomes):
    for outcome in outcomes:
        if isinstance(outcome, BaseException):
            raise outcome
    return outcomes


def expected(terms, x, y):
    """Clear scores of quantised vectors (the threshold's place is 0), exact, and what is left open."""
    raw = np.array(x, dtype=object) @ np.array(y, dtype=object).T
    if isinstance(terms.program, Near):
        squares = [(np.array(v, dtype=object) ** 2).sum(axis=1) for v in (x, y)]
        raw = 2 * raw - squares[0][:, None] - squares[1][None] + round(terms.program.threshold * (1 << 32))
    elif terms.program.threshold is not None:
        raw = raw - round(terms.program.threshold * (1 << 32))
    drop = 0 if terms.resolution is None else max(0, 32 - terms.resolution)
    return raw, (1 << drop) // 2


def burn_some(monkeypatch, rng):
    """Some masks do not suit, whatever is brought for the slot; the others are judged as ever."""
    real, unlucky = filling.inside, {rng.randrange(97) for _ in range(8)}

    def inside(words, bits, norm):
        good = real(words, bits, norm)
        for at, row in enumerate(words):
            good[at] &= int(row[0]) % 97 not in unlucky
        return good

    monkeypatch.setattr("spdz.session.filling.inside", inside)


def prepare_at_a_time(monkeypatch, slots):
    for where in ("gallery", "meeting"):
        monkeypatch.setattr(f"spdz.session.{where}.PREPARED", slots)
