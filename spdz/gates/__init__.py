"""Gates: the operations on secret values that need dealt correlations or openings.

Each module holds one gate in its three readings (:class:`spdz.engine.Gate`) and the function that
protocols call. Nothing here knows who else is running: a new gate needs no change in an engine.
"""

from spdz.gates.beaver import beaver_dot, beaver_multiply
from spdz.gates.comparison import nonnegative
from spdz.gates.product import dot, multiply

__all__ = ["beaver_dot", "beaver_multiply", "dot", "multiply", "nonnegative"]
