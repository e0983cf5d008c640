"""The paper's table, in its layout: ours, what the paper prints, and what was recorded of MP-SPDZ."""

from __future__ import annotations

from collections.abc import Iterator

from bench.recorded import Recorded, recorded
from bench.recorded_table import Printed, PrintedRow, recorded_table
from bench.report.cells import MODELS, Cell
from bench.report.folder import Results
from bench.report.table import NOTHING, Table, amount, milliseconds, whole
from bench.sweep.cells import SIZES
from protocols.scores import SCORES

_FIGURES = ("mean", "std", "MB", "#")
_NONE = (NOTHING,) * 4
_FIRST = ("N", "ID", "score", "figures")
ENGINE = "MP-SPDZ"


def tables(results: Results) -> Iterator[Table]:
    """The rows that the paper prints, then all that was run."""
    yield _paper(results)
    yield _everything(results)


def recorded_mp_spdz(score: str, n: int, security: str) -> Recorded | None:
    """What was recorded of MP-SPDZ's quickest protocol; None where nothing was."""
    found = (one for one in recorded(score, n, security) if one.engine.startswith(ENGINE))
    return next(found, None)


def _paper(results: Results) -> Table:
    rows: list[tuple[str, ...]] = []
    ours = set()
    for printed in recorded_table().printed:
        first = (str(printed.n), printed.score, printed.name)
        ours.add(len(rows))
        rows.append((*first, "ours", *_ours(results, printed.score, printed.n)))
        rows.append((*first, "paper", *_printed(printed)))
        found = [recorded_mp_spdz(printed.score, printed.n, model) for model in MODELS]
        if any(found):
            rows.append((*first, ENGINE, *(cell for one in found for cell in _recorded(one)), *_NONE))
    how = recorded_table().printed_how
    about = recorded("S10", 16, "malicious")[0]
    return Table(
        f"Ours, the paper's, and {ENGINE}'s",
        (*_FIRST, *_FIGURES, *_FIGURES, "mean", "std", "KB", "#"),
        rows,
        len(_FIRST),
        (
            ("", len(_FIRST)),
            ("malicious, t [ms], comms", 4),
            ("semi-honest, t [ms], comms", 4),
            ("insecure (C++), t [µs], comms", 4),
        ),
        frozenset(ours),
        (
            "Times of different machines compare roughly; bytes and rounds compare exactly. "
            f"{NOTHING}: not run, not printed or not recorded.",
            "MB is what one party sends (ours: the larger of the two, frame headers included). The paper "
            "does not say whose bytes it prints; they are one party's, since those of S2, S6 and S10 are "
            "what one party was recorded to send. Ours in # are frames of both parties. The deviation is a "
            "sample's.",
            f"paper: {how}",
            f"{ENGINE}: its quickest protocol of the model, on {about.how} The mean is that median; in "
            "brackets stand rounds, not messages. The programs are not the paper's: roots and normalising "
            "take fewer bytes in them.",
        ),
    )


def _ours(results: Results, score: str, n: int) -> list[str]:
    cells = [results.cell(model, score, n) for model in MODELS]
    return [*(figure for cell in cells for figure in _cell(cell)), *_baseline(results.cell("cpp", score, n))]


def _cell(cell: Cell | None) -> tuple[str, ...]:
    if cell is None:
        return _NONE
    mega = amount(cell.bytes_party / 1e6)
    return milliseconds(cell.mean_ms), milliseconds(cell.std_ms), mega, whole(cell.messages)


def _baseline(cell: Cell | None) -> tuple[str, ...]:
    if cell is None:
        return _NONE
    std = None if cell.std_ms is None else cell.std_ms * 1e3
    kilo = amount(cell.bytes_party / 1e3)
    return milliseconds(cell.mean_ms * 1e3), milliseconds(std), kilo, whole(cell.messages)


def _printed(row: PrintedRow) -> list[str]:
    return [
        cell for one in (row.malicious, row.semi_honest, row.baseline) for cell in _printed_cells(one)
    ]  # fmt: skip


def _printed_cells(one: Printed) -> tuple[str, ...]:
    return f"{one.mean:.2f}", f"{one.std:.2f}", f"{one.comms:.3f}", str(one.messages)


def _recorded(one: Recorded | None) -> tuple[str, ...]:
    if one is None:
        return _NONE
    rounds = NOTHING if one.rounds is None else f"({one.rounds})"
    return milliseconds(one.ms), NOTHING, amount(one.bytes_sent / 1e6), rounds


def _everything(results: Results) -> Table:
    rows = []
    for n in sorted({*SIZES, *results.sizes()}):
        for score in SCORES:
            cells = [results.cell(name, score, n) for name in (*MODELS, "numpy")]
            cpp = results.cell("cpp", score, n)
            if any(cells) or cpp:
                figures = [figure for cell in cells for figure in _cell(cell)]
                rows.append((str(n), score, SCORES[score].title, *figures, *_baseline(cpp)))
    return Table(
        f"All {len(results.cells)} cells that were run",
        (*_FIRST[:3], *_FIGURES, *_FIGURES, *_FIGURES, "mean", "std", "KB", "#"),
        rows,
        3,
        (
            ("", 3),
            ("malicious, t [ms], comms", 4),
            ("semi-honest, t [ms], comms", 4),
            ("in the clear (NumPy), t [ms], comms", 4),
            ("insecure (C++), t [µs], comms", 4),
        ),
        notes=("In the clear: the descriptors cross a socket as they are, and NumPy compares them.",),
        folded=True,
    )
