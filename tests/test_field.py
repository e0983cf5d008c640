"""The field kernels against Python integers and gmpy2."""

import random

import gmpy2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spdz.arithmetic import field
from spdz.arithmetic.field import P

POWERS = (16, 26, 32, 48, 52, 63, 64, 78, 80, 96, 104, 112, 126)
EDGES = [0, 1, 2, P - 1, P - 2, P // 2, P // 2 + 1, *(2**k + d for k in POWERS for d in (-1, 0, 1))]
SIZES = (0, 1, 6, 7, 64, 65, 1023, 1024, 2500)

elements = st.one_of(st.sampled_from(EDGES), st.integers(0, P - 1))
integers = st.one_of(st.sampled_from(EDGES), st.integers(-(2**140), 2**140))
lists = st.lists(elements, min_size=1, max_size=90)
laws = settings(max_examples=60, deadline=None)


def sample(size: int, seed: int) -> list[int]:
    """Random elements with edge values mixed in."""
    rng = random.Random(seed)
    return [rng.choice(EDGES) if rng.random() < 0.3 else rng.randrange(P) for _ in range(size)]


def check(result: np.ndarray, expected: list[int]) -> None:
    assert result.dtype == np.uint64
    assert field.is_canonical(result)
    assert field.to_ints(result).ravel().tolist() == [value % P for value in expected]


BINARY = {
    "add": (field.add, lambda x, y: x + y),
    "sub": (field.sub, lambda x, y: x - y),
    "mul": (field.mul, lambda x, y: int(gmpy2.mpz(x) * y % P)),
}


@pytest.mark.parametrize("name", BINARY)
def test_all_pairs_of_edge_values(name):
    kernel, oracle = BINARY[name]
    a = field.from_ints(EDGES)
    result = kernel(a[:, None], a[None])
    assert result.shape == (len(EDGES), len(EDGES), 2)
    check(result, [oracle(x, y) for x in EDGES for y in EDGES])


@pytest.mark.parametrize("name", BINARY)
@pytest.mark.parametrize("size", SIZES)
def test_every_kernel_size(name, size):
    kernel, oracle = BINARY[name]
    xs, ys = sample(size, 1), sample(size, 2)
    check(
        kernel(field.from_ints(xs), field.from_ints(ys)), [oracle(x, y) for x, y in zip(xs, ys, strict=True)]
    )


@pytest.mark.parametrize("name", BINARY)
@pytest.mark.parametrize("x, y", [(x, y) for x in EDGES[:7] for y in EDGES[:7]])
def test_single_elements(name, x, y):
    kernel, oracle = BINARY[name]
    result = kernel(field.from_int(x), field.from_int(y))
    assert result.shape == (2,)
    check(result, [oracle(x, y)])


@pytest.mark.parametrize("name", BINARY)
@pytest.mark.parametrize(
    "left, right",
    [
        ((), (5,)),
        ((3, 1), (1, 4)),
        ((3, 1), (4,)),
        ((), ()),
        ((1,), ()),
        ((40, 1), (1, 50)),
        ((2, 0), (1, 0)),
    ],
)
def test_broadcasting(name, left, right):
    kernel, oracle = BINARY[name]
    a = np.array(sample(int(np.prod(left)), 3), dtype=object).reshape(left)
    b = np.array(sample(int(np.prod(right)), 4), dtype=object).reshape(right)
    result = kernel(field.from_ints(a), field.from_ints(b))
    shape = np.broadcast_shapes(left, right)
    assert result.shape == (*shape, 2)
    pairs = zip(np.broadcast_to(a, shape).ravel(), np.broadcast_to(b, shape).ravel(), strict=True)
    check(result, [oracle(x, y) for x, y in pairs])


@laws
@given(st.lists(st.tuples(elements, elements, elements), min_size=1, max_size=90))
def test_ring_axioms(triples):
    a, b, c = (field.from_ints(list(column)) for column in zip(*triples, strict=True))
    one, add, mul = field.from_int(1), field.add, field.mul
    np.testing.assert_array_equal(add(a, b), add(b, a))
    np.testing.assert_array_equal(mul(a, b), mul(b, a))
    np.testing.assert_array_equal(add(add(a, b), c), add(a, add(b, c)))
    np.testing.assert_array_equal(mul(mul(a, b), c), mul(a, mul(b, c)))
    np.testing.assert_array_equal(mul(a, add(b, c)), add(mul(a, b), mul(a, c)))
    np.testing.assert_array_equal(add(a, field.neg(a)), np.zeros_like(a))
    np.testing.assert_array_equal(field.sub(a, b), add(a, field.neg(b)))
    np.testing.assert_array_equal(mul(a, np.broadcast_to(one, a.shape)), a)


@laws
@given(lists, integers)
def test_scale_is_a_product_with_an_integer(xs, k):
    check(field.scale(field.from_ints(xs), k), [k * x for x in xs])


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("k", [0, 1, -1, P - 1, P, -P, P // 3, 2**126, -(2**64)])
def test_scale_of_every_kernel_size(size, k):
    xs = sample(size, 5)
    check(field.scale(field.from_ints(xs), k), [k * x for x in xs])


def test_scale_of_the_largest_limbs_is_exact():
    check(field.scale(field.from_ints([P - 1] * 100), P - 1), [(P - 1) ** 2] * 100)


@laws
@given(lists)
def test_neg(xs):
    check(field.neg(field.from_ints(xs)), [-x for x in xs])


@pytest.mark.parametrize("axis", [0, 1, 2, -1, -2, -3])
@pytest.mark.parametrize("shape", [(2, 3, 5), (30, 20, 10), (2, 0, 4)])
def test_sum_over_an_axis(axis, shape):
    a = np.array(sample(int(np.prod(shape)), 6), dtype=object).reshape(shape)
    result = field.sum(field.from_ints(a), axis)
    expected = a.sum(axis=axis)
    assert result.shape == (*expected.shape, 2)
    check(result, expected.ravel().tolist())


@pytest.mark.parametrize("size", [0, 1, 128, 129, 5000])
def test_sum_of_a_vector(size):
    xs = sample(size, 7)
    for axis in (0, -1):
        result = field.sum(field.from_ints(xs), axis)
        assert result.shape == (2,)
        check(result, [sum(xs)])


@pytest.mark.parametrize("axis", [1, -2])
def test_sum_over_the_word_axis_is_refused(axis):
    with pytest.raises(ValueError, match="axis"):
        field.sum(field.zeros(3), axis)


@laws
@given(st.lists(st.lists(st.integers(0, 2**62 - 1), min_size=4, max_size=4), min_size=1, max_size=40))
def test_words_are_reduced(words):
    check(
        field.from_words32(np.array(words, dtype=np.uint64)),
        [sum(word << 32 * k for k, word in enumerate(number)) for number in words],
    )


@pytest.mark.parametrize("copies", [1, 40])
def test_edge_words_are_reduced(copies):
    full, top = 2**32 - 1, 2**31
    words = [
        [2**62 - 1] * 4,
        [full] * 4,
        [full, full, full, top - 1],
        [full - 1, full, full, top - 1],
        [0, 0, 0, top],
        [full, full, full, top],
        [full, full, full, 2 * top - 1 + top],
        [0, 0, 0, 0],
    ] * copies
    check(
        field.from_words32(np.array(words, dtype=np.uint64)),
        [sum(word << 32 * k for k, word in enumerate(number)) for number in words],
    )


@laws
@given(st.lists(integers, min_size=1, max_size=20))
def test_integers_round_trip(values):
    a = field.from_ints(values)
    check(a, values)
    assert field.to_ints(a).tolist() == [value % P for value in values]
    assert [field.to_int(element) for element in a] == [value % P for value in values]
    np.testing.assert_array_equal(np.stack([field.from_int(value) for value in values]), a)


@laws
@given(st.lists(st.integers(-(P // 2), P // 2), min_size=1, max_size=20))
def test_centered_undoes_the_signed_embedding(values):
    assert field.centered(field.from_ints(values)).tolist() == values


def test_shapes_of_integer_arrays():
    a = field.from_ints([[1, 2, 3], [4, 5, -6]])
    assert a.shape == (2, 3, 2)
    assert field.to_ints(a).shape == field.centered(a).shape == (2, 3)
    assert field.centered(a).dtype == object
    assert field.centered(a[1, 2]).shape == () and field.centered(a[1, 2]).item() == -6
    assert field.zeros((2, 3)).shape == (2, 3, 2) and field.zeros(3).shape == (3, 2)


@pytest.mark.parametrize("bad", [1.5, "1", None])
def test_only_integers_become_elements(bad):
    with pytest.raises(TypeError):
        field.from_ints([1, bad])


@laws
@given(st.lists(st.one_of(st.integers(-(2**63), 2**63 - 1), st.integers(-3, 3)), min_size=1, max_size=40))
def test_signed_embedding(values):
    check(field.from_int64(np.array(values, dtype=np.int64)), values)


@pytest.mark.parametrize("value", [0, 1, -1, 2**63 - 1, -(2**63)])
def test_signed_embedding_of_one_number(value):
    result = field.from_int64(np.array(value, dtype=np.int64))
    assert result.shape == (2,)
    check(result, [value])


@pytest.mark.parametrize("dtype", [np.float64, np.uint64, object])
def test_signed_embedding_refuses_other_dtypes(dtype):
    with pytest.raises(TypeError):
        field.from_int64(np.ones(3, dtype=dtype))


def test_blocks_lose_the_top_bit_and_p_becomes_zero():
    blocks = [0, P, P - 1, P + 1, 2**128 - 1, 2**128 - 2, 2**127 + 5]
    words = np.array([[block % 2**64, block >> 64] for block in blocks], dtype=np.uint64)
    before = words.copy()
    check(field.from_blocks(words), [0, 0, P - 1, 0, 0, P - 1, 5])
    np.testing.assert_array_equal(words, before)


@pytest.mark.parametrize("value, expected", [(P, False), (P - 1, True), (P + 1, False), (2**128 - 1, False)])
def test_canonical_means_below_p(value, expected):
    words = field.zeros(5)
    words[3] = value % 2**64, value >> 64
    assert field.is_canonical(words) is expected


def test_canonical_of_all_ones_in_one_word_only():
    ones = 2**64 - 1
    assert field.is_canonical(np.array([[ones, 0], [0, 2**63 - 1]], dtype=np.uint64))
    assert field.is_canonical(field.zeros(0))


@laws
@given(st.integers(-(2**130), 2**130).filter(lambda k: k % P))
def test_inverse(k):
    inverse = field.inverse(k)
    assert isinstance(inverse, int) and 0 < inverse < P and inverse * k % P == 1


@pytest.mark.parametrize("zero", [0, P, -P])
def test_zero_has_no_inverse(zero):
    with pytest.raises(ZeroDivisionError):
        field.inverse(zero)


def test_operands_may_be_read_only_views_and_are_not_changed():
    xs = sample(2400, 8)
    raw = field.from_ints(xs).tobytes()
    a = np.frombuffer(raw, dtype=np.uint64).reshape(-1, 2)
    every_second, backwards = a[::2], a[::-2]
    expected, reverse = xs[::2], xs[::-2]
    check(field.add(every_second, backwards), [x + y for x, y in zip(expected, reverse, strict=True)])
    check(field.mul(every_second, backwards), [x * y for x, y in zip(expected, reverse, strict=True)])
    check(field.scale(backwards, 3), [3 * x for x in reverse])
    check(field.sum(every_second, 0), [sum(expected)])
    assert a.tobytes() == raw


def test_results_are_writable():
    a = field.from_int(5)
    for result in (a, field.add(a, a), field.mul(a, a), field.scale(a, 2), field.neg(a)):
        result[...] = 0


@laws
@given(
    st.lists(
        st.tuples(
            st.one_of(st.sampled_from([0, 1, -1, 2**63 - 1, -(2**63)]), st.integers(-(2**39), 2**39)),
            elements,
        ),
        min_size=1,
        max_size=40,
    )
)
def test_masking_short_integers_is_a_subtraction(pairs):
    x = np.array([short for short, _ in pairs], dtype=np.int64)
    result = field.sub_from_int64(x, field.from_ints([element for _, element in pairs]))
    check(result, [short - element for short, element in pairs])


def test_masking_reaches_both_ends_of_the_field():
    shorts, masks = [0, 1, -1, 2**63 - 1, -(2**63)], [0, 1, 2, P - 1, P - 2, 2**63, P - 2**63]
    x = np.array(shorts, dtype=np.int64)[:, None] + np.zeros(len(masks), dtype=np.int64)
    a = np.broadcast_to(field.from_ints(masks), (*x.shape, 2))
    check(field.sub_from_int64(x, a), [short - mask for short in shorts for mask in masks])
