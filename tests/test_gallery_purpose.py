"""What a gallery is for: its terms, its header, and the thresholds that its resolution blurs."""

import json
import math
import shlex
from dataclasses import replace

import pytest

from dealer import cli, options
from dealer.gallery_mission import headers_for
from protocols.catalog import GalleryPurpose, Purpose, parse_resolution, threshold_warning
from protocols.scores import SCORES
from protocols.thresholds import resolution_warning
from spdz.readings.gallery_plan import measure_gallery

AGENTS = ("alice", "bob")
OTHER = GalleryPurpose("S6", 5, "score", 3.0, None, 0.5, proof=False)


@pytest.mark.parametrize("purpose", [GalleryPurpose("S10", 8), OTHER], ids=str)
def test_a_header_tells_the_purpose_and_nothing_is_lost(purpose):
    told = json.loads(json.dumps(purpose.as_json()))
    assert GalleryPurpose.from_json(told) == purpose
    for name in told:
        with pytest.raises(ValueError, match="of your own"):
            GalleryPurpose.from_json({key: value for key, value in told.items() if key != name})


def test_a_job_is_no_gallery():
    with pytest.raises(ValueError, match="of your own"):
        GalleryPurpose.from_json(Purpose("S10", 8).as_json())


@pytest.mark.parametrize("purpose", [GalleryPurpose("S10", 8), OTHER], ids=str)
def test_the_command_in_a_header_deals_the_same(purpose, monkeypatch):
    header, _ = headers_for(AGENTS, purpose, (17, 3), "semi-honest")
    words = shlex.split(header.dealer_command.replace("FOLDER", "x").replace("RxC", "17x3"))
    assert words[:3] == ["python", "-m", "spdz.dealer"]
    dealt = []
    monkeypatch.setattr(cli.gallery_cli, "_deal", lambda given, purpose: dealt.append((given, purpose)))
    assert cli.main([*words[3:], "--quiet"]) == 0
    ((given, again),) = dealt
    assert again == purpose
    assert (given.slots, given.security, given.agents) == ((17, 3), "semi-honest", [*AGENTS])


@pytest.mark.parametrize("security", ["malicious", "semi-honest"])
def test_terms_are_what_was_asked_for(security):
    terms = OTHER.terms(None, security)
    assert terms.program == SCORES["S6"].within(3.0, min_norm=0.5)
    assert (terms.dim, terms.security, terms.resolution) == (5, security, None)
    assert (terms.min_norm, terms.proves) == (0.5, False)
    terms = GalleryPurpose("S10", 8).terms(0.5, security)
    assert terms.program.threshold == 0.5
    assert terms.proves is (security == "malicious")


def test_a_threshold_changes_nothing_that_is_dealt():
    purpose = GalleryPurpose("S8", 8)
    plans = [measure_gallery(purpose.terms(threshold, "malicious")) for threshold in (0.0, 0.3, 1.0)]
    assert len({plan.recipe for plan in plans}) == 1 and len({plan.text for plan in plans}) == 3
    assert plans[0] == measure_gallery(purpose.dealt_terms("malicious"))
    other = replace(purpose, resolution=None)
    assert measure_gallery(other.dealt_terms("malicious")).recipe != plans[0].recipe


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"score": "S11"}, "unknown score"),
        ({"reveal": "all"}, "reveal"),
        ({"dim": 0}, "positive"),
        ({"max_norm": 2.0**22}, "57 bits"),
        ({"max_norm": -1.0}, "max_norm"),
        ({"min_norm": 1.5}, "min_norm"),
        ({"min_norm": math.nan}, "min_norm"),
        ({"resolution": 63}, "resolution"),
        ({"resolution": -1}, "resolution"),
    ],
)
def test_what_cannot_be_dealt_is_refused(wrong, says):
    with pytest.raises(ValueError, match=says):
        GalleryPurpose(**{"score": "S10", "dim": 1536, **wrong})


def test_a_threshold_is_given_where_bits_are_revealed_and_only_there():
    with pytest.raises(ValueError, match="give a threshold"):
        GalleryPurpose("S10", 8).terms(None, "malicious")
    with pytest.raises(ValueError, match="leave the threshold out"):
        OTHER.terms(0.5, "malicious")


@pytest.mark.parametrize("text", ["2^-0", "2^-16", "2^-62", "exact"])
def test_resolutions_are_read_as_they_are_written(text):
    bits = parse_resolution(text)
    assert GalleryPurpose("S10", 8, resolution=bits).step_text == text
    assert options.resolution(text) == text


@pytest.mark.parametrize("text", ["16", "2^16", "2^-", "2^--1", "2^-1.5", "Exact", "", "2^-²", "2^-1000"])
def test_other_resolutions_are_refused(text):
    with pytest.raises(ValueError, match="such as 2\\^-16"):
        parse_resolution(text)


# -- what a resolution does to thresholds -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("score", "threshold", "resolution", "says"),
    [
        ("S10", 0.98, 8, "from 1, where equal descriptors are"),
        ("S8", 0.9998, 14, "from 1, where equal"),
        ("S6", 1e-4, 16, "from 0, where equal"),
        ("S4", 0.01, 8, "from 0, where equal"),
        ("S2", 5.999, 8, "less than one of them from 6"),
        ("S10", -0.999, 8, "less than one of them from -1"),
    ],
)
def test_a_threshold_that_the_resolution_blurs_is_told(score, threshold, resolution, says):
    purpose = GalleryPurpose(score, 9, resolution=resolution)
    told = threshold_warning(purpose, threshold)
    assert told is not None and says in told and f"2^-{resolution}" in told and "\n" not in told
    assert threshold_warning(replace(purpose, resolution=None), threshold) is None
    assert threshold_warning(replace(purpose, resolution=30), threshold) is None
    assert threshold_warning(replace(purpose, reveal="score"), threshold) is None


USUAL = [("S10", 0.8), ("S10", 0.995), ("S6", 0.0169), ("S4", 0.13), ("S2", 0.5), ("S7", 0.42)]


@pytest.mark.parametrize(("score", "threshold"), USUAL)
def test_usual_thresholds_are_not_warned_of(score, threshold):
    assert threshold_warning(GalleryPurpose(score, 16), threshold) is None


def test_what_is_warned_of_in_jobs_is_warned_of_in_galleries():
    for threshold in (-1.0, 1.0, 1.01):
        purpose = GalleryPurpose("S10", 8)
        assert threshold_warning(purpose, threshold) == threshold_warning(
            Purpose("S10", 8, max_norm=1.0), threshold
        )


def test_a_resolution_that_is_too_coarse_for_anything_is_told():
    assert "128 steps" in resolution_warning(GalleryPurpose("S10", 8, resolution=6))
    assert resolution_warning(GalleryPurpose("S10", 8, resolution=9)) is None
    assert resolution_warning(GalleryPurpose("S10", 8, max_norm=20.0, resolution=0)) is not None
    assert resolution_warning(GalleryPurpose("S6", 8, max_norm=30.0, resolution=0)) is None
    assert resolution_warning(GalleryPurpose("S10", 8, resolution=None)) is None
    assert resolution_warning(GalleryPurpose("S10", 8, "score", resolution=6)) is None


def test_rules_name_the_resolution():
    assert GalleryPurpose("S10", 8).rule(0.8) == "S10 >= 0.8, to 2^-16"
    assert GalleryPurpose("S6", 8, resolution=None).rule(0.01) == Purpose("S6", 8).rule(0.01)
    assert OTHER.rule(None) == "S6 itself"


def test_words_are_as_long_as_the_norm_asks():
    purposes = [GalleryPurpose("S10", 1536, max_norm=norm) for norm in (1.0, 8.0)]
    assert [purpose.dealt_terms("malicious").word_bits for purpose in purposes] == [44, 47]
