"""A results folder, read and checked: what ``python -m bench sweep`` and its neighbours wrote into it.

``sweep.json`` says how and where it was measured, ``trials.jsonl`` has a line a trial. ``versus.json``
(``python -m bench versus``) and ``gallery.jsonl`` (``python -m bench gallery --json``) may be there. A folder
that is damaged is refused with the file and the line; nothing is repaired or guessed.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.report.cells import MODELS, Cell, Key
from bench.sweep.cells import PROTOCOLS, SIZES
from bench.sweep.phases import PHASES
from bench.sweep.results import ABOUT, FORMAT, TRIALS, Trial
from protocols.scores import SCORES


class BadResults(ValueError):
    """A results folder that is missing, damaged, or of another format."""


@dataclass(frozen=True, slots=True)
class VersusRow:
    """This tree against an earlier commit, in one run."""

    score: str
    n: int
    security: str
    base_ms: tuple[float, ...]
    ours_ms: tuple[float, ...]
    speedup: float


@dataclass(frozen=True, slots=True)
class Results:
    """A whole folder.

    Attributes:
        about: ``sweep.json``.
        cells: Those that were run.
        versus_base: The commit that ``versus.json`` compares with; None without that file.
        versus_commit: The commit that it compares, if it says so.
        versus: Its rows.
        galleries: Objects of ``gallery.jsonl``, as they are.
    """

    about: Mapping[str, Any]
    cells: Mapping[Key, Cell]
    versus_base: str | None
    versus_commit: str | None
    versus: Sequence[VersusRow]
    galleries: Sequence[Mapping[str, Any]]

    def cell(self, protocol: str, score: str, n: int) -> Cell | None:
        """A cell, or None if it was not run."""
        return self.cells.get((protocol, score, n))

    def sizes(self) -> list[int]:
        """All lengths that were run, rising."""
        return sorted({n for _, _, n in self.cells})

    def missing(self) -> list[Key]:
        """Cells of the paper's sweep that were not run."""
        everything = ((p, s, n) for p in PROTOCOLS for n in SIZES for s in SCORES)
        return [key for key in everything if key not in self.cells]

    def short(self) -> list[Key]:
        """Cells with fewer trials than were asked for: the run was cut off in them."""
        return [key for key, cell in self.cells.items() if len(cell.trials) < self.about["trials"]]


def read_results(folder: Path) -> Results:
    """Read a results folder.

    Raises:
        BadResults: If it is missing, damaged, or of another format.
        OSError: If a file cannot be read.
    """
    if not (folder / ABOUT).is_file():
        raise BadResults(
            f"there are no results in {folder} (no sweep.json): measure some with "
            f"`python -m bench sweep --quick --out {folder}`"
        )
    about = _read_object(folder / ABOUT)
    for key, kind in (("command", str), ("machine", dict), ("quick", bool), ("trials", int)):
        if not isinstance(about.get(key), kind):
            raise BadResults(f"{folder / 'sweep.json'}: {key!r} is missing or of the wrong kind: {_AGAIN}")
    base: str | None = None
    commit: str | None = None
    versus: tuple[VersusRow, ...] = ()
    if (folder / "versus.json").is_file():
        base, commit, versus = _read_versus(folder / "versus.json")
    galleries = folder / "gallery.jsonl"
    return Results(
        about,
        _read_cells(folder / TRIALS),
        base,
        commit,
        versus,
        list(_lines(galleries, _gallery)) if galleries.is_file() else [],
    )


_AGAIN = "the folder is damaged; measure into a new one"


def _read_object(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise BadResults(f"{path} is not JSON ({error}): {_AGAIN}") from error
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        raise BadResults(
            f"{path} is not of format {FORMAT}: it was written by another version, or is damaged"
        )
    return found


def _lines(path: Path, read: Callable[[Any], Any]) -> Iterator[Any]:
    """The whole lines of a file of JSON lines, each as it is read; an error names the line."""
    try:
        *lines, _ = path.read_text(encoding="utf-8").split("\n")  # a killed sweep may leave half a line
    except FileNotFoundError as error:
        raise BadResults(f"{path} is missing: run the sweep to its end, or measure again") from error
    except UnicodeDecodeError as error:
        raise BadResults(f"{path} is not text: {_AGAIN}") from error
    for number, line in enumerate(lines, 1):
        try:
            yield read(json.loads(line))
        except (ValueError, TypeError, KeyError) as error:
            what = f"has no {error}" if isinstance(error, KeyError) else str(error)
            raise BadResults(f"{path}, line {number}: {what}. Delete the line, or measure again") from error


def _read_cells(path: Path) -> dict[Key, Cell]:
    counted: dict[Key, dict[int, Trial]] = {}
    profiled: dict[Key, Trial] = {}
    for trial in _lines(path, _trial):
        key = (trial.protocol, trial.score, trial.n)
        if trial.profiled:
            profiled[key] = trial
        elif trial.trial in counted.setdefault(key, {}):
            name = " ".join(map(str, key))
            raise BadResults(f"{path}: trial {trial.trial} of {name} stands there twice: {_AGAIN}")
        else:
            counted[key][trial.trial] = trial
    if not counted:
        raise BadResults(f"{path} has no trials: run the sweep first")
    return {key: Cell(*key, list(trials.values()), profiled.get(key)) for key, trials in counted.items()}


def _trial(row: dict[str, Any]) -> Trial:
    trial = Trial.of(row)
    if trial.protocol not in PROTOCOLS or trial.score not in SCORES or not _whole(trial.n, "n"):
        raise ValueError(f"there is no cell {trial.protocol} {trial.score} {trial.n}")
    if not trial.profiled:
        _whole(trial.trial, "trial")
    _positive(row, "ms")
    if not trial.bytes_sent or not trial.tape_bytes:
        raise ValueError("bytes_sent or tape_bytes is empty")
    for name in ("bytes_sent", "tape_bytes"):
        for one in row[name]:
            _whole(one, name)
    for name in ("rounds", "messages"):
        _whole(row[name], name)
    if trial.error is not None:
        _number(trial.error, "error")
    if trial.floor_ms is not None:
        _positive(row, "floor_ms")
    for name in ("ahead_ms", "compile_ms"):
        if row[name] is not None:
            _number(row[name], name)
    if trial.phases is not None:
        for name in PHASES:
            _number(trial.phases[name], name)
    return trial


def _number(value: Any, name: str) -> float:
    if (
        isinstance(value, bool)
        or not isinstance(value, (int, float))
        or not math.isfinite(value)
        or value < 0
    ):
        raise ValueError(f"{name} is {value!r}, expected a number of at least 0")
    return float(value)


def _positive(row: Mapping[str, Any], name: str) -> float:
    value = _number(row[name], name)
    if not value:
        raise ValueError(f"{name} is 0, expected more")
    return value


def _whole(value: Any, name: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"{name} is {value!r}, expected a whole number of at least 0")
    return value


def _read_versus(path: Path) -> tuple[str, str | None, tuple[VersusRow, ...]]:
    data = _read_object(path)
    try:
        rows = tuple(
            VersusRow(
                row["score"],
                _whole(row["n"], "n"),
                row["security"],
                tuple(_number(one, "base_ms") for one in row["base_ms"]),
                tuple(_number(one, "ours_ms") for one in row["ours_ms"]),
                _positive(row, "speedup"),
            )
            for row in data["rows"]
        )
        return str(data["base"]), data.get("commit"), rows
    except (KeyError, TypeError, ValueError) as error:
        what = f"has no {error}" if isinstance(error, KeyError) else str(error)
        raise BadResults(f"{path}: {what}. Measure it again with `python -m bench versus`") from error


def _gallery(row: dict[str, Any]) -> dict[str, Any]:
    """A measured gallery; other questions of the same command (arrivals, streams) pass unused."""
    if "pairs_per_s" in row:
        for name in ("pairs_per_s", "bytes_per_pair", "tape_bytes_per_pair"):
            _positive(row, name)
        if row["security"] not in MODELS:
            raise ValueError(f"there is no security model {row['security']!r}")
        for name in ("n", "rows", "columns"):
            _whole(row[name], name)
    elif not ({"n", "security"} < row.keys() and row.keys() & {"stored", "rate"}):
        raise ValueError("`python -m bench gallery --json` prints no such line")
    return row
