"""A ROS 2 robot's stack on DDS, in a process of its own, with types as users of Cyclone write them.

``python stack_worker.py DOMAIN KEYFRAMES``: writes that many descriptors in the namespace /r0, waits for as
many matches, and prints what it has heard, and every topic that another process writes, as JSON.
"""

import json
import sys
import time
from dataclasses import dataclass

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import float32, float64, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from stack_helpers import descriptors

PATIENCE = 30.0
CSLAM = "cslam_common_interfaces::msg::dds_::"


@dataclass
@final
class Descriptor(IdlStruct, typename=f"{CSLAM}GlobalDescriptor_"):
    keyframe_id: uint32
    robot_id: uint32
    descriptor: sequence[float64]


@dataclass
@final
class Descriptors(IdlStruct, typename=f"{CSLAM}GlobalDescriptors_"):
    descriptors: sequence[Descriptor]


@dataclass
@final
class Match(IdlStruct, typename=f"{CSLAM}InterRobotMatch_"):
    robot0_id: uint32
    robot0_keyframe_id: uint32
    robot1_id: uint32
    robot1_keyframe_id: uint32
    weight: float32


@dataclass
@final
class Matches(IdlStruct, typename=f"{CSLAM}InterRobotMatches_"):
    robot_id: uint32
    matches: sequence[Match]


def wait(condition):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError("nothing came")
        time.sleep(0.01)


def main(domain: int, keyframes: int) -> None:
    participant = DomainParticipant(domain)
    quality = Qos(
        Policy.Reliability.Reliable(10**9), Policy.Durability.Volatile, Policy.History.KeepLast(100)
    )
    out = DataWriter(
        participant, Topic(participant, "rt/r0/cslam/global_descriptors", Descriptors), qos=quality
    )
    matches = DataReader(
        participant, Topic(participant, "rt/cslam/inter_robot_matches", Matches), qos=quality
    )
    spy = BuiltinDataReader(participant, BuiltinTopicDcpsPublication)
    own = str(participant.guid)[:24]
    wait(lambda: out.get_matched_subscriptions() and matches.get_matched_publications())
    for one in descriptors(*range(keyframes)).descriptors:
        out.write(Descriptors([Descriptor(one.keyframe_id, one.robot_id, one.descriptor.tolist())]))
    heard: list[Match] = []

    def enough():
        for message in matches.take(100):
            heard.extend(message.matches)
        return len(heard) >= keyframes

    wait(enough)
    foreign = [one for one in spy.take(100) if str(one.participant_key)[:24] != own]
    written = {one.topic_name: one.type_name for one in foreign}
    print(json.dumps({"heard": [vars_of(one) for one in heard], "written": written}))


def vars_of(match: Match) -> list[float]:
    return [
        match.robot0_id,
        match.robot0_keyframe_id,
        match.robot1_id,
        match.robot1_keyframe_id,
        match.weight,
    ]


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
