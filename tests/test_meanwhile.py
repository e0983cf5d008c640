"""A strip has begun, durably, before anything that depends on it is sent; its error stops what is sent."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from dealer.gallery import deal_gallery
from protocols.catalog import GalleryPurpose
from spdz.channels import FrameKind, memory_pair
from spdz.foundations.errors import TapeError
from spdz.gallery import GalleryTape
from spdz.gallery.ledger import Ledger
from spdz.session.gallery import GallerySession
from spdz.session.meanwhile import Meanwhile


def test_what_is_waited_for_is_done():
    done = []
    with Meanwhile(lambda: (time.sleep(0.05), done.append(1))) as work:
        work.wait()
        assert done == [1]
        work.wait()


def test_the_end_waits_too():
    done = []
    with Meanwhile(lambda: (time.sleep(0.05), done.append(1))):
        pass
    assert done == [1]


def test_an_error_is_raised_where_it_is_waited_for_and_at_the_end():
    def fail():
        raise TapeError("the disk")

    with pytest.raises(TapeError), Meanwhile(fail) as work:
        with pytest.raises(TapeError):
            work.wait()
    with pytest.raises(TapeError), Meanwhile(fail):
        pass


def test_an_error_of_this_side_comes_first_but_the_work_ends():
    done = []
    with pytest.raises(KeyError), Meanwhile(lambda: (time.sleep(0.05), done.append(1))):
        raise KeyError
    assert done == [1]


class Watched:
    """A channel that notes what is sent, and when."""

    def __init__(self, channel, log):
        self._channel, self._log = channel, log

    def __getattr__(self, name):
        return getattr(self._channel, name)

    def exchange(self, kind, payload, expect, *rest, **more):
        self._log.append(kind)
        return self._channel.exchange(kind, payload, expect, *rest, **more)


@pytest.fixture
def pair(tmp_path):
    """Two sessions of a gallery, with what each has done in order; both hold two descriptors."""
    terms = GalleryPurpose("S10", 8).terms(0.5, "malicious")
    paths = tmp_path / "0.gallery", tmp_path / "1.gallery"
    deal_gallery(paths, ("zero", "one"), terms, (4, 4))
    ends, logs = memory_pair(timeout=10.0), ([], [])

    def open_side(party):
        state = tmp_path / f"state {party}"
        tape = GalleryTape.open(paths[party], state_dir=state)
        ledger = Ledger.open(tmp_path / f"{party}.ledger", tape.header.tape, party, state_dir=state)
        return GallerySession(tape, ledger, Watched(ends[party], logs[party]), terms)

    with ThreadPoolExecutor(2) as pool:
        sessions = list(pool.map(open_side, (0, 1)))
        for session in sessions:
            session.add(np.eye(8)[:2])
        yield sessions, logs, pool
        for session in sessions:
            session.close()


def test_nothing_of_a_strip_is_sent_before_it_has_begun(pair, monkeypatch):
    sessions, logs, pool = pair
    begin, slow = Ledger.begin, threading.Event()

    def slowly(ledger, strip):
        slow.wait(0.2)  # long enough for what does not wait
        begin(ledger, strip)
        logs[ledger.party].append("begun")

    for party, session in enumerate(sessions):
        session._ledger.party = party
    monkeypatch.setattr(Ledger, "begin", slowly)
    steps = list(pool.map(lambda session: session.step(), sessions))
    assert all(step.blocks for step in steps)
    for log in logs:
        begun = log.index("begun")
        # After it: the element, a check, the bits, a check. Before it the last of the proofs' checks.
        assert log[begun + 1 :] == [FrameKind.DATA, FrameKind.CHECK, FrameKind.DATA, FrameKind.CHECK]
        assert log[begun - 1] == FrameKind.CHECK


def test_a_disk_that_fails_stops_the_strip_unsent(pair, monkeypatch):
    sessions, logs, pool = pair
    before = Ledger.begin

    def fail(ledger, strip):
        raise TapeError("the disk is full")

    monkeypatch.setattr(Ledger, "begin", fail)

    def step(session):
        with pytest.raises(Exception) as error:
            session.step()
        return error.value

    errors = list(pool.map(step, sessions))
    monkeypatch.setattr(Ledger, "begin", before)
    assert any("the disk is full" in str(error) for error in errors)
    for log in logs:
        assert log[-1] == FrameKind.CHECK  # that of the proofs
