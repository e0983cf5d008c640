"""An insider in a gallery lies in everything that it sends: caught before a bit of that cell is shown."""

import numpy as np
import pytest
from gallery_insider import (
    Lies,
    at_bit,
    at_element,
    duel,
    instead,
    random_element,
    vectors,
)
from gallery_session_helpers import Near, Product
from insider_frames import elements, frame_of

from spdz.arithmetic.field import P
from spdz.foundations.errors import SpdzError
from spdz.readings.gallery import Terms
from spdz.values.input_mask import element_bytes

pytestmark = pytest.mark.usefixtures("no_sync")

TERMS = Terms(Product(), 4)
SLOTS = (3, 4)
ACCOUNT, OFFER, WORDS, BEGIN, PROOF, PROOF_CHECK, PROOF_BITS, BITS_CHECK, CELL, CELL_CHECK, BITS, LAST = (
    range(1, 13)
)
"""The exchanges of one step; the greeting is 0."""


def run(galleries, evil, lies, terms=TERMS, **options):
    return duel(galleries(terms, SLOTS), vectors(), evil, lies, **options)


def assert_right(found, terms=TERMS):
    """The honest side saw the clear results."""
    data = vectors()
    honest = 1 - found.evil
    with_margin = np.abs(data[honest] @ data[found.evil].T - terms.program.threshold) > 2e-4
    (block,) = found.seen
    truth = data[honest] @ data[found.evil].T >= terms.program.threshold
    assert (block.results == truth)[with_margin].all()


@pytest.mark.parametrize("evil", [0, 1])
def test_without_a_lie_the_results_are_right(galleries, evil):
    found = run(galleries, evil, Lies())
    assert not found.caught, found.outcome
    assert [frame[0] for frame in found.frames] == (
        ["CONTROL"] * 3 + ["DATA", "CONTROL"] + ["DATA", "CHECK"] * 4
    )
    assert_right(found)


@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("exchange", [PROOF, CELL])
def test_a_lie_in_any_element_is_caught_by_the_next_check(galleries, evil, exchange):
    size = {PROOF: 7, CELL: 12}[exchange]
    changes = [lambda o, t: o + 1, lambda o, t: o - 1, lambda o, t: o + random_element(), lambda o, t: -t]
    for index in range(size):
        for follow in (True, False):
            change = changes[(index + follow) % len(changes)]
            found = run(galleries, evil, Lies(at_element(exchange, index, change), follow=follow))
            assert found.error == "MacCheckFailed", (index, follow, found.outcome)
            assert (len(found.frames), found.seen) == (exchange + 2, [])
            assert found.destroyed


PAIRS = {
    "cancelling in a row": lambda own, theirs, e: [own[0] + e, own[1] - e, *own[2:]],
    "cancelling in a column": lambda own, theirs, e: [own[0] + e, *own[1:-3], own[-3] - e, *own[-2:]],
    "cancelling in a rectangle": lambda own, theirs, e: [
        own[0] + e, own[1] - e, *own[2:-3], own[-3] - e, own[-2] + e, own[-1]
    ],
    "everything moved": lambda own, theirs, e: [one + e for one in own],
    "the honest shares": lambda own, theirs, e: theirs,
    "no shares": lambda own, theirs, e: [0 for _ in own],
    "in another order": lambda own, theirs, e: own[1:] + own[:1],
}  # fmt: skip


@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("how", PAIRS)
def test_lies_in_a_whole_cell_are_caught(galleries, evil, how):
    for e in (1, random_element()):
        change = instead(
            CELL,
            lambda own, theirs, e=e: frame_of(
                [n % P for n in PAIRS[how](elements(own), elements(theirs), e)]
            ),
        )
        found = run(galleries, evil, Lies(change))
        assert (found.error, len(found.frames), found.seen) == ("MacCheckFailed", CELL_CHECK + 1, [])


@pytest.mark.parametrize("evil", [0, 1])
def test_a_lie_in_one_strip_is_not_taken_back_in_the_next(galleries, evil):
    """What was shown of the strips before it stays; nothing of the strip with the lie is shown."""
    cuts = ((2, 1), (2, 2))
    honest = run(galleries, evil, Lies(), cuts=cuts)
    cells = [
        i for i, frame in enumerate(honest.frames) if frame[0] == "DATA" and len(frame[1]) in (32, 64, 96)
    ]
    first, second = cells[-2:]
    e = random_element()

    def frame(number, own, theirs):
        change = {first: e, second: -e}.get(number)
        if change is None:
            return own
        numbers = elements(own)
        return frame_of([(numbers[0] + change) % P, *numbers[1:]])

    found = run(galleries, evil, Lies(frame), cuts=cuts)
    assert (found.error, len(found.frames), len(found.seen)) == ("MacCheckFailed", first + 2, 1)
    assert found.destroyed


@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("exchange", [PROOF_BITS, BITS])
def test_every_wrong_bit_is_caught(galleries, evil, exchange):
    for bit in range(16):
        found = run(galleries, evil, Lies(at_bit(exchange, bit), follow=bit % 2 == 0))
        if exchange == PROOF_BITS:
            # A byte for the slots of either party.
            inside = bit % 8 < SLOTS[bit // 8]
        else:
            inside = bit < SLOTS[0] * SLOTS[1]
        assert found.error == ("MacCheckFailed" if inside else "ProtocolViolation"), (bit, found.outcome)
        assert (len(found.frames), found.seen) == (exchange + (2 if inside else 1), [])
        assert not inside or found.destroyed


FORGERIES = {
    "random": lambda own, theirs: bytes(range(16)),
    "zeros": lambda own, theirs: bytes(16),
    "the honest hash": lambda own, theirs: theirs,
    "its own, a bit changed": lambda own, theirs: bytes([own[0] ^ 1]) + own[1:],
}


@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("how", FORGERIES)
def test_a_forged_check_message_is_refused(galleries, evil, how):
    for exchange in (PROOF_CHECK, BITS_CHECK, CELL_CHECK, LAST):
        found = run(galleries, evil, Lies(instead(exchange, FORGERIES[how])))
        assert (found.error, len(found.frames), found.seen) == ("MacCheckFailed", exchange + 1, [])
        assert found.destroyed


@pytest.mark.parametrize("evil", [0, 1])
def test_frames_of_other_lengths_are_refused(galleries, evil):
    for exchange in (WORDS, PROOF, PROOF_CHECK, PROOF_BITS, CELL, BITS, LAST):
        for change in (
            lambda own, theirs: own[:-1],
            lambda own, theirs: own + b"\0",
            lambda own, theirs: b"",
        ):
            found = run(galleries, evil, Lies(instead(exchange, change)), timeout=1.0)
            assert (found.error, found.seen) == ("ProtocolViolation", []), (exchange, found.outcome)


@pytest.mark.parametrize("evil", [0, 1])
def test_words_outside_the_interval_are_refused_and_not_kept(galleries, evil):
    size, bits, norm = element_bytes(TERMS.word_bits), TERMS.word_bits, TERMS.norm
    for word in (0, norm - 1, (1 << bits) - norm, (1 << bits) - 1, (1 << 8 * size) - 1):
        for at in (0, 4 * SLOTS[evil] - 1):
            said = word.to_bytes(size, "little")
            change = instead(
                WORDS, lambda own, theirs, at=at, said=said: own[: at * size] + said + own[(at + 1) * size :]
            )
            found = run(galleries, evil, Lies(change))
            assert (found.error, len(found.frames), found.seen) == ("ProtocolViolation", BEGIN, [])
            tape = found.mission.tape(1 - evil)
            with tape, found.mission.ledger(1 - evil, tape) as ledger:
                assert ledger.slots[evil].filled == 0
    for word in (norm, (1 << bits) - norm - 1):
        said = word.to_bytes(size, "little")
        found = run(galleries, evil, Lies(instead(WORDS, lambda own, theirs, said=said: said + own[size:])))
        assert "heads" in str(found.outcome)  # legal words, but other ones than it says it sent


@pytest.mark.parametrize("evil", [0, 1])
def test_other_words_with_a_fitting_head_fail_the_first_check(galleries, evil):
    """It tells the head of what it sent and computes with what it did not send."""
    sent = {}

    def frame(number, own, theirs):
        if number == WORDS:
            own = sent["words"] = bytes([own[0] ^ 1]) + own[1:]
        return own

    def control(number, message):
        if number == BEGIN:
            from spdz.gallery.heads import digest_of, extended, first_head

            size = len(sent["words"]) // SLOTS[evil]
            slots = [sent["words"][i * size : (i + 1) * size] for i in range(SLOTS[evil])]
            heads = list(message["heads"])
            head = extended([first_head(tape["name"], evil)], [digest_of(slot) for slot in slots])[-1]
            heads[evil] = head.hex()
            message["heads"] = heads
        return message

    mission = galleries(TERMS, SLOTS)
    opened = mission.tape(evil)
    tape = {"name": opened.header.tape}
    opened.close()
    found = duel(mission, vectors(), evil, Lies(frame, control))
    assert (found.error, len(found.frames), found.seen) == ("MacCheckFailed", PROOF_CHECK + 1, [])


JUNK = [None, -1, 1 << 70, 10**300, "x", "", [], {}, [1], True, False, 1.5, [[]], [[0], [0]], {"0": 1}]
JUNK += [[-1, -1], [1, 2], [[1], []], [2, 3, 4, 5], [0, 1, 0, 1], [0, 3, 0, 4], [3, 4], [5, 5], [1 << 40, 0]]
JUNK += ["é\x1b[2J", list(range(50))]


@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("exchange", [ACCOUNT, OFFER, BEGIN])
def test_lies_in_control_messages_end_in_an_error_or_in_the_truth(galleries, evil, exchange):
    names = []
    run(
        galleries,
        evil,
        Lies(control=lambda number, message: names.extend(message if number == exchange else ()) or message),
    )
    assert names
    for name in names:
        for junk in JUNK[(len(name) + evil) % 2 :: 2]:

            def control(number, message, name=name, junk=junk):
                if number == exchange:
                    message[name] = junk
                return message

            found = run(galleries, evil, Lies(control=control), timeout=1.0)
            assert found.caught or isinstance(found.outcome, list), (name, junk, found.outcome)
            for block in found.seen:
                rows = vectors()[1 - evil][block.own.start : block.own.stop]
                columns = vectors()[evil][block.peer.start : block.peer.stop]
                truth = rows @ columns.T
                assert (block.results == (truth >= 0.5))[np.abs(truth - 0.5) > 2e-4].all()
            assert found.error != "MacCheckFailed", (name, junk)


@pytest.mark.parametrize("evil", [0, 1])
@pytest.mark.parametrize("exchange", [0, ACCOUNT, OFFER, BEGIN])
def test_control_messages_that_are_none_end_in_an_error(galleries, evil, exchange):
    said = [
        b"",
        b"{",
        b"[]",
        b"1",
        b"null",
        b"\xff",
        b'{"a":NaN}',
        b"[" * 50000,
        b'{"text":' + b"9" * 5000 + b"}",
    ]
    for message in said:
        found = run(
            galleries, evil, Lies(raw=instead(exchange, lambda own, theirs, m=message: m)), timeout=1.0
        )
        assert isinstance(found.outcome, SpdzError), (message[:20], found.outcome)
        assert found.error != "MacCheckFailed" and found.seen == []


@pytest.mark.parametrize("evil", [0, 1])
def test_who_always_has_more_to_bring_and_brings_nothing_is_refused(galleries, evil):
    more = Lies(control=lambda number, message: message | ({"more": True} if "more" in message else {}))
    cuts = ((3, 0, 0), (4,)) if evil == 0 else ((3,), (4, 0, 0))
    found = run(galleries, evil, more, cuts=cuts)
    assert found.error == "ProtocolViolation"
    assert len(found.frames) == LAST + 2


@pytest.mark.parametrize("evil", [0, 1])
def test_slots_that_do_not_follow_are_refused_before_their_words_are_taken(galleries, evil):
    lies = Lies(control=lambda number, message: message | ({"from": 1} if number == OFFER else {}))
    found = run(galleries, evil, lies, timeout=1.0)
    assert (found.error, len(found.frames)) == ("OutOfStep", WORDS)


@pytest.mark.parametrize("evil", [0, 1])
def test_more_slots_than_the_gallery_has_are_refused_before_their_words_are_taken(galleries, evil):
    for slots in (SLOTS[evil] + 1, 4096):
        lies = Lies(
            control=lambda number, message, n=slots: message | ({"slots": n} if number == OFFER else {})
        )
        found = run(galleries, evil, lies, timeout=1.0)
        assert (found.error, len(found.frames)) == ("ProtocolViolation", WORDS)
        assert "offer of slots" in str(found.outcome)


@pytest.mark.parametrize("evil", [0, 1])
def test_prepared_values_are_under_the_check_too(galleries, evil):
    terms = Terms(Near(), 4)
    for index in range(12):
        found = run(galleries, evil, Lies(at_element(CELL, index, lambda o, t: o + 1)), terms)
        assert (found.error, found.seen) == ("MacCheckFailed", [])
