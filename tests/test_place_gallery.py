"""Galleries of places that robots use: dealt for a team, met again and again, and shown by the commands."""

import json

import numpy as np
import pytest
from link_helpers import Link
from place_helpers import decisions, places
from stream_helpers import fresh, robots, table_of, tape
from tape_gallery_helpers import facts, show

from dealer.gallery_mission import deal_galleries
from dealer.gallery_plan import gallery_cost
from dealer.gallery_report import as_json, as_text
from protocols import Gallery, Part, PlacePurpose
from spdz.__main__ import main

pytestmark = pytest.mark.usefixtures("quick_disk")

PURPOSE = PlacePurpose((Part("lidar", "S10", 4, 3), Part("camera", "S6", 5)), "any")
LIMITS = {"lidar": 0.6, "camera": 1.0}
RULE = "any of lidar S10 >= 0.6 (3 turns), camera S6 <= 1.0, to 2^-16"
TERMS = PURPOSE.terms(LIMITS, "malicious")


@pytest.fixture(scope="module")
def dealt(tmp_path_factory):
    folder = tmp_path_factory.mktemp("places") / "m"
    deal_galleries(folder, ["alice", "bob"], PURPOSE, (8, 6))
    return folder


@pytest.fixture
def mission(dealt, tmp_path):
    return fresh(dealt, tmp_path / "m")


def both():
    return [places(PURPOSE, count, seed) for seed, count in enumerate((6, 5))]


def test_robots_stream_places_over_a_link_that_breaks(mission, capsys):
    def work(gallery, party):
        assert gallery.rule == RULE
        for part in np.array_split(both()[party], 3):
            gallery.add(part)
            gallery.step()
        return table_of(gallery.results(), (8, 6) if party == 0 else (6, 8))[0], gallery.filled

    link = Link([(0, 2500), (1, 4500)])
    (mine, rows), (theirs, columns) = robots(mission, link, work, threshold=None, terms=TERMS)
    assert len(link.sent) == 3
    truth = decisions(PURPOSE, *both(), LIMITS)
    assert truth.any() and not truth.all()
    assert np.array_equal(mine[np.ix_(rows, columns)], truth)
    assert np.array_equal(theirs[np.ix_(columns, rows)], truth.T)
    answer = facts(capsys, mission)
    assert answer["pinned"] == RULE and answer["pairs_used"] == 30


def test_tape_shows_what_places_consist_of(mission, capsys):
    answer = facts(capsys, mission)
    assert answer["rule"] == "any" and answer["resolution"] == "2^-16"
    assert [part["name"] for part in answer["place"]] == ["lidar", "camera"]
    status, out, err = show(capsys, mission)
    assert (status, err) == (0, "")
    for part in (
        "a gallery, places of lidar (S10 (dotprod) of 3 x 4-D, norm at most 1), camera (S6",
        "opens one bit, whether any of them match (resolution 2^-16), malicious",
        "S6 is the squared distance",
        "deal more python -m spdz.dealer mission.toml --out FOLDER",
    ):
        assert part in out, part


def test_match_says_in_one_sentence_what_to_use(mission, tmp_path, capsys):
    np.save(tmp_path / "x.npy", both()[0])
    words = ["--tape", str(tape(mission, 0)), "--descriptors", str(tmp_path / "x.npy"), "--threshold", "0.5"]
    status = main(["match", *words, "--listen", "127.0.0.1:0", "--state-dir", str(tmp_path)])
    out, err = capsys.readouterr()
    assert (status, out) == (2, "") and len(err.splitlines()) == 1
    assert "places of several descriptors" in err and "PlacePurpose" in err


def test_a_gallery_of_places_does_not_take_one_threshold(mission):
    with pytest.raises(ValueError, match="each with a threshold"):
        Gallery(tape(mission, 0), 0.5, listen="127.0.0.1:0", state_dir=mission / "state-0")


@pytest.mark.parametrize("part", ["lidar (turn 1)", "camera"])
def test_a_descriptor_that_does_not_suit_is_refused_by_its_name(mission, part):
    bad = both()[0]
    bad[2, 4 if part.startswith("lidar") else 12] = np.inf
    where = {"listen": "127.0.0.1:0", "state_dir": mission / "state-0"}
    gallery = Gallery(tape(mission, 0), terms=TERMS, **where)
    with pytest.raises(ValueError) as refused:
        gallery.add(bad)
    assert str(refused.value).startswith(f"{part}: ") and "inf" in str(refused.value)


def test_a_plan_says_what_a_place_costs():
    cost = gallery_cost(("alice", "bob"), PURPOSE, (300, 300), "malicious")
    assert not cost.slots_lost and not cost.pairs_lost
    words = PURPOSE.dim * -(-TERMS.word_bits // 8)
    assert cost.descriptor_bytes == (words + 4 * 16 + 4 / 8,) * 2  # a number and a bit for each proof
    first, *_ = as_text(cost, PURPOSE, "malicious", ("alice", "bob"), 1000)
    assert first.startswith("plan: a gallery of places of lidar (S10") and "to 2^-16" in first
    fields = json.loads(as_json(cost, PURPOSE, "malicious", 1000))
    assert fields["pair_tape_bytes"] == cost.pair_tape_bytes and fields["rule"] == "any"
