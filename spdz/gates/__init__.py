"""Gates: the operations on secret values that need dealt correlations or openings.

Each module holds one gate in its three readings (:class:`spdz.values.engine.Gate`) and the function that
protocols call. Nothing here knows who else is running: a new gate needs no change in an engine.
"""

from spdz.gates.beaver import beaver_dot, beaver_multiply
from spdz.gates.comparison import absolute, largest, maximum, nonnegative, sign
from spdz.gates.decision import decided
from spdz.gates.masking import mask
from spdz.gates.monomial import multiply
from spdz.gates.product import dot
from spdz.gates.truncation import round_exactly, truncate

__all__ = [
    "absolute",
    "beaver_dot",
    "beaver_multiply",
    "decided",
    "dot",
    "largest",
    "mask",
    "maximum",
    "multiply",
    "nonnegative",
    "round_exactly",
    "sign",
    "truncate",
]
