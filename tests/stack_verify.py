"""A user's verification for the tests' robots: it reads the peer's cloud and says where it was seen from."""

from protocols.agent import Meeting, Verdict
from protocols.stacks.codec import Codec
from protocols.stacks.messages import KeyframePointCloud


def verify(meeting: Meeting) -> Verdict:
    theirs = Codec().decode(KeyframePointCloud, meeting.other.payload)
    mine = Codec().decode(KeyframePointCloud, meeting.own.payload)
    good = theirs.id == meeting.other.id and mine.id == meeting.own.id
    return Verdict(good, "" if good else "another cloud", (1.0, 2.0, 0.5), 0.9)
