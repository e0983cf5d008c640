"""One port for all peers: calls, their topics, and how they are taken."""

import socket
import threading
import time

import pytest
from channel_helpers import CONTROL, LONG, SHORT, assert_alive, free_address, header, together
from port_helpers import LIDAR, PAIRS, Background, by_hand, calling, connected, parked, until

from spdz.channels import port as port_module
from spdz.channels.port import Port, dial
from spdz.channels.topic import MAX_TOPIC, answer, topic_bytes
from spdz.foundations.errors import ChannelTimeout, PeerAborted, ProtocolViolation

# --- meeting


def test_robots_and_topics_meet_on_one_port_at_once(folders, open_port):
    port = open_port()
    ends = together(
        *(lambda key=key: port.take(*key, LONG) for key in PAIRS),
        *(calling(folders, port, *key) for key in PAIRS),
    )
    for key, here, there in zip(PAIRS, ends[:4], ends[4:], strict=True):
        with here, there:
            name = "/".join(key).encode()
            got, _ = together(
                lambda here=here: here.exchange(CONTROL, [b""], None),
                lambda there=there, name=name: there.exchange(CONTROL, [name], None),
            )
            assert bytes(got) == name


def test_a_call_waits_until_it_is_taken(folders, open_port):
    port = open_port()
    caller = Background(calling(folders, port))
    until(lambda: parked(port) == {("bob", "lidar")})
    time.sleep(SHORT)
    assert caller.result is None
    with port.take("bob", "lidar", 0) as here, caller.wait() as there:
        assert_alive(here, there)


def test_the_caller_may_be_there_before_the_port(folders, open_port):
    address = free_address()
    caller = Background(lambda: dial(address, folders / "bob", "alice", "lidar", wait=LONG))
    time.sleep(SHORT)
    with open_port(address).take("bob", "lidar", LONG) as here, caller.wait() as there:
        assert_alive(here, there)


@pytest.mark.parametrize("other", [("bob", "camera"), ("carol", "lidar")])
def test_a_call_is_not_taken_for_another_topic_or_robot(folders, open_port, other):
    port = open_port()
    caller = Background(calling(folders, port))
    until(lambda: parked(port))
    with pytest.raises(ChannelTimeout):
        port.take(*other, 0)
    with port.take("bob", "lidar", 0) as here, caller.wait() as there:
        assert_alive(here, there)


def test_several_wait_for_one_caller_and_one_gets_it(folders, open_port):
    port = open_port()
    first, second, there = together(
        *[lambda: port.take("bob", "lidar", 4 * SHORT)] * 2, calling(folders, port)
    )
    here, nobody = (first, second) if isinstance(second, Exception) else (second, first)
    assert isinstance(nobody, ChannelTimeout)
    with here, there:
        assert_alive(here, there)


def test_a_channel_begins_with_its_own_limits_and_nothing_counted(folders, open_port):
    port = open_port(max_frame=100, timeout=7)
    here, there = connected(folders, port, timeout=8, max_frame=200)
    with here, there:
        assert (here.timeout, here._max_frame, there.timeout, there._max_frame) == (7, 100, 8, 200)
        assert (there.bytes_sent, there.rounds, there.control_rounds) == (0, 0, 0)
        assert_alive(here, there)
        assert here.bytes_received == there.bytes_sent == 18


# --- calls that nobody takes, and newer ones


def test_a_newer_call_takes_the_place_of_one_that_nobody_took(folders, open_port):
    port = open_port()
    older = Background(calling(folders, port))
    until(lambda: parked(port))
    newer = Background(calling(folders, port))
    with pytest.raises(PeerAborted, match="a newer call of the same robot about the same topic") as caught:
        raise older.wait()
    assert caught.value.passing
    with port.take("bob", "lidar", 0) as here, newer.wait() as there:
        assert_alive(here, there)


def test_a_call_whose_caller_hung_up_is_not_taken(folders, open_port):
    port = open_port()
    assert isinstance(Background(calling(folders, port, wait=0)).wait(), ChannelTimeout)
    assert parked(port)
    with pytest.raises(ChannelTimeout):
        port.take("bob", "lidar", 0)
    assert not parked(port)


def test_a_call_that_was_cut_off_is_not_taken(folders, open_port):
    port = open_port()
    channel = by_hand(folders, port, LIDAR)
    until(lambda: parked(port))
    channel._stream.close()
    with pytest.raises(ChannelTimeout):
        port.take("bob", "lidar", 0)


def test_a_call_that_went_on_before_it_was_taken_is_not_taken(folders, open_port):
    port = open_port()
    with by_hand(folders, port, LIDAR + header(2, kind=CONTROL) + b"{}"):
        until(lambda: parked(port))
        with pytest.raises(ChannelTimeout):
            port.take("bob", "lidar", 0)


def test_a_take_goes_on_waiting_behind_a_dead_call(folders, open_port):
    port = open_port()
    Background(calling(folders, port, wait=0)).wait()
    here, there = together(
        lambda: port.take("bob", "lidar", LONG), lambda: (time.sleep(0.1), calling(folders, port)())[1]
    )
    with here, there:
        assert_alive(here, there)


def test_a_call_that_is_not_taken_in_time_is_dropped_and_made_again(folders, open_port, monkeypatch):
    monkeypatch.setattr(port_module, "_GRACE", 0.0)
    port = open_port(timeout=SHORT)
    told = []
    caller = Background(calling(folders, port, on_event=told.append))
    until(lambda: parked(port))
    first = port._parking._calls["bob", "lidar"]
    until(lambda: port._parking._calls.get(("bob", "lidar"), first) is not first)
    assert first.stream.fileno() == -1
    with port.take("bob", "lidar", LONG) as here, caller.wait() as there:
        here._timeout = LONG
        assert_alive(here, there)
    assert [text.partition(" yet (")[0] for text in told] == [
        "'alice' does not take this robot's call about 'lidar'"
    ]


def test_a_caller_gives_up_and_says_that_the_peer_is_there(folders, open_port):
    port = open_port()
    told = []
    with pytest.raises(ChannelTimeout, match=r"'alice' does not .* 'lidar': it is there; .*0\.25 s"):
        calling(folders, port, timeout=SHORT / 4, wait=SHORT, on_event=told.append)()
    assert len(told) == 1 and "it is there" in told[0]


def test_a_caller_whose_port_begins_anew_calls_again(folders, open_port):
    port = open_port()
    caller = Background(calling(folders, port))
    until(lambda: parked(port))
    (address,) = port.addresses
    port.close()
    assert caller.result is None
    with open_port(address).take("bob", "lidar", LONG) as here, caller.wait() as there:
        assert_alive(here, there)


# --- peers that are gone


def test_a_peer_that_calls_again_is_noticed_beside_the_channel_that_it_had(folders, open_port):
    port = open_port()
    here, there = connected(folders, port)
    with here, there:
        assert not port.is_called("bob", "lidar")
        again = Background(calling(folders, port))
        until(lambda: port.is_called("bob", "lidar"))
        assert not port.is_called("bob", "camera") and not port.is_called("carol", "lidar")
    with port.take("bob", "lidar", 0) as here, again.wait() as there:
        assert_alive(here, there)


@pytest.mark.skipif(not hasattr(socket, "TCP_KEEPIDLE"), reason="this system calls it otherwise")
@pytest.mark.parametrize(("timeout", "longest"), [(0.5, 5), (30.0, 30), (1e12, 32767)])
def test_the_system_watches_over_an_idle_channel(folders, open_port, timeout, longest):
    for end in connected(folders, open_port(timeout=timeout), timeout=timeout):
        with end:
            option = end._stream._socket.getsockopt
            assert option(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
            idle, between, probes = (
                option(socket.IPPROTO_TCP, code)
                for code in (socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL, socket.TCP_KEEPCNT)
            )
            assert min(timeout, longest) * 0.8 <= idle + between * probes <= longest


# --- waiting


def test_a_take_says_whom_it_waited_for(open_port):
    with pytest.raises(ChannelTimeout, match=r"'bob' did not call about 'camera' within 0 s: is it started"):
        open_port().take("bob", "camera", 0)


def test_a_take_can_be_stopped(open_port):
    port, stop = open_port(), threading.Event()
    taker = Background(lambda: port.take("bob", "lidar", float("inf"), stop))
    time.sleep(0.05)
    stop.set()
    with pytest.raises(ChannelTimeout, match="was stopped"):
        raise taker.wait()


def test_a_call_can_be_stopped_while_the_peer_does_not_take_it(folders, open_port):
    port, stop = open_port(), threading.Event()
    caller = Background(calling(folders, port, timeout=10 * LONG, wait=float("inf"), stop=stop))
    until(lambda: parked(port))
    stop.set()
    with pytest.raises(ChannelTimeout, match="stopped"):
        raise caller.wait()
    with pytest.raises(ChannelTimeout):  # it hung up
        port.take("bob", "lidar", 0)


def test_a_call_can_be_stopped_while_nobody_listens(folders):
    stop = threading.Event()
    caller = Background(
        lambda: dial(free_address(), folders / "bob", "alice", "lidar", wait=float("inf"), stop=stop)
    )
    time.sleep(0.05)
    stop.set()
    assert isinstance(caller.wait(), ChannelTimeout)


# --- topics and arguments


def test_a_topic_that_the_port_does_not_know_is_told_on_both_sides(folders, open_port):
    told = []
    port = open_port(on_event=told.append)
    with pytest.raises(PeerAborted, match="its plan lacks the topic of this call: another mission") as caught:
        calling(folders, port, topic="radar")()
    assert not caught.value.passing
    until(lambda: len(told) == 2)
    assert told[1] == (
        "refused a caller: 'bob' calls about a topic that this robot's plan lacks "
        "(it has 'lidar', 'camera'): another mission, another plan?"
    )


def test_an_answer_about_another_topic_is_a_violation(folders, open_port, monkeypatch):
    port = open_port()
    monkeypatch.setattr("spdz.channels.parking.answer", lambda stream, topic: answer(stream, "radar"))
    here, error = together(lambda: port.take("bob", "lidar", LONG), calling(folders, port))
    with here, pytest.raises(ProtocolViolation, match="another topic"):
        raise error


@pytest.mark.parametrize("topic", ["", "x" * (MAX_TOPIC + 1), "é" * (MAX_TOPIC // 2 + 1), "a\nb", "\ud800"])
def test_a_topic_is_a_short_printable_text(folders, topic):
    with pytest.raises(ValueError, match="a topic is 1 to 64 bytes"):
        dial("127.0.0.1:1", folders / "bob", "alice", topic)
    with pytest.raises(ValueError, match="a topic is 1 to 64 bytes"):
        Port("127.0.0.1:0", folders / "alice", ["bob"], [topic])


def test_the_longest_topic_is_called_about(folders, open_port):
    topic = "é" * (MAX_TOPIC // 2)
    assert len(topic_bytes(topic)) == MAX_TOPIC
    here, there = connected(folders, open_port(topics=[topic]), topic=topic)
    with here, there:
        assert_alive(here, there)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("127.0.0.1", ["bob"], ["lidar"]), "host:port"),
        (("127.0.0.1:0", [], ["lidar"]), "at least one peer"),
        (("127.0.0.1:0", ["bob"], []), "at least one topic"),
        (("127.0.0.1:0", "bob", ["lidar"]), "a collection of at least one peer"),
    ],
)
def test_bad_arguments_are_refused(folders, arguments, message):
    address, peers, topics = arguments
    with pytest.raises(ValueError, match=message):
        Port(address, folders / "alice", peers, topics)


def test_unusable_credentials_are_refused(folders, tmp_path):
    with pytest.raises(ValueError, match=r"ca\.pem is missing"):
        Port("127.0.0.1:0", tmp_path, ["bob"], ["lidar"])


@pytest.mark.parametrize("key", [("dave", "lidar"), ("bob", "radar")])
def test_a_take_that_can_never_succeed_is_refused(open_port, key):
    port = open_port()
    for ask in (lambda: port.take(*key, 0), lambda: port.is_called(*key)):
        with pytest.raises(ValueError, match="takes no calls"):
            ask()


@pytest.mark.parametrize("wait", [-1, float("nan")])
def test_a_wait_is_a_number_of_seconds(open_port, wait):
    with pytest.raises(ValueError, match="wait must be"):
        open_port().take("bob", "lidar", wait)
