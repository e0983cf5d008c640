"""A port's life: where it listens, when it does not yet, what its thread survives, and how it ends."""

import errno
import os
import socket
import subprocess
import sys
import textwrap
import threading
from pathlib import Path

import pytest
from channel_helpers import CONTROL, LONG, SHORT, assert_alive, dial, free_address
from port_helpers import LIDAR, Background, by_hand, calling, connected, parked, until
from test_addresses import broken_sockets, names, needs_ipv6, port_of
from test_fork import in_a_child

from spdz.channels import port as port_module
from spdz.channels.port import Port
from spdz.foundations.errors import ChannelClosed, ChannelError, ChannelTimeout

__all__ = ["names"]
ROOT = Path(__file__).resolve().parent.parent


# --- where


def test_port_0_is_told_at_once(open_port):
    (address,) = open_port().addresses
    assert port_of(address) > 0
    dial(address).close()


@needs_ipv6
def test_a_port_listens_in_both_families(folders, open_port, names):
    names["robot"] = ["127.0.0.1", "::1"]
    told = []
    port = open_port("robot:0", on_event=told.append)
    first, second = port.addresses
    assert port_of(first) == port_of(second) and second.startswith("[::1]")
    for address in (first, second):
        caller = Background(
            lambda address=address: port_module.dial(address, folders / "bob", "alice", "lidar")
        )
        with port.take("bob", "lidar", LONG) as here, caller.wait() as there:
            assert_alive(here, there)
    assert told == [f"listening on {first} and {second} for 'bob', 'carol'"]


def test_an_address_in_use_is_tried_again(folders, open_port):
    told = []
    with socket.create_server(("127.0.0.1", 0)) as other:
        address = f"127.0.0.1:{other.getsockname()[1]}"
        port = open_port(address, on_event=told.append)
        assert port.addresses == [] and "not listening" in repr(port)
        with pytest.raises(ChannelTimeout, match=r"within 0 s: cannot listen on .*in use"):
            port.take("bob", "lidar", 0)
    until(lambda: port.addresses == [address])
    here, there = connected(folders, port)
    with here, there:
        assert_alive(here, there)
    assert told[0].startswith(f"cannot listen on {address} yet (") and told[0].endswith("; trying again")
    assert told[1].startswith(f"listening on {address}")


def test_an_interface_that_is_down_is_waited_for(folders, open_port, monkeypatch):
    address = free_address()
    with monkeypatch.context() as patch:
        broken_sockets(patch, "bind", errno.EADDRNOTAVAIL, "127.0.0.1")
        port = open_port(address)
        assert port.addresses == []
    until(lambda: port.addresses == [address])
    here, there = connected(folders, port)
    with here, there:
        assert_alive(here, there)


def test_an_address_that_becomes_forbidden_is_tried_again_and_told(open_port, monkeypatch):
    address, told = free_address(), []
    with monkeypatch.context() as patch:
        broken_sockets(patch, "bind", errno.EADDRNOTAVAIL, "127.0.0.1")
        port = open_port(address, on_event=told.append)
        broken_sockets(patch, "bind", errno.EACCES, "127.0.0.1")
        until(lambda: len(told) == 2)
        assert told[1] == f"cannot listen on {address}: Permission denied; trying again"
    until(lambda: port.addresses == [address])


def test_an_address_that_can_never_be_listened_on_is_refused_at_once(open_port, monkeypatch):
    before = set(os.listdir("/dev/fd"))
    broken_sockets(monkeypatch, "bind", errno.EACCES, "127.0.0.1")
    with pytest.raises(ChannelError, match="Permission denied"):
        open_port()
    assert set(os.listdir("/dev/fd")) <= before


# --- what the thread survives


def test_an_error_of_whoever_is_told_is_not_the_ports(folders, open_port):
    def broken(text):
        raise RuntimeError(text)

    port = open_port(on_event=broken)
    here, there = connected(folders, port)
    with here, there:
        assert_alive(here, there)


def test_an_error_that_nobody_expected_is_told_and_the_port_begins_again(folders, open_port, monkeypatch):
    monkeypatch.setattr(port_module, "_REST", 0.01)
    errors, told = [MemoryError("no memory")], []
    admit = Port._admit

    def fail_once(port, sock):
        if errors:
            sock.close()
            raise errors.pop()
        return admit(port, sock)

    monkeypatch.setattr(Port, "_admit", fail_once)
    port = open_port(free_address(), on_event=told.append)
    here, there = connected(folders, port)
    with here, there:
        assert_alive(here, there)
    assert told[1].endswith("begins again after an error: MemoryError('no memory')")


# --- the end


def test_closing_ends_the_thread_the_address_and_every_wait(folders, open_port):
    port = open_port()
    (address,) = port.addresses
    taker = Background(lambda: port.take("carol", "lidar", float("inf")))
    stranger, caller = dial(address), by_hand(folders, port, LIDAR)
    with stranger, caller:
        until(lambda: parked(port))
        port.close()
        assert not port._thread.is_alive()
        with pytest.raises(ChannelClosed, match="this port is closed") as caught:
            raise taker.wait()
        assert not caught.value.passing
        stranger.settimeout(LONG)
        assert stranger.recv(1) == b""
        with pytest.raises(ChannelClosed):
            caller.exchange(CONTROL, [b""], None)
    assert port.addresses == []
    with pytest.raises(ChannelClosed, match="this port is closed"):
        port.take("bob", "lidar", 0)
    with pytest.raises(ConnectionRefusedError):
        dial(address)
    port.close()


def test_closing_does_not_end_what_was_taken(folders, open_port):
    port = open_port()
    here, there = connected(folders, port)
    port.close()
    with here, there:
        assert_alive(here, there)


def test_closing_a_port_that_does_not_listen_yet_ends_its_thread(open_port):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = open_port(f"127.0.0.1:{other.getsockname()[1]}")
        port.close()
        assert not port._thread.is_alive()


def test_closing_does_not_wait_for_the_resolver(folders, names, monkeypatch):
    monkeypatch.setattr(port_module, "_END_SECONDS", SHORT)
    monkeypatch.setattr(port_module, "_REST", 0.01)
    asked, answer = threading.Event(), threading.Event()
    answers = [OSError(errno.EIO, "not now"), OSError(errno.EIO, "not now")]

    def resolver():
        if answers:
            return answers.pop()
        asked.set()
        answer.wait(LONG)
        return ["127.0.0.1"]

    names["robot"] = resolver
    port = Port("robot:0", folders / "alice", ["bob"], ["lidar"])
    assert asked.wait(LONG)
    port.close()
    assert port._thread.is_alive()
    answer.set()
    port._thread.join(LONG)
    assert not port._thread.is_alive() and port.addresses == []


def test_a_port_can_be_closed_by_whoever_is_told(folders, open_port):
    ports, done = [], []

    def told(text):
        if text.startswith("refused"):
            ports[0].close()
            done.append(text)

    ports.append(open_port(on_event=told))
    with dial(ports[0].addresses[0]) as sock:
        sock.sendall(b"GET / HTTP/1.1\r\n\r\n")
    until(lambda: not ports[0]._thread.is_alive())
    assert done


def test_descriptors_are_given_back(folders, open_port):
    for end in connected(folders, open_port()):  # whatever a first call loads
        end.close()
    before = len(os.listdir("/dev/fd"))
    port = open_port()
    here, there = connected(folders, port)
    with by_hand(folders, port, LIDAR), dial(port.addresses[0]), here, there:
        until(lambda: parked(port))
        port.close()
    assert len(os.listdir("/dev/fd")) <= before


# --- other processes


def test_a_fork_cannot_take_calls_and_does_not_disturb(folders, open_port):
    port = open_port()
    caller = Background(calling(folders, port))
    until(lambda: parked(port))

    def child():
        with pytest.raises(ChannelError, match="open one after the fork"):
            port.take("bob", "lidar", 0)
        port.close()
        assert port._listener.fileno() == port._awake.fileno() == -1
        for call in (*port._parking._calls.values(), *waiting):
            assert call.stream.fileno() == -1

    stranger = dial(port.addresses[0])
    until(lambda: port._reception._visits)
    waiting = [visit.caller for visit in port._reception._visits.values()]
    with stranger, port._parking._changed:  # as held by a thread that the child does not have
        in_a_child(child)
    with port.take("bob", "lidar", 0) as here, caller.wait() as there:
        assert_alive(here, there)
    again, there = connected(folders, port)
    with again, there:
        assert_alive(again, there)


def test_a_program_ends_with_a_port_open(folders):
    program = f"""
        import threading
        from pathlib import Path
        from spdz.channels.port import Port, dial
        folders = Path({str(folders)!r})
        port = Port("127.0.0.1:0", folders / "alice", ["bob"], ["lidar"])
        call = (port.addresses[0], folders / "bob", "alice", "lidar")
        threading.Thread(target=dial, args=call, daemon=True).start()
        threading.Thread(target=port.take, args=("bob", "lidar", 60), daemon=True).start()
        print("open")
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "open\n", "")
