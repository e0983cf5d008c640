"""Masks of opened numbers are uniform on the whole field; a number that may have wrapped is given up.

By the rule that happens once in 2^(127-b) times. So tests make the dealer's generator give a mask that does.
"""

from contextlib import contextmanager
from unittest.mock import patch

import numpy as np
import pytest
from gallery_session_helpers import Product, feed, no_errors, table, unit_vectors
from link_helpers import Link, all_batches, check_all, mission, robots
from session_helpers import deal, run_pair, state_dirs

from dealer import recipe
from protocols import batching
from spdz import ChannelError, Wrapped, dot, nonnegative, run_local, truncate
from spdz.arithmetic import field
from spdz.arithmetic.field import P
from spdz.gallery.ledger import Ledger
from spdz.gates.masking import dealt_integer_mask, integer_mask
from spdz.readings.gallery import Terms
from spdz.tape import Tape
from spdz.values.party_ring import PartyRing

SECURITIES = ["malicious", "semi-honest"]

WRAPS = P - (1 << 33)
"""A mask behind which every |z| < 2^33 is opened as a number below 2^34; values here have 34 bits or more."""


@contextmanager
def wrapping(*which, mask=WRAPS):
    """The first entry of these masks, counted from 0 as they are dealt, wraps."""
    drawn, count = recipe.uniform_below, [0]

    def patched(limit, shape):
        masks = drawn(limit, shape)
        assert limit == P, "a mask is uniform on the whole field"
        if count[0] in which:
            masks.reshape(-1, 2)[0] = field.from_int(mask)
        count[0] += 1
        return masks

    with patch.object(recipe, "uniform_below", patched):
        yield count


# -- why that is right ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("prime", "bits"), [(127, 2), (127, 4), (31, 3), (61, 5)])
def test_what_is_not_given_up_is_uniform_independent_of_the_value_and_right(prime, bits):
    """Every mask and every value of a small field: the argument of the specification, by exhaustion."""
    half = 1 << (bits - 1)
    for z in range(prime):  # also those that only a cheating peer can cause
        opened = [(z + half + rho) % prime for rho in range(prime)]
        kept = sorted(c for c in opened if c >= 1 << bits)
        assert kept == list(range(1 << bits, prime))  # each once, whatever z is: so is the rate of the others
    for z in range(-half + 1, half):  # a value in range
        for rho in range(prime):
            c = (z + half + rho) % prime
            assert c == z + half + rho or c < 1 << bits


@pytest.mark.parametrize("bits", [2, 35, 63, 64, 65, 86])
def test_a_number_is_given_up_below_a_power_of_two_exactly(bits):
    for number in ((1 << bits) - 1, 0, (1 << bits) // 3, 1 << (bits - 1)):
        for place in (0, 3):
            numbers = [P - 1, 1 << bits, 1 << 126, 1 << bits]
            PartyRing().refuse_wrapped(field.from_ints(numbers), bits, 127)
            numbers[place] = number
            with pytest.raises(Wrapped, match=f"once in 2.{127 - bits} times: nothing was output"):
                PartyRing().refuse_wrapped(field.from_ints(numbers), bits, 127)


@pytest.mark.parametrize("bits", [35, 64, 86])
def test_the_dealer_refuses_masks_that_cancel_and_none_that_chance_may_bring(bits):
    """One wrapping entry of several is dealt: to refuse it would make the others' masks less than uniform."""
    half = 1 << (bits - 1)
    good, wraps = (-(P // 3) - half) % P, (1 - half) % P  # rho is a third of p, or p - 1
    for masks in ([good], [good] * 3, [good, wraps, good]):
        r = field.from_ints(masks)
        assert np.array_equal(dealt_integer_mask(r, bits), integer_mask(r, bits))
    for masks in ([wraps], [good, wraps, wraps], [0], [good, 0, good]):
        with pytest.raises(ValueError, match="fresh=True"):
            dealt_integer_mask(field.from_ints(masks), bits)


# -- jobs -------------------------------------------------------------------------------------------------


async def compared(engine, x, y):
    return await nonnegative(dot(x[:, None], y[None]))


async def truncated(engine, x, y):
    (z,) = await truncate(dot(x[:, None], y[None]), frac=16)
    return z


compared.max_norm = truncated.max_norm = 1.0
DATA = np.array([[0.5, -0.25], [0.25, 0.75]]), np.array([[1.0, 0.0], [-0.5, 0.5]])
PROGRAMS = {"compared": compared, "truncated": truncated}

any_program = pytest.mark.parametrize("name", PROGRAMS)
any_security = pytest.mark.parametrize("security", SECURITIES)


@any_program
@any_security
def test_nothing_is_output_and_the_next_job_is_right(tmp_path, name, security):
    program, states = PROGRAMS[name], state_dirs(tmp_path)
    with wrapping(0) as count:
        paths = deal(tmp_path / "mission", program, (DATA[0].shape, DATA[1].shape), 3, security)
    assert count[0] == 3

    def work(session):
        return session.run(program, DATA[session.party]).value

    for outcome in run_pair(paths, states, work):
        assert type(outcome) is Wrapped and isinstance(outcome, ChannelError) and outcome.passing
    clear = DATA[0] @ DATA[1].T
    for result in run_pair(paths, states, work):
        assert np.allclose(result, clear >= 0 if name == "compared" else clear, atol=2.0**-15)
    with Tape.open(paths[0], state_dir=states[0]) as tape:
        assert tape.remaining == 1


@any_program
@any_security
def test_a_run_in_one_process_stops_as_well(name, security):
    with wrapping(0), pytest.raises(Wrapped):
        run_local(PROGRAMS[name], *DATA, security)


async def cut_twice(engine, x, y):
    (z,) = await truncate(dot(x[:, None], y[None]), frac=24)
    (z,) = await truncate(z.plus_raw(1 << 26), frac=16)
    return z


cut_twice.max_norm = 1.0


@any_security
def test_a_mask_that_wraps_only_after_a_cut_is_noticed_then(security):
    """rho = 2^33 opens no small number of a value of 34 bits; rho / 2^8 does, of one of 28 bits."""
    with wrapping(0, mask=P - (1 << 34)), pytest.raises(Wrapped, match=r"once in 2.91 times"):
        run_local(cut_twice, *DATA, security)
    assert np.allclose(run_local(cut_twice, *DATA, security).value, DATA[0] @ DATA[1].T + 4, atol=2.0**-15)


@any_security
def test_a_matcher_goes_on_with_the_next_jobs(tmp_path, security, monkeypatch):
    monkeypatch.setattr("spdz.tape.durable.os.fsync", lambda descriptor: None)
    bad = {0, 2, 3}
    with wrapping(*bad):
        paths, events, link = mission(tmp_path / "m", 400, security=security), [], Link()
    with patch.object(batching, "MOST_JOBS", 1):
        check_all(robots(tmp_path, paths, link, all_batches, on_event=events.append))
    assert len(link.ends) == 1 + len(bad)
    assert sum("may have wrapped" in event for event in events) >= len(bad)


# -- galleries --------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("no_sync")
@pytest.mark.parametrize("resolution", [16, None])
@any_security
def test_a_gallery_gives_up_the_strip_on_both_sides_and_goes_on(galleries, monkeypatch, security, resolution):
    monkeypatch.setattr("spdz.session.comparing.STRIP_PAIRS", 6)
    terms, rng = Terms(Product(0.1), 4, security, resolution), np.random.default_rng(5)
    x, y = unit_vectors(rng, 7, 4), unit_vectors(rng, 3, 4)
    proofs = 2 if security == "malicious" else 0  # their masks are dealt before those of the first pairs
    with wrapping(proofs):  # the pair of the first two slots
        mission = galleries(terms, (20, 20))
    seen = []
    for outcome in mission.meet(feed([x[:6]], seen), feed([y], seen)):
        assert type(outcome) is Wrapped and outcome.passing
    assert seen == []
    for party in (0, 1):
        with mission.tape(party) as tape, mission.ledger(party, tape) as ledger:
            assert ledger.done == (2, 3) and ledger.flight is None
    assert len(no_errors(mission.meet(feed([x[6:]]), feed([y[:1]])))) == 2
    left, right = no_errors(mission.meet(lambda session: table(session, session.results())))
    assert np.array_equal(left, right.T)
    known, clear = left[:7, :4], x @ np.concatenate([y, y[:1]]).T >= 0.1
    burnt = np.zeros((7, 4), dtype=bool)
    burnt[:2, :3] = True
    assert np.array_equal(known[~burnt], clear[~burnt])
    assert not (known[burnt] == 1).any()


@pytest.mark.usefixtures("no_sync")
def test_a_side_that_stops_before_it_has_given_up_the_strip_does_so_later(galleries, monkeypatch):
    class Stop(BaseException):
        pass

    def stop(ledger, strip):
        raise Stop

    terms, rng = Terms(Product(0.1), 4, "semi-honest"), np.random.default_rng(6)
    x, y = unit_vectors(rng, 3, 4), unit_vectors(rng, 3, 4)
    with wrapping(0):
        mission = galleries(terms, (21, 20))
    burn = Ledger.burn
    monkeypatch.setattr(
        Ledger, "burn", lambda self, strip: (burn, stop)[self._journal.mark.party](self, strip)
    )
    first, second = mission.meet(feed([x[:2]]), feed([y[:2]]))
    assert (type(first), type(second)) == (Wrapped, Stop)
    monkeypatch.setattr(Ledger, "burn", burn)
    assert [type(outcome) for outcome in mission.meet(lambda session: session.step())] == [Wrapped, Wrapped]
    no_errors(mission.meet(feed([x[2:]]), feed([y[2:]])))
    left, right = no_errors(mission.meet(lambda session: table(session, session.results())))
    assert np.array_equal(left, right.T)
    assert np.array_equal(left[:3, :3] != -1, [[False, False, True]] * 2 + [[True] * 3])
    assert np.array_equal((left == 1)[:3, :3] & (left != -1)[:3, :3], (x @ y.T >= 0.1) & (left != -1)[:3, :3])
