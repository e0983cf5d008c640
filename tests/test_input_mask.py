"""Short masks: the words hide perfectly, travel in few bytes, stay in their interval, or are not sent."""

from collections import Counter
from itertools import product
from math import prod

import numpy as np
import pytest

from protocols.scores import S10
from spdz import ProtocolViolation, dot, run_local
from spdz.arithmetic import field
from spdz.arithmetic.fixed_point import norm_bound
from spdz.foundations.errors import Unsent
from spdz.values import input_mask
from spdz.values.input_mask import JOB_REJECTION, LONG, element_bytes, hide, job_bits, pack, unpack, word_bits

SECURITIES = ["malicious", "semi-honest"]
SMALL = [(w, norm) for w in (2, 3, 5, 8) for norm in (1, 2, 3, 7, 15, 60, 127) if 2 * norm < 1 << w]
"""Words and bounds of which all combinations are tried: one coordinate is unsent in 2 norm / 2^w cases."""


def mask_of(s, bits):
    """The mask r = -s, made as a party makes it of its pad, whose other bits do not matter."""
    above = (1 << 64) - (1 << bits)
    return input_mask.from_pad(np.array([[one | above, 77] for one in s], dtype=np.uint64), bits)


def sent(x, s, bits, norm):
    """The words of one input under one mask; None where nothing is sent."""
    try:
        return tuple(hide(np.array(x, dtype=np.int64), mask_of(s, bits), bits, norm).tolist())
    except Unsent:
        return None


# -- hiding ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("bits", "norm"), SMALL)
def test_for_every_input_each_word_of_the_interval_is_sent_under_one_mask_and_no_other_word(bits, norm):
    """So the words are uniform, and they are unsent under equally many masks, whatever the input is."""
    interval = range(norm, (1 << bits) - norm)
    for x in range(-norm, norm + 1):
        words = Counter(sent([x], [s], bits, norm) for s in range(1 << bits))
        assert words.pop(None) == 2 * norm
        assert words == Counter((word,) for word in interval)


@pytest.mark.parametrize(("bits", "norm"), [(2, 1), (3, 1), (3, 2), (3, 3), (4, 5)])
def test_words_of_two_coordinates_are_uniform_together(bits, norm):
    interval, masks = range(norm, (1 << bits) - norm), range(1 << bits)
    for x in product(range(-norm, norm + 1), repeat=2):
        words = Counter(sent(x, s, bits, norm) for s in product(masks, repeat=2))
        assert words.pop(None) == len(masks) ** 2 - len(interval) ** 2
        assert words == Counter(product(interval, repeat=2))


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("sign", [1, -1])
def test_what_travels_is_uniform_for_the_largest_inputs_of_either_sign(security, sign):
    frames = []

    async def program(engine, x, y):
        return dot(x[0], y[0])

    def watch(number, sender, frame):
        if number == 0:
            frames.append(frame)
        return frame

    program.max_norm, rows = 1.0, np.full((500, 1), float(sign))
    run_local(program, rows, rows, security, tamper=watch)
    bits = job_bits(rows.shape, norm_bound(1.0, 1))
    assert (bits, {len(frame) for frame in frames}) == (56, {7 * 500})
    words = np.concatenate([unpack(frame, (500,), bits, norm_bound(1.0, 1)) for frame in frames])
    for classes in (words >> (bits - 3), words % 8):
        counts = np.bincount(classes, minlength=8)
        assert ((counts - 125) ** 2 / 125).sum() < 70  # by chance once in 10^12


# -- the interval and the bytes --------------------------------------------------------------------------


@pytest.mark.parametrize("bits", range(1, 64))
def test_words_of_every_length_are_masked_packed_and_read_back(bits):
    full = 1 << bits
    numbers = sorted({0, 1, full // 2, full - 1, full // 3, full - 1 & 0x0123456789ABCDEF})
    assert input_mask.field_offsets(mask_of(numbers, bits)).tolist() == numbers
    assert mask_of(numbers, bits).tolist() == field.neg(field.from_ints(numbers)).tolist()
    raw = pack(np.array(numbers), bits)
    size = -(-bits // 8)
    assert raw.tobytes() == b"".join(number.to_bytes(size, "little") for number in numbers)
    assert element_bytes(bits) == size
    assert unpack(raw.tobytes(), (len(numbers),), bits, 0).tolist() == numbers
    assert input_mask.span(bits) == full - 1
    cube = np.array(numbers * 4).reshape(2, 2, -1)
    assert np.array_equal(unpack(pack(cube, bits).tobytes(), cube.shape, bits, 0), cube)


def test_words_and_their_offsets_are_elements_and_back():
    edges = np.array([[0, 1, 2], [5, 2**52 - 1, 2**62], [2**63 - 2, 2**63 - 1, 3]])
    assert np.array_equal(input_mask.as_elements(edges), field.from_int64(edges))
    assert np.array_equal(input_mask.field_offsets(field.from_int64(-edges)), edges)


def test_long_masks_are_elements():
    pad = np.array([[5, 6], [7, 8]], dtype=np.uint64)
    assert input_mask.from_pad(pad, LONG) is pad
    assert (element_bytes(LONG), input_mask.span(LONG)) == (16, 0)
    x = np.array([-3, 1 << 40])
    assert np.array_equal(hide(x, pad, LONG, 1 << 40), field.sub(field.from_int64(x), pad))


@pytest.mark.parametrize(("bits", "norm"), [(18, 65538), (56, 65538), (57, 1), (63, 65538), (63, 1 << 32)])
def test_the_interval_has_the_same_ends_at_both_sides(bits, norm):
    lowest, highest = norm, (1 << bits) - norm - 1
    for word, inside in {
        lowest: True,
        highest: True,
        lowest - 1: False,
        highest + 1: False,
        0: False,
    }.items():
        for x in {norm, -norm, 0, 1, -1}:
            if 0 <= word - x < 1 << bits:
                assert (sent([x], [word - x], bits, norm) == (word,)) is inside
        for row in ([word, lowest, highest], [lowest, highest, word]):
            raw = pack(np.array(row), bits).tobytes()
            if inside:
                assert unpack(raw, (3,), bits, norm).tolist() == row
            else:
                assert sent([0, 0, 0], row, bits, norm) is None
                with pytest.raises(ProtocolViolation, match="outside the interval"):
                    unpack(raw, (3,), bits, norm)
    size = element_bytes(bits)
    for raw in (b"\xff" * size, (1 << 8 * size - 1).to_bytes(size, "little")):
        if int.from_bytes(raw, "little") > highest:
            with pytest.raises(ProtocolViolation, match="outside the interval"):
                unpack(raw, (1,), bits, norm)


# -- how long words are ----------------------------------------------------------------------------------


@pytest.mark.parametrize("rejection", [16, 30])
@pytest.mark.parametrize("shape", [(1,), (5,), (128,), (2, 3), (64, 1536)])
def test_words_are_as_short_as_the_chance_of_not_being_sent_allows(shape, rejection):
    for norm in (1, 2, 3, 65535, 65536, 65537, 1 << 20, (1 << 32) - 1, 1 << 32):
        unsent = 2 * prod(shape) * norm << rejection  # times 2^-rejection / 2^w
        bits = word_bits(shape, norm, rejection)
        assert bits == next((w for w in range(1, 64) if unsent <= 1 << w), LONG)


def test_the_longest_words_have_63_bits_and_what_has_no_norm_no_words():
    assert word_bits((1,), 1 << 32, 30) == word_bits((4,), 1 << 30, 30) == 63
    assert word_bits((1,), (1 << 32) + 1, 30) == word_bits((5,), 1 << 30, 30) == LONG
    assert word_bits((3,), 0, 30) == word_bits((0,), 5, 30) == word_bits((0, 3), 5, 30) == LONG


@pytest.mark.parametrize("shape", [(1,), (16,), (1536,), (8192,), (64, 1536)])
def test_a_jobs_words_take_whole_bytes(shape):
    for norm in (1, 65535, 65536 + 20, 1 << 22, 1 << 36):
        bits, least = job_bits(shape, norm), word_bits(shape, norm, JOB_REJECTION)
        assert (bits == LONG) == (least == LONG)
        if bits != LONG:
            assert bits in (8, 16, 24, 32, 40, 48, 56, 63) and least <= bits < least + 8


@pytest.mark.parametrize(
    ("dim", "max_norm", "size"),
    [(3, 1.0, 6), (128, 1.0, 7), (1536, 1.0, 7), (8192, 1.0, 7), (3, 2.0**22, 16)],
)
def test_both_security_modes_use_the_same_words(dim, max_norm, size):
    program, x = S10.within(max_norm), np.full(dim, 0.1 / dim)
    inputs = {name: [] for name in SECURITIES}
    for security, frames in inputs.items():
        run_local(program, x, x, security, tamper=lambda n, who, f: (frames.append(f), f)[1])  # noqa: B023
        assert [len(frame) for frame in frames[:2]] == [size * dim] * 2


@pytest.mark.parametrize("bits", [7, 8, 16, 23, 40, 44, 48, 55, 56, 63])
@pytest.mark.parametrize("shape", [(1,), (2,), (7,), (1000,), (8192,), (3, 70)])
def test_words_are_packed_one_after_the_other(shape, bits):
    words = np.random.default_rng(bits).integers(0, 1 << bits, shape, dtype=np.int64, endpoint=False)
    words.flat[0], words.flat[-1] = (1 << bits) - 1, 0
    size = element_bytes(bits)
    packed = pack(words, bits)
    assert packed.tobytes() == b"".join(one.to_bytes(size, "little") for one in words.ravel().tolist())
    assert np.array_equal(input_mask.read_packed(packed.tobytes(), shape, bits), words)
    ones = input_mask.read_packed(b"\xff" * (size * words.size), shape, bits)
    assert (ones == ((1 << 8 * size) - 1 if size < 8 else -1)).all()
