"""Places of several descriptors: one bit a pair, that of the clear decision, and no other."""

import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from gallery_memory import run_gallery
from place_helpers import CAMERA, LIDAR, MIXED, decisions, places, signs_of, terms, thresholds

from protocols import Part, PlacePurpose
from protocols.catalog import GalleryPurpose
from protocols.place_purpose import purpose_of
from spdz.readings.gallery import Terms
from spdz.readings.gallery_plan import measure_gallery
from spdz.readings.party import Party
from spdz.values.standing import Standing

DOCS = Path(__file__).resolve().parent.parent / "docs"
SECURITIES = ["malicious", "semi-honest"]
RULES = ["any", "all"]
KINDS = {
    "one descriptor": (CAMERA,),
    "two": (CAMERA, replace(CAMERA, name="lidar", dim=7)),
    "turns": (LIDAR,),
    "turns and one": (replace(LIDAR, turns=2), CAMERA),
    "turns of two": (replace(LIDAR, turns=2), replace(CAMERA, turns=3)),
    "mixed": MIXED,
}


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (17, 3)], ids=str)
@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("kind", KINDS)
def test_the_bit_of_a_pair_is_the_clear_one(tmp_path, kind, rule, shape):
    purpose = PlacePurpose(KINDS[kind], rule)
    x, y = (places(purpose, count, seed) for seed, count in enumerate(shape))
    truth = decisions(purpose, x, y, thresholds(purpose))
    assert np.array_equal(purpose.plain(x, y, thresholds(purpose)), truth)
    for security in SECURITIES:
        found = run_gallery(tmp_path / security, terms(purpose, security), x, y)
        assert found.dtype == np.bool_ and np.array_equal(found, truth)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("turns", [(1, 1), (3,), (2, 1), (2, 2), (1, 1, 1), (3, 1, 1), (2, 3), (5, 1), (8,)])
def test_every_pattern_of_comparisons_is_combined_by_the_rule(tmp_path, turns, rule):
    """Descriptors of one number, +1 or -1: the second robot brings every pattern of matches."""
    parts = tuple(Part(f"p{i}", "S10", 1, count) for i, count in enumerate(turns))
    purpose = PlacePurpose(parts, rule)
    x, y = np.ones((1, purpose.dim)), signs_of(purpose.dim)
    starts = np.cumsum((0, *turns))
    groups = [(y[:, a:b] > 0).any(axis=1) for a, b in pairwise(starts)]
    truth = np.all(groups, axis=0) if rule == "all" else np.any(groups, axis=0)
    found = run_gallery(tmp_path, purpose.terms({part.name: 0.5 for part in parts}, "malicious"), x, y)
    assert np.array_equal(found[0], truth) and truth.any() and not truth.all()


def test_only_turn_0_of_the_first_robot_counts(tmp_path):
    purpose = PlacePurpose((Part("lidar", "S10", 1, 2),))
    program = purpose.terms({"lidar": 0.5}, "malicious")
    found = run_gallery(tmp_path, program, signs_of(2), signs_of(2))
    assert np.array_equal(found, (signs_of(2)[:, :1, None] * signs_of(2)[None] > 0).any(axis=2))


@pytest.mark.parametrize("rule", RULES)
def test_without_a_resolution_a_score_at_its_threshold_is_decided_exactly(tmp_path, rule):
    purpose = PlacePurpose((replace(LIDAR, turns=2), replace(CAMERA, score="S6")), rule, None)
    x, y = places(purpose, 2), places(purpose, 3, seed=1)
    raw = [np.rint(one * 65536).astype(np.int64) for one in (x, y)]
    at = float(raw[0][1, :7] @ raw[1][2, 7:14]) / 2**32  # turn 1 of the last pair
    apart = float(((raw[0][1, 14:] - raw[1][2, 14:]) ** 2).sum()) / 2**32
    for step in (-(2.0**-32), 0.0, 2.0**-32):
        limits = {"lidar": at + step, "camera": apart - step}
        found = run_gallery(tmp_path / str(step), purpose.terms(limits, "malicious"), x, y)
        assert np.array_equal(found, decisions(purpose, x, y, limits))
        assert np.array_equal(found, purpose.plain(x, y, limits))


@pytest.mark.parametrize("limit", [-3.0, -1.0, 1.0, 3.0])
def test_thresholds_at_and_beyond_the_edge_of_all_scores(tmp_path, limit):
    """Opposite and equal vectors of the largest norm, and thresholds that all or none can meet."""
    purpose = PlacePurpose((Part("lidar", "S10", 1, 2), Part("camera", "S10", 1)), "any", None)
    limits = dict.fromkeys(("lidar", "camera"), limit)
    x, y = signs_of(3)[:2], signs_of(3)
    found = run_gallery(tmp_path, purpose.terms(limits, "malicious"), x, y)
    assert np.array_equal(found, decisions(purpose, x, y, limits))


def test_products_of_cuts_are_those_of_short_integers(tmp_path, monkeypatch):
    """A comparison of S10 never writes the words of a place out as field elements."""
    purpose = PlacePurpose((replace(LIDAR, turns=2), CAMERA))
    x, y = places(purpose, 2), places(purpose, 3, seed=1)
    real, written = Standing.parts, []

    def parts(standing, *, malicious, dealt):
        written.append((standing.owner, dealt))
        return real(standing, malicious=malicious, dealt=dealt)

    monkeypatch.setattr(Standing, "parts", parts)
    run_gallery(tmp_path, terms(purpose), x, y)
    assert written == [(0, False)] * 2 + [(1, False)] * 2  # once a slot and side, for the proof of norm


# -- nothing else is opened ---------------------------------------------------------------------------------


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("match", [True, False])
def test_the_bits_that_are_opened_on_the_way_are_uniform_whatever_matches(
    tmp_path, monkeypatch, match, security
):
    """Also the numbers: a count that is masked tells nothing of how many parts match."""
    purpose = PlacePurpose((Part("lidar", "S10", 1, 2), Part("camera", "S10", 1)), "any")
    x, y = np.ones((40, 3)), np.full((50, 3), 1.0 if match else -1.0)
    bits, numbers = [], []
    open_bits, open_elements = Party.open_bits, Party.open

    async def watched_bits(party, shares, delta, n):
        bits.append(await open_bits(party, shares, delta, n))
        return bits[-1]

    async def watched(party, *values):
        opened = await open_elements(party, *values)
        numbers.extend(one[..., 1] >> np.uint64(62) & np.uint64(1) for one in opened)
        return opened

    monkeypatch.setattr(Party, "open_bits", watched_bits)
    monkeypatch.setattr(Party, "open", watched)
    program = purpose.terms({"lidar": 0.5, "camera": 0.5}, security)
    assert (run_gallery(tmp_path, program, x, y) == match).all()
    on_the_way = [one for one in bits if len(one) == 3 * 2000]
    assert len(on_the_way) == 2 and np.array_equal(*on_the_way)
    for part in on_the_way[0].reshape(3, -1):
        assert abs(part.mean() - 0.5) < 0.06  # five standard deviations
    *_, count, same_count = [one for one in numbers if one.shape == (40, 50)]
    assert np.array_equal(count, same_count) and abs(count.mean() - 0.5) < 0.06
    assert [len(one) for one in bits if len(one) == 2000] == [2000, 2000]


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("rule", RULES)
def test_what_is_opened_is_checked_before_anything_that_depends_on_it_is_sent(rule, security):
    exact = (replace(LIDAR, turns=2), CAMERA, Part("depth", "S6", 4))
    assert measure_gallery(terms(PlacePurpose(exact, rule), security)).pair.repeatable
    for record in measure_gallery(terms(PlacePurpose(exact, rule), security)).slots:
        assert record.repeatable and record.openings == (security == "malicious")
    several = measure_gallery(terms(PlacePurpose(MIXED, rule), security)).pair
    assert several.repeatable == (security == "semi-honest") and several.openings > 2


# -- what is dealt ------------------------------------------------------------------------------------------

BASE = PlacePurpose((replace(LIDAR, turns=2), CAMERA))
OTHERS = {
    "a part less": PlacePurpose((replace(LIDAR, turns=2),)),
    "another order": PlacePurpose((CAMERA, replace(LIDAR, turns=2))),
    "more turns": PlacePurpose((replace(LIDAR, turns=3), CAMERA)),
    "turns of the other": PlacePurpose((LIDAR, replace(CAMERA, dim=5))),
    "another score": PlacePurpose((replace(LIDAR, turns=2), replace(CAMERA, score="S6"))),
    "another length": PlacePurpose((replace(LIDAR, turns=2), replace(CAMERA, dim=6))),
    "another largest norm": PlacePurpose((replace(LIDAR, turns=2), replace(CAMERA, max_norm=2.0))),
    "a smallest norm": PlacePurpose((replace(LIDAR, turns=2), replace(CAMERA, min_norm=0.5))),
    "the other rule": replace(BASE, rule="all"),
    "another resolution": replace(BASE, resolution=20),
    "exact": replace(BASE, resolution=None),
    "no proof": replace(BASE, proof=False),
}


@pytest.mark.parametrize("other", OTHERS)
def test_a_tape_for_another_place_has_another_recipe(other):
    plan, changed = (measure_gallery(one.dealt_terms("malicious")) for one in (BASE, OTHERS[other]))
    assert plan.recipe != changed.recipe


def test_any_and_all_of_three_equal_parts_are_dealt_apart():
    """Both take a count of three bits and a comparison of the same length."""
    parts = tuple(Part(f"p{i}", "S10", 2) for i in range(3))
    first, second = (measure_gallery(PlacePurpose(parts, rule).dealt_terms("malicious")) for rule in RULES)
    assert first.pair == second.pair and first.recipe != second.recipe


def test_thresholds_are_in_the_text_and_change_nothing_that_is_dealt():
    limits = [{"lidar": 0.35, "camera": 0.1}, {"lidar": 0.35, "camera": 0.2}, {"lidar": 0.1, "camera": 0.1}]
    plans = [measure_gallery(BASE.terms(one, "malicious")) for one in limits]
    assert len({plan.recipe for plan in plans}) == 1 and len({plan.text for plan in plans}) == 3


def test_words_are_long_enough_for_the_largest_bound_and_all_coordinates():
    purpose = PlacePurpose((replace(LIDAR, turns=2), replace(CAMERA, max_norm=100.0)))
    program = purpose.dealt_terms("malicious")
    assert program.entry == program.sections[2].norm > 100 * 65536
    assert 2 * purpose.dim * program.entry * 2**16 <= 2**program.word_bits
    alone = GalleryPurpose("S10", purpose.dim, max_norm=100.0).dealt_terms("malicious")
    assert program.word_bits == alone.word_bits


def test_a_place_with_one_descriptor_costs_what_a_descriptor_costs():
    place = measure_gallery(PlacePurpose((CAMERA,)).dealt_terms("malicious"))
    alone = measure_gallery(GalleryPurpose("S10", CAMERA.dim).dealt_terms("malicious"))
    assert place.pair == alone.pair and place.slots == alone.slots


@pytest.mark.parametrize(
    ("parts", "rule", "stored", "sent", "rounds"),
    [
        ((Part("lidar", "S10", 1200),), "any", 320, 16.125, 4),
        ((Part("lidar", "S10", 1200, 4),), "any", 1392, 80.625, 8),
        ((Part("camera", "S10", 1536), Part("lidar", "S10", 1200)), "any", 704, 48.375, 8),
        ((Part("camera", "S10", 1536), Part("lidar", "S10", 1200)), "all", 720, 48.375, 8),
        ((Part("camera", "S10", 1536), Part("lidar", "S10", 1200, 4)), "any", 1744, 96.75, 8),
        ((Part("camera", "S10", 1536), Part("lidar", "S10", 1200, 4)), "all", 1744, 96.75, 8),
        ((Part("camera", "S10", 1536, 4), Part("lidar", "S10", 1200, 4)), "all", 2816, 161.25, 12),
    ],
)
def test_a_pair_costs_what_the_page_of_scores_says(parts, rule, stored, sent, rounds):
    pair = measure_gallery(PlacePurpose(parts, rule).dealt_terms("malicious")).pair
    assert max(pair.correction_bytes) == stored and pair.rounds == rounds
    assert 16 * pair.elements_sent[0] + pair.bits_sent / 8 == sent and pair.repeatable
    turns = (f"S10 of {f'{part.turns} x ' if part.turns > 1 else ''}{part.dim:,}" for part in parts)
    said = rule if len(parts) > 1 else ""
    row = f"| {', '.join(turns)} | {said} | {stored:,} bytes | {sent:g} bytes | {rounds} |".replace(
        "|  |", "| |"
    )
    assert row in (DOCS / "scores.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize(
    "turns", [(4,), (1, 1), (1, 1, 1, 1), (5, 1), (3, 1, 1), (2, 3), (3, 3, 1), (16, 16)]
)
def test_a_pair_stores_what_the_formulas_of_the_spec_say(turns, rule):
    parts = tuple(Part(f"p{i}", "S10", 64, count) for i, count in enumerate(turns))
    pair = measure_gallery(PlacePurpose(parts, rule).dealt_terms("malicious")).pair
    alone = measure_gallery(GalleryPurpose("S10", 64).dealt_terms("malicious")).pair
    several, single = sorted(t for t in turns if t > 1), turns.count(1)
    text = (DOCS / "spec" / "protocols.md").read_text(encoding="utf-8").partition("## 28.")[2]
    known, total = {"L": max(alone.correction_bytes) // 16 - 2}, 0

    def add(row, times=1, **more):
        nonlocal total
        (formula,) = re.findall(rf"^\| {row} \| `(.*)` \|$", text, re.MULTILINE)
        total += times * eval(formula, known | more)

    add("S10 of one turn, L as in section 21", sum(turns))
    if rule == "any":
        add("the bit, M as above", M=sum(turns) - 1)
    else:
        for count in several[:-1]:
            add("a part that is decided in 28.8", M=count - 1)
        n, t = single + len(several[:-1]), (several or [0])[-1]
        add("the bit, M as above", M=t * n + 1 if n and t else n or t - 1)
    assert pair.correction_bytes == (total, total)


# -- the numbers that fit a header --------------------------------------------------------------------------


def test_a_header_is_read_back():
    for purpose in (BASE, *OTHERS.values(), PlacePurpose(MIXED, "all", None)):
        assert purpose_of(purpose.as_json()) == purpose
    single = GalleryPurpose("S10", 5)
    assert purpose_of(single.as_json()) == single


@pytest.mark.parametrize(
    "change",
    [
        {"rule": "some"},
        {"place": []},
        {"place": None},
        {"place": [{"name": "lidar"}]},
        {"place": [dict(BASE.as_json()["place"][0], turns=0)]},
        {"place": [dict(BASE.as_json()["place"][0], name="../lidar")]},
        {"place": BASE.as_json()["place"][:1] * 2},
        {"resolution": "16"},
    ],
)
def test_another_header_is_refused(change):
    with pytest.raises(ValueError):
        PlacePurpose.from_json(BASE.as_json() | change)


@pytest.mark.parametrize(
    ("fields", "what"),
    [
        ({"name": "a b"}, "name"),
        ({"score": "S11"}, "lidar: unknown score"),
        ({"dim": 0}, "lidar: the dimension"),
        ({"turns": 17}, "lidar: turns are 1 to 16"),
        ({"turns": True}, "lidar: turns are 1 to 16"),
        ({"max_norm": float("nan")}, "lidar: max_norm"),
        ({"min_norm": 1.5}, "lidar: min_norm"),
        ({"dim": 1 << 20, "max_norm": 2.0**20}, "lidar: vectors of"),
    ],
)
def test_a_part_out_of_range_is_refused_by_name(fields, what):
    with pytest.raises(ValueError, match=what):
        replace(LIDAR, **fields)


@pytest.mark.parametrize("limits", [{}, {"lidar": 0.3}, {"lidar": 0.3, "camera": 0.1, "odd": 1.0}, 0.5])
def test_every_part_has_a_threshold_and_nothing_else_has(limits):
    with pytest.raises(ValueError, match=r"each of its parts \(camera, lidar\)"):
        BASE.terms(limits, "malicious")
    with pytest.raises(ValueError, match="finite"):
        BASE.terms({"lidar": float("nan"), "camera": 0.1}, "malicious")


def test_the_rule_in_words_names_every_part():
    limits = {"lidar": 0.42, "camera": 0.8}
    assert BASE.in_words(limits) == "any of lidar S10 >= 0.42 (2 turns), camera S10 >= 0.8, to 2^-16"
    assert replace(BASE, rule="all", resolution=None).in_words(limits).startswith("all of lidar S10 >= 0.42")
    assert PlacePurpose((CAMERA,)).in_words({"camera": 0.8}) == "camera S10 >= 0.8, to 2^-16"


def test_places_that_do_not_suit_are_refused_by_the_name_of_the_part():
    x = places(BASE, 2)
    for at, name in ((0, r"lidar \(turn 0\)"), (7, r"lidar \(turn 1\)"), (14, "camera")):
        bad = x.copy()
        bad[1, at] = 1.5
        with pytest.raises(ValueError, match=name):
            BASE.plain(bad, x, thresholds(BASE))
        bad[1, at] = np.nan
        with pytest.raises(ValueError, match=name):
            BASE.plain(x, bad, thresholds(BASE))


def test_sections_make_up_the_whole_vector():
    program = BASE.dealt_terms("malicious").program
    with pytest.raises(ValueError, match="whole vector"):
        Terms(program, BASE.dim + 1)
    with pytest.raises(ValueError, match="smallest norm"):
        Terms(program, BASE.dim, min_norm=0.5)
