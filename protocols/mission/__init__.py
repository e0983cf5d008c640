"""A mission: what a team of robots wants to compare, and the folder that each of them takes along.

The plan is written once, as ``mission.toml``, read by the dealer (:meth:`Mission.load`) and carried by every
robot in its folder (:class:`Folder`).
"""

from protocols.mission.descriptors import DescriptorPlan
from protocols.mission.errors import PlanError
from protocols.mission.folder import Folder
from protocols.mission.galleries import GalleryPlan
from protocols.mission.mission import Mission
from protocols.mission.presets import KINDS, Kind
from protocols.mission.team import AgentPlan, Budgets

__all__ = [
    "KINDS",
    "AgentPlan",
    "Budgets",
    "DescriptorPlan",
    "Folder",
    "GalleryPlan",
    "Kind",
    "Mission",
    "PlanError",
]
