"""Forks: what belongs to one process must not be used in a copy of it.

Looking at :data:`count` takes a tenth of what asking the system for the process's number does.
"""

from __future__ import annotations

import os

count = 0
"""How many forks lie between the process that loaded this module and this one."""


def _forked() -> None:
    global count
    count += 1


os.register_at_fork(after_in_child=_forked)
