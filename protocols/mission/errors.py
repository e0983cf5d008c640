"""What is wrong with a plan."""

from __future__ import annotations


class PlanError(ValueError):
    """A plan cannot be used as it is written.

    Attributes:
        file: The file, for people.
        line: Its line, from 1; None where it cannot be told.
        field: The field, as in ``descriptors.lidar.score``; empty where it is none.
    """

    def __init__(self, message: str, *, file: str = "", line: int | None = None, field: str = "") -> None:
        where = file if line is None else f"{file}:{line}"
        super().__init__(": ".join(part for part in (where, field, message) if part))
        self.file, self.line, self.field = file, line, field
