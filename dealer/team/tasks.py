"""The work of a mission, cut up: one gallery of one pair of robots each."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from dealer.gallery import gallery_headers
from dealer.gallery_limits import check_plan, gallery_memory
from protocols.mission import GalleryPlan, Mission
from spdz.foundations.types import Security
from spdz.gallery.format import GalleryHeader, GalleryLayout, encode_gallery_header
from spdz.readings import gallery_plan
from spdz.readings.gallery import Terms

_NO_ID = "0" * 32


@dataclass(frozen=True, slots=True)
class Task:
    """A gallery of a pair.

    Attributes:
        couple: The pair's robots, party 0 first.
        gallery: The gallery's name.
    """

    couple: tuple[str, str]
    gallery: str

    @property
    def key(self) -> str:
        """Its name among files; robots and galleries have no ``+`` or ``.`` in theirs."""
        return f"{self.couple[0]}+{self.couple[1]}.{self.gallery}"


@dataclass(frozen=True, slots=True)
class Size:
    """What a task will take.

    Attributes:
        headers: Both parties' headers, but for the tapes' ids.
        tape_bytes: Exact sizes of both parties' tapes.
        layout: Where everything lies on party 0's.
        memory: Bytes of memory to deal it, an estimate from above.
    """

    headers: tuple[GalleryHeader, GalleryHeader]
    tape_bytes: tuple[int, int]
    layout: GalleryLayout
    memory: int

    @property
    def pairs(self) -> int:
        """Pairs of slots."""
        rows, columns = self.headers[0].capacity
        return rows * columns

    def pairs_in(self, written: int) -> int:
        """Pairs in so many bytes of party 0's tape, whose tiles are written last and in their order."""
        rows, columns = self.layout.bands.sizes
        tiles = max(0, written - self.layout.tiles) // self.layout.tile_bytes
        return min(self.pairs, tiles * rows * columns)


def tasks_of(mission: Mission) -> list[Task]:
    """All tasks of a mission, those with most pairs of descriptors first."""
    tasks = [Task(couple, gallery.name) for couple in mission.pairs for gallery in mission.galleries]

    def weight(task: Task) -> int:
        rows, columns = mission.gallery(task.gallery).slots(task.couple)
        return rows * columns

    return sorted(tasks, key=weight, reverse=True)


def size_of(mission: Mission, task: Task) -> Size:
    """What a task takes.

    Raises:
        ValueError: if its gallery cannot be dealt.
    """
    gallery = mission.gallery(task.gallery)
    terms, plan = measured(gallery, mission.security)
    first, second = gallery_headers(
        plan,
        terms,
        task.couple,
        gallery.slots(task.couple),
        mission=_NO_ID,
        tape=_NO_ID,
        description=gallery.description(),
    )
    layouts = [GalleryLayout.of(header, encode_gallery_header(header)) for header in (first, second)]
    sizes = layouts[0].end, layouts[1].end
    return Size((first, second), sizes, layouts[0], gallery_memory(terms, first)[0])


def measured(gallery: GalleryPlan, security: Security) -> tuple[Terms, gallery_plan.GalleryPlan]:
    """A gallery's terms, and what the meter sees of them.

    Raises:
        ValueError: if no tape can hold it, with the gallery's name.
    """
    try:
        terms = gallery.purpose.dealt_terms(security)
        plan = _measure(terms)
        check_plan(plan)
    except ValueError as error:
        raise ValueError(f"{gallery.name}: {error}") from error
    return terms, plan


@lru_cache(maxsize=64)
def _measure(terms: Terms) -> gallery_plan.GalleryPlan:
    return gallery_plan.measure_gallery(terms)
