"""What a command does to its own process; the library never does, since it changes the whole process."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable

import numpy as np

_HEAP_BYTES = 16 << 20
INTERRUPTED = 130
"""Exit status after Ctrl-C or SIGTERM, as shells have it."""


def run_command(name: str, main: Callable[[], int]) -> int:
    """Run a command with quick memory and a quiet end: Ctrl-C and SIGTERM end it in one line.

    Both unwind the stack, so that the peer is told and half-written files are removed.
    """
    keep_large_arrays_on_the_heap()
    try:
        signal.signal(signal.SIGTERM, _interrupt)
        return main()
    except KeyboardInterrupt:
        print(f"\n{name}: interrupted", file=sys.stderr)
        return INTERRUPTED


def _interrupt(number: int, frame: object) -> None:
    raise KeyboardInterrupt


def keep_large_arrays_on_the_heap() -> None:
    """Free one mapped block of 16 MB, untouched.

    By default glibc maps fresh, zeroed pages for each array above 128 KB and gives them back at once, which
    costs more than the arithmetic on them. It raises that limit, up to 32 MB, to the size of the largest
    mapped block that has been freed. Elsewhere this does nothing of note.
    """
    np.empty(_HEAP_BYTES, dtype=np.uint8)
