"""An MP-SPDZ folder on this machine: check it, compile a program, run both parties, read the scores.

Made for MP-SPDZ v0.4.2. Everything runs from its folder, as its compiler and virtual machines expect. The
preprocessing is live (no set-up, no insecure build), the channels are plain TCP on loopback, and the virtual
machine takes the length of the prime from the compiled program.
"""

from __future__ import annotations

import os
import socket
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path

from bench.exact import ONE
from bench.mpc import MARK, program_text
from bench.processes import Finished, run_together
from spdz.foundations.types import Security

VERSION = "v0.4.2"
PROTOCOLS: dict[str, Security] = {"mascot": "malicious", "hemi": "semi-honest"}
"""The protocols that can be run, and the security model of each."""

_LAST_LINES = 6


class MpSpdzError(Exception):
    """What went wrong, in words for a person."""


class MpSpdzMissing(MpSpdzError):
    """There is no usable MP-SPDZ where it should be."""


@dataclass(frozen=True, slots=True)
class MpSpdz:
    """An MP-SPDZ folder and one of its protocols; ``timeout`` is in seconds, for each compilation and run."""

    folder: Path
    protocol: str
    timeout: float

    @property
    def binary(self) -> str:
        """The name of the protocol's virtual machine."""
        return f"{self.protocol}-party.x"

    def check(self) -> None:
        """Raise :class:`MpSpdzMissing` unless the folder has what is needed."""
        if not self.folder.is_dir():
            raise MpSpdzMissing(f"{self.folder} is not a folder.\n{self._how_to_get()}")
        for name, what in (("compile.py", "the compiler"), (self.binary, "the virtual machine")):
            if not (self.folder / name).is_file():
                raise MpSpdzMissing(f"{self.folder} has no {name}, {what}.\n{self._how_to_get()}")
        if not os.access(self.folder / self.binary, os.X_OK):
            raise MpSpdzMissing(f"{self.folder / self.binary} is not executable")

    def compile(self, score: str, n: int, pairs: int) -> str:
        """Write and compile a score's program; returns the name to run it by.

        The text stays in ``Programs/Source``, so that it can be read what ran.
        """
        name = f"spdz_{score}"
        source = self.folder / "Programs" / "Source"
        source.mkdir(parents=True, exist_ok=True)
        (source / f"{name}.mpc").write_text(program_text(score), encoding="utf-8")
        self._run([[sys.executable, "compile.py", name, str(n), str(pairs)]], f"compiling {name}")
        return f"{name}-{n}-{pairs}"

    def run(self, compiled: str, x: Sequence[Sequence[int]], y: Sequence[Sequence[int]]) -> list[int]:
        """Run both parties on pairs of quantised vectors.

        Args:
            compiled: What :meth:`compile` returned.
            x: Party 0's vectors, as raw integers.
            y: Party 1's, as many.

        Returns:
            The opened scores, as raw integers.
        """
        with tempfile.TemporaryDirectory(prefix="spdz-inputs-") as folder:
            prefix = str(Path(folder, "Input"))
            for party, vectors in enumerate((x, y)):
                # A raw integer over 2^16 is a float, and repr() gives the decimal that reads back as it.
                lines = (" ".join(repr(value / ONE) for value in vector) for vector in vectors)
                Path(f"{prefix}-P{party}-0").write_text("\n".join(lines) + "\n", encoding="ascii")
            common = ["-N", "2", "-h", "localhost", "-pn", str(_free_ports()), "-IF", prefix, compiled]
            parties = [[f"./{self.binary}", "-p", str(party), *common] for party in (0, 1)]
            finished = self._run(parties, f"running {compiled}")
        return parse(finished.outputs[0], len(x))

    def _run(self, commands: Sequence[Sequence[str]], doing: str) -> Finished:
        libraries = {
            name: os.pathsep.join(filter(None, [str(self.folder), os.environ.get(name)]))
            for name in ("LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH")
        }
        try:
            finished = run_together(commands, self.folder, libraries, self.timeout)
        except OSError as error:
            raise MpSpdzError(f"{doing}: {error}") from error
        if finished.worked:
            return finished
        told = (f"  {line}" for output in finished.outputs for line in output.splitlines()[-_LAST_LINES:])
        if any(finished.statuses):
            what = f"failed with exit status {next(filter(None, finished.statuses))}"
        else:
            what = f"took more than {self.timeout:g} s; --timeout allows more"
        raise MpSpdzError("\n".join([f"{doing} {what}", *told]))

    def _how_to_get(self) -> str:
        return (
            f"MP-SPDZ {VERSION} is needed, built, at the path of --mp-spdz:\n"
            f"  git clone --recursive --branch {VERSION} https://github.com/data61/MP-SPDZ\n"
            f"  cd MP-SPDZ && make setup && make -j2 {self.binary}\n"
            "or the archive of that release, unpacked, after Scripts/tldr.sh in it."
        )


def parse(output: str, pairs: int) -> list[int]:
    """The raw integers in party 0's output.

    Raises:
        MpSpdzError: unless there is one score for each pair, in order, on the fixed-point grid.
    """
    found: list[int] = []
    for line in output.splitlines():
        words = line.split()
        if words[:1] != [MARK]:
            continue
        try:
            number, value = int(words[1]), Decimal(words[2]) * ONE
            if len(words) != 3 or number != len(found) or value != int(value):
                raise ValueError(line)
        except (ValueError, IndexError, InvalidOperation, OverflowError):
            raise MpSpdzError(f"cannot read this line of MP-SPDZ's output: {line!r}") from None
        found.append(int(value))
    if len(found) != pairs:
        raise MpSpdzError(f"expected {pairs} scores in MP-SPDZ's output, got {len(found)}:\n{output[-500:]}")
    return found


def _free_ports() -> int:
    """The first of two neighbouring loopback ports that nobody listens on: party i takes the i-th."""
    for _ in range(100):
        with socket.socket() as first, socket.socket() as second:
            first.bind(("127.0.0.1", 0))
            port: int = first.getsockname()[1]
            try:
                second.bind(("127.0.0.1", port + 1))
            except (OSError, OverflowError):
                continue
            return port
    raise MpSpdzError("no two neighbouring ports are free")
