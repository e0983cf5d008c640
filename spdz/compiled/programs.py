"""The programs that a session runs: their plans, and a party's code for those that it runs again."""

from __future__ import annotations

from spdz.compiled.record import compiled
from spdz.compiled.slots import NotCompiled
from spdz.compiled.source import Straight
from spdz.foundations.types import Security, Shape
from spdz.readings.plans import Plans
from spdz.readings.program import Program


class Programs(Plans):
    """Plans and code for one tape's shapes and security model.

    Args:
        shapes: Of both inputs of a job.
        security: The security model.
        party: Whose code.
    """

    def __init__(self, shapes: tuple[Shape, Shape], security: Security, party: int) -> None:
        super().__init__(shapes, security)
        self._party = party

    def code(self, program: Program, *, again: bool = False) -> Straight | None:
        """The code of a program; compiling takes about as long as ten runs, so it is done for the second.

        Args:
            program: The program.
            again: Whether it is known to be run more than once.

        Returns:
            None where it runs for the first time, can change, or is not to be compiled.
        """
        known = self.known(program)
        if known is None:
            return None
        known.runs += 1
        if known.code is None and (again or known.runs > 1):
            try:
                known.code = compiled(program, known.plan, self._party, self._security)
            except NotCompiled as error:
                known.code = error
        return known.code if isinstance(known.code, Straight) else None
