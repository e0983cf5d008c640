"""What is said where an optional package is not installed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def needs(package: str, instead: str = "") -> Iterator[None]:
    """Turn the import error of an optional package into one sentence.

    Args:
        package: Its name on the package index.
        instead: What else there is, as a clause that begins with a comma or a semicolon.

    Raises:
        ValueError: where the block cannot import.
    """
    try:
        yield
    except ImportError as error:
        raise ValueError(
            f"this needs the package {package}: pip install {package}{instead} ({error})"
        ) from error
