"""The MAC check by itself: what passes, and every cheap way of passing that must not."""

import numpy as np
import pytest

from spdz import MacCheckFailed
from spdz.arithmetic import field
from spdz.arithmetic.bound import NOTHING
from spdz.arithmetic.field import P
from spdz.foundations.stats import Stats
from spdz.readings.party import Party
from spdz.rounds.coroutine import exchange
from spdz.rounds.mac_check import DIGEST_BYTES, MacCheck, drive
from spdz.values.value import Value

ALPHA = (1234567, P - 99)
SESSION = b"session"


def pair(session=SESSION):
    return MacCheck(ALPHA[0], 0, session), MacCheck(ALPHA[1], 1, session)


def open_value(checks, value, error=0):
    """Both parties record ``value + error``, with MAC shares of ``value``."""
    share = 42 + value
    macs = (share, (sum(ALPHA) * value - share) % P)
    for check, mac in zip(checks, macs, strict=True):
        check.record(field.from_ints([value + error]), field.from_ints([mac]))


def test_what_is_heard_after_a_message_is_in_the_next_hash():
    checks, late = pair(), pair()
    for one in (*checks, *late):
        one.absorb([b"first"], b"first")
    for one in checks:
        one.message()  # which begins the hash of what is expected, too
    for one in (*checks, *late):
        one.absorb([b"second"], b"second")
    assert [one.expected() for one in checks] == [one.expected() for one in late]


def test_honest_parties_pass_again_and_again():
    checks = pair()
    for value in (0, 1, P - 1, 2**80):
        open_value(checks, value)
        assert all(check.pending for check in checks)
        messages = [check.message() for check in checks]
        checks[0].verify(messages[1])
        checks[1].verify(messages[0])
        assert not any(check.pending for check in checks)


@pytest.mark.parametrize("error", [1, -1, 2**64, P // 2])
def test_a_wrong_opening_fails_on_both_sides(error):
    checks = pair()
    open_value(checks, 7)
    open_value(checks, 8, error)
    messages = [check.message() for check in checks]
    for check, message in zip(checks, messages[::-1], strict=True):
        with pytest.raises(MacCheckFailed):
            check.verify(message)


def test_every_element_of_an_array_counts():
    for wrong in range(6):
        checks = pair()
        values = [7, 0, P - 1, 2**80, 5, 1]
        opened = [value + (place == wrong) for place, value in enumerate(values)]
        for check, macs in zip(checks, ([0] * 6, [sum(ALPHA) * value for value in values]), strict=True):
            check.record(*(field.from_ints(part).reshape(2, 3, 2) for part in (opened, macs)))
        with pytest.raises(MacCheckFailed):
            checks[0].verify(checks[1].message())


def test_every_bit_of_a_sigma_counts():
    """An error of ``2^bit / alpha`` changes sigma by 2^bit."""
    for bit in range(127):
        checks = pair()
        open_value(checks, 7, (field.inverse(sum(ALPHA)) << bit) % P)
        with pytest.raises(MacCheckFailed):
            checks[0].verify(checks[1].message())


def test_every_bit_of_the_hash_counts():
    for bit in range(8 * DIGEST_BYTES):
        checks = pair()
        open_value(checks, 7)
        message = int.from_bytes(checks[1].message(), "little") ^ 1 << bit
        with pytest.raises(MacCheckFailed):
            checks[0].verify(message.to_bytes(DIGEST_BYTES, "little"))


@pytest.mark.parametrize("error", [0, 5])
def test_an_echo_never_passes(error):
    for check in pair():
        check.record(field.from_ints([3 + error]), field.from_ints([17]))
        with pytest.raises(MacCheckFailed):
            check.verify(check.message())


@pytest.mark.parametrize("message", [b"", bytes(32), bytes(31), b"\xff" * 33])
def test_anything_else_fails(message):
    for check in pair():
        with pytest.raises(MacCheckFailed):
            check.verify(message)


def test_a_message_of_an_earlier_check_fails():
    checks = pair()
    old = checks[1].message()
    checks[0].verify(old)
    with pytest.raises(MacCheckFailed):
        checks[0].verify(old)


def test_a_message_of_another_session_fails():
    with pytest.raises(MacCheckFailed):
        pair()[0].verify(pair(b"another")[1].message())


@pytest.mark.parametrize(("sent", "got"), [(b"c", b"xb"), (b"x", b"ab"), (b"ab", b"c")])
def test_another_transcript_fails(sent, got):
    """Whichever party's message differs, or if they are mixed up."""
    checks = pair()
    checks[0].absorb([b"ab"], b"c")
    checks[1].absorb([sent], got)
    with pytest.raises(MacCheckFailed):
        checks[0].verify(checks[1].message())


def test_the_same_transcript_in_other_pieces_passes():
    checks = pair()
    checks[0].absorb([b"a", b"b"], b"c")
    checks[1].absorb([b"c"], b"ab")
    checks[0].verify(checks[1].message())


def test_nothing_passes_after_a_failure():
    checks = pair()
    with pytest.raises(MacCheckFailed):
        checks[0].verify(b"wrong")
    with pytest.raises(MacCheckFailed):
        checks[0].verify(checks[1].message())


def test_a_protocol_may_not_end_with_unchecked_openings():
    checks = pair()

    async def forgetful():
        await exchange([b"x"], 1, 1)
        open_value(checks, 5)
        return "output"

    frames = drive(forgetful(), checks[0])
    next(frames)
    with pytest.raises(MacCheckFailed, match="unchecked"):
        frames.send(memoryview(b"y"))


def test_the_message_depends_on_all_openings_in_order_and_on_how_they_were_grouped():
    def message(*arrays):
        check, _ = pair()
        for array in arrays:
            check.record(field.from_ints(array), field.from_ints([3 * one + 1 for one in array]))
        return check.message()

    assert message([1, 2], [5]) != message([1], [2, 5])
    assert len({message([1, 2]), message([2, 1]), message([1]), message([2]), message([1, 2, 2])}) == 5


def blocks(*rows):
    return np.array(rows, dtype=np.uint64).reshape(-1, 2)


def test_bits_pass_if_their_sigmas_are_the_same_and_fail_for_any_bit_of_them():
    sigma = blocks([1, 2], [3, 4], [5, 6])
    for place in range(sigma.size):
        for bit in (0, 1, 31, 63):
            checks, other = pair(), sigma.copy()
            other.flat[place] ^= np.uint64(1 << bit)
            checks[0].record_bits(sigma)
            checks[1].record_bits(other)
            with pytest.raises(MacCheckFailed):
                checks[0].verify(checks[1].message())
    for check in (checks := pair()):
        check.record_bits(sigma.copy())
        assert check.pending
    checks[0].verify(checks[1].message())
    assert not checks[0].pending


def message_of(*openings):
    """Of party 0: arrays of bits as blocks, elements as the MAC shares of zeros."""
    check, _ = pair()
    for kind, same in openings:
        if kind == "bits":
            check.record_bits(same)
        else:
            check.record(np.zeros_like(same), same)
    return check.message()


def test_bits_never_pass_for_elements():
    """Although what is the same at both parties is, byte by byte, the same."""
    same = blocks([1, 2], [3, 4])
    assert message_of(("bits", same)) != message_of(("elements", same))
    both = message_of(("bits", same), ("elements", same)), message_of(("elements", same), ("bits", same))
    assert both[0] != both[1]


def test_one_array_of_bits_never_passes_for_several():
    """Not even where a sigma spells what begins an array."""
    a, spelled = blocks([7, 8]), np.frombuffer(b"bits" * 4, dtype="<u8").reshape(1, 2)
    together = message_of(("bits", np.concatenate([a, spelled])))
    assert together != message_of(("bits", a), ("bits", spelled))
    assert together != message_of(("bits", a), *[("bits", a[:0])] * 4)


def test_what_is_recorded_after_a_message_is_in_the_next_one():
    check, other = pair()
    seen = [check.message()]
    steps = [
        lambda one: one.record_bits(blocks([1, 2])),
        lambda one: one.record(field.from_ints([0]), field.zeros((1,))),
        lambda one: one.record_bits(blocks([0, 0])),
        lambda one: one.absorb([b"a"], b"a"),
    ]
    for step in steps:
        for one in (check, other):
            step(one)
        seen.append(check.message())
    check.verify(other.message())
    seen.append(check.message())
    check.record_bits(blocks([1, 2]))
    seen.append(check.message())
    assert len(set(seen)) == len(seen)


def test_a_malicious_party_opens_nothing_without_a_check():
    """Nothing would ever look at it; a party is made without one before the two sides have agreed."""
    value = Value(None, (field.from_ints([1]), field.from_ints([2])), (1,), 0, NOTHING)
    bits = np.ones((3, 2), dtype=np.uint64)
    for security, refused in (("malicious", True), ("semi-honest", False)):
        party = Party(0, security, None, None, ALPHA[0], Stats())
        for opening in (party.open(value), party.open_bits(bits, bits[0], 3)):
            if refused:
                with pytest.raises(MacCheckFailed, match="without a check"):
                    opening.send(None)
            else:
                assert opening.send(None).payload
                opening.close()
