"""Which emulation a machine allows, and a link by it.

``netem`` and ``tun`` need a network namespace of their own, which any user may make on most Linux systems:
the command starts itself again in one (:func:`enter_namespace`), and the machine's own network is untouched.
``proxy`` needs nothing.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn

from bench.links.link import Link
from bench.links.netem import netem_link
from bench.links.proxy import proxy_link
from bench.links.tun import HERE, PORT, THERE, tun_link
from bench.parties import free_port

VIAS = ("netem", "tun", "proxy")
"""The emulations, the most faithful first."""

_NAMESPACE = ("unshare", "--user", "--map-root-user", "--net", "--")
_INSIDE = "SPDZ_BENCH_LINKS_VIA"
_CONGESTION = Path("/proc/sys/net/ipv4/tcp_congestion_control")
_PROBES = {
    "netem": "ip link set lo up && tc qdisc add dev lo root netem delay 1ms rate 1mbit",
    "tun": "ip tuntap add dev spdz0 mode tun",
}


@dataclass(frozen=True, slots=True)
class Ends:
    """Where party 0 listens and what party 1 calls: host and port."""

    listens: tuple[str, int]
    calls: tuple[str, int]


def possible(via: str) -> bool:
    """Whether this machine lets this user emulate a link so."""
    if via == "proxy":
        return True
    if not sys.platform.startswith("linux"):
        return False
    try:
        words = [*_NAMESPACE, "sh", "-c", _PROBES[via]]
        return subprocess.run(words, capture_output=True, timeout=20, check=False).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False


def inside() -> str | None:
    """The emulation whose namespace this process was started in."""
    return os.environ.get(_INSIDE)


def enter_namespace(via: str, words: Sequence[str]) -> NoReturn:
    """Go on as ``python -m bench links`` with these words, in a namespace made for it.

    Raises:
        OSError: if it cannot be started.
    """
    sys.stdout.flush()
    command = [*_NAMESPACE, sys.executable, "-m", "bench", "links", *words]
    os.execvpe(command[0], command, {**os.environ, _INSIDE: via})


def carried(link: Link, via: str) -> Link:
    """The link that an emulation makes of another: the proxy loses nothing."""
    return replace(link, loss=0.0) if via == "proxy" else link


@contextmanager
def emulated(link: Link, via: str) -> Iterator[Ends]:
    """A link while the block runs.

    Raises:
        OSError: if the system refuses.
    """
    if via == "proxy":
        port = free_port()
        with proxy_link(carried(link, via), port) as outer:
            yield Ends(("127.0.0.1", port), ("127.0.0.1", outer))
    elif via == "tun":
        choose_congestion_control()
        with tun_link(link):
            yield Ends((HERE, PORT), (THERE, PORT))
    else:
        choose_congestion_control()
        with netem_link(link):
            yield Ends(("127.0.0.1", PORT), ("127.0.0.1", PORT))


def choose_congestion_control() -> None:
    """Have TCP of this namespace probe for the rate by CUBIC, as on most machines, or by Reno if need be."""
    for name in ("cubic", "reno"):
        with suppress(OSError):
            _CONGESTION.write_text(name, encoding="ascii")
            return


def congestion_control() -> str | None:
    """How TCP of this namespace probes for rate; None where the system does not tell."""
    try:
        return _CONGESTION.read_text(encoding="ascii").strip()
    except OSError:
        return None
