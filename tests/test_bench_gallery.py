"""``python -m bench gallery``, small: fields, decisions, streams, help. No time is asserted."""

import contextlib
import io
import json
from dataclasses import fields

import numpy as np
import pytest

from bench import gallery, gallery_tapes
from bench.gallery_new import NewRow
from bench.gallery_pairs import GalleryRow, TileRow
from bench.gallery_stream import STRETCHES, StreamRow
from bench.parties import Note, run_processes
from bench.recorded_batch import recorded_batches
from protocols.catalog import GalleryPurpose

STATED = (
    "n rows columns security resolution pairs_per_s bytes_per_pair tape_bytes_per_pair bytes_per_descriptor "
    "tape_bytes_per_descriptor dealt_pairs_per_s differ engine"
).split()


def run(*words):
    """Run the command in this process; its parties are processes of their own."""
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        assert gallery.main(list(map(str, words))) == 0
    return output.getvalue()


def objects(*words):
    return [json.loads(line) for line in run(*words, "--json").splitlines()]


def asked(resolution=16, threshold=0.8, security="malicious", dim=16):
    return gallery_tapes.Asked(GalleryPurpose("S10", dim, resolution=resolution), threshold, security, 1)


# All pairs


@pytest.fixture(scope="module")
def both():
    words = "--dim 16 --rows 20 --columns 35 --security malicious semi-honest --trials 2 --compare"
    return objects(*words.split())


def test_all_pairs_have_the_stated_fields(both):
    assert [row["security"] for row in both] == ["malicious", "semi-honest"]
    for row in both:
        tiles, others = row.pop("tiles"), row.pop("recorded")
        assert list(row) == [field.name for field in fields(GalleryRow)]
        assert set(STATED) <= set(row) and list(tiles) == [field.name for field in fields(TileRow)]
        assert (row["n"], row["rows"], row["columns"], row["trials"]) == (16, 20, 35, 2)
        assert (row["resolution"], row["engine"], row["differ"]) == ("2^-16", "spdz", 0)
        assert 0 < row["pairs_per_s"] <= row["best_pairs_per_s"] and row["dealt_pairs_per_s"] > 0
        assert tiles["tile"] == [20, 35] and tiles["pairs_per_s"] > 0 and tiles["time_factor"] > 0
        # Only what was recorded at this length, and what is marked as printed.
        assert all(other["rows"] is None for other in others)


def test_bytes_are_those_of_the_construction(both):
    malicious, honest = both
    for row in both:
        # A pair takes an element of 16 bytes and a bit; the rest is three headers and two checks.
        assert 16 + 1 / 8 < row["bytes_per_pair"] < 16 + 1 / 8 + 200 / (20 * 35)
        # A product, its MAC, and 18 levels: a margin of 35 bits less its sign and the 16 that are left out.
        blocks = 18 + (2 if row["security"] == "malicious" else 1)
        assert 16 * blocks < row["tape_bytes_per_pair"] < 16 * blocks + 1  # and a seal a tile
    # Words of 5 bytes at N = 16; the proof opens an element and a bit, for own and for the peer's slots.
    assert 5 * 16 <= honest["bytes_per_descriptor"] < malicious["bytes_per_descriptor"] < 5 * 16 + 200
    assert malicious["tape_bytes_per_descriptor"] - malicious["tape_bytes_per_descriptor_unproved"] > 127 * 16
    assert honest["tape_bytes_per_descriptor"] == honest["tape_bytes_per_descriptor_unproved"]


def test_without_a_proof_and_exact_the_tape_shows_it(both):
    (row,) = objects(*"--dim 16 --rows 3 --columns 4 --trials 1 --resolution exact --no-proof".split())
    assert row["resolution"] == "exact" and row["differ"] == 0 and "tiles" not in row
    assert row["tape_bytes_per_descriptor"] == row["tape_bytes_per_descriptor_unproved"]
    assert row["tape_bytes_per_pair"] > both[0]["tape_bytes_per_pair"] + 15 * 16


def test_the_table_says_it_in_words():
    text = run(*"--dim 16 --rows 6 --columns 5 --trials 1 --compare".split())
    first, second, tiles, *_ = text.splitlines()
    assert first.startswith("malicious, N = 16, 6 x 5, resolution 2^-16:") and "pairs/s" in first
    assert "B/pair" in second and "without proof" in second and "differ 0" in second
    assert tiles.split()[:3] == ["as", "jobs,", "6x5"] and "x time" in tiles


# Decisions


def test_descriptors_lie_on_both_sides_of_the_threshold():
    x, y = gallery_tapes.places((20, 30), asked(dim=64))
    assert np.allclose(np.linalg.norm(np.concatenate([x, y]), axis=1), 1)
    near = (x @ y.T)[np.arange(0, 30, 2) % 20, np.arange(0, 30, 2)]
    assert (np.abs(near - 0.8) <= 0.1 + 1e-9).all() and 0 < (near >= 0.8).sum() < len(near)


@pytest.mark.parametrize("resolution", [16, None])
def test_wrong_decisions_are_counted_outside_the_resolution(resolution):
    what = asked(resolution, threshold=0.5, dim=2)
    x = np.eye(2)[:1]
    step = 2.0**-16
    # Margins of 0, of one step of the inputs on either side, and far from the threshold.
    y = np.array([[0.5, 0], [0.5 - step, 0], [0.5 + step, 0], [-1, 0], [0.9, 0]])
    right = np.array([[True, False, True, False, True]])
    assert gallery_tapes.differing(what, right, x, y) == 0
    counted = [gallery_tapes.differing(what, right ^ (np.arange(5) == k), x, y) for k in range(5)]
    assert counted == [resolution is None, 1, 1, 1, 1]
    assert gallery_tapes.differing(what, ~right, x, y) == sum(counted)


def test_decisions_are_found_by_slot_though_some_are_void():
    blocks = [
        gallery_tapes.Block(range(0, 2), range(0, 3), np.array([[1, 0, 0], [0, 1, 0]], dtype=bool)),
        gallery_tapes.Block(range(3, 4), range(0, 3), np.array([[1, 1, 1]], dtype=bool)),
    ]
    decided = gallery_tapes.decided(blocks, [0, 1, 3], [0, 2])
    assert decided.tolist() == [[True, False], [False, False], [True, True]]


# What robots live with


def test_new_keyframes_against_many():
    (row,) = objects(*"--dim 16 --new 2 --stored 300 --trials 2".split())
    assert list(row) == [field.name for field in fields(NewRow)]
    assert (row["new"], row["stored"], row["trials"], row["differ"]) == (2, 300, 2, 0)
    assert 0 < row["min_ms"] <= row["median_ms"] <= row["max_ms"] and row["comparing_ms"] < row["max_ms"]
    assert row["tape_bytes"] > 300 * 6 * 19 * 16 and min(row["max_rss_mb"]) > 10
    # Two new: 600 pairs at 16 bytes and a bit, and two descriptors.
    assert 600 * 16 + 600 / 8 + 2 * 5 * 16 < row["bytes_sent"] < 600 * 17 + 2000


def test_new_keyframes_in_words():
    text = run(*"--dim 16 --new 1 --stored 20 --trials 1 --security semi-honest".split())
    assert text.startswith("semi-honest, N = 16, 1 new against 20") and "MB at most; differ 0" in text


def test_a_stream_is_told_stretch_by_stretch():
    rows = objects(*"--dim 16 --stream 40 --seconds 0.5".split())
    assert 1 <= len(rows) <= STRETCHES
    for row in rows:
        assert list(row) == [field.name for field in fields(StreamRow)]
        assert row["backlog"] <= 20 and 0 < row["delay_ms"][0] <= row["delay_ms"][1] <= row["delay_ms"][2]
    seen = [row["keyframes"] for row in rows]
    assert seen == sorted(set(seen)) and seen[-1] == 40 and rows[-1]["pairs"] == 400


# Recorded figures


def test_recorded_figures_say_where_they_come_from_and_how_they_compare():
    figures = recorded_batches()
    assert {figure.security for figure in figures} == {"malicious", "semi-honest"} and len(figures) == 9
    for figure in figures:
        assert figure.machine and figure.how and figure.us_per_pair > 0
        beside = figure.beside(figure.us_per_pair / 2, 100)
        assert beside["time_factor"] == 2
        expected = None if figure.bytes_per_pair is None else figure.bytes_per_pair / 100
        assert beside["bytes_factor"] == (None if expected is None else pytest.approx(expected, abs=0.06))


# Processes


def _tell(index, task, pipe):
    pipe.send(Note(task + index))
    pipe.send(index)


def _die(index, task, pipe):
    raise SystemExit(0)


def test_processes_tell_and_return_in_order():
    heard = []
    assert run_processes(_tell, 5, 3, lambda index, what: heard.append((index, what))) == [0, 1, 2]
    assert sorted(heard) == [(0, 5), (1, 6), (2, 7)]


def test_a_process_that_dies_is_told():
    with pytest.raises(RuntimeError, match="died"):
        run_processes(_die, None, 1)


# The command


@pytest.mark.parametrize(
    "words",
    [
        ["--dim", 0],
        ["--trials", 0],
        ["--new", 0],
        ["--stream", 0],
        ["--stream", 1, "--seconds", 0],
        ["--new", 1, "--stream", 1],
        ["--resolution", "0.5"],
        ["--security", "none"],
        ["--threshold", "nan"],
    ],
)
def test_bad_arguments_are_usage_errors(words, capsys):
    with pytest.raises(SystemExit) as end:
        gallery.main(list(map(str, words)))
    assert end.value.code == 2
    assert "usage" in capsys.readouterr().err


def test_help_teaches(capsys):
    with pytest.raises(SystemExit):
        gallery.main(["--help"])
    text = capsys.readouterr().out
    for words in (
        "three questions",
        "examples:",
        "--stream 3 --seconds 600",
        "differ",
        "--compare also runs",
    ):
        assert words in text
