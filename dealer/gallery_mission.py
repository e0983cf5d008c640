"""Deal galleries for a whole team: two tapes for every pair of robots, and credentials for every robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

from dealer.folders import check_agents, mission_folders, sizes, tape_paths
from dealer.gallery import deal_gallery, gallery_headers
from dealer.gallery_limits import check_memory, check_plan
from protocols.place_purpose import AnyPurpose
from spdz.foundations.types import Security
from spdz.gallery.format import GalleryHeader, gallery_bytes
from spdz.readings.gallery_plan import measure_gallery

_NO_ID = "0" * 32


@dataclass(frozen=True, slots=True)
class DealtGalleries:
    """What one run of the dealer wrote.

    Attributes:
        folders: Each robot's folder and its size in bytes.
        capacity: Slots of a pair's first and of its second robot, rounded up to whole bands.
        pairs: Pairs of robots.
    """

    folders: dict[Path, int]
    capacity: tuple[int, int]
    pairs: int


def deal_galleries(
    out: Path,
    agents: Sequence[str],
    purpose: AnyPurpose,
    slots: tuple[int, int],
    security: Security = "malicious",
    *,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> DealtGalleries:
    """Deal a gallery for every pair of robots and write one folder a robot.

    Args:
        out: Folder to create the robots' folders in; those must not exist yet.
        agents: Two or more robot names.
        purpose: What the galleries are for: one descriptor a slot, or places of several.
        slots: Descriptors of a pair's first and of its second robot.
        security: The security model.
        progress: Called with pairs of descriptors dealt and in all.

    Returns:
        What was written.

    Raises:
        ValueError: for bad names, slots or purposes, too full a disk, or too little memory.
        FileExistsError: if a robot's folder exists: dealt material is never overwritten.
        OSError: if the folder cannot be made or written.
    """
    check_agents(agents)
    terms, couples = purpose.dealt_terms(security), list(combinations(agents, 2))
    headers = headers_for((agents[0], agents[1]), purpose, slots, security)
    check_memory(terms, headers[0])
    needed = gallery_mission_bytes(agents, purpose, slots, security)
    remedy = "deal fewer slots, a coarser resolution or a smaller max_norm"
    with mission_folders(out, agents, needed, remedy) as mission:
        for number, couple in enumerate(couples):

            def report(done: int, total: int, before: int = number) -> None:
                progress(before * total + done, len(couples) * total)

            deal_gallery(
                tape_paths(out, couple),
                couple,
                terms,
                slots,
                mission=mission,
                description=purpose.as_json(),
                progress=report,
            )
    return DealtGalleries(sizes(out, agents), headers[0].capacity, len(couples))


def headers_for(
    agents: tuple[str, str], purpose: AnyPurpose, slots: tuple[int, int], security: Security
) -> tuple[GalleryHeader, GalleryHeader]:
    """Both headers as they will be, but for the tapes' ids.

    Raises:
        ValueError: for slots out of range, or a pair that takes more than a gallery holds.
    """
    terms = purpose.dealt_terms(security)
    plan = measure_gallery(terms)
    check_plan(plan)
    return gallery_headers(
        plan, terms, agents, slots, mission=_NO_ID, tape=_NO_ID, description=purpose.as_json()
    )


def gallery_mission_bytes(
    agents: Sequence[str], purpose: AnyPurpose, slots: tuple[int, int], security: Security
) -> int:
    """What all tapes of a mission will take on the disk, exactly; arguments as for :func:`deal_galleries`."""
    return sum(
        gallery_bytes(header)
        for couple in combinations(agents, 2)
        for header in headers_for(couple, purpose, slots, security)
    )
