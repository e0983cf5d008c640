"""What a command does to its own process; the library never does, since it changes the whole process.

The exit status of every command: 0 done, 1 it failed, 2 bad input or usage, 130 interrupted. An error is one
line on standard error; with ``--json`` it is one JSON object on standard output.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

import numpy as np
from threadpoolctl import threadpool_limits

from spdz.console.streams import guarded_streams

_HEAP_BYTES = 16 << 20
_THREAD_VARIABLES = (
    "OPENBLAS_NUM_THREADS",
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
FAILED = 1
INTERRUPTED = 130
"""Exit status after Ctrl-C or SIGTERM, as shells have it."""


def run_command(name: str, main: Callable[[], int], *, as_json: bool = False) -> int:
    """Run a command with quick memory and a quiet end: no traceback for what a user or a machine can do.

    Ctrl-C and SIGTERM unwind the stack, so that the peer is told and half-written files are removed. A closed
    pipe behind standard output changes nothing. Output that cannot be written otherwise makes a success a
    failure. Memory that runs out is one line.

    Args:
        name: What messages call the command.
        main: Does the work and returns the exit status. It may end by ``SystemExit``, as parsers do.
        as_json: Whether the user asked for JSON.
    """
    tune_process()
    with guarded_streams() as output:
        try:
            signal.signal(signal.SIGTERM, _interrupt)
            status = main()
        except KeyboardInterrupt:
            print(f"\n{name}: interrupted", file=sys.stderr)
            status = INTERRUPTED
        except MemoryError as error:
            what = str(error) or "an allocation failed"
            say_error(name, "MemoryError", f"not enough memory ({what}): use smaller tiles", as_json=as_json)
            status = FAILED
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else FAILED * (end.code is not None)
        output.flush()
        if output.error is not None and not isinstance(output.error, BrokenPipeError):
            print(f"{name}: cannot write to standard output: {output.error.strerror}", file=sys.stderr)
            status = status or FAILED
    return status


def say_error(name: str, kind: str, message: str, *, as_json: bool) -> None:
    """Tell one error: a line on standard error, or a JSON object on standard output."""
    if as_json:
        print(json.dumps({"error": kind, "message": message}))
    else:
        print(f"{name}: {message}", file=sys.stderr)


class CommandParser(argparse.ArgumentParser):
    """An argument parser whose usage errors are JSON as well where JSON is asked for."""

    _words: Sequence[str] = ()

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As the base class."""
        self._words = list(sys.argv[1:] if args is None else args)
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Usage and message on standard error, and a JSON object on standard output if asked for."""
        if wants_json(self._words):
            say_error(self.prog, "UsageError", message, as_json=True)
        super().error(message)


def wants_json(words: Sequence[str]) -> bool:
    """Whether ``--json``, or what the parser takes for it, is among the arguments."""
    return any(len(word) > 2 and "--json".startswith(word) for word in words)


def _interrupt(number: int, frame: object) -> None:
    raise KeyboardInterrupt


def tune_process() -> None:
    """What makes a process quick that does little but matching or dealing; call it once, at its start."""
    keep_large_arrays_on_the_heap()
    use_one_blas_thread()


def use_one_blas_thread() -> None:
    """Keep BLAS to one thread, unless the user's environment says how many it may take.

    A party's products are many and short. Threads that wait for each other at the end of each cost more than
    they save, five times more where another process wants the second core.
    """
    if not any(name in os.environ for name in _THREAD_VARIABLES):
        threadpool_limits(1, user_api="blas")


def keep_large_arrays_on_the_heap() -> None:
    """Free one mapped block of 16 MB, untouched.

    By default glibc maps fresh, zeroed pages for each array above 128 KB and gives them back at once, which
    costs more than the arithmetic on them. It raises that limit, up to 32 MB, to the size of the largest
    mapped block that has been freed. Elsewhere this does nothing of note.
    """
    np.empty(_HEAP_BYTES, dtype=np.uint8)
