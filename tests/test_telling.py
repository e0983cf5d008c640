"""What is told while two robots look for each other: every reason, each once, in words for people."""

import errno
import os
import re
import socket
import threading
import time

import pytest
from channel_helpers import (
    DATA,
    LONG,
    SHORT,
    assert_alive,
    careless,
    careless_context,
    dial,
    free_address,
    greet,
    meet,
    together,
    ways,
)

from spdz.channels import addresses, memory_pair, reception, tcp, telling, tls
from spdz.channels.telling import Teller, in_seconds, printable
from spdz.foundations.errors import ChannelError, ChannelTimeout

AGAIN = r"; trying again for up to \S+ s"


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.999998, "1 s"),
        (19.9496, "19.9 s"),
        (0.05, "0.05 s"),
        (0.0123456, "0.0123 s"),
        (59.9998, "60 s"),
        (60.0, "60 s"),
        (30, "30 s"),
        (86400, "86400 s"),
        (12345.6, "12300 s"),
        (1e12, "1000000000000 s"),
    ],
)
def test_a_time_has_at_most_three_significant_digits(seconds, text):
    assert in_seconds(seconds) == text


@pytest.mark.parametrize("wait", [0.249998765, 0.0512345])
def test_every_timeout_is_told_in_a_few_digits(folders, wait):
    few = in_seconds(wait)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        there = f"127.0.0.1:{silent.getsockname()[1]}"
        attempts = [lambda: memory_pair(timeout=wait)[0].exchange(DATA, [b"1"], 1)]
        for kind in ("tcp", "tls"):
            listen, connect = ways(kind, folders)
            attempts += [
                lambda listen=listen: listen("127.0.0.1:0", wait=wait),
                lambda listen=listen: listen(there, wait=wait),
                lambda connect=connect: connect(free_address(), wait=wait),
                lambda connect=connect: connect(there, wait=wait, timeout=wait),
            ]
        for attempt in attempts:
            with pytest.raises(ChannelError) as caught:
                attempt()
            assert set(re.findall(r"[\d.]+ s\b", str(caught.value))) == {few}, caught.value


# --- which reasons, and how often


def test_a_reason_is_told_when_it_changes():
    told = []
    teller = Teller(told.append)
    for reason in ("first", "first", "second", "second", "third"):
        teller.tell(reason)
    assert told == ["first", "second", "third"]


def test_a_reason_that_lasts_is_not_told_again(monkeypatch):
    told, now = [], [0.0]
    monkeypatch.setattr(telling.time, "monotonic", lambda: now[0])
    teller = Teller(told.append)
    for now[0] in (0.0, 100.0, 200.0):
        teller.tell("first")
    assert told == ["first"]


def test_reasons_that_take_turns_are_told_now_and_then_only(monkeypatch):
    told, now = [], [0.0]
    monkeypatch.setattr(telling.time, "monotonic", lambda: now[0])
    teller = Teller(told.append)
    for now[0] in (0.0, 1.0, 2.0):
        teller.tell("first")
        teller.tell("second")
    assert told == ["first", "second"]
    now[0] = 100.0
    teller.tell("first")
    assert told == ["first", "second", "first"]


def test_what_is_told_is_printable():
    assert printable("a b\x1b[2J\r\n\u202eé\ud800") == "a b?[2J???é?"
    told = []
    Teller(told.append).tell("from \x1b[2J", " to \n")
    assert told == ["from ?[2J to ?"]


# --- not there yet


@pytest.fixture
def unknown(monkeypatch):
    """What looking up the name ``robot`` does; by default it is not known."""
    behaviour = [lambda: None]
    real = socket.getaddrinfo

    def look_up(host, *args, **options):
        if host == "robot":
            behaviour[0]()
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
        return real(host, *args, **options)

    monkeypatch.setattr(socket, "getaddrinfo", look_up)
    return behaviour


def events_of(meeting, address, error, **options):
    """What is told until a meeting fails."""
    told = []
    with pytest.raises(error):
        meeting(address, on_event=told.append, **options)
    return told


@pytest.mark.parametrize("kind", ["tcp", "tls"])
@pytest.mark.parametrize("side", [0, 1])
def test_a_name_that_is_not_known_is_told_at_once_and_once(folders, unknown, kind, side):
    meeting = ways(kind, folders)[side]
    (told,) = events_of(meeting, "robot:1", ChannelError, wait=4 * SHORT)
    assert re.fullmatch(rf"robot cannot be resolved yet \(Name or service not known\){AGAIN}", told)


def test_a_resolver_that_takes_long_is_told_before_it_answers(unknown, monkeypatch):
    monkeypatch.setattr(addresses, "_SLOW_SECONDS", 0.01)
    heard, told = threading.Event(), []
    unknown[0] = lambda: heard.wait(LONG)

    def on_event(sentence):
        told.append((sentence, heard.is_set()))
        heard.set()

    with pytest.raises(ChannelTimeout):
        tcp.connect("robot:1", wait=4 * SHORT, on_event=on_event)
    sentence, answered = told[0]
    assert re.fullmatch(rf"robot cannot be resolved yet \(the resolver does not answer\){AGAIN}", sentence)
    assert not answered


@pytest.mark.parametrize("kind", ["tcp", "tls"])
def test_nobody_there_is_told_at_once_and_once(folders, kind):
    _, connect = ways(kind, folders)
    address = free_address()
    (told,) = events_of(connect, address, ChannelTimeout, wait=4 * SHORT)
    assert re.fullmatch(rf"nobody answers at {address} yet \(Connection refused\){AGAIN}", told)


@pytest.mark.parametrize("kind", ["tcp", "tls"])
def test_a_port_in_use_is_told_at_once_and_once_and_nothing_claims_to_listen(folders, kind):
    listen, _ = ways(kind, folders)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        (told,) = events_of(listen, address, ChannelError, wait=4 * SHORT)
    assert re.fullmatch(rf"cannot listen on {address} yet \(Address already in use\){AGAIN}", told)


def test_an_address_of_another_machine_is_told():
    told, *more = events_of(
        tcp.listen, "192.0.2.1:9000", ChannelError, wait=2 * SHORT
    )  # TEST-NET-1, RFC 5737
    assert told.startswith("cannot listen on 192.0.2.1:9000 yet (") and not more


def test_a_try_that_is_the_last_is_not_told():
    assert events_of(tcp.connect, free_address(), ChannelTimeout, wait=0) == []


def test_a_wait_is_told_as_what_is_left_of_it(monkeypatch):
    reasons = iter([errno.EADDRINUSE, errno.EADDRNOTAVAIL])
    now, told = [100.0], []
    monkeypatch.setattr(addresses.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(addresses.time, "sleep", lambda seconds: now.__setitem__(0, now[0] + 20))

    def attempt():
        code = next(reasons, None)
        if code is not None:
            raise addresses.NotYet(os.strerror(code), "it cannot")
        return "done"

    assert addresses.patiently(attempt, 159.99987, lambda last: last, Teller(told.append), "") == "done"
    assert told == [
        "it cannot yet (Address already in use); trying again for up to 60 s",
        "it cannot yet (Cannot assign requested address); trying again for up to 40 s",
    ]


def test_a_wait_without_end_can_be_told():
    told = []
    Teller(told.append).not_yet("it cannot yet", float("inf"))
    assert len(told) == 1 and told[0].startswith("it cannot yet; trying again")


# --- listening


@pytest.mark.parametrize(("kind", "peer"), [("tcp", "the other robot"), ("tls", "'bob'")])
def test_listening_is_told_once_it_is_true_with_the_real_port(folders, kind, peer):
    listen, connect = ways(kind, folders)
    told = []

    def on_event(sentence):
        address = re.fullmatch(rf"listening on (127\.0\.0\.1:[1-9]\d*) for {peer}", sentence)[1]
        dial(address).close()  # refused unless somebody listens
        told.append(address)

    (a, found), b = meet(
        lambda address, on_listening: (
            listen(
                address,
                wait=LONG,
                on_listening=lambda at: (told.append(at), on_listening(at)),
                on_event=lambda sentence: told or on_event(sentence),
            ),
            told,
        ),
        lambda address: connect(address, wait=LONG),
    )
    with a, b:
        assert_alive(a, b)
    assert found[0] == found[1]


def test_nobody_calling_is_told_with_what_may_be_the_cause(folders):
    for kind, peer in (("tcp", "the other robot"), ("tls", "'bob'")):
        with pytest.raises(ChannelTimeout) as caught:
            ways(kind, folders)[0]("127.0.0.1:0", wait=SHORT)
        assert str(caught.value) == (
            f"{peer} did not connect within 0.25 s: is it started with connect= (--connect) to this address?"
        )


def test_a_stranger_is_told_once_however_often_he_calls():
    told = []

    def call(address):
        for _ in range(5):
            for rubbish in (b"GET / HTTP/1.1\r\n\r\n", b"\x16\x03\x01\x1b[2J"):
                with dial(address) as sock:
                    sock.sendall(rubbish)
                    sock.settimeout(LONG)
                    while sock.recv(100):
                        pass
        return tcp.connect(address, wait=LONG)

    a, b = meet(
        lambda address, on_listening: tcp.listen(address, on_listening=on_listening, on_event=told.append),
        call,
    )
    with a, b:
        assert_alive(a, b)
    assert told[1:] == [
        "refused a caller: the other side did not send the greeting of plain TCP",
        "refused a caller: the other side did not send the greeting of plain TCP (it seems to speak TLS, and "
        "this side does not)",
    ]


def test_a_caller_with_the_certificate_of_another_robot_is_told(folders):
    listen, _ = ways("tls", folders)
    told = []
    meet(
        lambda address, on_listening: listen(
            address, wait=4 * SHORT, on_listening=on_listening, on_event=told.append
        ),
        lambda address: [greet_as(folders, "carol", address) for _ in range(2)],
    )
    assert told[1:] == ["refused a caller: expected the robot 'bob', but the certificate there is of 'carol'"]


def greet_as(folders, folder, address):
    return together(lambda: greet(careless(careless_context(folders, folder), address)))


@pytest.mark.parametrize("who", ["a robot of another run", "a caller that believes this run"])
def test_credentials_of_another_run_are_suspected_by_the_listener(folders, who):
    listen, _ = ways("tls", folders)
    told = []

    def call(address):
        if who == "a robot of another run":  # it refuses this side's certificate
            return together(lambda: tls.connect(address, folders / "other-bob", "alice", wait=0))
        return greet_as(folders, "other-bob", address)  # this side refuses its certificate

    refusal, _ = meet(
        lambda address, on_listening: listen(
            address, wait=4 * SHORT, on_listening=on_listening, on_event=told.append
        ),
        call,
    )
    suspicion = ": credentials of another dealer run?"
    assert str(refusal).endswith(suspicion)
    assert len(told) == 2 and told[1].startswith("refused a caller: ") and told[1].endswith(suspicion)


def test_a_caller_that_speaks_no_tls_is_not_suspected_of_wrong_credentials(folders):
    listen, _ = ways("tls", folders)

    def call(address):
        with dial(address) as sock:
            sock.sendall(b"GET / HTTP/1.1\r\n\r\n")
            sock.settimeout(LONG)
            return sock.recv(100)

    refusal, _ = meet(
        lambda address, on_listening: listen(address, wait=4 * SHORT, on_listening=on_listening), call
    )
    assert "the TLS handshake failed" in str(refusal) and "dealer" not in str(refusal)


def test_that_no_connection_can_be_taken_is_told_once(monkeypatch):
    def full(door):
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    monkeypatch.setattr(reception, "accept_one", full)
    told = []

    def call(address):
        with dial(address):
            time.sleep(2 * SHORT)

    refusal, _ = meet(
        lambda address, on_listening: tcp.listen(
            address, wait=4 * SHORT, on_listening=on_listening, on_event=told.append
        ),
        call,
    )
    assert isinstance(refusal, ChannelTimeout)
    assert told[1:] == [
        "a connection could not be taken (Too many open files); close files or raise `ulimit -n`"
    ]
