"""The programs that a session runs: their plans, and a party's code for those that it runs again."""

from __future__ import annotations

from spdz.compiled.record import compiled
from spdz.compiled.slots import NotCompiled
from spdz.compiled.straight import Straight
from spdz.foundations.types import Security, Shape
from spdz.readings.meter import Plan
from spdz.readings.plans import Plans
from spdz.readings.program import Program


class Programs(Plans):
    """Plans and code for one tape's shapes and security model.

    Args:
        shapes: Of both inputs of a job.
        security: The security model.
        party: Whose code.
        recipe: The fingerprint of what was dealt: other programs are not compiled.
    """

    def __init__(self, shapes: tuple[Shape, Shape], security: Security, party: int, recipe: str) -> None:
        super().__init__(shapes, security)
        self._party, self._recipe = party, recipe

    def ready(self, program: Program, *, again: bool = False) -> tuple[Plan, Straight | None]:
        """The plan of a program, and its code; compiling takes about ten runs, so it is done for the second.

        Args:
            program: The program.
            again: Whether it is known to be run more than once.

        Returns:
            No code where it runs for the first time, can change, or is not to be compiled.
        """
        known = self.known(program)
        if known is None:
            return self.of(program), None
        known.runs += 1
        if known.code is None and (again or known.runs > 1) and known.plan.recipe == self._recipe:
            try:
                known.code = compiled(program, known.plan, self._party, self._security)
            except NotCompiled as error:
                known.code = str(error)  # the error itself would keep its callers' inputs and jobs alive
        code = known.code
        return known.plan, code if type(code) is Straight else None
