"""Two-party SPDZ in Python and NumPy: two robots learn whether two descriptors match, and nothing else."""

from spdz.foundations.errors import (
    ChannelClosed,
    ChannelError,
    ChannelTimeout,
    MacCheckFailed,
    OutOfStep,
    PeerAborted,
    ProtocolViolation,
    SpdzError,
    TapeDamaged,
    TapeDestroyed,
    TapeError,
    TapeExhausted,
    TapeInUse,
    TapeMismatch,
    Unsent,
    Wrapped,
)
from spdz.foundations.stats import Outcome, Stats
from spdz.functions import (
    divide,
    l1_normalised,
    l2_normalised,
    power,
    reciprocal,
    reciprocal_sqrt,
    sqrt,
)
from spdz.gates import (
    absolute,
    beaver_dot,
    beaver_multiply,
    decided,
    dot,
    largest,
    mask,
    maximum,
    multiply,
    nonnegative,
    round_exactly,
    sign,
    truncate,
)
from spdz.local import run_clear, run_local
from spdz.readings.meter import Plan, measure
from spdz.readings.program import Program
from spdz.readings.stock import Stock
from spdz.rounds.coroutine import parallel
from spdz.session import Result, Session, open_session
from spdz.values.columns import columns
from spdz.values.engine import Engine
from spdz.values.value import Value
from spdz.version import __version__

__all__ = [
    "ChannelClosed",
    "ChannelError",
    "ChannelTimeout",
    "Engine",
    "MacCheckFailed",
    "OutOfStep",
    "Outcome",
    "PeerAborted",
    "Plan",
    "Program",
    "ProtocolViolation",
    "Result",
    "Session",
    "SpdzError",
    "Stats",
    "Stock",
    "TapeDamaged",
    "TapeDestroyed",
    "TapeError",
    "TapeExhausted",
    "TapeInUse",
    "TapeMismatch",
    "Unsent",
    "Value",
    "Wrapped",
    "__version__",
    "absolute",
    "beaver_dot",
    "beaver_multiply",
    "columns",
    "decided",
    "divide",
    "dot",
    "l1_normalised",
    "l2_normalised",
    "largest",
    "mask",
    "maximum",
    "measure",
    "multiply",
    "nonnegative",
    "open_session",
    "parallel",
    "power",
    "reciprocal",
    "reciprocal_sqrt",
    "round_exactly",
    "run_clear",
    "run_local",
    "sign",
    "sqrt",
    "truncate",
]
