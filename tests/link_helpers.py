"""A radio link in memory that breaks after so many bytes, and two robots that look for each other over it."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from queue import Empty, Queue, SimpleQueue
from unittest.mock import patch

import numpy as np

from dealer.mission import deal_mission
from protocols import Matcher, matcher, reconnecting
from protocols.catalog import Purpose
from spdz import ChannelTimeout
from spdz.channels import memory
from spdz.gallery import GalleryTape
from spdz.gallery.ledger import Ledger
from spdz.session import GallerySession, Session
from spdz.tape import Tape

DIM = 4


def unit(seed, count):
    vectors = np.random.default_rng(seed).standard_normal((count, DIM))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def mission(folder, count, tile=(2, 2), security="malicious", score="S10"):
    purpose = Purpose(score, DIM, max_norm=1.0, tile=tile)
    deal_mission(folder, ["alice", "bob"], purpose, count, security)
    return folder / "alice" / "bob.tape", folder / "bob" / "alice.tape"


class Cut:
    """What one end writes, until the link breaks: the rest is lost, and both ends see the line close."""

    def __init__(self, there, back, limit):
        self.there, self.back, self.left = there, back, limit

    def put(self, piece):
        if self.left <= 0:
            return
        if piece is None or len(piece) >= self.left:
            if piece:
                self.there.put(piece[: self.left])
            self.left = 0
            self.there.put(None)
            self.back.put(None)
        else:
            self.left -= len(piece)
            self.there.put(piece)


class Link:
    """Where two robots meet. Connection k breaks after ``cuts[k] = (sender, bytes)``; later ones hold.

    Attributes:
        sent: Bytes that either party sent, a pair for each connection.
    """

    def __init__(self, cuts=(), timeout=5.0):
        self.cuts, self.timeout = list(cuts), timeout
        self.calls, self.ends = Queue(), []

    @property
    def sent(self):
        return [tuple(end.bytes_sent for end in ends) for ends in self.ends]

    def open_session(self, tape, *, wait, state_dir, **where):
        """As :func:`spdz.open_session`: party 1 calls, party 0 takes the next call."""
        opened = Tape.open(tape, state_dir=Path(state_dir))
        with ExitStack() as resources:
            resources.enter_context(opened)
            channel = self._reach(opened.header.party, wait)
            resources.pop_all()
        return Session(opened, channel)

    def open_gallery(self, tape, terms, *, waiting, wait, state_dir, **where):
        """As :func:`spdz.session.open_gallery`, in the same way."""
        opened, state = GalleryTape.open(tape, state_dir=Path(state_dir)), Path(state_dir)
        with ExitStack() as resources:
            resources.enter_context(opened)
            header, path = opened.header, tape.with_suffix(".ledger")
            ledger = Ledger.open(path, header.tape, header.party, state_dir=state)
            resources.enter_context(ledger)
            channel = self._reach(header.party, wait)
            resources.pop_all()
        return GallerySession(opened, ledger, channel, terms, waiting)

    def _reach(self, party, wait):
        try:
            return self._call() if party else self.calls.get(timeout=wait)
        except Empty:
            raise ChannelTimeout("nobody calls") from None

    def _call(self):
        there, back = SimpleQueue(), SimpleQueue()
        pipes = [[back, there], [there, back]]  # what either end reads and writes
        if len(self.ends) < len(self.cuts):
            sender, limit = self.cuts[len(self.ends)]
            pipes[sender][1] = Cut(pipes[sender][1], pipes[sender][0], limit)
        first, second = (memory.MemoryChannel(*pair, self.timeout) for pair in pipes)
        self.ends.append((first, second))
        self.calls.put(first)
        return second


def robots(folder, paths, link, work, *, first_pause=1e-3, **options):
    """Run ``work(matcher, party)`` for both robots over a link; returns results or exceptions, in order."""

    def robot(party):
        where = {"listen": "127.0.0.1:1"} if party == 0 else {"connect": "127.0.0.1:1"}
        try:
            with Matcher(paths[party], 0.2, state_dir=folder / f"state-{party}", **where, **options) as one:
                return work(one, party)
        except Exception as error:
            return error

    with (
        patch.object(matcher, "open_session", link.open_session),
        patch.object(reconnecting, "_FIRST_PAUSE", first_pause),
    ):
        with ThreadPoolExecutor(2) as pool:
            futures = [pool.submit(robot, party) for party in (0, 1)]
            return [future.result(timeout=60) for future in futures]


BATCHES = (
    [unit(k, n) for k, n in enumerate((3, 0, 2, 1))],
    [unit(10 + k, n) for k, n in enumerate((4, 2, 5, 2))],
)


def expected(k, party):
    rows = [np.rint(side[k] * 65536).astype(object) for side in BATCHES]
    table = (rows[0] @ rows[1].T >= 0.2 * 2**32).astype(bool)
    return table.T if party else table


def all_batches(one, party):
    return [one.match(batch) for batch in BATCHES[party]]


def check_all(results):
    for party, result in enumerate(results):
        assert not isinstance(result, Exception), result
        for k, matches in enumerate(result):
            assert matches.batch == k and matches.complete
            assert np.array_equal(matches.decisions, expected(k, party)), (party, k)
