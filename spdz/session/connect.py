"""Open a tape and reach the peer that it was dealt for."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TypeAlias

from spdz.channels import Channel, tcp, tls
from spdz.channels.addresses import parse_address
from spdz.channels.credentials import check_credentials
from spdz.channels.telling import ignore
from spdz.foundations.types import IntArray
from spdz.gallery.ledger import Ledger
from spdz.gallery.tape import GalleryTape
from spdz.readings.gallery import Terms
from spdz.session.gallery import GallerySession
from spdz.session.session import Session
from spdz.tape import Tape
from spdz.tape.header import Header

Reach: TypeAlias = Callable[[Header, Path], Channel]
"""Makes the channel to the peer that a tape's header names, with the credentials in a folder."""


def open_session(
    tape: str | Path,
    *,
    listen: str | None = None,
    connect: str | None = None,
    credentials: str | Path | None = None,
    insecure: bool = False,
    wait: float = 60.0,
    timeout: float = 30.0,
    state_dir: str | Path | None = None,
    on_event: Callable[[str], None] = ignore,
) -> Session:
    """Open a tape and connect to the peer that it was dealt for, over mutually authenticated TLS 1.3.

    Args:
        tape: This robot's tape for that peer.
        listen: ``"host:port"`` to accept the peer at; or
        connect: ``"host:port"`` to reach it at. Exactly one of the two.
        credentials: Folder of ca.pem, cert.pem and key.pem; the tape's folder if not given.
        insecure: Plain TCP without encryption or authentication, for closed test networks only.
        wait: Seconds to wait for the peer to appear.
        timeout: Seconds that one round may take.
        state_dir: Where the second record of what was used is kept (default: the user's state folder).
        on_event: Called with a sentence when this side listens, and when the reason changes why there is no
            connection yet, or why a caller was refused.

    Raises:
        ValueError: unless exactly one of ``listen`` and ``connect`` is given, or if the credentials are not
            those of the robot that the tape names.
        TapeError: if the tape is damaged, in use, destroyed, or does not match the peer's.
        ChannelError: if there is no connection within ``wait`` seconds, or the peer is not who it
            should be.
    """
    check_where(listen, connect, wait, timeout)
    path = Path(tape)
    opened = Tape.open(path, state_dir=None if state_dir is None else Path(state_dir))
    try:
        channel = reach_peer(
            opened.header,
            path.parent if credentials is None else Path(credentials),
            listen=listen,
            connect=connect,
            insecure=insecure,
            wait=wait,
            timeout=timeout,
            on_event=on_event,
        )
    except BaseException:
        opened.close()
        raise
    return Session(opened, channel)


def open_gallery(
    tape: str | Path,
    terms: Terms,
    *,
    waiting: list[IntArray] | None = None,
    listen: str | None = None,
    connect: str | None = None,
    credentials: str | Path | None = None,
    insecure: bool = False,
    wait: float = 60.0,
    timeout: float = 30.0,
    state_dir: str | Path | None = None,
    on_event: Callable[[str], None] = ignore,
    reach: Reach | None = None,
) -> GallerySession:
    """Open a gallery and connect to the peer that it was dealt for; arguments as for :func:`open_session`.

    Args:
        tape: This robot's gallery tape for that peer. What it was used for is kept beside it, in a file of
            the same name that ends in ``.ledger``.
        terms: What the tape was dealt for, with the threshold.
        waiting: As for :class:`GallerySession`.
        listen: As for a session.
        connect: As for a session.
        credentials: As for a session.
        insecure: As for a session.
        wait: As for a session.
        timeout: As for a session.
        state_dir: As for a session.
        on_event: As for a session.
        reach: In the place of ``listen`` and ``connect``: makes the channel to the peer, by a port
            (:mod:`spdz.channels.port`), say. It gets the tape's header and the folder of the credentials,
            which were held against the header unless ``insecure``. ``wait`` and ``timeout`` are its own.

    Raises:
        ValueError: as :func:`open_session`.
        TapeError: if tape or ledger are damaged, in use, destroyed, or do not match the peer's.
        ChannelError: as :func:`open_session`.
    """
    check_where(listen, connect, wait, timeout, reach)
    path, state = Path(tape), None if state_dir is None else Path(state_dir)
    with ExitStack() as resources:
        opened = resources.enter_context(GalleryTape.open(path, state_dir=state))
        header = opened.header
        ledger = resources.enter_context(
            Ledger.open(path.with_suffix(".ledger"), header.tape, header.party, state_dir=state)
        )
        channel = reach_peer(
            header,
            path.parent if credentials is None else Path(credentials),
            listen=listen,
            connect=connect,
            insecure=insecure,
            wait=wait,
            timeout=timeout,
            on_event=on_event,
            reach=reach,
        )
        resources.pop_all()
    return GallerySession(opened, ledger, channel, terms, waiting)


def reach_peer(
    header: Header,
    credentials: Path,
    *,
    listen: str | None,
    connect: str | None,
    insecure: bool,
    wait: float,
    timeout: float,
    on_event: Callable[[str], None],
    reach: Reach | None = None,
) -> Channel:
    """Connect to the peer of a tape, whose header names both robots."""
    where, events = listen or connect or "", {"timeout": timeout, "wait": wait, "on_event": on_event}
    if insecure and reach is None:
        meet_plainly = tcp.connect if listen is None else tcp.listen
        return meet_plainly(where, **events)  # type: ignore[arg-type]
    if not insecure:
        check_credentials(credentials, header.name)
    if reach is not None:
        return reach(header, credentials)
    meet = tls.connect if listen is None else tls.listen
    return meet(where, credentials, header.peer, **events)  # type: ignore[arg-type]


def check_where(
    listen: str | None, connect: str | None, wait: float, timeout: float, reach: Reach | None = None
) -> None:
    """Refuse arguments of :func:`open_session` that make no sense, before anything is opened.

    Raises:
        ValueError: naming the argument.
    """
    if reach is not None:
        if listen is not None or connect is not None:
            raise ValueError("reach= takes the place of listen= and connect=: give it alone")
    elif (listen is None) == (connect is None):
        raise ValueError("give exactly one of listen= and connect=")
    else:
        parse_address(listen or connect or "")
    for name, seconds in (("wait", wait), ("timeout", timeout)):
        if not (seconds > 0 and math.isfinite(seconds)):
            raise ValueError(f"{name} must be a positive number of seconds, not {seconds!r}")
