"""One conformance suite that memory, TCP and TLS channels have to pass; then what only sockets and TLS do."""

import socket
import ssl
import struct
import threading
import time
import tracemalloc
from contextlib import ExitStack
from queue import SimpleQueue

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dealer.pki import MissionAuthority, write_credentials
from spdz.channels import AbortReason, DType, FrameKind, MemoryChannel, memory_pair, tcp, tls
from spdz.channels.frames import MAX_CONTROL, MAX_FRAME, FrameReader, merge_small
from spdz.errors import (
    ChannelClosed,
    ChannelError,
    ChannelTimeout,
    PeerAborted,
    ProtocolViolation,
    SpdzError,
)

DATA, CHECK, CONTROL = FrameKind.DATA, FrameKind.CHECK, FrameKind.CONTROL
SHORT = 0.25
LONG = 20.0


def header(length, *, version=1, kind=1, dtype=0, reserved=0, session=0, round_=0):
    return struct.pack("<BBBBIII", version, kind, dtype, reserved, session, round_, length)


def together(*calls):
    """Run each call in a thread of its own; returns results, or the exceptions raised."""
    results = [None] * len(calls)

    def run(index):
        try:
            results[index] = calls[index]()
        except Exception as error:
            results[index] = error

    threads = [threading.Thread(target=run, args=(i,), daemon=True) for i in range(len(calls))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(LONG + 10)
    assert not any(thread.is_alive() for thread in threads)
    return results


def meet(listen, connect, **options):
    """Run ``listen(address, ...)`` in a thread and ``connect(actual address, ...)`` here."""
    found = SimpleQueue()
    return together(
        lambda: listen("127.0.0.1:0", on_listening=found.put, **options),
        lambda: connect(found.get(timeout=LONG), **options),
    )


@pytest.fixture(scope="session")
def folders(tmp_path_factory):
    """Credentials of three robots of one mission, and of an ``alice`` and a ``bob`` of another."""
    root = tmp_path_factory.mktemp("credentials")
    mission, other = MissionAuthority(), MissionAuthority()
    for authority, name, folder in (
        (mission, "alice", "alice"),
        (mission, "bob", "bob"),
        (mission, "carol", "carol"),
        (other, "alice", "other-alice"),
        (other, "bob", "other-bob"),
    ):
        write_credentials(root / folder, authority.credentials(name))
    return root


@pytest.fixture(params=["memory", "tcp", "tls"])
def pair(request, folders):
    """A factory of connected channels; closes them all. ``timeout`` is for exchanges, not for meeting."""
    with ExitStack() as stack:

        def make(timeout=LONG, **options):
            options |= {"timeout": LONG}
            if request.param == "memory":
                channels = memory_pair(**options)
            elif request.param == "tcp":
                channels = meet(tcp.listen, tcp.connect, **options)
            else:
                channels = meet(
                    lambda address, **rest: tls.listen(address, folders / "alice", "bob", **rest),
                    lambda address, **rest: tls.connect(address, folders / "bob", "alice", **rest),
                    **options,
                )
            for channel in channels:
                stack.enter_context(channel)._timeout = timeout
            return channels

        yield make


def send_raw(channel, data):
    """Send bytes of one's own choice through a channel."""
    if isinstance(channel, MemoryChannel):
        channel._outgoing.put(bytes(data))
    else:
        channel._socket.settimeout(LONG)
        channel._socket.sendall(data)


def both(first, second, *args):
    return together(lambda: first.exchange(*args), lambda: second.exchange(*args))


# --- what an exchange does


@pytest.mark.parametrize("size", [0, 1, 7, 64 << 10, 32 << 20])
def test_both_sides_receive_what_the_other_sent(pair, size):
    a, b = pair()
    rng = np.random.default_rng(size)
    there, back = rng.bytes(size), rng.bytes(size)
    got = together(lambda: a.exchange(DATA, [there], size), lambda: b.exchange(DATA, [back], size))
    assert [bytes(payload) for payload in got] == [back, there]


def test_lengths_may_differ_between_directions(pair):
    a, b = pair()
    big = bytes(5_000_000)
    got = together(lambda: a.exchange(DATA, [big], 0), lambda: b.exchange(DATA, [], len(big)))
    assert [len(payload) for payload in got] == [0, len(big)]


def test_rounds_arrive_in_order(pair):
    a, b = pair()

    def play(channel, sign):
        return [
            int(np.frombuffer(channel.exchange(DATA, [np.int64(sign * i)], 8), np.int64)[0])
            for i in range(200)
        ]

    got = together(lambda: play(a, 1), lambda: play(b, -1))
    assert got == [[-i for i in range(200)], list(range(200))]


def test_buffers_of_any_kind_and_size_are_concatenated(pair):
    a, b = pair()
    rng = np.random.default_rng(5)
    matrix = rng.integers(0, 2**63, (40, 500), dtype=np.uint64)
    buffers = [
        b"x",
        bytearray(b""),
        np.zeros((3, 0)),
        matrix,
        memoryview(b"yz"),
        rng.bytes(70_000),
        *[rng.bytes(31)] * 5000,
    ]
    expected = b"".join(bytes(buffer) for buffer in buffers)
    got, _ = together(
        lambda: a.exchange(DATA, [], len(expected)), lambda: b.exchange(DATA, buffers, 0, DType.BYTES)
    )
    assert bytes(got) == expected


def test_the_payload_is_writable_aligned_and_the_callers_own(pair):
    a, b = pair()
    first, _ = both(a, b, DATA, [b"first---"], 8)
    words = np.frombuffer(first, np.uint64)
    assert not first.readonly
    assert words.flags.aligned
    second, _ = both(a, b, DATA, [b"second--"], 8)
    second[:] = b"changed-"
    assert bytes(first) == b"first---"


def test_a_control_message_may_have_any_length_up_to_the_cap(pair):
    a, b = pair()
    long = bytes(MAX_CONTROL)
    got = together(lambda: a.exchange(CONTROL, [b"{}"], None), lambda: b.exchange(CONTROL, [long], None))
    assert [bytes(message) for message in got] == [long, b"{}"]
    assert [bytes(message) for message in both(a, b, CONTROL, [], None)] == [b"", b""]


def test_counters_count_frames_with_headers_and_control_rounds_apart(pair):
    a, b = pair()
    together(lambda: a.exchange(CONTROL, [b"abc"], None), lambda: b.exchange(CONTROL, [b"defgh"], None))
    both(a, b, DATA, [bytes(100)], 100)
    both(a, b, CHECK, [bytes(32)], 32)
    assert (a.rounds, a.control_rounds) == (b.rounds, b.control_rounds) == (2, 1)
    assert a.bytes_sent == b.bytes_received == 3 * 16 + 3 + 100 + 32
    assert b.bytes_sent == a.bytes_received == 3 * 16 + 5 + 100 + 32


def test_frames_of_a_bound_session_are_exchanged(pair):
    a, b = pair()
    both(a, b, CONTROL, [b"hello"], None)
    a.bind(0xDEADBEEF)
    b.bind(0xDEADBEEF)
    assert [bytes(got) for got in both(a, b, DATA, [b"12"], 2)] == [b"12", b"12"]


# --- requests that are wrong before anything is sent


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((FrameKind.ABORT, [], 0), "only DATA, CHECK and CONTROL"),
        ((DATA, [], None), "must be known"),
        ((DATA, [], -1), "negative"),
        ((DATA, [], 1001), "above this channel's limit"),
        ((DATA, [bytes(1001)], 0), "above this channel's limit"),
        ((DATA, [np.zeros((4, 4)).T[1:]], 0), "as bytes"),
        ((DATA, [np.array([None])], 0), "Python objects"),
    ],
)
def test_a_wrong_request_is_refused_and_the_channel_lives(pair, arguments, message):
    a, b = pair(max_frame=1000)
    with pytest.raises(ValueError, match=message):
        a.exchange(*arguments)
    assert [bytes(got) for got in both(a, b, DATA, [bytes(1000)], 1000)] == [bytes(1000)] * 2


def test_a_control_message_above_its_cap_is_not_sent():
    a, _ = memory_pair()
    with pytest.raises(ValueError, match="limit of 65536"):
        a.exchange(CONTROL, [bytes(MAX_CONTROL + 1)], None)


@pytest.mark.parametrize(
    "options", [{"timeout": 0}, {"timeout": float("inf")}, {"max_frame": 0}, {"max_frame": MAX_FRAME + 1}]
)
def test_limits_out_of_range_are_refused(options):
    with pytest.raises(ValueError, match="must be"):
        memory_pair(**options)


@pytest.mark.parametrize("tag", [-1, 1 << 32])
def test_a_session_tag_has_32_bits(tag):
    with pytest.raises(ValueError, match="32 bits"):
        memory_pair()[0].bind(tag)


# --- peers that do not answer


@pytest.mark.parametrize("size", [10, 16 << 20], ids=["small", "more than the socket buffers"])
def test_a_silent_peer_is_a_timeout(pair, size):
    a, _ = pair(SHORT)
    with pytest.raises(ChannelTimeout, match=r"within 0\.25 s \(0 of 26 bytes"):
        a.exchange(DATA, [bytes(size)], 10)
    assert_dead(a)


def test_a_byte_now_and_then_does_not_extend_the_deadline(pair):
    a, b = pair(SHORT)
    done = threading.Event()

    def trickle():
        for byte in header(24) + bytes(24):
            if done.wait(0.025):
                return
            send_raw(b, bytes([byte]))

    def receive():
        try:
            return a.exchange(DATA, [], 24)
        finally:
            done.set()

    received, _ = together(receive, trickle)
    assert isinstance(received, ChannelTimeout)


@pytest.mark.parametrize("sent", [b"", header(8)[:5], header(8), header(8) + b"1234567"])
def test_a_peer_that_hangs_up_in_a_frame_is_told_as_closed(pair, sent):
    a, b = pair()
    send_raw(b, sent)
    b.close()
    with pytest.raises(ChannelClosed, match=f"{len(sent)} of 24 bytes|broke"):
        a.exchange(DATA, [bytes(8)], 8)
    assert_dead(a)


def test_a_peer_that_hangs_up_while_it_is_sent_to_is_told_as_closed(pair):
    a, b = pair()
    send_raw(b, header(8)[:4])
    results = together(lambda: a.exchange(DATA, [bytes(16 << 20)], 8), lambda: (time.sleep(0.05), b.close()))
    assert isinstance(results[0], ChannelClosed)


# --- peers that send something else


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"version": 2}, "frame version: expected 1, the peer sent 2"),
        ({"version": 22}, "speak TLS"),
        ({"reserved": 1}, "reserved byte: expected 0"),
        ({"kind": CHECK}, "frame kind: expected DATA, the peer sent CHECK"),
        ({"kind": CONTROL}, "expects a DATA frame, the peer sent CONTROL"),
        ({"kind": 77}, "unknown code 77"),
        ({"session": 7}, "session tag: expected 00000000, the peer sent 00000007"),
        ({"round_": 1}, "round: expected 0, the peer sent 1"),
        ({"dtype": DType.FIELD}, "payload dtype: expected BYTES, the peer sent FIELD"),
        ({"length": 7}, "payload length: expected 8 bytes, the peer sent 7"),
        ({"length": 9}, "payload length: expected 8 bytes, the peer sent 9"),
        ({"length": 2**32 - 1}, "the peer sent 4294967295"),
        ({"kind": FrameKind.ABORT, "length": 2}, "ABORT frame: expected 1"),
    ],
)
def test_any_other_header_is_a_violation(pair, wrong, message):
    a, b = pair()
    send_raw(b, header(**{"length": 8} | wrong))  # the payload never comes: the header alone decides
    with pytest.raises(ProtocolViolation, match=message):
        a.exchange(DATA, [bytes(8)], 8)
    assert_dead(a)


def test_parties_of_different_sessions_refuse_each_other(pair):
    a, b = pair()
    a.bind(1)
    b.bind(2)
    errors = both(a, b, DATA, [b"1"], 1)
    assert all(isinstance(error, ProtocolViolation) for error in errors)


@pytest.mark.parametrize("length", [MAX_CONTROL + 1, 2**32 - 1])
def test_a_claimed_length_is_refused_before_memory_is_taken(pair, length):
    a, b = pair()
    send_raw(b, header(length, kind=CONTROL))
    tracemalloc.start()
    try:
        with pytest.raises(ProtocolViolation, match="at most 65536 bytes"):
            a.exchange(CONTROL, [b"{}"], None)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


def test_garbage_is_a_violation_and_is_not_echoed(pair):
    a, b = pair()
    send_raw(b, b"GET / HTTP/1.1\r\nHost: secret\r\n\r\n")
    with pytest.raises(ProtocolViolation) as caught:
        a.exchange(DATA, [bytes(8)], 8)
    assert "secret" not in str(caught.value)


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=60) | st.binary(max_size=44).map(lambda rest: header(9, kind=2) + rest), st.data())
def test_a_reader_completes_the_expected_frame_and_no_other(stream, data):
    reader = FrameReader(CHECK, DType.BYTES, 0, 0, 9, MAX_CONTROL)
    position = 0
    try:
        while position < len(stream) and not reader.complete:
            size = data.draw(st.integers(1, min(len(reader.space), len(stream) - position)))
            reader.space[:size] = stream[position : position + size]
            position += size
            reader.advance(size)
    except SpdzError:
        assert stream[:16] != header(9, kind=2)
        return
    assert reader.complete == (stream[:16] == header(9, kind=2) and len(stream) >= 25)
    if reader.complete:
        assert bytes(reader.payload()) == stream[16:25]


@given(st.lists(st.sampled_from([0, 1, 50_000, 65_536, 65_537]), max_size=12))
def test_merging_buffers_keeps_their_bytes(sizes):
    buffers = [bytes([i]) * size for i, size in enumerate(sizes)]
    assert b"".join(merge_small(buffers)) == b"".join(buffers)


# --- aborting


@pytest.mark.parametrize("reason", list(AbortReason))
def test_an_abort_tells_the_peer_why(pair, reason):
    a, b = pair()
    error, _ = together(lambda: a.exchange(DATA, [bytes(8)], 8), lambda: b.abort(reason))
    assert isinstance(error, PeerAborted)
    assert str(error).startswith("the peer stopped because ")
    assert_dead(a)


@pytest.mark.parametrize(("kind", "expect"), [(DATA, 0), (CONTROL, None), (DATA, 16 << 20)])
def test_an_abort_is_seen_whatever_was_expected(pair, kind, expect):
    a, b = pair()
    error, _ = together(
        lambda: a.exchange(kind, [bytes(expect or 5)], expect), lambda: b.abort(AbortReason.MAC_CHECK_FAILED)
    )
    with pytest.raises(PeerAborted, match="MAC check failed"):
        raise error


def test_an_abort_after_a_frame_leaves_the_frame_whole(pair):
    a, b = pair()

    def last_words():
        b.exchange(DATA, [b"last"], 4)
        b.abort(AbortReason.STOPPED)

    def hear():
        first = bytes(a.exchange(DATA, [b"here"], 4))
        with pytest.raises(PeerAborted):
            a.exchange(DATA, [b"more"], 4)
        a.close()
        return first

    assert together(hear, last_words) == [b"last", None]


def test_a_side_that_was_sent_garbage_can_still_say_so(pair):
    a, b = pair()
    send_raw(b, bytes(100))
    with pytest.raises(ProtocolViolation):
        a.exchange(DATA, [bytes(8)], 8)
    a_done, _ = together(
        lambda: a.abort(AbortReason.PROTOCOL_VIOLATION), lambda: assert_hears(b, header(8) + bytes(8))
    )
    assert a_done is None


def assert_hears(channel, sent_before):
    reader = channel.exchange(DATA, [], len(sent_before) - 16)
    assert bytes(reader) == sent_before[16:]
    with pytest.raises(PeerAborted, match="no honest peer"):
        channel.exchange(DATA, [], 1)


def test_an_unknown_abort_reason_is_a_violation(pair):
    a, b = pair()
    send_raw(b, header(1, kind=FrameKind.ABORT) + b"\xff")
    with pytest.raises(ProtocolViolation, match="abort reason: expected 1 to 9, the peer sent 255"):
        a.exchange(DATA, [], 100)


def test_an_abort_is_heard_in_another_round_and_session(pair):
    a, b = pair()
    send_raw(b, header(1, kind=FrameKind.ABORT, session=9, round_=99) + bytes([AbortReason.STOPPED]))
    with pytest.raises(PeerAborted):
        a.exchange(DATA, [], 1)


def test_aborting_never_raises(pair):
    a, b = pair()
    b.close()
    a.abort(AbortReason.STOPPED)
    a.abort(AbortReason.STOPPED)
    b.abort(AbortReason.STOPPED)
    assert_dead(a)
    assert_dead(b)


def read_raw(channel):
    """Everything that comes through a TCP channel until it is closed."""
    channel._socket.settimeout(LONG)
    return b"".join(iter(lambda: channel._socket.recv(1 << 20), b""))


def test_no_abort_is_put_into_the_middle_of_a_frame():
    a, b = meet(tcp.listen, tcp.connect, timeout=SHORT)
    with a, b:
        with pytest.raises(ChannelTimeout):
            a.exchange(DATA, [bytes(16 << 20)], 1)  # b does not read: most of the frame stays here
        _, came = together(lambda: a.abort(AbortReason.TIMEOUT), lambda: read_raw(b))
    assert 16 < len(came) < 16 << 20
    assert not any(came[16:])


def test_an_abort_is_not_overtaken_by_a_reset():
    a, b = meet(tcp.listen, tcp.connect, timeout=LONG)
    with a, b:
        send_raw(b, bytes(100_000))  # a will not have read all of this when it hangs up

        def hear():
            try:
                return read_raw(b)
            finally:
                b.close()

        _, came = together(lambda: a.abort(AbortReason.STOPPED), hear)
    assert came == header(1, kind=FrameKind.ABORT) + bytes([AbortReason.STOPPED])


# --- dead channels


def assert_dead(channel):
    with pytest.raises(ChannelClosed):
        channel.exchange(DATA, [b"1"], 1)


def test_a_closed_channel_refuses_and_closing_again_does_nothing(pair):
    a, b = pair()
    with a:
        pass
    a.close()
    assert_dead(a)
    with pytest.raises(ChannelClosed):
        b.exchange(DATA, [b"1"], 1)


def test_an_interrupted_exchange_kills_the_channel(pair, monkeypatch):
    a, _ = pair()

    def interrupted(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(a, "_swap", interrupted)
        a.exchange(DATA, [b"1"], 1)
    with pytest.raises(ChannelClosed, match="interrupted"):
        a.exchange(DATA, [b"1"], 1)


# --- TCP: addresses and finding each other


@pytest.mark.parametrize(
    ("address", "parts"),
    [
        ("localhost:9000", ("localhost", 9000)),
        ("10.0.0.2:1", ("10.0.0.2", 1)),
        ("[::1]:9000", ("::1", 9000)),
    ],
)
def test_addresses_are_host_and_port(address, parts):
    assert tcp.parse_address(address) == parts


@pytest.mark.parametrize(
    "address", ["", "host", "host:", ":9000", "host:-1", "host:65536", "host:९", "::1:9000", "[]:1"]
)
def test_malformed_addresses_are_refused(address):
    with pytest.raises(ValueError, match=r"address|host"):
        tcp.parse_address(address)


def free_address():
    with tcp.open_listener("127.0.0.1:0") as listener:
        return tcp.address_of(listener)


def test_the_caller_may_be_started_first():
    address = free_address()
    started = threading.Event()

    def late():
        started.wait(LONG)
        time.sleep(0.15)
        return tcp.listen(address, wait=LONG)

    def early():
        started.set()
        return tcp.connect(address, wait=LONG)

    a, b = together(late, early)
    with a, b:
        assert [bytes(got) for got in both(a, b, DATA, [b"ok"], 2)] == [b"ok", b"ok"]


def test_nobody_there_is_a_timeout():
    with pytest.raises(ChannelTimeout, match=r"nobody answered .* is the other robot listening"):
        tcp.connect(free_address(), wait=SHORT)
    with pytest.raises(ChannelTimeout, match="nobody connected"):
        tcp.listen("127.0.0.1:0", wait=SHORT)


def test_an_address_in_use_is_told():
    with tcp.open_listener("127.0.0.1:0") as listener, pytest.raises(ChannelError, match="cannot listen on"):
        tcp.listen(tcp.address_of(listener), wait=SHORT)


def test_an_unknown_host_is_told_at_once():
    with pytest.raises(ChannelError, match="cannot be resolved"):
        tcp.connect("no such host:9000", wait=LONG)


# --- TLS: who is let in


def reception(folders, *, wait=LONG, peer="bob"):
    return lambda address, **rest: tls.listen(address, folders / "alice", peer, wait=wait, **rest)


def caller(folders, folder="bob", peer="alice"):
    return lambda address: tls.connect(address, folders / folder, peer, timeout=LONG)


def greet(channel):
    with channel:
        channel.exchange(CONTROL, [b"{}"], None)


@pytest.fixture
def intrude(folders, monkeypatch):
    """Has an intruder call alice, then bob, who has to get through; returns the intruder's end, and why."""
    refusals = []
    refuse = tls._Reception._refuse

    def spy(reception, sock, why):
        refusals.append(why)
        refuse(reception, sock, why)

    monkeypatch.setattr(tls._Reception, "_refuse", spy)

    def run(intruder):
        def call(address):
            (outcome,) = together(lambda: intruder(address))
            return outcome, caller(folders)(address)

        a, (outcome, b) = meet(reception(folders), call)
        with a, b:
            assert [bytes(got) for got in both(a, b, DATA, [b"ok"], 2)] == [b"ok", b"ok"]
        return outcome, *refusals

    return run


def careless_context(folders, folder=None, newest=ssl.TLSVersion.TLSv1_3):
    """What an intruder might use: it believes alice's authority and shows any certificate, or none."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.maximum_version = newest
    context.load_verify_locations(folders / "alice" / "ca.pem")
    if folder is not None:
        context.load_cert_chain(folders / folder / "cert.pem", folders / folder / "key.pem")
    return context


def careless(context):
    return lambda address: greet(tcp.owned(context.wrap_socket(tcp.dial(address, LONG)), LONG, 100))


def test_a_third_robots_valid_certificate_is_refused_by_the_listener(folders, intrude):
    told, refusal = intrude(lambda address: greet(caller(folders, "carol")(address)))
    assert refusal == "expected the robot 'bob', but the certificate there is of 'carol'"
    with pytest.raises(PeerAborted, match="expects another robot"):
        raise told


def test_a_third_robots_valid_certificate_is_refused_by_the_caller(folders):
    peer, error = meet(reception(folders), caller(folders, peer="carol"))
    peer.close()
    with pytest.raises(ChannelError, match=r"expected the robot 'carol', but .* of 'alice'"):
        raise error


@pytest.mark.parametrize("folder", ["other-bob", "other-alice"])
def test_a_robot_of_another_mission_refuses_this_ones(folders, intrude, folder):
    error, refusal = intrude(caller(folders, folder))
    with pytest.raises(ChannelError, match=r"certificate.*same run of the dealer"):
        raise error
    assert "alert" in refusal


def test_a_certificate_of_another_mission_is_refused(folders, intrude):
    told, refusal = intrude(careless(careless_context(folders, "other-bob")))
    assert "certificate" in refusal
    with pytest.raises(ChannelClosed, match=r"refused this side's TLS connection .*ALERT.*same run"):
        raise told


def test_a_caller_without_a_certificate_is_refused(folders, intrude):
    told, refusal = intrude(careless(careless_context(folders)))
    assert "peer did not return a certificate" in refusal
    assert isinstance(told, ChannelClosed)


def test_a_plain_caller_is_refused(intrude):
    told, refusal = intrude(lambda address: greet(tcp.connect(address)))
    assert "TLS handshake failed" in refusal
    assert isinstance(told, (ChannelClosed, ProtocolViolation))


def test_tls_1_2_is_refused_by_the_listener(folders, intrude):
    told, refusal = intrude(careless(careless_context(folders, "bob", ssl.TLSVersion.TLSv1_2)))
    assert "unsupported protocol" in refusal
    assert isinstance(told, ssl.SSLError)


def test_tls_1_2_is_refused_by_the_caller(folders):
    def old_listener(address, on_listening):
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.maximum_version = ssl.TLSVersion.TLSv1_2
        context.load_cert_chain(folders / "alice" / "cert.pem", folders / "alice" / "key.pem")
        with tcp.open_listener(address) as listener:
            listener.settimeout(LONG)
            on_listening(tcp.address_of(listener))
            sock, _ = listener.accept()
            with sock, pytest.raises(ssl.SSLError):
                context.wrap_socket(sock, server_side=True)

    other, refusal = meet(old_listener, caller(folders))
    assert other is None
    with pytest.raises(ChannelError, match="TLS handshake failed"):
        raise refusal


def test_a_listener_that_refused_everybody_says_why(folders):
    refusal, _ = meet(
        reception(folders, wait=4 * SHORT), lambda address: greet(caller(folders, "carol")(address))
    )
    with pytest.raises(ChannelError, match=r"'bob' did not connect .*: 1, the last .* of 'carol'"):
        raise refusal


def test_a_tls_caller_of_a_plain_listener_is_told_so(folders):
    def listen(address, on_listening):
        with tcp.listen(address, on_listening=on_listening) as channel:
            channel.exchange(CONTROL, [b"{}"], None)

    violation, error = meet(listen, caller(folders))
    with pytest.raises(ProtocolViolation, match="seems to speak TLS"):
        raise violation
    with pytest.raises(ChannelError, match="does the other side speak TLS"):
        raise error


def test_garbage_and_stalling_callers_do_not_keep_the_peer_out(folders):
    with ExitStack() as stack:

        def call(address):
            first, *_ = (stack.enter_context(tcp.dial(address, LONG)) for _ in range(tls.MAX_HANDSHAKES + 1))
            first.settimeout(LONG)
            assert first.recv(1) == b""  # dropped for the benefit of the last
            for rubbish in (b"GET / HTTP/1.1\r\n\r\n", b"\x16\x03\x01\xff\xff" + bytes(300)):
                stack.enter_context(tcp.dial(address, LONG)).sendall(rubbish)
            with pytest.raises(ChannelError), caller(folders, "carol")(address) as channel:
                channel.exchange(CONTROL, [b"{}"], None)
            return caller(folders)(address)

        a, b = meet(reception(folders), call)
        stack.enter_context(a)
        stack.enter_context(b)
        assert [bytes(got) for got in both(a, b, DATA, [b"ok"], 2)] == [b"ok", b"ok"]


def test_a_stalling_caller_does_not_extend_the_wait(folders):
    with ExitStack() as stack:
        refusal, _ = meet(
            reception(folders, wait=3 * SHORT),
            lambda address: stack.enter_context(tcp.dial(address, LONG)) and None,
        )
    with pytest.raises(ChannelTimeout, match="1 connected without a TLS handshake"):
        raise refusal


def test_a_stalling_listener_is_a_timeout(folders):
    with tcp.open_listener("127.0.0.1:0") as listener, pytest.raises(ChannelTimeout, match="handshake"):
        tls.connect(tcp.address_of(listener), folders / "bob", "alice", timeout=SHORT)


def test_unusable_credentials_are_told_before_anything_is_opened(folders, tmp_path):
    with pytest.raises(ValueError, match=r"ca\.pem is missing"):
        tls.listen("127.0.0.1:0", tmp_path, "bob", wait=SHORT)
    for name in ("ca.pem", "cert.pem", "key.pem"):
        (tmp_path / name).write_bytes((folders / "alice" / name).read_bytes())
    (tmp_path / "key.pem").write_bytes((folders / "bob" / "key.pem").read_bytes())
    with pytest.raises(ValueError, match="cannot be used: key values mismatch"):
        tls.connect("127.0.0.1:1", tmp_path, "bob", wait=SHORT)


def test_a_socket_that_cannot_become_a_channel_is_closed():
    here, there = socket.socketpair()
    with there, pytest.raises(ValueError, match="timeout"):
        tcp.owned(here, -1, 100)
    assert here.fileno() == -1
