"""One robot's agent: keyframes in, matches out, over hours, peers and restarts.

::

    keyframe   what it is given, and what a verification sees and says
    events     what it tells
    agent      the agent; asynchronous: for asyncio; cli, lines, folder_watch: for people and other programs
    link       one gallery with one peer: connections; turn, turns, showing: what is done over them
    records    the durable file; keyframes, matches: what is in it
    verifier   the thread of the user's verification; budgets, reasons: what is refused, and why nothing came
    reaching   one port for all peers; discovery: where they are
"""

from protocols.agent.agent import Agent
from protocols.agent.asynchronous import AsyncAgent
from protocols.agent.events import Event, Match
from protocols.agent.keyframe import Keyframe, Meeting, Verdict
from protocols.agent.records import RecordsError

__all__ = ["Agent", "AsyncAgent", "Event", "Keyframe", "Match", "Meeting", "RecordsError", "Verdict"]
