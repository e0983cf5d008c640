"""This repository's own history: a commit that a user names, and its tree."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import bench


class HistoryError(Exception):
    """The history is not there; the message says what to do."""


def own_tree() -> Path:
    """The folder that holds this code."""
    return Path(bench.__file__).resolve().parent.parent


def resolve(tree: Path, name: str) -> str:
    """The full hash of a commit that a user named.

    Raises:
        HistoryError: if there is no git, no repository, or no such commit in it.
    """
    top = _git(tree, "rev-parse", "--show-toplevel")
    if top is None or Path(top).resolve() != tree:
        raise HistoryError(
            f"{tree} is not a clone of the repository, so it has no history to compare with: "
            "run this in a clone (git clone), not in an installed or unpacked package"
        )
    found = _git(tree, "rev-parse", "--verify", "--quiet", "--end-of-options", f"{name}^{{commit}}")
    if found is not None:
        return found
    if _git(tree, "rev-parse", "--is-shallow-repository") == "true":
        raise HistoryError(f"no commit {name}: this clone is shallow. Fetch the rest: git fetch --unshallow")
    raise HistoryError(f"no commit {name} in {tree}: see git log, or fetch it (git fetch --all)")


@contextmanager
def tree_of(tree: Path, commit: str) -> Iterator[Path]:
    """The files of a commit in a temporary worktree, which is removed afterwards.

    Raises:
        HistoryError: if git cannot make it.
    """
    with TemporaryDirectory(prefix="spdz-versus-") as folder:
        path = Path(folder).resolve() / commit[:7]
        if _git(tree, "worktree", "add", "--detach", "--quiet", str(path), commit) is None:
            raise HistoryError(f"git cannot check out {commit} in {path}: see git worktree list, and df")
        try:
            yield path
        finally:
            _git(tree, "worktree", "remove", "--force", str(path))


def _git(tree: Path, *words: str) -> str | None:
    """What git prints, stripped; None where it fails."""
    try:
        done = subprocess.run(["git", "-C", str(tree), *words], capture_output=True, text=True, check=False)
    except OSError as error:
        raise HistoryError("git is not installed, or cannot be run: install it (apt install git)") from error
    return done.stdout.strip() if done.returncode == 0 else None
