"""A port and its callers, as the tests of ports share them."""

import threading
import time
from contextlib import ExitStack

import pytest
from channel_helpers import CONTROL, LONG, header, send_raw, together

from spdz.channels import tls
from spdz.channels.port import Port, dial

TOPICS = ("lidar", "camera")
PAIRS = [(robot, topic) for robot in ("bob", "carol") for topic in TOPICS]
LIDAR = header(5, kind=CONTROL) + b"lidar"


def until(condition, seconds=LONG):
    """Wait until something is so; fails if it never is."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it never came about"
        time.sleep(0.005)


def parked(port):
    """The calls that wait at a port, by peer and topic."""
    return set(port._parking._calls)


@pytest.fixture
def open_port(folders):
    """A factory of alice's ports; closes them all, and sees that their threads end."""
    with ExitStack() as stack:

        def make(address="127.0.0.1:0", *, peers=("bob", "carol"), topics=TOPICS, timeout=LONG, **options):
            port = Port(address, folders / "alice", peers, topics, timeout=timeout, **options)
            stack.callback(port._thread.join, LONG)
            return stack.enter_context(port)

        yield make


def calling(folders, port, robot="bob", topic="lidar", *, timeout=LONG, wait=LONG, **options):
    """A call of alice's port, to be made in a thread."""
    credentials = folders / robot
    return lambda: dial(port.addresses[0], credentials, "alice", topic, timeout=timeout, wait=wait, **options)


def connected(folders, port, robot="bob", topic="lidar", **options):
    """Both ends of a call that was taken."""
    return together(lambda: port.take(robot, topic, LONG), calling(folders, port, robot, topic, **options))


def by_hand(folders, port, frames, robot="bob"):
    """A channel of a robot of the mission that sends frames of its own choice to a port."""
    channel = tls.connect(port.addresses[0], folders / robot, "alice", wait=LONG, timeout=LONG)
    send_raw(channel, frames)
    return channel


class Background:
    """A call in a thread of its own; ``result`` is what it returned or raised."""

    def __init__(self, call):
        self._call = call
        self.result = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self):
        try:
            self.result = self._call()
        except Exception as error:
            self.result = error

    def wait(self):
        self._thread.join(LONG)
        assert not self._thread.is_alive()
        return self.result
