"""The folder that a sweep writes, and what reads it.

- ``sweep.json``: one object, :class:`About`;
- ``trials.jsonl``: a line a trial, :class:`Trial`; those of a cell are appended together;
- ``sweep.csv``: the same without the profiled trials.

Killed at any moment, a sweep goes on with the cells that are missing: a line that was half written, and the
lines of a cell that is not all there, are dropped when the folder is opened.
"""

from __future__ import annotations

import csv
import fcntl
import io
import json
import os
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from itertools import accumulate
from pathlib import Path
from types import TracebackType
from typing import Any

from bench.out import out_folder
from bench.sweep.cells import Cell
from spdz.foundations.types import SECURITIES

FORMAT = 1
PROFILED = -1
"""The number of the trial that ran under a profiler."""

ABOUT, TRIALS, TABLE = "sweep.json", "trials.jsonl", "sweep.csv"


class ResultsError(Exception):
    """Why a folder of results cannot be used, in words for a person."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One trial.

    Attributes:
        protocol: ``"malicious"``, ``"semi-honest"``, ``"numpy"`` or ``"cpp"``.
        score: ``"S1"`` to ``"S10"``.
        n: Length of a descriptor.
        trial: Its number, from 0; :data:`PROFILED` for the one under a profiler.
        ms: Milliseconds, of the slower party; of ``cpp``, those of the bare computation.
        bytes_sent: By party 0 and 1, frame headers included; of ``cpp``, what an exchange would send.
        rounds: Exchanges, both directions at once.
        messages: What a party sends and receives, twice the rounds.
        tape_bytes: Stored for it on party 0's and party 1's tape.
        error: Distance from the true score of the quantised descriptors, of the party that is further off.
        floor_ms: The same frames over a bare socket, a median; None where nothing is sent.
        ahead_ms: A job's part of what is done before its inputs are known (:mod:`bench.sweep.ahead`), of the
            slower party; one figure a cell, not in ``ms``. None of ``numpy`` and ``cpp``.
        compile_ms: Reading and compiling the program, once a session, likewise; neither in ``ms`` nor in
            ``ahead_ms``.
        phases: Of the profiled trial, milliseconds of each phase in party 0, scaled to the cell's median.
    """

    protocol: str
    score: str
    n: int
    trial: int
    ms: float
    bytes_sent: list[int]
    rounds: int
    messages: int
    tape_bytes: list[int]
    error: float | None
    floor_ms: float | None
    ahead_ms: float | None = None
    compile_ms: float | None = None
    phases: dict[str, float] | None = None

    @property
    def cell(self) -> Cell:
        """The cell that it belongs to."""
        return Cell(self.n, self.score, self.protocol)

    @property
    def profiled(self) -> bool:
        """Whether it ran under a profiler: its time is then no measurement."""
        return self.trial == PROFILED

    def but(self, **changes: Any) -> Trial:
        """The same with other fields."""
        return replace(self, **changes)

    def as_dict(self) -> dict[str, Any]:
        """A line of ``trials.jsonl``."""
        return {**asdict(self), "profiled": self.profiled}

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> Trial:
        """Read a line of ``trials.jsonl``.

        Raises:
            KeyError: if a field is missing.
        """
        return cls(**{field.name: row[field.name] for field in fields(cls)})


@dataclass(frozen=True, slots=True)
class About:
    """What ``sweep.json`` says.

    Attributes:
        command: What was typed, each command once.
        commit: The project's commit; None where it does not run from its repository.
        dirty: Whether tracked files differed from that commit.
        started: When the folder was begun, ISO 8601, UTC.
        finished: When the last command had all that it asked for; None before.
        machine: What it ran on: see :mod:`bench.sweep.machine`.
        quick: Whether ``--quick`` chose the cells.
        trials: Counted trials of a cell.
        warm_up: Trials before them.
        seed: Of the descriptors.
        source: A digest of the engine's and the sweep's source files.
        threshold_note: What is measured.
        format: Of the folder.
    """

    command: str
    commit: str | None
    dirty: bool
    started: str
    finished: str | None
    machine: dict[str, Any]
    quick: bool
    trials: int
    warm_up: int
    seed: int
    source: str
    threshold_note: str
    format: int = FORMAT

    def settings(self) -> dict[str, Any]:
        """What all trials of a folder have in common."""
        machine = {name: value for name, value in self.machine.items() if name != "compiler"}
        names = ("format", "quick", "trials", "warm_up", "seed", "source")
        return {**{name: getattr(self, name) for name in names}, **machine}


class Results:
    """A folder of results, open for one sweep; a context manager.

    Args:
        folder: The folder; made if it is not there.
        about: The sweep that is about to run.

    Attributes:
        about: As given, begun when the folder was.
        done: The trials of all cells that are complete.

    Raises:
        ResultsError: if the folder holds trials of other settings, or another sweep writes to it.
        OSError: if it cannot be read or written.
    """

    def __init__(self, folder: Path, about: About) -> None:
        self.folder = out_folder(folder)
        self._file = (folder / TRIALS).open("ab")
        try:
            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise ResultsError(f"another sweep is writing to {folder}") from None
            self.about, self.done = self._resume(about)
        except BaseException:
            self._file.close()
            raise

    def _resume(self, about: About) -> tuple[About, dict[Cell, list[Trial]]]:
        path = self.folder / ABOUT
        if path.exists():
            before = read_about(self.folder)
            ours, theirs = about.settings(), before.settings()
            other = [
                f"{name} {theirs.get(name)} (now {ours[name]})"
                for name in ours
                if ours[name] != theirs.get(name)
            ]
            if other:
                raise ResultsError(
                    f"{self.folder} holds a sweep with other settings: {', '.join(other)}. One folder holds "
                    "one kind of trial: give another --out, or delete that folder"
                )
            about = replace(
                about,
                command="; ".join(dict.fromkeys([*before.command.split("; "), about.command])),
                started=before.started,
                finished=before.finished,
            )
        elif (self.folder / TRIALS).stat().st_size:
            raise ResultsError(f"{self.folder} has {TRIALS} and no {ABOUT}: give another --out")
        trials, ends = _read_lines(self.folder / TRIALS)
        done = complete(trials, about.trials)
        kept = next((number for number, trial in enumerate(trials) if trial.cell not in done), len(trials))
        self._file.truncate(ends[kept])  # a killed sweep leaves what is not complete at the end
        _write(path, json.dumps(asdict(about), indent=1) + "\n")
        return about, complete(trials[:kept], about.trials)

    def add(self, trials: Sequence[Trial]) -> None:
        """Keep all trials of a cell: when this returns they are on the disk."""
        if self.about.finished is not None:
            self._note(None)
        self.done[trials[0].cell] = list(trials)
        self._file.write(b"".join(json.dumps(trial.as_dict()).encode() + b"\n" for trial in trials))
        self._file.flush()
        os.fsync(self._file.fileno())

    def finish(self, when: str) -> None:
        """Note that nothing of what was asked for is missing; where nothing was, the time stays."""
        if self.about.finished is None:
            self._note(when)

    def _note(self, finished: str | None) -> None:
        self.about = replace(self.about, finished=finished)
        _write(self.folder / ABOUT, json.dumps(asdict(self.about), indent=1) + "\n")

    def close(self) -> None:
        """Write the table, and let go of the folder."""
        if not self._file.closed:
            with self._file:
                _write(self.folder / TABLE, table([trial for rows in self.done.values() for trial in rows]))

    def __enter__(self) -> Results:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def read_about(folder: Path) -> About:
    """Read ``sweep.json``.

    Raises:
        ResultsError: if it is not of this format.
        OSError: if it cannot be read.
    """
    try:
        row = json.loads((folder / ABOUT).read_text(encoding="utf-8"))
        if row["format"] != FORMAT:
            raise ValueError(f"format {row['format']}, expected {FORMAT}")
        return About(**row)
    except (ValueError, KeyError, TypeError) as error:
        raise ResultsError(f"{folder / ABOUT} is not about a sweep: {error}") from error


def read_trials(folder: Path) -> list[Trial]:
    """Read all trials of a folder's complete cells, in the order in which they were measured.

    Raises:
        ResultsError: if the folder is not of this format.
        OSError: if it cannot be read.
    """
    found, _ = _read_lines(folder / TRIALS)
    done = complete(found, read_about(folder).trials)
    return [trial for rows in done.values() for trial in rows]


def complete(trials: Sequence[Trial], count: int) -> dict[Cell, list[Trial]]:
    """The cells that have every trial once, and where there is one the profiled trial, with their trials."""
    cells: dict[Cell, list[Trial]] = defaultdict(list)
    for trial in trials:
        cells[trial.cell].append(trial)
    wanted = {
        protocol: [*range(count), *([PROFILED] if protocol in SECURITIES else [])]
        for protocol in {cell.protocol for cell in cells}
    }
    return {
        cell: rows for cell, rows in cells.items() if [row.trial for row in rows] == wanted[cell.protocol]
    }


def table(trials: Sequence[Trial]) -> str:
    """The trials that are measurements, as CSV with a header."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = [field.name for field in fields(Trial) if field.name != "phases"]
    pairs = ("bytes_sent", "tape_bytes")
    writer.writerow(
        [part for name in names for part in ([f"{name}_0", f"{name}_1"] if name in pairs else [name])]
    )
    for trial in trials:
        if not trial.profiled:
            values = (getattr(trial, name) for name in names)
            writer.writerow([part for one in values for part in (one if isinstance(one, list) else [one])])
    return text.getvalue()


def _read_lines(path: Path) -> tuple[list[Trial], list[int]]:
    """The trials of all whole lines, and where each line begins, and the end of the last."""
    lines = path.read_bytes().split(b"\n")[:-1]
    try:
        trials = [Trial.of(json.loads(line)) for line in lines]
        return trials, list(accumulate((len(line) + 1 for line in lines), initial=0))
    except (ValueError, KeyError, TypeError) as error:
        raise ResultsError(f"{path} has a line that is no trial: {error}") from error


def _write(path: Path, text: str) -> None:
    """Write a file so that it is always the old one or the new one."""
    beside = path.with_name(path.name + ".new")
    beside.write_text(text, encoding="utf-8")
    beside.replace(path)
