"""A masked input that would leave its interval is not sent: its job is used up, and the next one is run.

By the rule that happens once in 2^25 times.
"""

from itertools import count
from queue import SimpleQueue
from unittest.mock import patch

import numpy as np
import pytest
from link_helpers import Link, all_batches, check_all, mission, robots
from session_helpers import deal, run_pair, state_dirs

from protocols import batching
from spdz import ChannelError, PeerAborted, run_local
from spdz.channels import FrameKind
from spdz.channels.memory import MemoryChannel
from spdz.foundations.errors import Unsent
from spdz.tape import Tape
from spdz.values import input_mask

SECURITIES = ["malicious", "semi-honest"]
MANY, FEW = (99,), (2,)


def nothing_inside(which):
    """The interval is empty where ``which(x)`` says so of an input that is to be sent."""
    hide = input_mask.hide

    def patched(x, r, bits, norm):
        return hide(x, r, bits, 1 << (bits - 1) if which(x) else norm)

    return patch.object(input_mask, "hide", patched)


async def added_up(engine, x, y):
    return x.sum() + y.sum()


added_up.max_norm = 1.0


class Watched(MemoryChannel):
    """Notes the kinds of its frames."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.kinds = []

    def post(self, kind, *arguments):
        self.kinds.append(kind)
        super().post(kind, *arguments)


@pytest.mark.parametrize("security", SECURITIES)
@pytest.mark.parametrize("owner", [0, 1])
@pytest.mark.parametrize("jobs", [1, 2])
def test_an_owner_stops_before_it_sends_and_both_can_go_on(tmp_path, owner, security, jobs):
    shapes = (MANY, FEW)[:: 1 - 2 * owner]
    inputs = [np.full(shape, 0.0625) for shape in shapes]
    states = state_dirs(tmp_path)

    paths = deal(tmp_path / "mission", added_up, shapes, 5, security)
    pipes = (SimpleQueue(), SimpleQueue())
    ends = [Watched(*pipes[::step], 5.0) for step in (1, -1)]

    def work(session):
        before = session.remaining
        return before, session.run_many(added_up, [inputs[session.party]] * jobs).value

    with nothing_inside(lambda x: x.shape == MANY):
        outcomes = run_pair(paths, states, work, channels=ends)
    unsent, told = outcomes[owner], outcomes[1 - owner]
    assert type(unsent) is Unsent and isinstance(unsent, ChannelError) and unsent.passing
    assert "nothing was sent; run the next job" in str(unsent)
    assert isinstance(told, PeerAborted) and told.passing
    assert FrameKind.DATA not in ends[owner].kinds
    assert ends[1 - owner].kinds[-1] == FrameKind.DATA
    # These jobs are used up, and no others.
    assert run_pair(paths, states, work) == [(5 - jobs, [101 * 0.0625] * jobs)] * 2


def test_a_run_in_one_process_stops_as_well():
    frames = []
    with (
        patch.object(input_mask, "job_bits", lambda shape, norm: 18),
        pytest.raises(Unsent),
    ):  # half are outside
        run_local(added_up, np.full(99, 0.0625), np.full(2, 0.5), tamper=lambda *frame: frames.append(frame))
    assert not frames


@pytest.mark.parametrize("security", SECURITIES)
def test_a_matcher_goes_on_with_the_next_jobs(tmp_path, security, monkeypatch):
    monkeypatch.setattr("spdz.tape.durable.os.fsync", lambda descriptor: None)
    paths, events, link = mission(tmp_path / "m", 400, security=security), [], Link()
    calls, bad = count(), {0, 5, 6, 11, 18, 24}
    with patch.object(batching, "MOST_JOBS", 1), nothing_inside(lambda x: next(calls) in bad):
        check_all(robots(tmp_path, paths, link, all_batches, on_event=events.append))
    assert sum("does not suit this input" in event for event in events) == len(bad)
    assert len(bad) // 2 < len(link.ends) <= 1 + len(bad)
    for path, state in zip(paths, (tmp_path / "state-0", tmp_path / "state-1"), strict=True):
        with Tape.open(path, state_dir=state) as tape:
            lost = 400 // 4 - 8 - tape.remaining  # 8 tiles, of 4 comparisons each
            assert len(bad) // 2 <= lost <= len(bad)
