"""The floor of the benchmark: which frames a comparison sends, and the same frames without the rest."""

import functools
import threading

import pytest

from bench.parties import free_port
from bench.sweep.floor import (
    WARM_UP,
    bare_rounds,
    bare_socket,
    bare_trials,
    both_directions,
    recorded_frames,
)
from bench.sweep.standing import StandingPair
from spdz.channels import FrameKind
from spdz.channels.frames import HEADER_BYTES
from spdz.channels.memory import memory_pair


def together(*works):
    """Run calls at the same time and return what they returned, in order."""
    results = [None] * len(works)

    def run(index):
        results[index] = works[index]()

    threads = [threading.Thread(target=run, args=(index,), daemon=True) for index in range(len(works))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=30)
    return results


def talk(channel, own, theirs):
    channel.exchange(FrameKind.CONTROL, [b"{}"], None)
    for mine, yours in zip(own, theirs, strict=True):
        channel.exchange(FrameKind.DATA, [bytes(mine)], yours)


def test_what_is_exchanged_is_noted_with_headers_and_without_control_messages():
    first, second = memory_pair()
    with recorded_frames(first) as frames:
        together(lambda: talk(first, [5, 0], [7, 3]), lambda: talk(second, [7, 3], [5, 0]))
    assert frames == [(5 + HEADER_BYTES, 7 + HEADER_BYTES), (HEADER_BYTES, 3 + HEADER_BYTES)]
    together(lambda: talk(first, [1], [1]), lambda: talk(second, [1], [1]))
    assert len(frames) == 2, "noting has ended with the block"


def test_both_parties_recordings_are_the_same_frames():
    assert both_directions([(1, 2), (3, 4)], 0) == both_directions([(2, 1), (4, 3)], 1) == [(1, 2), (3, 4)]


def counting(sock, counts):
    """A socket that counts the bytes it sends and receives."""

    class Counting:
        def send(self, data):
            sent = sock.send(data)
            counts[0] += sent
            return sent

        def recv_into(self, space):
            count = sock.recv_into(space)
            counts[1] += count
            return count

        def fileno(self):
            return sock.fileno()

    return Counting()


def test_a_replay_moves_exactly_the_bytes_of_the_frames():
    frames = [(48, 96), (600_000, 16), (16, 700_001)]
    port, trials = free_port(), 3
    sockets = together(*(lambda index=index: bare_socket(index, port) for index in (0, 1)))
    counts = [[0, 0], [0, 0]]
    seconds = together(
        *(
            lambda index=index: bare_trials(counting(sockets[index], counts[index]), index, frames, trials)
            for index in (0, 1)
        )
    )
    for sock in sockets:
        sock.close()
    assert [len(each) for each in seconds] == [trials, trials] and min(map(min, seconds)) > 0
    by_first, by_second = (sum(pair[party] for pair in frames) * (trials + WARM_UP) for party in (0, 1))
    assert counts == [[by_first, by_second], [by_second, by_first]]


def test_a_replay_whose_other_side_hangs_up_ends():
    port = free_port()
    first, second = together(*(lambda index=index: bare_socket(index, port) for index in (0, 1)))
    second.close()
    with first, pytest.raises(ConnectionError):
        bare_trials(first, 0, [(16, 16)], 3)


def test_more_rounds_take_longer():
    short, long = ([(64, 64)] * rounds for rounds in (1, 200))
    assert min(bare_rounds(long, 5)) > min(bare_rounds(short, 5))


# The pair of processes


def name_and_party(index, line):
    return index, line.getpeername()[0]


def fall(index, line):
    raise ValueError("as the test wants")


def test_a_pair_serves_many_works_between_the_same_two_processes():
    with StandingPair() as pair:
        assert pair.run(name_and_party, name_and_party) == ((0, "127.0.0.1"), (1, "127.0.0.1"))
        frames = [(32, 64)] * 4
        works = [functools.partial(replay, frames=frames) for _ in range(2)]
        first, second = pair.run(*works)
        assert len(first) == len(second) == 3 and min(first + second) > 0


def replay(index, line, frames):
    return bare_trials(line, index, frames, 3)


def test_a_process_that_dies_is_told_and_nothing_hangs(capfd):
    with pytest.raises(RuntimeError, match="died"), StandingPair() as pair:
        pair.run(name_and_party, fall)
    assert "as the test wants" in capfd.readouterr().err
