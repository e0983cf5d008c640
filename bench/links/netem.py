"""A link by the kernel's own emulator, netem, on the loopback of a network namespace: TCP sees all of it.

Each direction has a queue of its own, chosen by the listener's port.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

from bench.links.link import QUEUE, Link
from bench.links.tun import PORT

_MTU = 1500


def commands(link: Link) -> list[str]:
    """What sets a link up; the first clears what was there."""
    shape = f"netem limit {QUEUE} delay {link.delay_ms}ms rate {round(link.mbit * 1e6)}bit"
    shape += f" loss {link.loss * 100}%" if link.loss else ""
    return [
        f"ip link set lo up mtu {_MTU} gso_max_segs 1",  # packets as on a link, not 64 KB in one piece
        "tc qdisc add dev lo root handle 1: prio bands 2 priomap 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0",
        f"tc qdisc add dev lo parent 1:1 handle 10: {shape}",
        f"tc qdisc add dev lo parent 1:2 handle 20: {shape}",
        f"tc filter add dev lo parent 1: protocol ip u32 match ip sport {PORT} 0xffff flowid 1:2",
    ]


@contextmanager
def netem_link(link: Link) -> Iterator[None]:
    """Emulate a link on the loopback device while the block runs.

    Raises:
        OSError: if the kernel, or its tools, cannot.
    """
    try:
        for command in commands(link):
            done = subprocess.run(command.split(), capture_output=True, text=True, check=False)
            if done.returncode:
                raise OSError(f"{command}: {done.stderr.strip()}")
        yield
    finally:
        subprocess.run("tc qdisc del dev lo root".split(), capture_output=True, check=False)
