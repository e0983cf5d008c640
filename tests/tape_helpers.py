import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from spdz.arithmetic import prf
from spdz.tape import TapeHeader, TapeWriter

CHAIN = bytes(range(100, 132))
ALPHA = bytes(range(200, 216))

HEADER = TapeHeader(
    mission="0a1b",
    tape="beef",
    agents=("alice", "bob"),
    party=0,
    security="malicious",
    fingerprint="c0ffee",
    program={"score": "S10", "reveal": "bit", "dim": 1536, "tile": [1, 1], "max_norm": 1.5},
    jobs=10,
    pad_bytes=64,
    correction_bytes=40,
)


def corrections(header: TapeHeader) -> list[bytes]:
    rng = np.random.default_rng(1)
    return [rng.bytes(header.correction_bytes) for _ in range(header.jobs)]


def chains(number: int) -> list[bytes]:
    result = [CHAIN]
    while len(result) < number:
        result.append(prf.next_chain(result[-1]))
    return result


def deal(path: Path, **changes: object) -> Path:
    header = replace(HEADER, **changes)  # type: ignore[arg-type]
    with TapeWriter(path, header, CHAIN, ALPHA) as writer:
        for correction in corrections(header):
            writer.append(correction)
    assert writer.bytes_written == path.stat().st_size
    return path


def skip_sync(monkeypatch: pytest.MonkeyPatch) -> None:
    """Syncing only takes time where no crash is simulated."""
    for module in ("durable", "state", "publishing"):
        monkeypatch.setattr(f"spdz.tape.{module}.sync", lambda descriptor: None)
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)
