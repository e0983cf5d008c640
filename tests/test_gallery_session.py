"""Galleries in any order of arrival: every pair once, in its place, with the clear result.

``SPDZ_GALLERIES`` sets how many random galleries are played (seeds 0, 1, ...).
"""

import itertools
import os
import random
import threading

import numpy as np
import pytest
from gallery_session_helpers import (
    Cosine,
    Near,
    Product,
    Twice,
    burn_some,
    cables,
    expected,
    feed,
    no_errors,
    prepare_at_a_time,
    table,
    unit_vectors,
)

from spdz.foundations.errors import TapeMismatch
from spdz.readings.gallery import Terms
from spdz.readings.gallery_plan import measure_gallery
from spdz.session.admission import quantised

pytestmark = pytest.mark.usefixtures("no_sync")

GALLERIES = int(os.environ.get("SPDZ_GALLERIES", "16"))


def cut(rng, array, parts):
    """Cut an array in so many parts, some of them empty."""
    edges = [0, *sorted(rng.randint(0, len(array)) for _ in range(parts - 1)), len(array)]
    return [array[a:b] for a, b in itertools.pairwise(edges)]


@pytest.mark.parametrize("seed", range(GALLERIES))
def test_random_galleries(galleries, monkeypatch, seed):
    rng, numbers = random.Random(seed), np.random.default_rng(seed)
    program = [
        Product(0.5), Product(None), Near(1.0), Product(-0.3), Cosine(0.5), Twice(0.2), Product(0.9),
    ][seed % 7]  # fmt: skip
    dim = rng.choice([1, 7, 64]) if program.__class__ is not Cosine else 7
    security = rng.choice(["malicious", "semi-honest"])
    terms = Terms(program, dim, security, resolution=rng.choice([None, 16, 6]))
    counts = rng.choice([(1, 1), (1, 30), (40, 1), (rng.randint(1, 40), rng.randint(1, 60))])
    monkeypatch.setattr("spdz.session.comparing.STRIP_PAIRS", rng.choice([1, 7, 50, 1 << 16]))
    monkeypatch.setattr("spdz.session.comparing.CELL_BYTES", rng.choice([3000, 64 << 20]))
    prepare_at_a_time(monkeypatch, rng.choice([3, 128]))
    monkeypatch.setattr("spdz.session.filling.MOST", rng.choice([4, 4096]))
    voids = rng.random() < 0.5
    if voids:
        burn_some(monkeypatch, rng)
    mission = galleries(terms, (counts[0] + 16, counts[1] + 16))
    data = [unit_vectors(numbers, count, dim) for count in counts]
    steps = rng.randint(1, 6)
    parts = [cut(rng, array, steps) for array in data]
    blocks, own = ([], []), ([], [])
    at = 0
    while at < steps:
        more = rng.randint(1, 3)
        works = [feed(parts[i][at : at + more]) for i in (0, 1)]
        for i, done in enumerate(no_errors(mission.meet(*works))):
            for step in done:
                blocks[i].extend(step.blocks)
                own[i].extend(step.own)
        at += more
    tables, stored, plain = [], [], []

    def look(session):
        assert session.filled == own[session.party]
        return (
            table(session, blocks[session.party]),
            table(session, session.results()),
            session.plain(session.filled),
        )

    for found in no_errors(mission.meet(look)):
        tables.append(found[0])
        stored.append(found[1])
        plain.append(found[2])
    assert np.array_equal(tables[0], tables[1].T, equal_nan=True)
    for i in (0, 1):
        assert np.array_equal(plain[i], quantised(terms, data[i]))
        held = stored[i][np.ix_(own[i], own[1 - i])]
        assert np.array_equal(held, tables[i][np.ix_(own[i], own[1 - i])])
    assert_clear(terms, plain, tables[0][np.ix_(own[0], own[1])])
    assert (tables[0] != -1).sum() == counts[0] * counts[1] or program == Product(None)
    if voids and sum(counts) > 60:
        assert sum(map(len, own)) < sum(max(slots) + 1 for slots in own)


def assert_clear(terms, plain, found):
    if isinstance(terms.program, Cosine):
        x, y = (v / np.linalg.norm(v, axis=1)[:, None] for v in map(np.float64, plain))
        score = x @ y.T - terms.program.threshold
        margin = 2.0 ** -(16 if terms.resolution is None else min(12, terms.resolution))
        sure = np.abs(score) > margin
        assert (found == (score >= 0))[sure].all()
        return
    raw, open_ = expected(terms, *plain)
    if terms.program.threshold is None:
        assert (found * 2.0**32 == raw).all()
        return
    sure = (raw >= open_) | (raw < -open_) if open_ else np.ones(raw.shape, dtype=bool)
    assert (found == (raw >= 0))[sure].all()
    assert np.isin(found, (0, 1)).all()


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
def test_a_coarse_comparison_errs_by_half_a_step_on_either_side_and_no_more(galleries, security):
    terms, rng = Terms(Product(0.2), 7, security, resolution=3), np.random.default_rng(4)
    x, y = unit_vectors(rng, 40, 7), unit_vectors(rng, 40, 7)
    found = no_errors(galleries(terms, (40, 40)).meet(feed([x]), feed([y])))
    (block,) = found[0][0].blocks
    raw, half = expected(terms, quantised(terms, x), quantised(terms, y))
    assert half == 1 << 28
    assert (block.results == (raw >= 0))[(raw >= half) | (raw < -half)].all()
    unsure = block.results[(raw > -half) & (raw < half)]
    wrong_below, wrong_above = (
        block.results[(raw < 0) & (raw > -half)],
        ~block.results[(raw >= 0) & (raw < half)],
    )
    assert len(unsure) > 100 and wrong_below.any() and wrong_above.any()


def test_both_sides_cut_alike_where_one_of_them_stores_more(galleries, monkeypatch):
    terms = Terms(Twice(), 4, "semi-honest")
    stored = measure_gallery(terms).pair.correction_bytes
    assert stored[0] != stored[1]
    monkeypatch.setattr("spdz.session.comparing.CELL_BYTES", 4 * min(stored))
    rng = np.random.default_rng(0)
    x, y = unit_vectors(rng, 7, 4), unit_vectors(rng, 9, 4)
    for (step,) in no_errors(galleries(terms, (7, 9)).meet(feed([x]), feed([y]))):
        assert sum(block.results.size for block in step.blocks) == 63 and len(step.blocks) > 7


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
def test_steps_without_news_compare_nothing(galleries, security):
    terms = Terms(Product(), 4, security)
    mission, rng = galleries(terms, (3, 4)), np.random.default_rng(0)
    x, y = unit_vectors(rng, 3, 4), unit_vectors(rng, 4, 4)
    nothing = x[:0]
    for_x, for_y = feed([nothing, x, nothing, nothing]), feed([nothing, nothing, y, nothing])
    for steps in no_errors(mission.meet(for_x, for_y)):
        assert [sum(b.results.size for b in step.blocks) for step in steps] == [0, 0, 12, 0]


def test_pairs_that_lie_in_several_tiles_and_bands_are_in_their_places(galleries):
    """Slots 10 to 40 of 16 a band, in a cell that begins and ends inside bands."""
    terms = Terms(Product(0.3), 7, resolution=None)
    mission, rng = galleries(terms, (40, 45)), np.random.default_rng(1)
    x, y = unit_vectors(rng, 40, 7), unit_vectors(rng, 45, 7)
    found = no_errors(mission.meet(feed([x[:10], x[10:]]), feed([y[:5], y[5:]])))
    for i, (a, b) in enumerate([(x, y), (y, x)]):
        for step in found[i]:
            for block in step.blocks:
                raw, _ = expected(
                    terms,
                    quantised(terms, a[block.own.start : block.own.stop]),
                    quantised(terms, b[block.peer.start : block.peer.stop]),
                )
                assert np.array_equal(block.results, raw >= 0)


def test_other_terms_on_either_side_are_refused_before_anything_is_filled(galleries):
    terms = Terms(Product(0.5), 4)
    mission, x = galleries(terms, (3, 4)), unit_vectors(np.random.default_rng(0), 3, 4)
    other = [
        Terms(Product(0.6), 4),
        Terms(Product(0.5), 4, resolution=None),
        Terms(Product(0.5), 4, proof=False),
    ]
    for changed in [*other, Terms(Near(), 4), Terms(Product(0.5), 4, "semi-honest"), Terms(Product(0.5), 5)]:
        ends = cables()
        outcomes = [None, None]

        def side(i, ends=ends, outcomes=outcomes, changed=changed):
            try:
                with mission.open(i, ends[i], terms=changed if i else terms) as session:
                    session.add(x)
                    session.step()
            except Exception as error:
                outcomes[i] = error
                ends[i].close()

        threads = [threading.Thread(target=side, args=(i,)) for i in (0, 1)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(30)
        assert any(isinstance(outcome, TapeMismatch) for outcome in outcomes), (changed, outcomes)
        assert all(isinstance(outcome, Exception) for outcome in outcomes)
    for steps in no_errors(mission.meet(feed([x]))):
        assert steps[0].own == [0, 1, 2] or steps[0].own


def test_a_pinned_gallery_answers_no_other_threshold(galleries):
    terms = Terms(Product(0.5), 4)
    mission, x = galleries(terms, (3, 4)), unit_vectors(np.random.default_rng(0), 3, 4)
    no_errors(mission.meet(feed([x])))
    mission.terms = Terms(Product(0.6), 4)
    for outcome in mission.meet(feed([x[:0]])):
        assert isinstance(outcome, Exception)
    mission.terms = terms
    no_errors(mission.meet(feed([x[:0]])))


def test_every_tile_and_slot_has_a_delta_of_its_own(galleries):
    mission = galleries(Terms(Product(), 4), (40, 45))
    for party in (0, 1):
        with mission.tape(party) as tape:
            rows, columns = tape.header.bands.counts
            deltas = [tape.tile(r, c).delta.tobytes() for r in range(rows) for c in range(columns)]
            for owner in (0, 1):
                slots = range(tape.header.capacity[owner])
                deltas += [tape.slot(owner, slot).pad[:16].tobytes() for slot in slots]
        assert len(set(deltas)) == len(deltas)
