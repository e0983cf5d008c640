"""Finding each other: who starts first, forwarders in between, port scans, and the greeting of plain TCP."""

import errno
import socket
import struct
import threading
import time
from contextlib import ExitStack

import pytest
from channel_helpers import (
    DATA,
    LONG,
    SHORT,
    assert_alive,
    dial,
    free_address,
    meet,
    read_raw,
    together,
    ways,
)

from spdz.channels import tcp
from spdz.channels.addresses import parse_address
from spdz.channels.reception import MAX_HANDSHAKES
from spdz.foundations.errors import ChannelError, ChannelTimeout

RESET = struct.pack("ii", 1, 0)


@pytest.mark.parametrize("kind", ["tcp", "tls"])
def test_the_caller_may_be_started_first(folders, kind):
    listen, connect = ways(kind, folders)
    address = free_address()
    started = threading.Event()

    def late():
        started.wait(LONG)
        time.sleep(0.15)
        return listen(address, wait=LONG)

    def early():
        started.set()
        return connect(address, wait=LONG)

    a, b = together(late, early)
    with a, b:
        assert_alive(a, b)


def forward_to_nobody(address, end, calls):
    """What a forwarder does whose target does not listen yet: it takes connections and ends them."""
    with socket.create_server(parse_address(address)) as forwarder:
        for _ in range(calls):
            sock, _ = forwarder.accept()
            if end == "reset":
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
            elif end == "close late":
                sock.recv(1 << 16)
            sock.close()


@pytest.mark.parametrize("end", ["reset", "close", "close late"])
@pytest.mark.parametrize("kind", ["tcp", "tls"])
def test_a_forwarder_that_takes_the_call_too_early_is_called_again(folders, kind, end):
    listen, connect = ways(kind, folders)
    address = free_address()

    def late():
        forward_to_nobody(address, end, 3)
        return listen(address, wait=LONG)

    a, b = together(late, lambda: connect(address, wait=LONG))
    with a, b:
        assert_alive(a, b)


@pytest.mark.parametrize("kind", ["tcp", "tls"])
def test_a_forwarder_that_never_reaches_anybody_is_a_timeout(folders, kind):
    _, connect = ways(kind, folders)
    with socket.create_server(("127.0.0.1", 0)) as forwarder:
        address = f"127.0.0.1:{forwarder.getsockname()[1]}"

        def end_all():
            forwarder.settimeout(4 * SHORT)
            with pytest.raises(TimeoutError):
                while True:
                    forwarder.accept()[0].close()

        _, error = together(end_all, lambda: connect(address, wait=2 * SHORT))
    with pytest.raises(ChannelTimeout, match=r"nobody answered .*is the other robot listening"):
        raise error


def test_what_only_connects_is_not_taken_for_the_peer():
    with ExitStack() as stack:

        def call(address):
            dial(address).close()
            scan = dial(address)
            scan.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
            scan.close()
            for rubbish in (
                b"GET / HTTP/1.1\r\n\r\n",
                tcp.CALLER_GREETING[:-1] + b"?",
                tcp.LISTENER_GREETING,
            ):
                stack.enter_context(dial(address)).sendall(rubbish)
            for _ in range(MAX_HANDSHAKES + 1):
                stack.enter_context(dial(address))
            return tcp.connect(address, wait=LONG)

        a, b = meet(lambda address, on_listening: tcp.listen(address, on_listening=on_listening), call)
        with a, b:
            assert_alive(a, b)


def test_a_listener_that_nobody_greeted_says_so():
    def call(address):
        with dial(address) as sock:
            sock.sendall(b"GET / HTTP/1.1\r\n\r\n")
            sock.settimeout(LONG)
            told = sock.recv(100), sock.recv(100)
            time.sleep(0.05)
            sock.sendall(b"\r\n")  # the end was no reset
            return told

    refusal, told = meet(
        lambda address, on_listening: tcp.listen(address, wait=3 * SHORT, on_listening=on_listening), call
    )
    with pytest.raises(ChannelError, match=r"callers refused: 1, .* did not send the greeting of plain TCP$"):
        raise refusal
    assert len(told[0]) == 17  # an ABORT frame
    assert told[1] == b""


def test_a_caller_refuses_whoever_does_not_greet():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        address = f"127.0.0.1:{listener.getsockname()[1]}"

        def answer():
            with listener.accept()[0] as sock:
                sock.sendall(b"\x15\x03\x03\0\x02\x02\x46")
                sock.recv(100)

        _, error = together(answer, lambda: tcp.connect(address, wait=LONG))
    with pytest.raises(ChannelError, match=r"greeting of plain TCP \(it seems to speak TLS") as caught:
        raise error
    assert not isinstance(caught.value, ChannelTimeout)


def test_a_greeting_in_pieces_is_taken_and_what_follows_is_kept():
    def call(address):
        with dial(address) as sock:
            for byte in tcp.CALLER_GREETING:
                sock.sendall(bytes([byte]))
                time.sleep(0.002)
            sock.sendall(b"rest")
            sock.settimeout(LONG)
            return sock.recv(100)

    def listen(address, on_listening):
        with tcp.listen(address, on_listening=on_listening) as channel:
            space = memoryview(bytearray(10))
            while (count := channel._stream.receive_into(space)) is None:
                time.sleep(0.002)
            return bytes(space[:count])

    assert meet(listen, call) == [b"rest", tcp.LISTENER_GREETING]


def test_the_greeting_is_not_counted():
    a, b = meet(tcp.listen, tcp.connect)
    with a, b:
        assert (a.bytes_sent, a.rounds, a.control_rounds) == (0, 0, 0)
        assert_alive(a, b)
        assert a.bytes_received == b.bytes_sent == 18


def test_an_abort_to_a_peer_that_does_not_read_ends_in_time():
    a, b = meet(tcp.listen, tcp.connect)
    with a, b:
        try:
            while True:
                a._stream._socket.send(bytes(1 << 16))
        except BlockingIOError:
            pass
        assert together(lambda: a.abort(4)) == [None]
        assert set(read_raw(b)) == {0}


def test_a_network_that_was_lost_before_the_exchange_is_no_hang_up(monkeypatch):
    a, b = meet(tcp.listen, tcp.connect)
    with a, b:

        def send(data):
            raise TimeoutError(errno.ETIMEDOUT, "Connection timed out")

        monkeypatch.setattr(a._stream, "send", send)
        b.close()
        with pytest.raises(ChannelTimeout, match="the network does not reach the peer any more"):
            a.exchange(DATA, [b"1"], 1)


def test_an_exchange_that_may_take_years_is_no_error_of_the_system():
    a, b = meet(tcp.listen, tcp.connect, timeout=1e12)
    with a, b:
        later = threading.Timer(0.05, b.close)
        later.start()
        with pytest.raises(ChannelError):
            a.exchange(DATA, [b"1"], 1)
        later.join()


def test_a_listener_may_wait_for_years():
    a, b = meet(
        lambda address, on_listening: tcp.listen(address, wait=1e12, on_listening=on_listening),
        lambda address: (time.sleep(0.05), tcp.connect(address, wait=1e12))[1],
    )
    with a, b:
        assert_alive(a, b)
