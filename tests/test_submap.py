"""The payload of a submap: what goes in comes out, and nothing else is read."""

import struct

import numpy as np
import pytest
from geometry_helpers import hall
from hypothesis import given
from hypothesis import strategies as st

from protocols.geometry.submap import FARTHEST, HEADER, MOST_BYTES, MOST_POINTS, Submap, thin


def submap(n=50):
    return Submap(np.random.default_rng(5).uniform(-20, 20, (n, 2)), 0.25)


def test_submap_is_read_as_it_was_written_to_float32():
    written = submap()
    read = Submap.from_bytes(written.to_bytes())
    np.testing.assert_array_equal(read.points, written.points.astype(np.float32))
    assert read.walls == written.walls and read.points.dtype == np.float64
    assert Submap.from_bytes(read.to_bytes()).to_bytes() == written.to_bytes()


def test_submap_takes_eight_bytes_a_point():
    assert len(submap(50).to_bytes()) == HEADER.size + 400


def test_empty_submap_is_a_submap():
    assert Submap.from_bytes(submap(0).to_bytes()).points.shape == (0, 2)


def test_points_do_not_show_in_the_repr():
    assert repr(submap()) == "Submap(walls=0.25)"


GOOD = submap().to_bytes()


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (b"", "0 bytes are not a 2-D submap"),
        (GOOD[:10], "10 bytes are not"),
        (GOOD[: HEADER.size], "50 points takes"),
        (GOOD[:-1], "takes 424 bytes, got 423"),
        (GOOD + b"\0", "takes 424 bytes, got 425"),
        (b"\x80\x04" + GOOD[2:], "do not start like one"),
        (GOOD[:8] + struct.pack("<I", 2) + GOOD[12:], "version 2 came"),
        (GOOD[:12] + struct.pack("<I", 2**32 - 1) + GOOD[16:], "4,294,967,295 points takes"),
        (GOOD[:16] + struct.pack("<d", np.nan) + GOOD[24:], "walls"),
        (GOOD[:16] + struct.pack("<d", 7.0) + GOOD[24:], "walls"),
        (GOOD[:-4] + struct.pack("<f", np.nan), "finite"),
        (GOOD[:-4] + struct.pack("<f", np.inf), "finite"),
        (GOOD[:-4] + struct.pack("<f", -101.0), "within 100 m"),
        (bytes(MOST_BYTES + 1), "at most 400,024 bytes"),
    ],
)
def test_damaged_or_foreign_payload_is_refused(payload, words):
    with pytest.raises(ValueError, match=words):
        Submap.from_bytes(payload)


@given(st.integers(0, len(GOOD) - 1), st.integers(1, 255))
def test_changed_byte_is_refused_or_gives_a_submap_within_bounds(place, change):
    damaged = bytearray(GOOD)
    damaged[place] ^= change
    try:
        read = Submap.from_bytes(bytes(damaged))
    except ValueError:
        return
    assert np.abs(read.points).max() <= FARTHEST and abs(read.walls) <= 2 * np.pi


@pytest.mark.parametrize(
    ("points", "walls", "words"),
    [
        (np.zeros((3, 3)), 0.0, r"shape \(n, 2\)"),
        (np.zeros(4), 0.0, r"shape \(n, 2\)"),
        (np.full((2, 2), np.nan), 0.0, "finite"),
        (np.full((2, 2), 100.5), 0.0, "within 100 m"),
        (np.zeros((MOST_POINTS + 1, 2)), 0.0, "at most 50,000 points"),
        (np.zeros((1, 2)), np.inf, "walls"),
    ],
)
def test_submap_of_bad_numbers_is_not_made(points, walls, words):
    with pytest.raises(ValueError, match=words):
        Submap(points, walls)


def test_thinning_keeps_one_point_of_each_square_and_no_order():
    points = hall()
    once = thin(points)
    squares = {tuple(square) for square in np.floor(points / 0.05).astype(int)}
    assert {tuple(square) for square in np.floor(once / 0.05).astype(int)} == squares
    assert len(once) == len(squares) < len(points)
    shuffled = np.random.default_rng(6).permutation(points)
    squares_of = [np.floor(found / 0.05).astype(int) for found in (once, thin(shuffled))]
    np.testing.assert_array_equal(*squares_of)


def test_thinning_nothing_gives_nothing():
    assert thin(np.zeros((0, 2))).shape == (0, 2)
