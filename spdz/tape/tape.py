"""A tape: one party's half of what the dealer dealt for one pair of robots, used once whatever happens.

A tape is ``header.jobs`` jobs of equal size. A job has a key, from which the engine expands its pad, and a
stored correction. Keys come from a forward ratchet, key_j = job_key(chain_j) and
chain_{j+1} = next_chain(chain_j), and the stored correction is sealed under one of them: a captured robot's
tape tells nothing of the jobs that it has used, not even to a peer that kept its own half of them.

What keeps a job from being used twice, since that would reveal x - x' to the peer:

- *Reserving.* ``reserve`` returns when the high-water mark (:mod:`spdz.tape.high_water`) and the cursor are
  on the disk and the used chain values are not (:mod:`spdz.tape.state`). What was reserved stays used.
- *One process.* The tape and its mark are locked; a fork and a second thread are noticed.
- *Backups.* A tape behind its mark is moved up to it when it is opened.
- *The peer.* ``resume`` starts at the larger of both sides' cursors.

Cost of one ``reserve``: the corrections are read and checked once, then four syncs for any number of jobs.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType

from spdz.arithmetic import prf
from spdz.foundations.errors import TapeDamaged, TapeDestroyed, TapeError, TapeExhausted, TapeMismatch
from spdz.tape.advice import replacement
from spdz.tape.corrections import read_corrections
from spdz.tape.format import Layout, TapeHeader, read_header
from spdz.tape.high_water import HighWater, Mark
from spdz.tape.hold import Hold
from spdz.tape.state import State, StateSlots


@dataclass(frozen=True, slots=True)
class Job:
    """One job's share of the dealt correlations.

    Attributes:
        index: Its place on the tape, the same for both parties.
        key: 32 bytes, from which the pad is expanded.
        correction: ``correction_bytes`` bytes, read-only, 16-byte aligned.
    """

    index: int
    key: bytes = field(repr=False)
    correction: memoryview = field(repr=False)


class Tape:
    """An open tape. Use :meth:`open`; a context manager; safe to share between threads.

    After any error of the disk the tape refuses to go on until it is opened again: then it is known again
    what the disk holds.

    Attributes:
        header: What the tape is for.
        rolled_back: Whether the tape was behind its high-water mark when it was opened, and so was moved past
            the jobs in between: it was restored from a backup, or the last reservation was interrupted by a
            crash.
    """

    MAX_JUMP = 1 << 16
    """Most jobs that a peer's claim may skip. Honest cursors differ by the reservations of one session, since
    each handshake makes them equal. It caps what one bad claim burns, and its cost at 65,536 ratchet steps
    (about 0.1 s). Give ``resume`` a larger one to rejoin a peer after losing the state of many sessions."""

    def __init__(self, hold: Hold, header: TapeHeader, layout: Layout, mark: HighWater) -> None:
        self.header = header
        self.rolled_back = False
        self._hold = hold
        self._path = hold.path
        self._layout = layout
        self._mark = mark
        self._slots = StateSlots(hold.file.fileno(), layout.slots, layout.digest)
        self._state: State | None = None

    @classmethod
    def open(cls, path: str | os.PathLike[str], *, state_dir: Path | None = None) -> Tape:
        """Open and lock a tape.

        Args:
            path: The tape.
            state_dir: Where the high-water mark is kept; by default ``$XDG_STATE_HOME/spdz`` or
                ``~/.local/state/spdz``. Always give the same one for a tape.

        Raises:
            TapeInUse: It, or a copy of it, is open already.
            TapeMismatch: It is a tape of another kind.
            TapeDamaged: It is not a whole tape; the message says where. ``reserve`` checks corrections.
            TapeDestroyed: It was destroyed, or is a copy of a tape that was.
            TapeError: It, or its high-water mark, cannot be read or written.
        """
        hold = Hold(Path(path))
        try:
            with hold.one_at_a_time():
                header, layout = read_header(hold.file.fileno(), hold.path)
                tape = cls(hold, header, layout, hold.lock_copies(header, state_dir))
                tape._recover()
        except BaseException:
            with hold.closing():
                pass
            raise
        return tape

    @property
    def cursor(self) -> int:
        """The next unused job."""
        return self._usable().cursor

    @property
    def remaining(self) -> int:
        """Number of unused jobs."""
        return self.header.jobs - self.cursor

    @property
    def alpha(self) -> bytes:
        """This party's share of the MAC key, 16 bytes."""
        return self._usable().alpha

    def resume(self, peer_cursor: int, *, max_jump: int = MAX_JUMP) -> int:
        """Move on to where the peer is, if it is ahead.

        Args:
            peer_cursor: The peer's claim of its own cursor.
            max_jump: Most jobs that it may be ahead.

        Returns:
            The cursor that both sides start at.

        Raises:
            TapeMismatch: The claim is past the end, or too far ahead. It is not stored.
            TapeInUse: Called in a fork of the process that opened the tape.
            TapeError: The tape is closed, destroyed, or its state cannot be written.
        """
        with self._hold.one_at_a_time():
            state = self._usable()
            claim = f"{self._path}: {self.header.peer} says that it is at job {peer_cursor!r}"
            if type(peer_cursor) is not int or not 0 <= peer_cursor <= self.header.jobs:
                raise TapeMismatch(f"{claim}, but {self.header.jobs} jobs were dealt. Nothing was used")
            if peer_cursor - state.cursor > max_jump:
                raise TapeMismatch(
                    f"{claim}, which is more than {max_jump} ahead of this tape's {state.cursor}. "
                    "Nothing was used. If it is true, deal new tapes"
                )
            if peer_cursor > state.cursor:
                self._advance(peer_cursor)
            return self.cursor

    def reserve(self, count: int) -> list[Job]:
        """Take the next ``count`` jobs, all or nothing. They are used from now on, whatever happens.

        Raises:
            ValueError: ``count`` is negative.
            TapeExhausted: Fewer are left; nothing was used.
            TapeDamaged: A checksum does not hold; its message names job and offset. No job was taken.
            TapeInUse: Called in a fork of the process that opened the tape.
            TapeError: The tape is closed, destroyed, or its state cannot be written.
        """
        with self._hold.one_at_a_time():
            state = self._usable()
            if count < 0:
                raise ValueError(f"cannot reserve {count} jobs")
            left = self.header.jobs - state.cursor
            if count > left:
                raise TapeExhausted(
                    f"{self._path}: of {self.header.jobs} jobs dealt for {' and '.join(self.header.agents)}, "
                    f"{state.cursor} are used and {left} left; {count} are needed. Nothing was used. "
                    f"Deal more: {self.header.dealer_command}"
                )
            if count == 0:
                return []
            corrections = read_corrections(
                self._hold.file,
                self._path,
                self.header,
                self._layout,
                state.cursor,
                count,
                used=state.cursor > 0,
            )
            jobs: list[Job] = []
            for chain, correction in zip(self._advance(state.cursor + count), corrections, strict=True):
                prf.seal(prf.seal_key(chain), correction)
                jobs.append(Job(state.cursor + len(jobs), prf.job_key(chain), correction.toreadonly()))
            return jobs

    def destroy(self) -> None:
        """Overwrite the tape's secrets and mark it destroyed, here and in its high-water mark.

        For a failed MAC check: alpha must not be used again. A second call does nothing.

        Raises:
            TapeInUse: Called in a fork of the process that opened the tape.
            TapeError: The tape is closed, or the disk failed.
        """
        with self._hold.one_at_a_time():
            if self._hold.file.closed:
                raise TapeError(f"{self._path}: the tape is closed")
            if self._state is None or not self._state.destroyed:
                self._destroy(0 if self._state is None else self._state.cursor)

    def close(self) -> None:
        """Unlock the tape. A second call does nothing; in a fork the lock stays the parent's."""
        with self._hold.closing():
            self._state = None

    def __repr__(self) -> str:
        return f"<tape of {self.header.name} for {self.header.peer}: {self.remaining} jobs left>"

    def __enter__(self) -> Tape:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _usable(self) -> State:
        if self._state is None:
            raise TapeError(f"{self._path}: the tape is closed, or recording its use failed: open it again")
        if self._state.destroyed:
            raise TapeDestroyed(f"{self._path}: the tape was destroyed. Deal a new pair of tapes")
        return self._state

    def _recover(self) -> None:
        """Bring slots and mark together, at whichever is further."""
        mark = self._mark.read()
        state = self._slots.load()
        if (mark is not None and mark.destroyed) or (state is not None and state.destroyed):
            self._destroy(max(mark.cursor if mark else 0, state.cursor if state else 0))
            raise TapeDestroyed(
                f"{self._path}: the tape was destroyed, because a MAC check failed. "
                "A copy of it cannot be used either. Deal a new pair of tapes"
            )
        if state is None or state.cursor > self.header.jobs:
            raise TapeDamaged(
                f"{self._path}: the checksums of the state at byte {self._layout.slots} do not hold. "
                f"{replacement(None if mark is None else mark.cursor > 0)}"
            )
        if mark is not None and mark.cursor > self.header.jobs:
            raise TapeDamaged(
                f"{self._path}: the high-water mark {mark.cursor} is past its {self.header.jobs} jobs. "
                f"{replacement(used=True)}"
            )
        self._state = state
        if mark is None or mark.cursor < state.cursor:
            self._mark.write(Mark(state.cursor))
        elif mark.cursor > state.cursor:
            self.rolled_back = True
            self._advance(mark.cursor)

    def _advance(self, cursor: int) -> list[bytes]:
        """Use all jobs below ``cursor``, durably: mark first, then slots. Returns their chain values."""
        state = self._usable()
        self._state = None  # until the disk has it, it is not known what the disk has
        used, chain = [], state.chain
        for _ in range(state.cursor, cursor):
            used.append(chain)
            chain = prf.next_chain(chain)
        self._mark.write(Mark(cursor))
        advanced = State(cursor, chain, state.alpha)
        self._slots.store(advanced)
        self._state = advanced
        return used

    def _destroy(self, cursor: int) -> None:
        self._state = None
        wiped = State.wiped(cursor)
        try:
            self._mark.write(Mark(cursor, destroyed=True))
        finally:
            self._slots.store(wiped)
        self._state = wiped
