"""One robot's agent: keyframes in, matches out, over hours, peers and restarts.

::

    keyframe   what it is given, and what a verification sees and says; intake: what is taken
    events     what it tells
    agent      the agent; asynchronous: for asyncio; cli, lines, folder_watch: for people and other programs
    link       one gallery with one peer, over connections; turns, saying: what is brought and compared;
    following  what becomes of matches; showing: what two robots show each other
    records    the durable file; keyframes, matches, news, strikes: what is in it; evidence: shown to people
    verifier   the thread of the user's verification
    allowance  what a peer is granted; budgets: in a minute; reasons: why nothing matched
    reaching   one port for all peers; discovery, sightings: where they are
    desk       what all of these share
"""

from protocols.agent.agent import Agent
from protocols.agent.asynchronous import AsyncAgent
from protocols.agent.events import Event, Match
from protocols.agent.keyframe import Keyframe, Meeting, Verdict
from protocols.agent.records import RecordsError

__all__ = ["Agent", "AsyncAgent", "Event", "Keyframe", "Match", "Meeting", "RecordsError", "Verdict"]
