"""Deal on this machine: in this process, or in one a core."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from multiprocessing.connection import Connection

from dealer.team.pair import deal_pair
from dealer.team.room import Room
from dealer.team.stopped import DealingStopped
from dealer.team.tasks import Task
from spdz.console.command import tune_process

POLL_SECONDS = 0.3


def cores() -> int:
    """Cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)  # not on macOS
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1


def deal_here(
    room: Room,
    tasks: Sequence[Task],
    workers: int,
    *,
    on_dealt: Callable[[Task], None],
    poll: Callable[[], None],
) -> None:
    """Deal tasks in so many processes; one is this process itself.

    Whatever ends this function ends the processes as well; what they had not published is void.

    Raises:
        DealingStopped: if a process dies.
        ValueError: if a task cannot be dealt.
        OSError: if a tape cannot be written.
    """
    if workers == 1:
        for task in tasks:
            deal_pair(*_arguments(room, task), progress=lambda done, total: poll())
            on_dealt(task)
        return
    context = get_context("spawn")
    alive, held = context.Pipe(duplex=False)
    pool = ProcessPoolExecutor(
        min(workers, len(tasks)), mp_context=context, initializer=_begin, initargs=(alive,)
    )
    try:
        futures = {pool.submit(deal_pair, *_arguments(room, task)): task for task in tasks}
        pending = set(futures)
        while pending:
            done, pending = wait(pending, POLL_SECONDS, return_when=FIRST_COMPLETED)
            for future in done:
                future.result()
                on_dealt(futures[future])
            poll()
        pool.shutdown()
    except BrokenProcessPool as error:
        raise DealingStopped(
            "a dealing process died, perhaps for lack of memory. What was dealt stays: give the same command "
            "to go on, with fewer --workers if it happens again"
        ) from error
    finally:
        held.close()  # what still runs ends, at once
        pool.shutdown(wait=True, cancel_futures=True)
        alive.close()
        room.clear()


def _arguments(room: Room, task: Task) -> tuple[str, str, tuple[str, str], str]:
    return str(room.out), room.mission_id, task.couple, task.gallery


def _begin(alive: Connection) -> None:
    """Make this process one that deals, and ends with the one that began it, however that ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the dealer's
    threading.Thread(target=_end_with, args=(alive,), daemon=True).start()
    tune_process()


def _end_with(alive: Connection) -> None:
    try:
        alive.recv_bytes()
    except (EOFError, OSError):
        pass
    os._exit(1)
