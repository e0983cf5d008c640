"""The folder that a command writes into."""

from __future__ import annotations

from pathlib import Path


def out_folder(path: Path) -> Path:
    """Make it, if it is not there.

    Raises:
        OSError: if something else is in its place, or it cannot be made; the message says so.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise OSError(f"{path} cannot be a folder: a file is in its place; name another with --out") from None
    return path
