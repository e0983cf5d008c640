"""Lanes of `parallel` share rounds, and a check is a barrier over all of them."""

import pytest

from spdz.rounds.coroutine import Check, Exchange, check, exchange, parallel, run_silently


def drive(protocol):
    """Step a protocol and return (requests seen, result); exchanges are echoed."""
    seen, reply = [], None
    try:
        while True:
            request = protocol.send(reply)
            seen.append(request)
            reply = memoryview(b"".join(request.payload)) if isinstance(request, Exchange) else None
    except StopIteration as done:
        return seen, done.value


async def talker(messages):
    return [bytes(await exchange([message], len(message), 1)) for message in messages]


def test_lanes_share_a_round_and_get_their_own_part():
    seen, result = drive(parallel(talker([b"aa", b"bbb"]), talker([b"c"]), talker([])))
    assert [b"".join(request.payload) for request in seen] == [b"aac", b"bbb"]
    assert [request.elements for request in seen] == [2, 1]
    assert result == [[b"aa", b"bbb"], [b"c"], []]


def test_a_check_waits_for_every_lane_and_travels_alone():
    async def early():
        await check()
        return await talker([b"after"])

    async def late():
        words = await talker([b"one", b"two"])
        await check()
        return words

    seen, result = drive(parallel(early(), late()))
    assert [type(request) for request in seen] == [Exchange, Exchange, Check, Exchange]
    assert result == [[b"after"], [b"one", b"two"]]


def test_groups_nest():
    seen, _ = drive(parallel(parallel(talker([b"a"]), talker([b"b"])), talker([b"c"])))
    assert [b"".join(request.payload) for request in seen] == [b"abc"]


def test_a_failing_lane_closes_the_others():
    closed = []

    async def patient():
        try:
            await exchange([b"x"], 1, 1)
        finally:
            closed.append(True)

    async def failing():
        raise ValueError("lane")

    with pytest.raises(ValueError, match="lane"):
        drive(parallel(patient(), failing()))
    assert closed == [True]


def test_a_silent_drive_sees_every_request():
    async def protocol():
        await exchange([], 0, 0)
        await check()
        return "done"

    requests = []
    assert run_silently(protocol(), requests.append) == "done"
    assert [type(request) for request in requests] == [Exchange, Check]
