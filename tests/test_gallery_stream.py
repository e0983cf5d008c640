"""Steps of a gallery with one peer, over connections that break at any byte."""

import os
import time

import pytest
from link_helpers import Link
from stream_helpers import STREAMS, check_stream, deal, fresh, robots, stream

pytestmark = pytest.mark.usefixtures("quick_disk")

CUTS = int(os.environ.get("SPDZ_DROPS", "40"))
"""Drops tried a direction; a whole stream has some thousands of bytes a direction."""


@pytest.fixture(scope="module")
def dealt(tmp_path_factory):
    return deal(tmp_path_factory.mktemp("gallery") / "m")


def test_all_that_both_bring_is_compared_once(dealt, tmp_path):
    link = Link()
    check_stream(robots(fresh(dealt, tmp_path / "m"), link, stream))
    assert len(link.ends) == 1


@pytest.mark.parametrize("sender", [0, 1])
def test_a_drop_at_any_byte_loses_and_repeats_nothing(dealt, tmp_path, sender):
    link = Link()
    robots(fresh(dealt, tmp_path / "whole"), link, stream)
    total = link.sent[0][sender]
    slow = []
    for limit in sorted({1 + k * total // CUTS for k in range(CUTS)}):
        link = Link([(sender, limit)])
        t = time.time()
        check_stream(robots(fresh(dealt, tmp_path / f"m-{limit}"), link, stream))
        slow.append((round(time.time() - t, 2), limit, len(link.ends)))
    print(total, slow)
