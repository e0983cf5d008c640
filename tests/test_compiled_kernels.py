"""The kernels of compiled code are exact where their numbers are largest."""

import random

import numpy as np
import pytest

from spdz.arithmetic import field
from spdz.arithmetic.field import P
from spdz.compiled import kernels
from spdz.foundations.errors import ProtocolViolation, Unsent
from spdz.values import input_mask

LENGTHS = (65, 128, 129, 4096, 4097, 65536, 65537, 131072)
SHORT = (1, 16, 40, 62, 63)


def words_at_the_ends(n, bits, kind):
    """Signed words of so many bits."""
    top = (1 << bits) - 1
    one = {"largest": top, "smallest": -top, "limbs": top & -2, "lowest": -(1 << (bits - 1))}
    if kind in one:
        return np.full(n, one[kind], dtype=np.int64)
    pattern = [top, -top, 1, -1, 0, -(1 << (bits - 1)), top >> 1]
    return np.resize(np.array(pattern, dtype=np.int64), n)


KINDS = ("largest", "smallest", "limbs", "lowest", "mixed")


def limbs_of(words, bits):
    """Limbs of signed words, and their bits, as compiled code asks for them."""
    if bits <= 22:
        return kernels.one_limb(words), bits
    return kernels.signed_limbs(words, -(-(bits + 1) // 16)), 16


@pytest.mark.parametrize("n", LENGTHS)
def test_a_dot_product_of_words_is_exact(n):
    for bits, other in ((63, 63), (41, 63), (16, 40), (1, 62)):
        for kind, second in zip(KINDS, ("smallest", "largest", "mixed", "limbs", "mixed"), strict=True):
            x, y = words_at_the_ends(n, bits, kind), words_at_the_ends(n, other, second)
            (left, width), (right, second_width) = limbs_of(x, bits), limbs_of(y, other)
            exact = int(x.astype(object) @ y.astype(object))
            assert kernels.product(left, right, width, second_width) == exact


@pytest.mark.parametrize("n", LENGTHS)
def test_a_dot_product_of_words_and_elements_is_exact(n):
    for bits in (63, 17):
        for kind, number in zip(KINDS, (P - 1, P - 1, (1 << 126) - 1, P - 1, P // 3), strict=True):
            x = words_at_the_ends(n, bits, kind)
            elements = np.broadcast_to(field.from_int(number), (n, 2))
            left, width = limbs_of(x, bits)
            product = kernels.product(left, kernels.element_limbs(elements), width, 22)
            assert product == int(x.astype(object).sum()) * number


def test_sums_of_pieces_do_not_wrap_up_to_the_longest_vector():
    """The largest limbs of 22 bits, all of one sign: 2^18 2^44 is below 2^63."""
    limbs = np.full((1, kernels.LONGEST), (1 << 22) - 1, dtype=np.float64)
    exact = kernels.LONGEST * ((1 << 22) - 1) ** 2
    assert kernels.product(limbs, limbs, 22, 22) == exact < 1 << 63
    assert kernels.LONGEST << 44 < 1 << 63


@pytest.mark.parametrize("bits", SHORT)
def test_limbs_add_up_to_the_words(bits):
    for kind in KINDS:
        words = words_at_the_ends(9, bits, kind)
        limbs, width = limbs_of(words, bits)
        assert np.abs(limbs).max() <= 1 << width and limbs[:-1].min(initial=0) >= 0
        assert added_up(limbs, width) == words.tolist()
        positive = words & (1 << bits) - 1
        limbs = kernels.word_limbs(positive, -(-bits // 16))
        assert limbs.min() >= 0 and limbs.max() < 1 << 16
        assert added_up(limbs, 16) == positive.tolist()


@pytest.mark.parametrize("number", [0, 1, P - 1, (1 << 126) - 1, P // 3, 0x123456789ABCDEF0FEDCBA987654321])
def test_limbs_add_up_to_the_elements(number):
    limbs = kernels.element_limbs(field.from_ints([number, P - 1, 1 << 64]))
    assert limbs.min() >= 0 and limbs.max() < 1 << 22
    assert added_up(limbs, 22) == [number, P - 1, 1 << 64]


@pytest.mark.parametrize("n", [65, 4097])
def test_a_dot_product_of_a_vector_with_itself_is_exact(n):
    for kind in KINDS:
        x = words_at_the_ends(n, 57, kind)
        limbs, width = limbs_of(x, 57)
        assert kernels.product(limbs, limbs, width, width) == int(x.astype(object) @ x.astype(object))


def added_up(limbs, width):
    total = sum(limb.astype(np.int64).astype(object) * 2 ** (width * i) for i, limb in enumerate(limbs))
    return [int(one) for one in total]


def test_products_of_limbs_are_joined_whatever_their_sign():
    draw = random.Random(1)
    for rows, columns in ((1, 1), (4, 8), (3, 3), (2, 8)):
        numbers = [
            [draw.choice([-1, 1]) * draw.randrange(1 << 53) for _ in range(columns)] for _ in range(rows)
        ]
        numbers[0][0], numbers[-1][-1] = 1 << 53, -(1 << 53)
        exact = sum(one << 18 * i + 16 * j for i, row in enumerate(numbers) for j, one in enumerate(row))
        assert kernels._joined(np.array(numbers, dtype=np.float64).tolist(), 18, 16) == exact


def test_numbers_become_arrays_and_come_back():
    numbers = [0, 1, P - 1, 1 << 64, (1 << 64) - 1, 1 << 126]
    array = kernels.array_of(numbers, (2, 3))
    assert array.shape == (2, 3, 2) and array.flags.writeable
    assert field.to_list(array) == numbers
    assert kernels.elements_of(array.tobytes(), kernels.cut(6, 16)) == numbers
    assert [kernels.element_of(one.tobytes()) for one in array.reshape(6, 2)] == numbers
    assert field.to_int(kernels.array_of(P - 1, ())) == P - 1


@pytest.mark.parametrize("number", [P, P + 1, (1 << 128) - 1, 1 << 127])
@pytest.mark.parametrize("place", [0, 2])
def test_an_element_that_is_not_canonical_is_refused(number, place):
    raw = bytearray(48)
    raw[16 * place : 16 * place + 16] = number.to_bytes(16, "little")
    with pytest.raises(ProtocolViolation, match="not a field element"):
        kernels.elements_of(raw, kernels.cut(3, 16))
    with pytest.raises(ProtocolViolation, match="not a field element"):
        kernels.element_of(raw[16 * place : 16 * place + 16])


@pytest.mark.parametrize("bits", [9, 47, 56, 63])
def test_words_are_read_as_the_ordinary_reading_reads_them(bits):
    norm, size = 5, input_mask.element_bytes(bits)
    form = kernels.unpacking(3, size)
    top = (1 << bits) - norm
    for word, honest in ((norm, True), (top - 1, True), (norm - 1, False), (top, False), (0, False)):
        raw = b"".join(one.to_bytes(size, "little") for one in (norm, word, top - 1))
        if honest:
            assert kernels.words_of(raw, *form, norm, top) == (norm, word, top - 1)
            assert input_mask.unpack(raw, (3,), bits, norm).tolist() == [norm, word, top - 1]
            continue
        for read in (
            lambda: kernels.words_of(raw, *form, norm, top),  # noqa: B023
            lambda: input_mask.unpack(raw, (3,), bits, norm),  # noqa: B023
        ):
            with pytest.raises(ProtocolViolation, match="outside the interval"):
                read()
    with pytest.raises(ProtocolViolation):
        kernels.words_of(b"\xff" * size, *kernels.unpacking(1, size), norm, top)


@pytest.mark.parametrize("count", [1, 3, 64])
@pytest.mark.parametrize("bits", [8, 47, 48, 63])
def test_words_are_packed_as_the_ordinary_reading_packs_them(count, bits):
    size = input_mask.element_bytes(bits)
    words = [(7 << bits - 3) - i for i in range(count)]
    whole, cut = kernels.packing(count, size)
    assert b"".join(cut(whole(*words))) == input_mask.pack(np.array(words), bits).tobytes()


def test_own_words_outside_the_interval_are_not_sent():
    low, high = 5, 100
    r = np.zeros(3, dtype=np.int64)
    for word, honest in ((low, True), (high - 1, True), (low - 1, False), (high, False)):
        words = [low, word, high - 1]
        if honest:
            kernels.check_hidden(words, low, high)
            assert kernels.hidden_words(np.array(words), r, False, low, high).tolist() == words
            continue
        with pytest.raises(Unsent):
            kernels.check_hidden(words, low, high)
        with pytest.raises(Unsent):
            kernels.hidden_words(np.array(words), r, False, low, high)


def test_masks_that_suit_every_input_are_known():
    norm, high = 5, 100
    for s, far in ((2 * norm, True), (high - norm - 1, True), (2 * norm - 1, False), (high - norm, False)):
        masks = [-2 * norm, -s, norm - high + 1]
        assert kernels.far_inside(masks, norm, high) is far
        assert kernels.far_inside(np.array(masks), norm, high) is far
        words = [s + x for x in (-norm, norm)]
        assert far == all(norm <= word < high for word in words)


@pytest.mark.parametrize("bits", [8, 63])
def test_a_mask_is_that_of_the_ordinary_reading(bits):
    pad = field.from_ints([0, 1, P - 1, (1 << 63) - 1, 1 << 63, (1 << 64) - 1, 12345 << 60])
    words = kernels.mask_words(pad, bits)
    assert np.array_equal(field.from_int64(words), input_mask.from_pad(pad, bits))


@pytest.mark.parametrize("frac", [0, 16, 70])
def test_a_number_is_decoded_to_the_nearest_float(frac):
    for number in (0, 1, 5 << 60, (1 << 54) + 1, P // 2):
        assert kernels.decoded_element(number, frac) == number / (1 << frac)
        assert kernels.decoded_element(-number % P, frac) == -number / (1 << frac)
