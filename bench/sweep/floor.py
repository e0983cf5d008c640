"""The floor of a time: the same frames over the same kind of socket, in bare Python, with nothing computed.

A comparison sends frames in rounds. This module replays their sizes, headers included, both directions at
once, round by round, over a TCP socket with ``TCP_NODELAY``, and waits as the engine's channel does
(:mod:`spdz.channels.socket_channel`): it looks a hundred times before it sleeps. No protocol with these
frames takes less in this language on this machine; what a comparison takes beyond it is the engine's.

::

    with recorded_frames(channel) as frames:
        session.run(program, descriptor)
    seconds = bare_rounds(both_directions(frames, party), trials=10)
"""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeAlias

from bench.parties import free_port, pin, run_processes
from spdz.channels import Channel

Frames: TypeAlias = Sequence[tuple[int, int]]
"""A round each: the bytes that party 0 sends in it and those that party 1 sends, frame headers included."""

WARM_UP = 10
"""Uncounted trials before the counted ones."""

_SLICE = 256 << 10
_SPINS = 100
_WAIT = 30.0


# -- what a comparison sends -----------------------------------------------------------------------------


@contextmanager
def recorded_frames(channel: Channel) -> Iterator[list[tuple[int, int]]]:
    """Note what a channel exchanges while the block runs: (bytes sent, bytes received) a round.

    Control messages are left out, as in a run's statistics. After the block the channel is as it was.
    """
    frames: list[tuple[int, int]] = []
    take = channel.take

    def noting() -> memoryview:
        rounds, sent, received = channel.rounds, channel.bytes_sent, channel.bytes_received
        reply = take()
        if channel.rounds > rounds:
            frames.append((channel.bytes_sent - sent, channel.bytes_received - received))
        return reply

    vars(channel)["take"] = noting
    try:
        yield frames
    finally:
        del vars(channel)["take"]


def both_directions(frames: Sequence[tuple[int, int]], party: int) -> list[tuple[int, int]]:
    """What a party recorded, (sent, received), as :data:`Frames`: (by party 0, by party 1)."""
    return [(sent, received) if party == 0 else (received, sent) for sent, received in frames]


# -- the same without the rest ---------------------------------------------------------------------------


def bare_rounds(frames: Frames, trials: int, *, warm_up: int = WARM_UP) -> list[float]:
    """Replay frames between two fresh processes on a core each, over loopback.

    Args:
        frames: What to send, round by round.
        trials: How often to time all rounds.
        warm_up: Uncounted trials before those.

    Returns:
        Seconds a trial: the slower of the two parties.
    """
    first, second = run_processes(_bare_party, _Task(list(frames), trials, warm_up, free_port()))
    return [max(pair) for pair in zip(first, second, strict=True)]


def bare_socket(index: int, port: int, host: str = "127.0.0.1") -> socket.socket:
    """One end of a TCP connection set up as the engine's: party 0 listens, party 1 calls.

    Args:
        index: The party.
        port: Where party 0 listens, and party 1 calls.
        host: The same.

    Raises:
        OSError: if the other side does not come within 30 s.
    """
    deadline = time.monotonic() + _WAIT
    if index == 0:
        with socket.create_server((host, port)) as listener:
            listener.settimeout(_WAIT)
            sock, _ = listener.accept()
    else:
        sock = _called(host, port, deadline)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    sock.setblocking(False)
    return sock


def bare_trials(
    sock: socket.socket, index: int, frames: Frames, trials: int, warm_up: int = WARM_UP
) -> list[float]:
    """One party's side of a replay over a connected socket that does not block; seconds a trial.

    Raises:
        OSError: if the connection breaks, or 30 s pass without a byte.
    """
    longest = max((max(pair) for pair in frames), default=0)
    out, into = memoryview(bytes(longest)), memoryview(bytearray(longest))
    rounds = [(out[: pair[index]], into[: pair[1 - index]]) for pair in frames]
    poll = select.poll()
    seconds = []
    for _ in range(trials + warm_up):
        started = time.perf_counter()
        for sent, received in rounds:
            _swap(sock, poll, sent, received)
        seconds.append(time.perf_counter() - started)
    return seconds[warm_up:]


@dataclass(frozen=True, slots=True)
class _Task:
    frames: Frames
    trials: int
    warm_up: int
    port: int


def _bare_party(index: int, task: _Task, pipe: Any) -> None:
    pin(index)
    with bare_socket(index, task.port) as sock:
        pipe.send(bare_trials(sock, index, task.frames, task.trials, task.warm_up))


def _called(host: str, port: int, deadline: float) -> socket.socket:
    while True:
        try:
            return socket.create_connection((host, port), timeout=_WAIT)
        except OSError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.01)


def _swap(sock: socket.socket, poll: select.poll, out: memoryview, into: memoryview) -> None:
    """Send and receive one frame, both at once."""
    while out or into:
        before = len(out) + len(into)
        if out:
            try:
                out = out[sock.send(out[:_SLICE]) :]
            except BlockingIOError:
                pass
        if into:
            try:
                count = sock.recv_into(into)
            except BlockingIOError:
                pass
            else:
                if not count:
                    raise ConnectionAbortedError("the other side of the replay hung up")
                into = into[count:]
        if (out or into) and len(out) + len(into) == before:
            _wait(sock, poll, select.POLLOUT * bool(out) | select.POLLIN * bool(into))


def _wait(sock: socket.socket, poll: select.poll, events: int) -> None:
    poll.register(sock, events)
    if not any(poll.poll(0) for _ in range(_SPINS)) and not poll.poll(_WAIT * 1000):
        raise TimeoutError("the other side of the replay sends nothing")
