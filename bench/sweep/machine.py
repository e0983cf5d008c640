"""What a sweep ran on, and which source it ran."""

from __future__ import annotations

import hashlib
import os
import platform
import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

import spdz
from spdz.version import __version__

_ROOT = Path(spdz.__file__).resolve().parent.parent
_SOURCES = ("spdz", "protocols", "dealer", "bench/sweep")


def machine() -> dict[str, Any]:
    """The processor, how many cores this process may use, the system, and versions."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "cpu": _cpu(),
        "cores": cores,
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "python": platform.python_version(),
        "numpy": np.__version__,
        "spdz": __version__,
    }


def commit() -> tuple[str | None, bool]:
    """The commit of the repository that this runs from, and whether tracked files differ from it.

    None, False outside of a repository, or where that is somebody else's, as of an installed package.
    """
    if _git("ls-files", "--error-unmatch", "bench/sweep/machine.py") is None:
        return None, False
    return _git("rev-parse", "--short", "HEAD"), bool(_git("status", "--porcelain", "--untracked-files=no"))


def source_digest() -> str:
    """A digest of the source files that decide what a trial measures."""
    digest = hashlib.sha256()
    for folder in _SOURCES:
        for path in sorted((_ROOT / folder).rglob("*")):
            if path.suffix in (".py", ".cpp"):
                text = path.read_bytes()
                digest.update(f"{path.relative_to(_ROOT).as_posix()} {len(text)}\n".encode() + text)
    return digest.hexdigest()[:12]


def _cpu() -> str:
    try:
        found = re.search(r"^model name\s*:\s*(.+)$", Path("/proc/cpuinfo").read_text("utf-8"), re.MULTILINE)
    except OSError:
        found = None
    told = found[1] if found else _told(["sysctl", "-n", "machdep.cpu.brand_string"])
    return told or platform.processor() or platform.machine()


def _git(*words: str) -> str | None:
    return _told(["git", "-C", str(_ROOT), *words])


def _told(words: list[str]) -> str | None:
    """What a command prints; None if it fails or is not there."""
    try:
        done = subprocess.run(words, capture_output=True, check=True, timeout=30, text=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
