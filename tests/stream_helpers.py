"""Two robots with a gallery of small slots, and streams that go over a link which breaks."""

import shutil
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from unittest.mock import patch

import numpy as np
from link_helpers import unit

from dealer.gallery_mission import deal_galleries
from protocols import Gallery, gallery, reconnecting
from protocols.catalog import GalleryPurpose

DIM, THRESHOLD = 4, 0.2
STREAMS = (
    [unit(20 + k, n) for k, n in enumerate((2, 0, 3, 1, 0))],
    [unit(30 + k, n) for k, n in enumerate((1, 2, 0, 1, 0))],
)
NONE = np.empty((0, DIM))


def deal(folder, slots=(8, 6), security="malicious", score="S10", **purpose):
    deal_galleries(folder, ["alice", "bob"], GalleryPurpose(score, DIM, **purpose), slots, security)
    return folder


def fresh(dealt, folder):
    """A copy of a dealt mission that nobody has used."""
    shutil.copytree(dealt, folder)
    return folder


def tape(folder, party):
    return folder / ("alice/bob.tape", "bob/alice.tape")[party]


def robot(folder, party, threshold=THRESHOLD, **options):
    where = {"listen": "127.0.0.1:1"} if party == 0 else {"connect": "127.0.0.1:1"}
    return Gallery(tape(folder, party), threshold, state_dir=folder / f"state-{party}", **where, **options)


def robots(folder, link, work, *, farewell=0.3, **options):
    """Run ``work(gallery, party)`` for both robots over a link; returns results or exceptions, in order."""

    def one(party):
        try:
            with robot(folder, party, **options) as opened:
                return work(opened, party)
        except Exception as error:
            return error

    with ExitStack() as stack:
        stack.enter_context(patch.object(gallery, "open_gallery", link.open_gallery))
        stack.enter_context(patch.object(gallery, "FAREWELL", farewell))
        stack.enter_context(patch.object(reconnecting, "_FIRST_PAUSE", 1e-3))
        with ThreadPoolExecutor(2) as pool:
            futures = [pool.submit(one, party) for party in (0, 1)]
            return [future.result(timeout=60) for future in futures]


def stream(opened, party):
    """One step for each element; the steps, and what ``results()`` has at the end."""
    steps = []
    for new in STREAMS[party]:
        opened.add(new)
        steps.append(opened.step())
    return steps, list(opened.results())


def maps(streams=STREAMS):
    return [np.concatenate(side) for side in streams]


def expected(party, streams=STREAMS):
    """Decisions of all own descriptors with all of the peer's."""
    rows = [np.rint(side * 65536).astype(object) for side in maps(streams)]
    table = (rows[0] @ rows[1].T >= THRESHOLD * 2**32).astype(bool)
    return table.T if party else table


def table_of(blocks, shape):
    """The decisions of disjoint blocks, and which pairs they have."""
    table, known = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=int)
    for block in blocks:
        at = np.ix_(block.own, block.peer)
        table[at] = block.results
        known[at] += 1
    return table, known


def check_stream(results, streams=STREAMS):
    """Every pair was decided once and rightly, in the step that brought the later of the two."""
    for party, result in enumerate(results):
        assert not isinstance(result, Exception), result
        steps, stored = result
        assert len(steps) == len(streams[party])
        right = expected(party, streams)
        for blocks in ([block for step in steps for block in step.blocks], stored):
            table, known = table_of(blocks, right.shape)
            assert (known == 1).all() and np.array_equal(table, right)
        sizes = [[len(new) for new in side] for side in (streams[party], streams[1 - party])]
        assert [len(step.own) for step in steps] == sizes[0]
        assert [slot for step in steps for slot in step.own] == list(range(sum(sizes[0])))
        assert sorted([slot for step in steps for slot in step.peer]) == list(range(sum(sizes[1])))


def decided(blocks, party):
    right = expected(party)
    table, known = table_of(blocks, right.shape)
    assert (known == 1).all() and np.array_equal(table, right)


def in_thread(work):
    thread = threading.Thread(target=work)
    thread.start()
    return thread
