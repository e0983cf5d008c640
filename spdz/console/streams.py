"""Standard output and standard error that cannot break a command's work.

A reader may hang up (``| head``), the disk behind a redirection may be full, a service may be started with
the streams closed. None of that may stop a matching in which jobs were used and a peer waits. So while a
command runs, a failure of these streams is only noted. What it means for the exit status is decided when the
command has ended.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO, cast


class GuardedStream:
    """A text stream whose first failure is kept, and which is silent from then on.

    What the stream's encoding cannot say is written with backslashes, as standard error does.

    Attributes:
        error: The first failure, if any.
    """

    def __init__(self, stream: TextIO) -> None:
        """Guard this stream; everything but writing is the stream's own."""
        self._stream = stream
        self.error: OSError | None = None

    def write(self, text: str) -> int:
        """Write, and return the length of ``text`` whatever happens."""
        encoding = self._stream.encoding or "utf-8"
        sayable = text.encode(encoding, "backslashreplace").decode(encoding)
        self._attempt(lambda: self._stream.write(sayable))
        return len(text)

    def flush(self) -> None:
        """Flush, if nothing has failed."""
        self._attempt(self._stream.flush)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def settle(self) -> None:
        """Flush; after a failure, lead the stream nowhere, so that the interpreter's own flush succeeds."""
        self.flush()
        if self.error is not None:
            with suppress(OSError, ValueError), open(os.devnull, "w") as nowhere:
                os.dup2(nowhere.fileno(), self._stream.fileno())

    def _attempt(self, action: Callable[[], object]) -> None:
        if self.error is None:
            try:
                action()
            except OSError as error:
                self.error = error


@contextmanager
def guarded_streams() -> Iterator[GuardedStream]:
    """Guard standard output and standard error; yields the guarded output.

    Descriptors 0 to 2 are opened to nowhere where they are closed: else the next file or connection would get
    such a number, and a stray message would be written into it.
    """
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number, which is this one
    before = sys.stdout, sys.stderr
    with open(os.devnull, "w") as nowhere:
        output, errors = (GuardedStream(stream or nowhere) for stream in before)
        sys.stdout, sys.stderr = cast(TextIO, output), cast(TextIO, errors)
        try:
            yield output
        finally:
            output.settle()
            errors.settle()
            sys.stdout, sys.stderr = before
