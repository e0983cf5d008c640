"""Holding a tape: one process, one thread at a time, and no copy of it open elsewhere."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from io import FileIO
from pathlib import Path
from threading import Lock

from spdz.foundations.errors import TapeError, TapeInUse
from spdz.tape.advice import cannot_open
from spdz.tape.durable import try_lock, unlock
from spdz.tape.header import Header
from spdz.tape.high_water import HighWater, default_state_dir


class Hold:
    """A tape's file, open and locked for this process.

    Args:
        path: The tape.

    Attributes:
        path: The tape.
        file: The same, open for reading and writing.

    Raises:
        TapeInUse: Another process has it.
        TapeError: It cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._process = os.getpid()
        self._lock = Lock()
        self._mark: HighWater | None = None
        try:
            self.file = FileIO(path, "r+")
        except OSError as error:
            raise cannot_open(path, error, writing=True) from error
        try:
            with _disk_errors(path):
                if not try_lock(self.file.fileno()):
                    raise TapeInUse(f"{path}: the tape is open in another process")
        except BaseException:
            self.file.close()
            raise

    def lock_copies(self, header: Header, state_dir: Path | None) -> HighWater:
        """Lock this tape's high-water mark, which its copies share; it is closed with this object.

        Raises:
            TapeInUse: A copy of the tape is open.
            TapeError: The mark's folder cannot be written.
        """
        self._mark = HighWater(state_dir or default_state_dir(), header.tape, header.party)
        return self._mark

    @contextmanager
    def one_at_a_time(self) -> Iterator[None]:
        """Use the tape alone.

        Raises:
            TapeInUse: In a fork of the process that opened it.
            TapeError: For an ``OSError`` inside.
        """
        if os.getpid() != self._process:  # before the lock: a fork may have copied it locked
            raise TapeInUse(
                f"{self.path}: the tape belongs to process {self._process}, which forked this one"
            )
        with self._lock, _disk_errors(self.path):
            yield

    @contextmanager
    def closing(self) -> Iterator[None]:
        """Unlock and close the tape after what is inside; in a fork its lock stays the parent's."""
        own = os.getpid() == self._process
        with self._lock if own else nullcontext():
            yield
            if own and not self.file.closed:
                # A fork that lives on holds the same open file: closing ours would not unlock it (flock(2)).
                with suppress(OSError):  # closing unlocks as well, unless a fork lives on
                    unlock(self.file.fileno())
                if self._mark is not None:
                    with suppress(OSError):
                        self._mark.unlock()
            if not self.file.closed:
                self.file.close()
                if self._mark is not None:
                    self._mark.close()


@contextmanager
def _disk_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise TapeError(
            f"{path}: the disk failed ({error.strerror}). Nothing was handed out; open the tape again"
        ) from error
