"""A link for whole packets, in a network namespace with one TUN device: TCP sees rate, delay and loss.

Both parties are in one namespace. Party 0 listens at :data:`HERE`, party 1 calls :data:`THERE`, an address
that nobody has: the device gets the packet, and this module holds it as the link would, exchanges its two
addresses and writes it back. So it comes to party 0 from :data:`THERE`, and the answer goes the same way.
Both checksums stay right, since they are sums.
"""

from __future__ import annotations

import fcntl
import os
import select
import struct
import subprocess
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

from bench.links.link import Line, Link

HERE, THERE, PORT = "10.77.0.1", "10.77.0.2", 9000
_DEVICE = "spdz0"
_TUNSETIFF = 0x400454CA
_IFF_TUN, _IFF_NO_PI = 0x0001, 0x1000  # IP packets, with nothing before them
_MTU = 1500
_TCP = 6


@contextmanager
def tun_link(link: Link) -> Iterator[None]:
    """Emulate a link between the two addresses while the block runs, in the namespace of this process.

    Raises:
        OSError: if the device cannot be made.
    """
    device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    try:
        fcntl.ioctl(device, _TUNSETIFF, struct.pack("16sH22x", _DEVICE.encode(), _IFF_TUN | _IFF_NO_PI))
        for words in (
            f"addr add {HERE}/24 dev {_DEVICE}",
            f"link set {_DEVICE} up mtu {_MTU}",
            "link set lo up",
        ):
            _ip(words)
        reader, writer = os.pipe()
        relay = threading.Thread(target=_relay, args=(device, reader, link), daemon=True)
        relay.start()
        try:
            yield
        finally:
            os.close(writer)
            relay.join(10)
            os.close(reader)
    finally:
        os.close(device)


def _ip(words: str) -> None:
    done = subprocess.run(["ip", *words.split()], capture_output=True, text=True, check=False)
    if done.returncode:
        raise OSError(f"ip {words}: {done.stderr.strip()}")


def _relay(device: int, stop: int, link: Link) -> None:
    """Hold every packet as long as the link does, until the other end of ``stop`` is closed."""
    lines = (Line(link, 0), Line(link, 1))
    held: tuple[deque[tuple[float, bytes]], ...] = (deque(), deque())
    while True:
        first = min((queue[0][0] for queue in held if queue), default=None)
        timeout = None if first is None else max(0.0, first - time.monotonic())
        ready, _, _ = select.select([device, stop], [], [], timeout)
        if stop in ready:
            return
        if device in ready:
            packet = os.read(device, _MTU)
            sender = from_party(packet)
            if sender is not None:
                due = lines[sender].arrival(time.monotonic(), len(packet))
                if due is not None:
                    held[sender].append((due, exchanged(packet)))
        now = time.monotonic()
        for queue in held:
            while queue and queue[0][0] <= now:
                os.write(device, queue.popleft()[1])


def from_party(packet: bytes) -> int | None:
    """The party that sent a packet, by the listener's port; None if it is no TCP packet of IPv4."""
    if len(packet) < 40 or packet[0] >> 4 != 4 or packet[9] != _TCP:
        return None
    start = (packet[0] & 15) * 4
    return 0 if int.from_bytes(packet[start : start + 2], "big") == PORT else 1


def exchanged(packet: bytes) -> bytes:
    """A packet of IPv4 with its two addresses exchanged."""
    return packet[:12] + packet[16:20] + packet[12:16] + packet[20:]
