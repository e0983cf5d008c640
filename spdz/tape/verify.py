"""Reading all of a tape that is still to be used, to find damage before a robot drives off with it.

Nothing is written or locked, and what is read stays sealed. Corrections never change, so a tape in use may be
verified too. Cost: one reading of the file; memory for 16 MB of it, or for one job if that is larger.
"""

from __future__ import annotations

from collections.abc import Callable
from io import FileIO
from pathlib import Path

from spdz.foundations.errors import TapeError
from spdz.tape.advice import cannot_open
from spdz.tape.corrections import read_corrections
from spdz.tape.format import read_header
from spdz.tape.status import TapeStatus

_READ_BYTES = 16 << 20


def verify_corrections(
    path: Path, status: TapeStatus, progress: Callable[[int, int], None] = lambda done, total: None
) -> None:
    """Hold every job that is left against its checksums.

    Args:
        path: The tape.
        status: What :func:`spdz.tape.tape_status` told of it.
        progress: Called with jobs verified and jobs to verify.

    Raises:
        TapeDamaged: A checksum does not hold; the message names the first such job and the byte.
        TapeError: The file cannot be read.
    """
    try:
        with FileIO(path) as file:
            header, layout = read_header(file.fileno(), path)
            step = max(1, _READ_BYTES // max(1, layout.stride))
            for done in range(0, status.left, step):
                count = min(step, status.left - done)
                first = status.used + done
                read_corrections(file, path, header, layout, first, count, used=status.used > 0)
                progress(done + count, status.left)
    except OSError as error:
        if error.filename is not None:
            raise cannot_open(path, error, writing=False) from error
        raise TapeError(f"{path}: cannot read the tape ({error.strerror})") from error
