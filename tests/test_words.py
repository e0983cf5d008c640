"""Counts and times as people read them."""

import pytest

from dealer.words import counted, each_pair, in_seconds


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.0052, "0.0052 s"),
        (99.4, "99 s"),
        (100, "1.7 min"),
        (5000, "83 min"),
        (5970, "1.7 h"),
        (80_099, "22 h"),
        (120_331, "33 h"),
        (358_200, "4.1 days"),
        (1e8, "1,157 days"),
    ],
)
def test_times_have_two_digits_and_the_unit_that_fits(seconds, text):
    assert in_seconds(seconds) == text


def test_one_is_not_several():
    assert [counted(count, "pair") for count in (0, 1, 2)] == ["0 pairs", "1 pair", "2 pairs"]
    assert (each_pair(1), each_pair(3)) == ("for a pair of robots", "for each of 3 pairs of robots")
    assert counted(1, "gallery", "galleries") == "1 gallery"
    assert counted(1900, "gallery", "galleries") == "1,900 galleries"
