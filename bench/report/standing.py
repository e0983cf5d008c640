"""Which of our models stands for which of the paper's protocols: the sweep's statement, in paragraphs."""

from __future__ import annotations

import re
from collections.abc import Iterator

from bench.sweep.stands import STATEMENT


def paragraphs(text: str = STATEMENT) -> Iterator[str]:
    """The paragraphs of a text for a terminal; of an indented list, each entry is one."""
    for block in text.split("\n\n"):
        entries = re.split(r"^  (?=\S)", block, flags=re.MULTILINE) if block.startswith("  ") else [block]
        for entry in filter(None, entries):
            words = " ".join(entry.split())
            yield words if entry is block else re.sub(r"^\S+", r"`\g<0>`", words)
