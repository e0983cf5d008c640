"""Sessions: one tape and one connection, from the handshake to the last result."""

from spdz.session.connect import open_session
from spdz.session.session import Result, Session

__all__ = ["Result", "Session", "open_session"]
