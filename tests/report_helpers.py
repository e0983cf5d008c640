"""An invented results folder: its figures were never measured, and are told apart by being formulas."""

import json
from pathlib import Path

from bench.report.cells import MODELS
from bench.report.folder import BadResults, read_results
from bench.sweep.cells import PROTOCOLS, SIZES
from bench.sweep.phases import PHASES
from protocols.scores import SCORES

QUICK = {n: tuple(SCORES) if n == 16 else ("S10",) for n in (16, 1536)}
WHOLE = {n: tuple(SCORES) for n in SIZES}
_LEVEL = {"malicious": 0.2, "semi-honest": 0.125, "numpy": 0.0625, "cpp": 0.0005}


def ms(protocol, score, n, trial):
    """Milliseconds of a trial: trials 0, 1, 2 are 0.9, 1.0 and 1.4 of the middle one."""
    slow = {"S1": 40, "S2": 8, "S10": 1}.get(score, 12)
    return _LEVEL[protocol] * slow * (1 + n / 4096) * (0.9, 1.0, 1.4)[trial % 3]


def ahead_ms(protocol, n):
    """Milliseconds ahead of a comparison."""
    return 0.125 * _LEVEL[protocol] * (1 + n / 4096) if protocol in MODELS else None


def sent(protocol, score, n):
    """Bytes of both parties."""
    return (8 * n, 8 * n) if protocol not in MODELS else (8 * n + 64, 8 * n + 80 + len(score))


def trial(protocol, score, n, number, *, profiled=False):
    secure = protocol in MODELS
    time = ms(protocol, score, n, max(number, 0)) * (2 if profiled else 1)
    row = {"protocol": protocol, "score": score, "n": n, "trial": number, "ms": time}
    row |= {"bytes_sent": sent(protocol, score, n), "messages": 6 if secure else 2}
    row |= {"rounds": (3 if protocol == "malicious" else 2) if secure else 1}
    row |= {"tape_bytes": [16 * n + 16, 16 * n] if secure else [0, 0], "error": 1e-5 if secure else None}
    row |= {"floor_ms": 0.05 if secure else None, "phases": None}
    row |= {"ahead_ms": ahead_ms(protocol, n), "compile_ms": 7.5 if secure else None}
    if profiled:
        row |= {"profiled": True, "phases": {name: time * (at + 1) / 42 for at, name in enumerate(PHASES)}}
    return row


def lines(lengths, trials=3):
    """The lines of trials.jsonl, as objects."""
    rows = []
    for n, scores in lengths.items():
        for score in scores:
            for protocol in PROTOCOLS:
                rows += [trial(protocol, score, n, number) for number in range(trials)]
                if protocol in MODELS:
                    rows.append(trial(protocol, score, n, -1, profiled=True))
    return rows


def about(quick=True):
    machine = {"cpu": "an invented processor", "cores": 2, "system": "Linux", "python": "3.12", "numpy": "2"}
    machine |= {"spdz": "0.1", "compiler": None}
    return {
        "format": 1, "command": "python -m bench sweep --quick", "commit": "abc1234", "dirty": False,
        "started": "2026-01-01T00:00:00", "finished": "2026-01-01T00:01:00", "machine": machine,
        "quick": quick, "trials": 3,
    }  # fmt: skip


def versus(base="ff69b37"):
    """Two cells that MP-SPDZ was recorded beside, and one that it was not."""
    rows = [
        {
            "score": "S10",
            "n": 16,
            "security": "malicious",
            "base_ms": [1.0],
            "ours_ms": [0.5],
            "speedup": 2.0,
        },
        {"score": "S4", "n": 1536, "security": "malicious", "base_ms": [3.0], "ours_ms": [1], "speedup": 3.0},
        {"score": "S9", "n": 256, "security": "malicious", "base_ms": [9.0], "ours_ms": [1], "speedup": 9.0},
    ]
    return {"format": 1, "base": base, "commit": "abc1234", "dirty": False, "rows": rows}


def gallery():
    row = {"n": 1536, "rows": 256, "columns": 256, "resolution": "2^-16", "pairs_per_s": 500_000.0}
    row |= {"bytes_per_pair": 16.0, "tape_bytes_per_pair": 320.0}
    return [{**row, "security": security} for security in MODELS]


def write(folder: Path, lengths=QUICK, *, more=False):
    """Write the folder; with ``more``, the neighbours' files too."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "sweep.json").write_text(json.dumps(about(quick=lengths is QUICK)), encoding="utf-8")
    write_lines(folder / "trials.jsonl", lines(lengths))
    if more:
        (folder / "versus.json").write_text(json.dumps(versus()), encoding="utf-8")
        write_lines(folder / "gallery.jsonl", gallery())
    return folder


def write_lines(path, rows):
    path.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")


def refusal(folder):
    """What a damaged folder is refused with."""
    try:
        read_results(folder)
    except BadResults as error:
        return str(error)
    raise AssertionError("the folder was taken")
