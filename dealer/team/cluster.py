"""Deal on a Dask cluster: the same tasks, on machines that share the mission's folder.

Only names, ids and digests travel through the scheduler; the tapes are written into the shared folder.
Workers see both halves of what they deal: they belong to the dealer (``docs/threat-model.md``).
``distributed`` is optional and loaded when it is asked for.
"""

from __future__ import annotations

import logging
import os
import secrets
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from dealer.team.here import cores
from dealer.team.pair import deal_pair, room_here
from dealer.team.room import Room
from dealer.team.stopped import DealingStopped
from dealer.team.tasks import Task, size_of
from protocols.memory import require_memory
from spdz.channels.addresses import parse_address
from spdz.console.command import tune_process
from spdz.tape.durable import PRIVATE_FOLDER
from spdz.version import __version__

LOCAL = "local"
POLL_SECONDS = 0.2
_RETRIES = 3
_TAKES = 10.0  # seconds to hand over an error that is there, or to take leave
_SEEN = "seen"
_SAME = "all machines need the same folder, at the same path"
_LOOPBACK = ("127.0.0.1", "::1", "localhost")


@dataclass(frozen=True, slots=True)
class Cluster:
    """Which cluster, and how it is reached.

    Attributes:
        address: ``tls://host:port`` of the scheduler; ``tcp://`` on loopback; or ``local``.
        ca: The cluster's certificate authority, PEM.
        cert: The dealer's certificate, PEM.
        key: The dealer's key, PEM.
        plain: Whether plain TCP is accepted beyond loopback.
        workers: Processes of a local cluster; 0 for one a core.
        wait: Seconds to wait for the scheduler, and for workers wherever there are none.
    """

    address: str
    ca: Path | None = None
    cert: Path | None = None
    key: Path | None = None
    plain: bool = False
    workers: int = 0
    wait: float = 30.0

    def check(self) -> None:
        """Refuse an address or files that cannot be meant, before anything else is done.

        Raises:
            ValueError: saying what to give.
        """
        if self.address == LOCAL:
            return
        scheme, found, rest = self.address.partition("://")
        if not found or scheme not in ("tls", "tcp"):
            raise ValueError(f"a scheduler is tls://HOST:PORT, or {LOCAL}, not {self.address!r}")
        host, _ = parse_address(rest)
        files = (self.ca, self.cert, self.key)
        if scheme == "tls":
            if None in files:
                raise ValueError("a cluster over TLS takes --tls-ca, --tls-cert and --tls-key")
            for file in files:
                if file is not None and not os.access(file, os.R_OK):
                    raise ValueError(f"{file} cannot be read")
        elif host not in _LOOPBACK and not self.plain:
            raise ValueError(
                f"{self.address} is plain TCP, and whoever is on the network could have the cluster run "
                "anything: give tls://HOST:PORT, or --insecure-plain-tcp in a closed network"
            )


def deal_on_cluster(
    room: Room,
    tasks: Sequence[Task],
    cluster: Cluster,
    *,
    on_dealt: Callable[[Task], None],
    poll: Callable[[], None],
) -> None:
    """Deal tasks on a cluster.

    Raises:
        DealingStopped: if scheduler or workers are lost, or do not come.
        ValueError: if a worker has another version, or a task cannot be dealt.
        OSError: if a worker does not see the room, or cannot write.
    """
    with connected(cluster) as client:
        _check_workers(client, room, cluster.wait)
        futures = {
            client.submit(
                deal_on_worker,
                *_about(room),
                task.couple,
                task.gallery,
                key=f"deal-{room.mission_id}-{task.key}",
                retries=_RETRIES,
                pure=False,
            ): task
            for task in tasks
        }
        try:
            for future in _completed(client, list(futures), cluster.wait, poll):
                check_future(future)
                task = futures.pop(future)
                future.release()  # or it would be computed again if its worker were lost now
                if not _until(partial(_is_dealt, room, task), cluster.wait):
                    raise OSError(f"the dealer does not see {room.pair(task)}, which a worker wrote; {_SAME}")
                on_dealt(task)
        finally:
            with suppress(Exception):  # the scheduler may be what failed
                client.cancel(list(futures))


def _is_dealt(room: Room, task: Task) -> bool:
    return room.record(task) is not None


def deal_on_worker(out: str, mission_id: str, version: str, couple: tuple[str, str], gallery: str) -> str:
    """:func:`dealer.team.pair.deal_pair` in a process of a cluster; returns the id of what is published."""
    tune_process()
    room, task = room_here(out, mission_id, version), Task(couple, gallery)
    require_memory(size_of(room.mission, task).memory, f"dealing {task.key}", "start fewer workers a machine")
    return deal_pair(out, mission_id, couple, gallery, version).tape


def probe_on_worker(out: str, mission_id: str, version: str, name: str) -> None:
    """Look for the room, and leave a file in it that the dealer will look for."""
    probe = room_here(out, mission_id, version).work / name
    probe.mkdir(mode=PRIVATE_FOLDER)
    (probe / _SEEN).touch()


def _about(room: Room) -> tuple[str, str, str]:
    return str(room.out.resolve()), room.mission_id, __version__


def _check_workers(client: Any, room: Room, wait: float) -> None:
    """See that there are workers, and that whoever answers shares the room, both ways."""
    try:
        client.wait_for_workers(1, timeout=wait)
    except Exception as error:  # what it raises in time differs from release to release
        raise DealingStopped(
            f"the cluster has had no worker for {wait:g} s: start some, and go on"
        ) from error
    probes = {}
    for worker in client.nthreads():
        name = f"probe.{secrets.token_hex(8)}"
        probes[client.submit(probe_on_worker, *_about(room), name, workers=[worker], pure=False)] = name
    _until(lambda: all(probe.done() for probe in probes), wait)
    for probe, name in probes.items():
        if not probe.done():  # busy: its tasks will tell
            client.cancel([probe])
            continue
        check_future(probe)
        if not _until((room.work / name / _SEEN).exists, wait):
            raise OSError(f"the dealer does not see what a worker wrote into {room.work}; {_SAME}")
        shutil.rmtree(room.work / name, ignore_errors=True)


def _completed(client: Any, futures: Sequence[Any], wait: float, poll: Callable[[], None]) -> Iterator[Any]:
    """Futures as they are done; gives up where there is nobody to do them for ``wait`` seconds."""
    pending, seen = list(futures), time.monotonic()
    while pending:
        done = [future for future in pending if future.done()]
        pending = [future for future in pending if future not in done]
        yield from done
        poll()
        if done or _has_workers(client):
            seen = time.monotonic()
        elif time.monotonic() - seen > wait:
            raise DealingStopped(
                f"scheduler or workers have been away for {wait:g} s. What was dealt stays: give the same "
                "command to go on when they are back"
            )
        time.sleep(POLL_SECONDS)


def _has_workers(client: Any) -> bool:
    if client.status != "running":
        return False
    try:
        return bool(client.scheduler_info()["workers"])
    except Exception:  # a broken connection, in one of many ways
        return False


def check_future(future: Any) -> None:
    """Refuse a task that is done and did not succeed: its own error as it is, the cluster's in a sentence.

    What a task returned is not fetched: it may be lost with its worker, and is in the room.
    """
    if future.status == "finished":
        return
    error = future.exception(timeout=_TAKES) if future.status == "error" else None
    if isinstance(error, (ValueError, OSError)):
        raise error
    what = f"{type(error).__name__}: {error}" if error is not None else "the scheduler dropped a task"
    raise DealingStopped(
        f"the cluster failed ({what}). What was dealt stays: give the same command to go on"
    ) from error


def _until(condition: Callable[[], bool], seconds: float) -> bool:
    """Wait for what another machine did: a network file system shows it a little later."""
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(POLL_SECONDS)
    return True


@contextmanager
def connected(cluster: Cluster) -> Iterator[Any]:
    """A client of the cluster; a local cluster lives as long as its client.

    Raises:
        ValueError: if ``distributed`` is not installed.
        DealingStopped: if the scheduler is not reached.
    """
    try:
        from distributed import Client, LocalCluster
        from distributed.security import Security
    except ImportError as error:
        raise ValueError(
            "dealing on a cluster takes the package distributed: pip install distributed"
        ) from error
    security: Any = None
    with ExitStack() as stack:
        where: Any = cluster.address
        if cluster.address == LOCAL:
            security = Security.temporary()
            where = LocalCluster(
                n_workers=cluster.workers or cores(),
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                protocol="tls://",
                security=security,
                dashboard_address="127.0.0.1:0",
                silence_logs=logging.CRITICAL,
            )
            stack.callback(where.close, timeout=_TAKES)
        elif cluster.address.startswith("tls:"):
            security = Security(
                tls_ca_file=str(cluster.ca),
                tls_client_cert=str(cluster.cert),
                tls_client_key=str(cluster.key),
                require_encryption=True,
            )
        try:
            client = Client(where, security=security, timeout=cluster.wait, set_as_default=False)
        except OSError as error:  # also where certificates are refused
            raise DealingStopped(
                f"the scheduler at {cluster.address} was not reached within {cluster.wait:g} s: {error}"
            ) from error
        stack.callback(client.close, timeout=_TAKES)
        yield client
