"""What a comparison costs in exact numbers, and the file that holds them: ``tests/vectors/counts.json``.

Where a change is meant to change them: ``python tests/count_helpers.py`` writes the file again, and its
difference is part of the change that is reviewed.
"""

import json
from pathlib import Path

import numpy as np

from protocols.scores import SCORES
from spdz import measure, run_local

FILE = Path(__file__).parent / "vectors" / "counts.json"
SIZES = (1, 7, 16, 1536)
SECURITIES = ("malicious", "semi-honest")
CELLS = [(score, n, security) for score in SCORES for n in SIZES for security in SECURITIES]


def inputs(n):
    """Two vectors of norm 1."""
    return np.full(n, n**-0.5), np.linspace(-1, 1, n + 1)[1:] / max(1.0, n**0.5)


def count(score, n, security):
    """One comparison's counts, as the two parties counted them and as the meter foresees the tapes."""
    program = SCORES[score].within(1.0)
    stats = run_local(program, *inputs(n), security).stats
    assert stats[0].rounds == stats[1].rounds and stats[0].correlations == stats[1].correlations
    return {
        "score": score,
        "n": n,
        "security": security,
        "rounds": stats[0].rounds,
        "bytes_sent": [one.bytes_sent for one in stats],
        "tape_bytes": list(measure(program, ((n,), (n,)), security).correction_bytes),
        "correlations": dict(sorted(stats[0].correlations.items())),
    }


def recorded():
    """The file's rows, by cell."""
    rows = json.loads(FILE.read_text(encoding="utf-8"))
    return {(row["score"], row["n"], row["security"]): row for row in rows}


def write():
    rows = ",\n".join(json.dumps(count(*cell)) for cell in CELLS)
    FILE.write_text(f"[\n{rows}\n]\n", encoding="utf-8")


if __name__ == "__main__":
    write()
