"""TLS: who is let in, who is refused, and what either side is told."""

import socket
import ssl
from contextlib import ExitStack
from datetime import datetime, timedelta, timezone

import pytest
from channel_helpers import (
    CONTROL,
    LONG,
    SHORT,
    assert_alive,
    careless,
    careless_context,
    dial,
    greet,
    meet,
    read_raw,
    together,
)
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization

from dealer.pki import MissionAuthority, write_credentials
from spdz.channels import tcp, tls
from spdz.channels.frame_reader import FrameReader
from spdz.channels.frames import DType, pack_header
from spdz.channels.reception import MAX_HANDSHAKES, Reception
from spdz.channels.socket_channel import lost
from spdz.foundations.errors import ChannelClosed, ChannelError, ChannelTimeout, PeerAborted


def reception(folders, *, wait=LONG, peer="bob"):
    return lambda address, **rest: tls.listen(address, folders / "alice", peer, wait=wait, **rest)


def caller(folders, folder="bob", peer="alice"):
    return lambda address: tls.connect(address, folders / folder, peer, timeout=LONG)


@pytest.fixture
def intrude(folders, monkeypatch):
    """Has an intruder call alice, then bob, who has to get through; returns the intruder's end, and why."""
    refusals = []
    refuse = Reception._refuse

    def spy(reception, caller, why):
        refusals.append(why)
        refuse(reception, caller, why)

    monkeypatch.setattr(Reception, "_refuse", spy)

    def run(intruder):
        def call(address):
            (outcome,) = together(lambda: intruder(address))
            return outcome, caller(folders)(address)

        a, (outcome, b) = meet(reception(folders), call)
        with a, b:
            assert_alive(a, b)
        return outcome, *refusals

    return run


def test_a_third_robots_valid_certificate_is_refused_by_the_listener(folders, intrude):
    told, refusal = intrude(lambda address: greet(caller(folders, "carol")(address)))
    assert refusal == "expected the robot 'bob', but the certificate there is of 'carol'"
    with pytest.raises(PeerAborted, match="expects another robot"):
        raise told


def test_a_third_robots_valid_certificate_is_refused_by_the_caller(folders):
    peer, error = meet(reception(folders), caller(folders, peer="carol"))
    with pytest.raises(ChannelError, match=r"expected the robot 'carol', but .* of 'alice'"):
        raise error
    with peer, pytest.raises(PeerAborted, match="expects another robot"):
        peer.exchange(CONTROL, [b"{}"], None)


@pytest.mark.parametrize("folder", ["other-bob", "other-alice"])
def test_a_robot_of_another_mission_refuses_this_ones(folders, intrude, folder):
    error, refusal = intrude(caller(folders, folder))
    with pytest.raises(ChannelError, match=r"certificate.*same run of the dealer"):
        raise error
    assert "alert" in refusal


def test_a_certificate_of_another_mission_is_refused(folders, intrude):
    told, refusal = intrude(lambda address: greet(careless(careless_context(folders, "other-bob"), address)))
    assert "certificate" in refusal
    with pytest.raises(ChannelClosed, match=r"refused this side's TLS connection .*ALERT.*same run"):
        raise told
    assert not told.passing  # a further try would not help


def test_a_caller_without_a_certificate_is_refused(folders, intrude):
    told, refusal = intrude(lambda address: greet(careless(careless_context(folders), address)))
    assert "peer did not return a certificate" in refusal
    assert isinstance(told, ChannelClosed)


def test_a_plain_caller_is_refused(intrude):
    told, refusal = intrude(lambda address: greet(tcp.connect(address, wait=0)))
    assert "TLS handshake failed" in refusal
    with pytest.raises(ChannelTimeout, match="a listener that speaks TLS"):
        raise told


def test_tls_1_2_is_refused_by_the_listener(folders, intrude):
    context = careless_context(folders, "bob", ssl.TLSVersion.TLSv1_2)
    told, refusal = intrude(lambda address: greet(careless(context, address)))
    assert "unsupported protocol" in refusal
    assert isinstance(told, ssl.SSLError)


def test_tls_1_2_is_refused_by_the_caller(folders):
    def old_listener(address, on_listening):
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.maximum_version = ssl.TLSVersion.TLSv1_2
        context.load_cert_chain(folders / "alice" / "cert.pem", folders / "alice" / "key.pem")
        with socket.create_server(("127.0.0.1", 0)) as listener:
            listener.settimeout(LONG)
            on_listening(f"127.0.0.1:{listener.getsockname()[1]}")
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


def test_a_tls_caller_of_a_plain_listener_is_told_so_at_once(folders):
    refusal, error = meet(
        lambda address, on_listening: tcp.listen(address, wait=4 * SHORT, on_listening=on_listening),
        caller(folders),
    )
    with pytest.raises(ChannelError, match=r"callers refused: 1, .*seems to speak TLS"):
        raise refusal
    with pytest.raises(ChannelError, match="does the other side speak TLS"):
        raise error


def test_garbage_and_stalling_callers_do_not_keep_the_peer_out(folders):
    with ExitStack() as stack:

        def call(address):
            first, *_ = (stack.enter_context(dial(address)) for _ in range(MAX_HANDSHAKES + 1))
            first.settimeout(LONG)
            assert first.recv(1) == b""  # dropped for the benefit of the last
            for rubbish in (b"GET / HTTP/1.1\r\n\r\n", b"\x16\x03\x01\xff\xff" + bytes(300)):
                stack.enter_context(dial(address)).sendall(rubbish)
            with pytest.raises(ChannelError), caller(folders, "carol")(address) as channel:
                channel.exchange(CONTROL, [b"{}"], None)
            return caller(folders)(address)

        a, b = meet(reception(folders), call)
        stack.enter_context(a)
        stack.enter_context(b)
        assert_alive(a, b)


def test_a_stalling_caller_does_not_extend_the_wait(folders):
    with ExitStack() as stack:
        refusal, _ = meet(
            reception(folders, wait=3 * SHORT), lambda address: stack.enter_context(dial(address)) and None
        )
    with pytest.raises(ChannelTimeout, match="1 connected without a TLS handshake"):
        raise refusal


def test_a_stalling_listener_is_a_timeout(folders):
    with socket.create_server(("127.0.0.1", 0)) as listener, pytest.raises(ChannelTimeout, match="handshake"):
        address = f"127.0.0.1:{listener.getsockname()[1]}"
        tls.connect(address, folders / "bob", "alice", timeout=SHORT, wait=SHORT)


def test_unusable_credentials_are_told_before_anything_is_opened(folders, tmp_path):
    with pytest.raises(ValueError, match=r"ca\.pem is missing"):
        tls.listen("127.0.0.1:0", tmp_path, "bob", wait=SHORT)
    for name in ("ca.pem", "cert.pem", "key.pem"):
        (tmp_path / name).write_bytes((folders / "alice" / name).read_bytes())
    (tmp_path / "key.pem").write_bytes((folders / "bob" / "key.pem").read_bytes())
    with pytest.raises(ValueError, match=r"cannot be used \(key values mismatch\): copy the folder again"):
        tls.connect("127.0.0.1:1", tmp_path, "bob", wait=SHORT)


def test_limits_out_of_range_are_refused_before_anything_is_opened(folders):
    for meeting in (tcp.listen, tcp.connect, reception(folders), caller(folders)):
        with pytest.raises((ValueError, TypeError), match="timeout"):
            meeting("127.0.0.1:1", timeout=-1)


def test_a_name_in_a_certificate_cannot_reach_the_terminal_raw(folders, tmp_path):
    authority = MissionAuthority()
    write_credentials(tmp_path / "bob", authority.credentials("bob"))
    write_credentials(tmp_path / "alice", authority.credentials("alice"))
    rename(authority, tmp_path / "alice" / "cert.pem", "\x1b[2Jalice\r\n")
    peer, error = meet(reception(tmp_path), caller(tmp_path))
    with peer, pytest.raises(ChannelError, match=r"of '\\x1b\[2Jalice\\r\\n'"):
        raise error


def rename(authority, path, name):
    """Issue a robot's certificate anew, for another name."""
    old = x509.load_pem_x509_certificate(path.read_bytes())
    builder = (
        x509.CertificateBuilder()
        .subject_name(old.subject)
        .issuer_name(old.issuer)
        .public_key(old.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(datetime.now(timezone.utc) - timedelta(days=1))
        .not_valid_after(datetime.now(timezone.utc) + timedelta(days=1))
    )
    for extension in old.extensions:
        if not isinstance(extension.value, x509.SubjectAlternativeName):
            builder = builder.add_extension(extension.value, extension.critical)
    builder = builder.add_extension(x509.SubjectAlternativeName([x509.DNSName(name)]), False)
    signed = builder.sign(authority._key, hashes.SHA256())
    path.write_bytes(signed.public_bytes(serialization.Encoding.PEM))


def test_closing_sends_close_notify(folders):
    a, b = meet(reception(folders), caller(folders))
    with b:
        a.close()
        assert read_raw(b).startswith(b"\x17\x03\x03")  # an encrypted record, and then the end


@pytest.mark.parametrize(
    ("reason", "passing"),
    [
        ("SSLV3_ALERT_BAD_RECORD_MAC", True),
        ("DECRYPTION_FAILED_OR_BAD_RECORD_MAC", True),
        ("TLSV1_ALERT_DECODE_ERROR", True),
        ("SSLV3_ALERT_BAD_CERTIFICATE", False),
        ("TLSV1_ALERT_UNKNOWN_CA", False),
        ("TLSV13_ALERT_CERTIFICATE_REQUIRED", False),
    ],
)
def test_a_damaged_line_may_pass_and_a_refused_certificate_does_not(reason, passing):
    error = ssl.SSLError(1, reason)
    error.reason = reason
    reader = FrameReader(pack_header(CONTROL, DType.BYTES, 0, 0, 0), None, 100)
    assert lost(error, reader).passing is passing
    assert ("certificate" in str(lost(error, reader))) is not passing
