"""The insecure baseline in C++, as the paper has it: compiled with the system's compiler, timed inside.

The bare computation of a score in double precision, ``-O3``, on one core, the vectors in its caches: nothing
is sent. Beside it stands what an exchange in the clear would send: 8 bytes a number each way.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np

from spdz.foundations.types import FloatArray

FLAGS = ("-O3", "-std=c++11")
_COMPILERS = ("g++", "clang++", "c++")
_TIMEOUT = 120.0


def find_compiler() -> str | None:
    """The C++ compiler to use: the one that ``CXX`` names, or the first of the usual ones that is there."""
    named = os.environ.get("CXX")
    return next(filter(None, map(shutil.which, [named] if named else _COMPILERS)), None)


def compiler_version(compiler: str) -> str:
    """The first line of what a compiler says of itself.

    Raises:
        OSError: if it cannot be run.
        subprocess.SubprocessError: if it fails.
    """
    told = _run([compiler, "--version"]).decode(errors="replace")
    return told.splitlines()[0].strip() if told.strip() else Path(compiler).name


@dataclass(frozen=True, slots=True)
class Baseline:
    """The compiled program."""

    program: Path

    def measure(self, score: str, x: FloatArray, y: FloatArray) -> tuple[list[float], list[float]]:
        """Scores of pairs, and the seconds that one evaluation of each took.

        Args:
            score: ``"S1"`` to ``"S10"``.
            x: The first vectors, shape (pairs, N).
            y: The second, of the same shape.

        Raises:
            subprocess.SubprocessError: if the program fails.
            ValueError: if it prints something else than two numbers a pair.
        """
        pairs = np.ascontiguousarray(np.stack([x, y], axis=1), dtype=np.float64).tobytes()
        told = _run([str(self.program), score, str(x.shape[1]), str(len(x))], pairs).split()
        if len(told) != 2 * len(x):
            raise ValueError(f"the C++ baseline printed {len(told)} numbers for {len(x)} pairs")
        return [float(word) for word in told[::2]], [float(word) for word in told[1::2]]


@contextmanager
def compiled(compiler: str) -> Iterator[Baseline]:
    """The baseline, compiled into a folder that goes with the block.

    Raises:
        subprocess.SubprocessError: if the compiler fails.
    """
    with tempfile.TemporaryDirectory(prefix="spdz-bench-") as folder:
        program = Path(folder, "baseline")
        with as_file(files("bench.sweep").joinpath("baseline.cpp")) as source:
            _run([compiler, *FLAGS, "-o", str(program), str(source)])
        yield Baseline(program)


def _run(words: list[str], data: bytes = b"") -> bytes:
    return subprocess.run(words, input=data, capture_output=True, check=True, timeout=_TIMEOUT).stdout
