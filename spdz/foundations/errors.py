"""Every error that the engine raises on purpose, as one hierarchy.

::

    SpdzError
    ├── MacCheckFailed       the peer (or somebody on the line) changed a share; the tape is destroyed
    ├── ProtocolViolation    the peer sent something that no honest peer sends
    │   └── OutOfStep        the peer is at another step: it makes other calls than this side
    ├── ChannelError         the connection could not be made or did not last
    │   ├── ChannelTimeout   the peer did not answer within the time limit
    │   ├── ChannelClosed    the peer hung up
    │   ├── PeerAborted      the peer stopped and said why
    │   ├── Unsent           this job's mask does not suit the input, a matter of chance: run the next one
    │   └── Wrapped          an opened number may have wrapped, a matter of chance: run the next job
    └── TapeError            something about the dealt correlations
        ├── TapeMismatch     the two tapes, or tape and program, do not belong together
        ├── TapeExhausted    every dealt job has been used
        ├── TapeDamaged      a checksum does not hold: the file was damaged
        ├── TapeInUse        another process has the tape open
        └── TapeDestroyed    the tape was wiped after a failed MAC check

Bad *local* input (not finite, wrong shape, out of range) is a plain :class:`ValueError`, raised before
anything is consumed or sent. After any other error that a running session raises it is dead: nothing is
output, and what was reserved stays burnt. (What is refused before anything was sent, such as a tape with too
few jobs for a matching, leaves the session alive.)
"""


class SpdzError(Exception):
    """Base of all errors raised on purpose by this package.

    Attributes:
        partial: What had been decided, checked and final, before the error; None where that is nothing.
    """

    partial: object | None = None


class MacCheckFailed(SpdzError):
    """An opened value does not carry a valid MAC. Nothing was output and the tape is destroyed."""


class ProtocolViolation(SpdzError):
    """The peer sent a frame that no honest peer sends at this point."""


class OutOfStep(ProtocolViolation):
    """The peer is at another step of the session: the two sides do not make the same calls.

    Attributes:
        here: This side's number, where the steps have numbers (a batch of a matching).
        there: The peer's.
    """

    def __init__(self, message: str = "", *, here: int | None = None, there: int | None = None) -> None:
        super().__init__(message)
        self.here, self.there = here, there


class ChannelError(SpdzError):
    """The connection to the peer could not be made or did not last.

    Attributes:
        passing: Whether another try may go better: radios drop, robots restart. False where the other side is
            not who it should be, or has said that it will not go on.
    """

    passing: bool = False

    def __init__(self, message: str = "", *, passing: bool | None = None) -> None:
        super().__init__(message)
        if passing is not None:
            self.passing = passing


class ChannelTimeout(ChannelError):
    """The peer did not answer within the time limit."""

    passing = True


class ChannelClosed(ChannelError):
    """The peer closed the connection."""

    passing = True


class PeerAborted(ChannelError):
    """The peer stopped and gave a reason."""


class Unsent(ChannelError):
    """A masked input would have told something of itself and was not sent; the job is used up."""

    passing = True


class Wrapped(ChannelError):
    """An opened number may have wrapped behind its mask; nothing was output, and the job is used up."""

    passing = True


class TapeError(SpdzError):
    """Something is wrong with a tape of dealt correlations."""


class TapeMismatch(TapeError):
    """Two tapes, or a tape and a program, do not belong together."""


class TapeExhausted(TapeError):
    """Every job on the tape has been used."""


class TapeDamaged(TapeError):
    """A checksum of the tape file does not hold."""


class TapeInUse(TapeError):
    """Another process has the tape open."""


class TapeDestroyed(TapeError):
    """The tape was wiped after a failed MAC check and cannot be used again."""
