"""Steps of a gallery with one peer, over connections that break at any byte."""

import os
from unittest.mock import patch

import numpy as np
import pytest
from link_helpers import Link
from stream_helpers import (
    STREAMS,
    check_stream,
    deal,
    expected,
    fresh,
    maps,
    robots,
    stream,
    table_of,
)

from spdz import ChannelError
from spdz.session import comparing

pytestmark = pytest.mark.usefixtures("quick_disk")

CUTS = int(os.environ.get("SPDZ_DROPS", "40"))
"""Drops tried a direction; a stream has some 4,000 bytes a direction, and so many of them try every byte."""


@pytest.fixture(scope="module")
def dealt(tmp_path_factory):
    return deal(tmp_path_factory.mktemp("gallery") / "m")


def whole_stream(mission):
    link = Link()
    results = robots(mission, link, stream)
    return link.sent[0], results


def limits(total, cuts):
    return sorted({1 + k * total // cuts for k in range(cuts)})


def test_all_that_both_bring_is_compared_once(dealt, tmp_path):
    link = Link()
    check_stream(robots(fresh(dealt, tmp_path / "m"), link, stream))
    assert len(link.ends) == 1


@pytest.mark.parametrize("sender", [0, 1])
def test_a_drop_at_any_byte_of_a_stream_loses_and_repeats_nothing(dealt, tmp_path, sender):
    total = whole_stream(fresh(dealt, tmp_path / "whole"))[0][sender]
    for limit in limits(total, CUTS):
        link, blocks = Link([(sender, limit)]), ([], [])

        def work(one, party):
            one._on_block = blocks[party].append  # noqa: B023
            return stream(one, party)

        results = robots(fresh(dealt, tmp_path / f"m-{limit}"), link, work)
        check_stream(results)
        for (steps, _), seen in zip(results, blocks, strict=True):
            assert [id(block) for block in seen] == [id(block) for step in steps for block in step.blocks]
        assert len(link.ends) == 2, limit


def test_drop_after_drop_is_survived_strip_by_strip(dealt, tmp_path):
    link = Link([(k % 2, 1500 + 60 * k) for k in range(9)])
    with patch.object(comparing, "STRIP_PAIRS", 1):
        check_stream(robots(fresh(dealt, tmp_path / "m"), link, stream))
    assert len(link.ends) >= 5


@pytest.mark.parametrize(
    ("score", "security", "purpose"),
    [
        ("S10", "semi-honest", {}),
        ("S6", "malicious", {"min_norm": 0.5}),
        ("S1", "malicious", {}),
        ("S3", "semi-honest", {}),
        ("S3", "malicious", {}),
        ("S10", "malicious", {"reveal": "score"}),
    ],
)
def test_any_score_goes_on_after_a_drop_with_what_can_still_be_answered(tmp_path, score, security, purpose):
    """Slots half prepared are lost, not what was in them; a strip that was cut off may be, not its slots."""
    dealt = deal(tmp_path / "m", (12, 10), security, score, **purpose)
    threshold = None if "reveal" in purpose else 0.7

    def work(one, party):
        steps, stored = stream(one, party)
        return steps, stored, one._session.plain(one.filled), one.filled

    def table(result, shape):
        """In the order of the descriptors, NaN where there is no answer."""
        _, stored, _, own = result
        found = np.full((30, 30), np.nan)
        for block in stored:
            found[np.ix_(block.own, block.peer)] = block.results
        return found[own], own

    link = Link()
    whole = robots(fresh(dealt, tmp_path / "whole"), link, work, threshold=threshold)
    shape = expected(0).shape
    right = table(whole[0], shape)[0][:, whole[1][3]]
    assert not np.isnan(right).any() and right.shape == shape
    lost = 0
    for sender in (0, 1):
        for limit in limits(link.sent[0][sender], min(CUTS, 12)):
            folder = fresh(dealt, tmp_path / f"m-{sender}-{limit}")
            results = robots(folder, Link([(sender, limit)]), work, threshold=threshold)
            for party, result in enumerate(results):
                assert not isinstance(result, Exception), (limit, result)
                held = np.rint(maps()[party] * 65536)
                assert np.array_equal(result[2], held)  # each descriptor in one slot, in order
                assert result[3] == [slot for step in result[0] for slot in step.own]
                assert results[1 - party][3] == [slot for step in result[0] for slot in step.peer]
                _, known = table_of([b for step in result[0] for b in step.blocks], (30, 30))
                assert known.max() <= 1
            first = table(results[0], shape)[0][:, results[1][3]]
            second = table(results[1], shape)[0][:, results[0][3]].T
            for found in (first, second):
                known = ~np.isnan(found)
                lost += int((~known).sum())
                assert np.allclose(found[known], right[known], atol=2e-4)
    assert (lost > 0) == (score == "S3" and security == "malicious")


def test_the_end_of_the_last_step_is_served_by_a_robot_that_has_finished(dealt, tmp_path):
    marks = {}

    def work(one, party):
        result = stream(one, party)
        marks[party] = one._session._channel.bytes_sent
        return result

    robots(fresh(dealt, tmp_path / "whole"), Link(), work)
    for sender, end in marks.items():
        for missing in (1, 17, 33, 60):
            events = []
            folder = fresh(dealt, tmp_path / f"m-{sender}-{missing}")
            link = Link([(sender, end - missing)])
            check_stream(robots(folder, link, stream, farewell=20.0, on_event=events.append))
            assert len(link.ends) == 2 and not any("ended without" in event for event in events)


def test_what_was_decided_is_kept_when_the_peer_is_gone_for_good(dealt, tmp_path):
    sizes = [[len(new) for new in side] for side in STREAMS]
    with patch.object(comparing, "STRIP_PAIRS", 1):
        total = whole_stream(fresh(dealt, tmp_path / "whole"))[0][1]
        link = Link([(1, total // 2)], timeout=1.0)
        reach, put = [], link.calls.put
        link.calls.put = lambda end: None if reach else reach.append(put(end))  # later calls reach nobody
        kept = ([], [])

        def work(one, party):
            for new in STREAMS[party]:
                one.add(new)
                try:
                    kept[party].append(one.step())
                except ChannelError as error:
                    assert error.partial is one.partial
                    return [*kept[party], error.partial]

        results = robots(fresh(dealt, tmp_path / "m"), link, work, wait=0.5)
    for party, steps in enumerate(results):
        assert 0 < len(steps) < len(sizes[party])
        right = expected(party)
        table, known = table_of([block for step in steps for block in step.blocks], right.shape)
        assert 0 < known.sum() < right.size and known.max() == 1
        assert np.array_equal(table[known == 1], right[known == 1])


def test_a_step_that_an_error_has_broken_off_goes_on_with_what_it_had(dealt, tmp_path):
    broken = []

    def work(one, party):
        steps = []
        for new in STREAMS[party]:
            one.add(new)
            while True:
                try:
                    steps.append(one.step())
                    break
                except ChannelError as error:
                    broken.append(len(error.partial.blocks))
                    link.cuts[:] = link.cuts[: len(link.ends)]
        return steps, list(one.results())

    with patch.object(comparing, "STRIP_PAIRS", 1):
        total = whole_stream(fresh(dealt, tmp_path / "whole"))[0][0]
        link = Link([(0, total * 3 // 5), *[(0, 50)] * 200], timeout=2.0)
        check_stream(robots(fresh(dealt, tmp_path / "m"), link, work, wait=0.3))
    assert broken and max(broken) > 0
