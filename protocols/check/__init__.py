"""How a user's own descriptors stand, before a mission: ``python -m spdz check``, or :func:`describe`."""

from protocols.check.description import describe
from protocols.check.spread import Whitening
from protocols.check.standing import Form, Norms, Standing

__all__ = ["Form", "Norms", "Standing", "Whitening", "describe"]
