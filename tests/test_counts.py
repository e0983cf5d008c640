"""Rounds, bytes, tape and correlations of every score are exact, and are those of ``vectors/counts.json``."""

import pytest
from count_helpers import CELLS, SECURITIES, count, inputs, recorded
from session_helpers import deal, run_pair, state_dirs

from protocols.scores import SCORES
from spdz.tape import Tape

RECORDED = recorded()
FRAME_HEADER, ELEMENT = 16, 16
WORDS = {1: 6, 7: 6, 16: 6, 1536: 7}
"""Bytes of a masked coordinate on the line, by length (docs/spec/protocols.md, 4)."""


def test_the_file_has_every_cell_once():
    assert list(RECORDED) == CELLS


@pytest.mark.parametrize("cell", CELLS, ids=lambda cell: "-".join(map(str, cell)))
def test_counts_are_exact(cell):
    assert count(*cell) == RECORDED[cell], "if this is meant: python tests/count_helpers.py"


@pytest.mark.parametrize("n", WORDS)
def test_a_dot_product_sends_its_coordinates_an_element_and_the_check(n):
    semi_honest, malicious = (RECORDED["S10", n, security] for security in ("semi-honest", "malicious"))
    sent = FRAME_HEADER + n * WORDS[n] + FRAME_HEADER + ELEMENT
    assert semi_honest["bytes_sent"] == [sent, sent]
    assert malicious["bytes_sent"] == [sent + FRAME_HEADER + ELEMENT] * 2
    assert (semi_honest["rounds"], malicious["rounds"]) == (2, 3)


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("name", SCORES)
def test_sessions_with_tapes_send_and_read_the_same(name, security, tmp_path, quick_disk):
    program, n = SCORES[name].within(1.0), 16
    paths = deal(tmp_path, program, ((n,), (n,)), 1, security)
    works = [lambda session, vector=vector: session.run(program, vector).stats for vector in inputs(n)]
    both = run_pair(paths, state_dirs(tmp_path), *works)
    expected = RECORDED[name, n, security]
    assert [stats.bytes_sent for stats in both] == expected["bytes_sent"]
    assert {stats.rounds for stats in both} == {expected["rounds"]}
    assert [dict(sorted(stats.correlations.items())) for stats in both] == [expected["correlations"]] * 2
    for number, path in enumerate(paths):
        with Tape.open(path, state_dir=tmp_path / "read") as tape:
            assert tape.header.correction_bytes == expected["tape_bytes"][number]
