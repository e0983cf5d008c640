"""What the documentation says a gallery costs is what the meter says, and what its files take."""

import re
from pathlib import Path

import numpy as np
import pytest
from gallery_session_helpers import feed, no_errors, prepare_at_a_time, unit_vectors

from dealer import gallery_report
from dealer.gallery import gallery_headers
from dealer.gallery_plan import gallery_cost
from protocols import is_candidate
from protocols.catalog import GalleryPurpose
from protocols.scores import SCORES
from spdz import measure
from spdz.dcf import signs
from spdz.gallery import gallery_bytes
from spdz.readings.gallery_plan import measure_gallery

DOCS = Path(__file__).resolve().parent.parent / "docs"
COST = (DOCS / "spec" / "protocols.md").read_text(encoding="utf-8").partition("**Cost** of S10 with")[2]
SIZES = (DOCS / "reference.md").read_text(encoding="utf-8").partition("## Tape sizes")[2]
JOBS, GALLERIES = SIZES.partition("\n## ")[0].split("**Galleries.**")
HOW_TO = (DOCS / "how-to.md").read_text(encoding="utf-8")
FRACTION = 32  # of S10


def table(text: str, first: str) -> list[list[str]]:
    """The cells of the rows of the table whose header begins with ``first``."""
    body = text.partition(f"| {first}")[2].partition("|\n|---")[2]
    rows = re.match(r"[-|]*\n((?:\|.*\|\n)+)", body)
    assert rows is not None, first
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows[1].splitlines()]


def formulas(first: str) -> dict[str, list[str]]:
    return {name: [cell.strip("`") for cell in cells] for name, *cells in table(COST, first)}


class Case:
    """One gallery of S10, and the numbers that its formulas are in."""

    def __init__(self, dim: int, norm: float, resolution: int | None, security: str = "malicious") -> None:
        self.purpose = GalleryPurpose("S10", dim, max_norm=norm, resolution=resolution)
        self.terms = self.purpose.dealt_terms(security)
        self.plan = measure_gallery(self.terms)
        drop = 0 if resolution is None else max(0, FRACTION - resolution)
        self.known = {"N": dim, "B": self.terms.norm, "f": drop}
        shared = formulas("what | formula")
        for name in ("w", "b"):
            self.known[name] = self.value(shared[name][0])
        self.known["L"] = self.known["b"] - 1 - drop

    def value(self, formula: str) -> int:
        return int(eval(formula, {"__builtins__": {}}, dict(self.known)))

    def values(self, cells: list[str]) -> tuple[int, int]:
        first, second = map(self.value, cells)
        return first, second


CASES = [
    (16, 1.0, 16),
    (1536, 1.0, 16),
    (1536, 1.0, None),
    (8192, 1.0, 20),
    (100, 37.5, 10),
    (256, 900.0, 16),
    (64, 1.4, 2),  # half a step takes a bit more
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_formulas_of_the_spec_are_the_plan_of_a_malicious_gallery(case):
    case = Case(*case)
    told = {name: case.values(cells) for name, cells in formulas("malicious: what").items()}
    slots, pair = case.plan.slots, case.plan.pair
    assert told == {
        "stored for a slot of party 0": slots[0].correction_bytes,
        "stored for a slot of party 1": slots[1].correction_bytes,
        "stored for a pair": pair.correction_bytes,
        "pad of a slot, without Delta": slots[0].pad_bytes,
        "pad of a pair": pair.pad_bytes,
    }
    assert slots[0].pad_bytes == slots[1].pad_bytes
    for record in (*slots, pair):
        assert (record.elements_sent, record.rounds, record.openings) == ((1, 1), 4, 1)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_formulas_of_the_spec_are_the_plan_of_a_semi_honest_gallery(case):
    case = Case(*case, security="semi-honest")
    told = {name: case.values(cells) for name, cells in formulas("semi-honest: what").items()}
    first, second = case.plan.slots
    assert first.correction_bytes == second.correction_bytes
    assert told == {
        "stored for a slot of either party": first.correction_bytes,
        "stored for a pair": case.plan.pair.correction_bytes,
    }


@pytest.mark.parametrize("case", CASES, ids=str)
def test_words_and_levels_of_the_spec_are_those_of_the_engine(case):
    case = Case(*case)
    known = case.known
    assert known["w"] == case.terms.word_bits
    assert known["L"] == signs.sign_levels(known["b"], known["f"])
    assert case.value(formulas("what | formula")["sent for a slot: words"][0]) == known["N"] * -(
        -case.terms.word_bits // 8
    )


def test_word_lengths_of_the_spec():
    text = (DOCS / "spec" / "protocols.md").read_text(encoding="utf-8").partition("## 23.")[2]
    (header,) = re.findall(r"^\| N, `max_norm` 1 \|(.*)\|$", text, re.MULTILINE)
    bits, sizes = table(text, "N, `max_norm` 1")
    for dim, *told in zip(header.split("|"), bits[1:], sizes[1:], strict=True):
        words = GalleryPurpose("S10", int(dim.replace(",", ""))).dealt_terms("malicious").word_bits
        assert (words, -(-words // 8)) == tuple(map(int, told))


def headers(purpose: GalleryPurpose, slots: tuple[int, int]):
    terms = purpose.dealt_terms("malicious")
    facts = {"mission": "0" * 32, "tape": "0" * 32, "description": purpose.as_json()}
    return gallery_headers(measure_gallery(terms), terms, ("alice", "bob"), slots, **facts)


@pytest.mark.parametrize("slots", [(1, 1), (20, 5), (300, 300)], ids=str)
def test_the_formula_of_the_spec_is_the_size_of_a_file(slots):
    formula = re.findall(r"^`(4096 .*)`$", COST, re.MULTILINE)[0]
    for header in headers(GalleryPurpose("S10", 96), slots):
        (sizes, counts), stored = header.bands, header.slot_correction
        known = {"S0": sizes[0], "S1": sizes[1], "K0": counts[0], "K1": counts[1]}
        known |= {"slot0": stored[0], "slot1": stored[1], "pair": header.pair_correction}
        assert eval(formula, {"__builtins__": {}}, known) == gallery_bytes(header)


def test_sizes_of_galleries_in_the_reference():
    rows = table(GALLERIES, "score | N | resolution")
    assert len(rows) >= 5
    for score, dim, resolution, *told in rows:
        purpose = GalleryPurpose(score, int(dim), resolution=None if resolution == "exact" else 16)
        first, second = headers(purpose, (300, 300))
        numbers = [*first.slot_correction, first.pair_correction]
        assert [f"{number:,}" for number in numbers] == told[:3]
        assert (second.slot_correction[1], second.slot_correction[0]) == tuple(n - 16 for n in numbers[:2])
        for slots, size in zip((300, 1000, 5000), told[3:], strict=True):
            largest = max(map(gallery_bytes, headers(purpose, (slots, slots))))
            assert f"{largest / 1e6:,.1f}" == size


def test_sizes_of_jobs_in_the_reference():
    names: list[str] = []
    for score, dim, *told in table(JOBS, "score | N | malicious"):
        names = score.split(", ") if score else names
        for security, sizes in (("malicious", told[:2]), ("semi-honest", told[2:])):
            for norm, size in zip((2.0**22, 1.0), sizes, strict=True):
                stored = [
                    max(measure(program, ((1, 1, int(dim)),) * 2, security).correction_bytes)
                    for program in (is_candidate(SCORES[name].within(norm), 0.5) for name in names)
                ]
                assert f"{-(-max(stored) // 1000):,}" == size, (names, dim, security, norm)


@pytest.mark.usefixtures("no_sync")
@pytest.mark.parametrize(
    ("score", "security"), [("S10", "malicious"), ("S10", "semi-honest"), ("S8", "malicious")]
)
def test_rounds_of_a_step_are_those_that_the_plan_and_the_how_to_say(galleries, monkeypatch, score, security):
    """Groups of 3 descriptors and strips of 6 pairs, in place of 128 and 65,536."""
    monkeypatch.setattr("spdz.session.comparing.STRIP_PAIRS", 6)
    prepare_at_a_time(monkeypatch, 3)
    purpose, vectors = GalleryPurpose(score, 16), unit_vectors(np.random.default_rng(1), 12, 16)
    cost = gallery_cost(("alice", "bob"), purpose, (300, 300), security, timed=False)
    sentence = next(
        line
        for line in gallery_report.as_text(cost, purpose, security, ("alice", "bob"), 0)
        if "rounds" in line
    )
    one, both = map(int, re.findall(r"(\d+) (?:rounds )?where", sentence))
    group = int(*(re.findall(r"(\d+) for each further 128 descriptors", sentence) or [0]))
    strip = int(*re.findall(r"(\d+) for each further 65,536 pairs", sentence))
    brought = [(1, 1), (1, 0), (1, 1), (0, 0), (6, 0)]
    parts = [np.split(vectors, np.cumsum([step[i] for step in brought]))[: len(brought)] for i in (0, 1)]
    mission = galleries(purpose.terms(0.5, security), (12, 12))
    for steps in no_errors(mission.meet(feed(parts[0]), feed(parts[1]))):
        assert [step.stats.rounds for step in steps] == [one, one, both, 1, one + group + strip]
    if (score, security) == ("S10", "malicious"):
        told = re.search(
            r"(\d+) rounds a step in which one side brings .*?, (\d+) if both do", HOW_TO, re.DOTALL
        )
        assert told and tuple(map(int, told.groups())) == (one, both)
        more = re.search(
            r"plus (\d+) for each further 128 .*? and (\d+) for each further 65,536", HOW_TO, re.DOTALL
        )
        assert more and tuple(map(int, more.groups())) == (group, strip)
