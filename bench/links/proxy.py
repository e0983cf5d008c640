"""A link by a forwarder of TCP on loopback, where no network namespace may be made: rate and delay, no loss.

It delays what the parties wrote, in pieces of a packet's size. TCP itself runs on loopback: it sees neither
the delay nor a loss, so there is no slow start after a pause and nothing is ever sent twice. Figures are
lower than over a true link for messages longer than TCP's first window (about 14 KB), most of all on a long
link.
"""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from queue import SimpleQueue

from bench.links.link import Line, Link

_PAYLOAD, _HEADERS = 1448, 52
"""Bytes of a packet of 1,500 that are payload, and those of its IP and TCP headers."""
_WAIT = 30.0


@contextmanager
def proxy_link(link: Link, target: int) -> Iterator[int]:
    """Forward to a port of this machine while the block runs; yields the port to call."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(0.1)
        stop = threading.Event()
        accepting = threading.Thread(target=_accept, args=(listener, target, link, stop), daemon=True)
        accepting.start()
        try:
            yield listener.getsockname()[1]
        finally:
            stop.set()
            accepting.join(10)


def _accept(listener: socket.socket, target: int, link: Link, stop: threading.Event) -> None:
    while not stop.is_set():
        with suppress(TimeoutError):
            caller, _ = listener.accept()
            peer = _reach(target)
            for one in (caller, peer):
                one.settimeout(None)
                one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            open_ends = threading.Semaphore(0)
            _forward(caller, peer, Line(link, 1), open_ends)
            _forward(peer, caller, Line(link, 0), open_ends)
            threading.Thread(target=_close, args=(caller, peer, open_ends), daemon=True).start()


def _reach(target: int) -> socket.socket:
    """Connect to who listens there, as soon as it does."""
    deadline = time.monotonic() + _WAIT
    while True:
        try:
            return socket.create_connection(("127.0.0.1", target), timeout=_WAIT)
        except ConnectionRefusedError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.01)


def _forward(source: socket.socket, sink: socket.socket, line: Line, done: threading.Semaphore) -> None:
    """Carry one direction in two threads: one reads and dates the pieces, one hands them over when due."""
    held: SimpleQueue[tuple[float, bytes]] = SimpleQueue()
    threading.Thread(target=_read, args=(source, line, held), daemon=True).start()
    threading.Thread(target=_write, args=(sink, held, done), daemon=True).start()


def _read(source: socket.socket, line: Line, held: SimpleQueue[tuple[float, bytes]]) -> None:
    with suppress(OSError):
        while piece := source.recv(_PAYLOAD):
            while (due := line.arrival(time.monotonic(), len(piece) + _HEADERS)) is None:
                time.sleep(0.001)  # the queue is full: nothing is lost here, the sender waits
            held.put((due, piece))
    held.put((0.0, b""))


def _write(sink: socket.socket, held: SimpleQueue[tuple[float, bytes]], done: threading.Semaphore) -> None:
    with suppress(OSError):
        while True:
            due, piece = held.get()
            if not piece:
                break
            time.sleep(max(0.0, due - time.monotonic()))
            sink.sendall(piece)
        sink.shutdown(socket.SHUT_WR)
    done.release()


def _close(caller: socket.socket, peer: socket.socket, open_ends: threading.Semaphore) -> None:
    for _ in range(2):
        open_ends.acquire()
    caller.close()
    peer.close()
