"""The committed ratios, and what a measurement says beside them. Nothing here measures.

A ratio is this engine's time over another's in the same run: the textbook protocol's, or that of the same
frames over a bare socket. Machines differ in it far less than in milliseconds.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

FILE = Path(__file__).with_name("ratios.json")
FORMAT = 1
TOLERANCE = 1.6
"""A ratio may be so many times the committed one: docs/reference.md says from what noise that was chosen."""


class RatiosError(Exception):
    """The committed ratios cannot be used; the message says what to do."""


@dataclass(frozen=True, slots=True, order=True)
class Key:
    """What is divided by what: a score at a length in a model, over ``textbook`` or ``floor``."""

    score: str
    n: int
    security: str
    against: str

    def __str__(self) -> str:
        other = {"textbook": "the textbook protocol", "floor": "the bare socket"}[self.against]
        return f"{self.score}, N = {self.n}, {self.security}, against {other}"


@dataclass(frozen=True, slots=True)
class Verdict:
    """A measured ratio beside the committed one, None if there is none yet."""

    key: Key
    measured: float
    committed: float | None
    tolerance: float

    @property
    def worse(self) -> bool:
        """Past the tolerance."""
        return self.committed is not None and self.measured > self.committed * self.tolerance

    @property
    def better(self) -> bool:
        """As far below, so that the committed ratio guards nothing any more."""
        return self.committed is not None and self.measured * self.tolerance < self.committed

    @property
    def word(self) -> str:
        """What it is, in a word."""
        if self.committed is None:
            return "new"
        return "WORSE" if self.worse else "better" if self.better else "ok"


def judge(
    measured: Mapping[Key, float], committed: Mapping[Key, float], tolerance: float = TOLERANCE
) -> list[Verdict]:
    """Each measured ratio beside the committed one, in the order of the measurement."""
    return [Verdict(key, ratio, committed.get(key), tolerance) for key, ratio in measured.items()]


def advice(verdicts: Sequence[Verdict]) -> list[str]:
    """What to do, a paragraph each; nothing if all is well."""
    said = []
    worse = [one for one in verdicts if one.worse]
    if worse:
        first = worse[0].key
        cell = f"--score {first.score} --dim {first.n} --security {first.security}"
        said.append(
            f"{len(worse)} of {len(verdicts)} ratios stay above {worse[0].tolerance:g} times "
            f"the committed ones. See what changed: python -m bench versus COMMIT {cell}\n"
            "If the cost is meant: python -m bench check --update, and say why in the commit."
        )
    if any(one.better for one in verdicts):
        said.append(
            "Some are far better than the committed ones, which so guard nothing any more: "
            "python -m bench check --update, and commit bench/check/ratios.json."
        )
    if any(one.committed is None for one in verdicts):
        said.append("Some have no committed ratio: python -m bench check --update, and commit the file.")
    return said


def read() -> dict[Key, float]:
    """The committed ratios.

    Raises:
        RatiosError: if there is no such file, or it is not one.
    """
    path = FILE
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data["format"] != FORMAT:
            raise RatiosError(
                f"{path} has format {data['format']}, expected {FORMAT}: write it with --update"
            )
        return {Key(*(row[name] for name in Key.__slots__)): float(row["ratio"]) for row in data["ratios"]}
    except FileNotFoundError:
        raise RatiosError(f"{path} is not there: measure and write it with --update") from None
    except (ValueError, KeyError, TypeError) as error:
        raise RatiosError(f"{path} cannot be read ({error!r}): take it from git, or --update") from None


def write(measured: Mapping[Key, float], about: Mapping[str, Any]) -> None:
    """Write measured ratios as the committed ones, a line each, at once.

    Raises:
        OSError: if it cannot be written.
    """
    rows = ",\n".join(json.dumps({**asdict(key), "ratio": ratio}) for key, ratio in sorted(measured.items()))
    head = json.dumps({"format": FORMAT, **about}, indent=1)[:-2]
    draft = FILE.with_suffix(".new")
    draft.write_text(f'{head},\n "ratios": [\n{rows}\n ]\n}}\n', encoding="utf-8")
    draft.replace(FILE)
