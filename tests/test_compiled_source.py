"""The text that is compiled: nothing secret in it, nothing left out of it, and the same for every tape."""

import re
from unittest.mock import patch

import numpy as np
import pytest
from compiled_helpers import SECURITIES, deal, unit_vectors

from protocols import is_candidate
from protocols.scores import S2, S4, S8, S10
from spdz import dot, maximum
from spdz.arithmetic.field import to_list
from spdz.compiled.record import TracedCheck, compiled
from spdz.compiled.ring import TracedRing
from spdz.compiled.slots import NotCompiled, Slot
from spdz.compiled.trace import Trace
from spdz.rounds.wire import ELEMENT_BYTES
from spdz.session.session import _Reserved

PROGRAMS = {
    "S2": S2.within(1.0),
    "S4": S4.within(1.0),
    "S8": S8.within(1.0),
    "S10": S10.within(1.0),
    "decided": is_candidate(S10.within(1.0), 0.5),
}

any_program = pytest.mark.parametrize("name", PROGRAMS)


@any_program
@pytest.mark.parametrize("n", [6, 70])
def test_the_text_is_the_same_whatever_the_tape_and_the_data(name, n):
    for security in SECURITIES:
        jobs = [deal(PROGRAMS[name], unit_vectors(n, seed=seed), security) for seed in (1, 2)]
        for index in (0, 1):
            first, second = (job.code(index) for job in jobs)
            assert first.code.source == second.code.source
            assert first.sizes == second.sizes and first.correlations == second.correlations


def secrets_of(job, index):
    """Everything that the party's tape, its key share and its input hold, as integers."""
    pad, stored = job.stream(index).elements
    words = {word for array in (pad, stored) for word in array.ravel().tolist()}
    elements = {*to_list(pad), *to_list(stored)}
    alpha = set() if job.mac is None else {job.mac.shares[index], sum(job.mac.shares)}
    return {one for one in words | elements | alpha if one > 1 << 32}


def numbers_in(space):
    """All integers of what the code can name, arrays among it."""
    for one in space.values():
        if isinstance(one, np.ndarray) and one.dtype == np.uint64:
            yield from one.ravel().tolist()
            yield from to_list(one)
        elif isinstance(one, int):
            yield one


@any_program
@pytest.mark.parametrize("n", [6, 70])
def test_no_number_of_a_tape_is_in_the_text_or_in_what_it_names(name, n):
    for security in SECURITIES:
        job = deal(PROGRAMS[name], unit_vectors(n), security)
        for index in (0, 1):
            code, secret = job.code(index).code, secrets_of(job, index)
            assert len(secret) > 20
            assert secret.isdisjoint(map(int, re.findall(r"\d+", code.source)))
            assert secret.isdisjoint(numbers_in(code.online.__globals__))


def test_nothing_secret_is_in_a_repr():
    job = deal(PROGRAMS["S4"], unit_vectors(5), "malicious")
    code = job.codes[0]
    early = code.ahead(job.stream(0), job.mac.shares[0])
    reserved = _Reserved(7, job.stream(0), code, early)
    shown = set(map(int, re.findall(r"\d+", f"{reserved!r} {code!r} {code.code!r}")))
    assert code.code.source.splitlines()[0] not in repr(reserved)
    assert early and secrets_of(job, 0).isdisjoint(shown)
    assert "early" not in repr(reserved)
    assert repr(Slot("v1", "one", (), early=True)).startswith("Slot(name='v1'")


def test_the_tapes_part_is_ahead_of_the_input():
    """What is early needs no reply: it is the same for every input, and the rest is not in it."""
    job = deal(PROGRAMS["S4"], unit_vectors(5), "malicious")
    ahead, online = job.codes[0].code.source.split("def online")
    assert "data" not in ahead and "yield" not in ahead and "mac_check" not in ahead
    assert "pad" not in online.replace("packed", "") and "stored" not in online and "stream" not in online


def test_every_draw_of_a_key_is_at_its_place():
    job = deal(PROGRAMS["S2"], unit_vectors(5), "malicious")
    (place,) = re.findall(r"stream\.at\((\d+), (\d+)\)", job.codes[0].code.source)
    assert all(0 < int(one) < size for one, size in zip(place, job.codes[0].sizes, strict=True))
    assert int(place[1]) % ELEMENT_BYTES == 0


async def _unused(engine, x, y):
    """The larger of the two is opened to nobody; what is sent for it is sent all the same."""
    await maximum(dot(x, y), dot(x, x))
    return x.sum()


def test_what_no_effect_needs_is_left_out():
    for security in SECURITIES:
        job = deal(_unused, unit_vectors(5), security)
        whole = deal(lambda engine, x, y: maximum(dot(x, y), dot(x, x)), unit_vectors(5), security)
        for index in (0, 1):
            assert "keys" not in job.code(index).code.source
            assert "keys" in whole.code(index).code.source
            assert job.read(index).frames == job.read(index, job.code(index)).frames


def test_one_computation_is_written_down_once():
    trace = Trace()
    a = trace.note("data", form="few", shape=(3,), kind="effect")
    first, second = (trace.note("[-v for v in {0}]", a, form="few", shape=(3,)) for _ in range(2))
    assert first is second and len(trace.operations) == 2
    assert trace.note("[-v for v in {0}]", a, form="few", shape=(3, 1)) is not first
    sent = [trace.note("yield {0}", a, form="other", kind="effect") for _ in range(2)]
    assert sent[0] is not sent[1]
    assert not a.early and not first.early


def test_bits_that_were_opened_wait_for_a_check():
    ring = TracedRing(Trace())
    check = TracedCheck(ring, Slot("alpha", "one", (), early=True), 0)
    assert not check.pending
    check.record_bits(ring.trace.note("bits", form="other", kind="effect"))
    assert check.pending and ring.trace.operations[-1].kind == "record"


def test_a_result_that_is_no_number_of_the_codes_is_not_compiled():
    job = deal(PROGRAMS["S10"], unit_vectors(5), "malicious")

    async def nothing(*_):
        return 5.0

    with patch("spdz.compiled.record.run", nothing), pytest.raises(NotCompiled, match="result"):
        compiled(PROGRAMS["S10"], job.plan, 0, "malicious")
