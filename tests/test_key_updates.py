"""A peer that keeps OpenSSL busy: TLS 1.3 key updates (RFC 8446, 4.6.3), written by hand."""

import contextlib
import select
import signal
import struct
import threading
import time

import pytest
from channel_helpers import (
    DATA,
    LONG,
    SHORT,
    assert_dead,
    careless,
    careless_context,
    header,
    meet,
    send_on_the_wire,
    together,
)
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.kdf.hkdf import HKDFExpand

from spdz.channels import tls, tls_stream
from spdz.channels.tls_stream import MAX_ANSWERS, MAX_SILENT, READ_BYTES, TlsStream
from spdz.foundations.errors import ChannelTimeout, ProtocolViolation

HASH = hashes.SHA384()  # of TLS_AES_256_GCM_SHA384
APPLICATION_DATA, HANDSHAKE = 23, 22
UPDATE, DEMAND = b"\x18\0\0\1\0", b"\x18\0\0\1\1"


class Writer:
    """Writes the records of one direction, given its traffic secret, from the first on."""

    def __init__(self, secret):
        self.secret, self.number = secret, 0

    def expand(self, label, size):
        info = struct.pack(">HB", size, 6 + len(label)) + b"tls13 " + label + b"\0"
        return HKDFExpand(HASH, size, info).derive(self.secret)

    def record(self, kind, content):
        head = b"\x17\x03\x03" + struct.pack(">H", len(content) + 17)
        nonce = int.from_bytes(self.expand(b"iv", 12), "big") ^ self.number
        self.number += 1
        sealed = AESGCM(self.expand(b"key", 32)).encrypt(
            nonce.to_bytes(12, "big"), content + bytes([kind]), head
        )
        return head + sealed

    def key_updates(self, count, message=UPDATE):
        records = []
        for _ in range(count):
            records.append(self.record(HANDSHAKE, message))
            self.secret, self.number = self.expand(b"traffic upd", 48), 0
        return b"".join(records)


@pytest.fixture
def against(folders, tmp_path):
    """Alice's channel, the channel of a bob who knows his own secrets, and a writer of his records."""

    def connect(address, timeout):
        context = careless_context(folders, "bob")
        context.keylog_filename = str(tmp_path / "secrets")
        return careless(context, address)

    alice, bob = meet(
        lambda address, **rest: tls.listen(address, folders / "alice", "bob", **rest), connect, timeout=LONG
    )
    (secret,) = [
        bytes.fromhex(line.split()[2])
        for line in (tmp_path / "secrets").read_text().splitlines()
        if line.startswith("CLIENT_TRAFFIC_SECRET_0")
    ]
    with alice, bob:
        yield alice, bob, Writer(secret)


def test_a_few_key_updates_are_no_offence(against):
    alice, bob, writer = against
    send_on_the_wire(bob, writer.key_updates(20, UPDATE) + writer.key_updates(20, DEMAND))
    send_on_the_wire(bob, writer.record(APPLICATION_DATA, header(2) + b"ok"))
    assert bytes(alice.exchange(DATA, [b"ok"], 2)) == b"ok"


@pytest.mark.parametrize("message", [UPDATE, DEMAND], ids=["update", "demand"])
def test_key_updates_without_end_are_a_violation(against, message):
    alice, bob, writer = against
    flood = writer.key_updates(2 * (MAX_SILENT + READ_BYTES) // 27, message)
    refusal, _ = together(lambda: alice.exchange(DATA, [b"1"], 1), lambda: send_on_the_wire(bob, flood))
    with pytest.raises(ProtocolViolation, match="without data, such as key updates"):
        raise refusal
    assert_dead(alice)


def test_key_updates_between_bytes_do_not_extend_the_deadline(against):
    alice, bob, writer = against
    seconds = 20 * SHORT
    part = writer.key_updates(1000) + writer.record(APPLICATION_DATA, header(1 << 20)[:1])
    alice._timeout = SHORT
    stop = threading.Event()

    def flood():
        rest = header(1 << 20)[1:] + bytes(1 << 20)
        deadline, sent = time.monotonic() + seconds, part
        for byte in rest:
            send_on_the_wire(bob, sent)
            if stop.is_set() or time.monotonic() > deadline:
                return
            sent = writer.key_updates(100) + writer.record(APPLICATION_DATA, bytes([byte]))

    def receive():
        started = time.monotonic()
        try:
            alice.exchange(DATA, [], 1 << 20)
        except ChannelTimeout:
            return time.monotonic() - started
        finally:
            stop.set()

    took, _ = together(receive, flood)
    assert took < seconds / 2


def test_answers_that_the_peer_does_not_take_do_not_pile_up(against):
    alice, bob, writer = against
    fill_up(alice)
    flood = b"".join(
        writer.key_updates(300, DEMAND) + writer.record(APPLICATION_DATA, bytes([byte]))
        for byte in header(100)[:15]
    )
    assert len(flood) > 4 * MAX_ANSWERS
    refusal, _ = together(lambda: alice.exchange(DATA, [], 100), lambda: send_on_the_wire(bob, flood))
    with pytest.raises(ProtocolViolation, match="demands TLS key updates"):
        raise refusal


def fill_up(channel):
    """Leave no room in a channel's socket for anything that it sends."""
    sock = channel._stream._socket
    quiet = 0
    while quiet < 3:  # the system makes some room yet, by merging what it holds
        sent = 0
        for size in (1 << 16, 1):
            with contextlib.suppress(BlockingIOError):
                while True:
                    sent += sock.send(bytes(size))
        quiet = 0 if sent else quiet + 1
        time.sleep(0.05)


def test_one_call_of_openssl_works_on_a_bounded_number_of_bytes(against, monkeypatch):
    alice, bob, writer = against
    send_on_the_wire(bob, writer.key_updates(4 * READ_BYTES // 27))
    pending = []
    feed = TlsStream._feed

    def spy(stream):
        fed = feed(stream)
        pending.append(stream._incoming.pending)
        return fed

    monkeypatch.setattr(TlsStream, "_feed", spy)
    with pytest.raises(ProtocolViolation):
        alice.exchange(DATA, [], 1)
    assert 0 < max(pending) <= READ_BYTES


def test_the_deadline_alone_ends_a_flood_and_signal_handlers_run_meanwhile(against, monkeypatch):
    alice, bob, writer = against
    monkeypatch.setattr(tls_stream, "MAX_SILENT", 1 << 40)
    flood = writer.key_updates(60_000)  # more than half a second's work
    ran = []
    before = signal.signal(signal.SIGALRM, lambda *_: ran.append(alice._death))
    sender = threading.Thread(target=send_and_ignore, args=(bob, flood), daemon=True)
    try:
        sender.start()
        alice._timeout = 0.1
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        with pytest.raises(ChannelTimeout):
            alice.exchange(DATA, [], 100)
    finally:
        signal.signal(signal.SIGALRM, before)
    assert ran == [None]
    assert select.select([alice._stream], [], [], 0)[0]  # the flood is not over
    alice.close()
    sender.join(LONG)
    assert not sender.is_alive()


def send_and_ignore(channel, data):
    with contextlib.suppress(OSError):
        send_on_the_wire(channel, data)
