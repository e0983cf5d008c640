"""The proof of norm: a vector that no honest robot brings is refused by name before a bit of its pairs."""

import numpy as np
import pytest
from gallery_insider import Lies, duel, vectors
from gallery_session_helpers import Near, Product, cables, feed, no_errors, unit_vectors

from spdz.arithmetic.field import P
from spdz.foundations.errors import ProtocolViolation
from spdz.readings.gallery import Terms
from spdz.session.admission import quantised

pytestmark = pytest.mark.usefixtures("no_sync")

DIM, SLOTS, ONE = 4, (3, 4), 1 << 16


def cheat(galleries, evil, raw, terms):
    """An insider brings raw vectors; what the honest side did."""
    brought = [np.array(vector, dtype=np.int64) for vector in raw]
    return duel(galleries(terms, SLOTS), vectors(), evil, Lies(vectors=brought))


CHEATS = {
    "norm 1.01": ([[66191, 0, 0, 0]], 0.0),
    "one more than the bound": ([[0, 0, 0, "over"]], 0.0),
    "huge": ([[1 << 30, 0, 0, 0]], 0.0),
    "as large as its words can be": ([["most", "most", "most", "most"]], 0.0),
    "zero, where vectors have a length": ([[0, 0, 0, 0]], 0.5),
    "short": ([[ONE // 3, 0, 0, 0]], 0.5),
    "the third of three": ([[ONE, 0, 0, 0], [0, ONE, 0, 0], [1 << 20, 0, 0, 0]], 0.0),
}


@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("how", CHEATS)
def test_a_vector_of_another_norm_is_refused_by_name(galleries, evil, how):
    raw, min_norm = CHEATS[how]
    terms = Terms(Product(), DIM, min_norm=min_norm)
    # The larger a coordinate, the fewer masks suit it; the insider takes the next slot then.
    sizes = {"over": terms.norm + 1, "most": 1 << terms.word_bits - 8}
    raw = [[sizes.get(number, number) for number in vector] for vector in raw]
    found = cheat(galleries, evil, raw, terms)
    assert found.error == "ProtocolViolation", found.outcome
    name = ("alice", "bob")[evil]
    assert f"of {name} has not a norm" in str(found.outcome) and "nothing was compared" in str(found.outcome)
    assert found.seen == []
    assert [frame[0] for frame in found.frames[-4:]] == ["DATA", "CHECK", "DATA", "CHECK"]
    assert len(found.frames) == 9  # the cell's were never sent
    for outcome in found.mission.meet(feed([np.empty((0, DIM))])):  # the slot is filled for ever
        assert isinstance(outcome, ProtocolViolation) and f"of {name} has not a norm" in str(outcome)


@pytest.mark.parametrize("evil", [0, 1])
def test_honest_vectors_at_the_edge_pass(galleries, evil):
    terms = Terms(Product(), DIM, min_norm=0.5)
    ((least, most),) = terms.squares
    root = int(np.sqrt(float(least)))
    for square, raw in ((most, [terms.norm, 0, 0, 0]), (least, [root, 0, 0, 0])):
        assert sum(number**2 for number in raw) == square
        found = cheat(galleries, evil, [raw], terms)
        assert not found.caught, found.outcome
    for raw in ([terms.norm, 1, 0, 0], [root - 1, 0, 0, 0]):
        assert cheat(galleries, evil, [raw], terms).error == "ProtocolViolation"


def test_no_words_make_the_square_of_a_long_vector_small(galleries):
    """A sum of squares cannot wrap: the largest that words of w bits can make is below p / 2."""
    for dim in (1, 4, 1536, 8192):
        terms = Terms(Product(), dim)
        assert 2 * dim * ((1 << terms.word_bits) - 1) ** 2 < P
    for max_norm in (2.0**15, 2.0**21):  # words of 59 bits, and none
        with pytest.raises(ValueError, match="57 bits"):
            Terms(Product(max_norm=max_norm), 1536)


def edges(rng, dim):
    """Unit vectors that round badly, and some that do not."""
    yield np.full(dim, 1 / np.sqrt(dim))
    yield np.full(dim, -1 / np.sqrt(dim))
    for at in (0, dim - 1):
        for sign in (1.0, -1.0):
            one = np.zeros(dim)
            one[at] = sign
            yield one
    while True:
        vector = rng.normal(size=dim)
        kind = rng.integers(4)
        if kind == 0:
            vector = np.abs(vector) ** 8
        elif kind == 1:
            vector[rng.random(dim) < 0.8] = 0.0
            vector[0] += 1e-9
        elif kind == 2:
            vector = np.round(vector / np.linalg.norm(vector) * ONE) + 0.5 * rng.choice([-1, 1], dim)
        yield vector / np.linalg.norm(vector)


@pytest.mark.parametrize("dim", [1, 8, 64])
def test_honest_unit_vectors_always_pass(galleries, dim):
    """A thousand of them, in all, under the narrowest terms: norms between 1 and 1."""
    terms = Terms(Product(), dim, min_norm=1.0)
    source = edges(np.random.default_rng(dim), dim)
    x = np.array([next(source) for _ in range(340)])
    assert (np.abs(np.linalg.norm(x, axis=1) - 1) < 1e-12).all()
    found = no_errors(galleries(terms, (344, 8)).meet(feed([x]), feed([x[:0]])))
    assert len(found[0][0].own) == 340


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
def test_without_a_proof_nothing_is_proved(galleries, security):
    terms = Terms(Product(), DIM, security, proof=False)
    mission, x = galleries(terms, SLOTS), unit_vectors(np.random.default_rng(0), 3, DIM)
    ends = cables()
    no_errors(mission.meet(feed([x]), channels=ends))
    assert not any(len(frame[1]) == 6 * 16 for frame in ends[0].frames)
    again = Terms(Product(), DIM, "semi-honest")
    assert not again.proves and Terms(Product(), DIM).proves


@pytest.mark.parametrize("evil", [0, 1])
def test_a_zero_vector_is_near_everything_only_without_a_least_norm(galleries, evil):
    """What the proof is for: under a distance the zero vector is as near as 1 to every unit vector."""
    zero = [np.zeros(DIM, dtype=np.int64)]
    terms = Terms(Near(1.01), DIM)
    found = duel(galleries(terms, SLOTS), vectors(), evil, Lies(vectors=zero))
    (block,) = found.seen
    assert block.results.all()
    terms = Terms(Near(1.01), DIM, min_norm=1.0)
    found = duel(galleries(terms, SLOTS), vectors(), evil, Lies(vectors=zero))
    assert isinstance(found.outcome, ProtocolViolation) and found.seen == []


def test_quantised_refuses_what_the_proof_would_refuse():
    """So no honest robot is named: whatever may be added lies in the proved interval."""
    terms, rng = Terms(Product(), 8, min_norm=0.5), np.random.default_rng(3)
    for _ in range(300):
        vector = rng.normal(size=8)
        vector *= rng.choice([0.5, 1.0, 0.49999, 1.00001, rng.uniform(0.4, 1.1)]) / np.linalg.norm(vector)
        try:
            raw = quantised(terms, vector[None])
        except ValueError:
            continue
        assert terms.squares[0][0] <= (raw.astype(object) ** 2).sum() <= terms.squares[0][1]
