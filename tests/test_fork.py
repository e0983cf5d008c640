"""A fork never writes: whatever a child does with an inherited channel, the peer and the parent go on."""

import os
import select
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from channel_helpers import DATA, LONG, assert_alive, meet, ways

from spdz.channels import AbortReason, MemoryChannel
from spdz.foundations.errors import ChannelClosed, ChannelError

ROOT = Path(__file__).resolve().parent.parent


def in_a_child(work):
    """Run ``work`` in a fork; it must return without an error."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            work()
            status = 0
        finally:
            os._exit(status)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 0


def exchange(channel):
    with pytest.raises(ChannelError, match="connect after the fork"):
        channel.exchange(DATA, [b"secret"], 6)


def leave_by_an_error(channel):
    with suppress(RuntimeError), channel:
        raise RuntimeError


def leave(channel):
    with channel:
        pass


def abort_and_close(channel):
    channel.abort(AbortReason.STOPPED)
    channel.close()


def exchange_after_closing(channel):
    channel.close()
    exchange(channel)


@pytest.mark.parametrize(
    "work",
    [exchange, leave, leave_by_an_error, abort_and_close, exchange_after_closing, lambda channel: None],
)
def test_a_child_sends_nothing_and_the_parent_goes_on(pair, work):
    a, b = pair()
    assert_alive(a, b)
    in_a_child(lambda: work(a))
    if not isinstance(b, MemoryChannel):
        assert select.select([b._stream], [], [], 0)[0] == []  # not a byte, and not an end
    assert_alive(a, b)
    assert_alive(a, b)


@pytest.mark.parametrize("kind", ["tcp", "tls"])
def test_a_child_closes_its_descriptor(folders, kind):
    a, b = meet(*ways(kind, folders), timeout=LONG)

    def work():
        descriptor = a._stream.fileno()
        a.close()
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(descriptor)

    with a, b:
        in_a_child(work)


def test_an_unsent_rest_stays_with_the_parent(folders):
    a, b = meet(*ways("tls", folders), timeout=LONG)
    with a, b:
        a._stream._tls.write(b"not sent yet")
        assert a._stream.backlog
        in_a_child(lambda: abort_and_close(a))
        assert select.select([b._stream], [], [], 0)[0] == []


@pytest.mark.parametrize("kind", ["tcp", "tls"])
def test_the_peer_learns_that_the_parent_hung_up_although_a_child_lives(folders, kind):
    a, b = meet(*ways(kind, folders), timeout=LONG)
    wait, release = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(release)
        os.read(wait, 1)
        os._exit(0)
    try:
        a.close()
        with b, pytest.raises(ChannelClosed):
            b.exchange(DATA, [], 1)
    finally:
        os.close(release)
        os.close(wait)
        os.waitpid(child, 0)


PROGRAM = """
import os, sys
sys.path.insert(0, {tests!r})
from pathlib import Path
from channel_helpers import assert_alive, pair_without_threads
from spdz.channels import AbortReason
a, b = pair_without_threads({kind!r}, Path({folders!r}))
child = os.fork()
if child == 0:
    {leave}
    sys.exit(0)
os.waitpid(child, 0)
assert_alive(a, b)
a.close()
b.close()
"""


@pytest.mark.parametrize("kind", ["tcp", "tls"])
@pytest.mark.parametrize(
    "leave", ["pass", "a.abort(AbortReason.LOCAL_ERROR)", "del a, b", "raise ValueError"]
)
def test_a_child_whose_interpreter_shuts_down_sends_nothing(folders, kind, leave):
    program = PROGRAM.format(tests=str(ROOT / "tests"), kind=kind, folders=str(folders), leave=leave)
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
