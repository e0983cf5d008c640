"""The Killian Court run: 3,873 laser scans of a robot in MIT's corridors, with a pose graph.

The log (``killian.g2o.zip``, recorded by M. Bosse and J. Leonard) comes with the PyPI package ``rtb-data``
(MIT licence). It is a g2o text file (Kümmerle et al., "g2o: A general framework for graph optimization",
ICRA 2011) with three kinds of records:

- ``VERTEX_SE2 id x y theta``: the pose of a scan;
- ``ROBOTLASER1 ...``: the scan of the vertex before it, in CARMEN's format (type, first bearing, field of
  view, resolution, range limit, accuracy, remission mode, number of readings, readings, ...);
- ``EDGE_SE2 i j dx dy dtheta ...``: the pose of j seen from i, either odometry (j = i + 1) or a loop closure.

**The vertices are optimised, not raw odometry.** They agree with the 1,115 loop edges to 2 cm (median) and
20 cm (worst); odometry chained from edge to edge misses the same edges by 7 m (median) and 27 m (worst). So
the vertices serve as ground truth to 1 m, and the odometry edges are what a robot knows on its own.
"""

import io
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass, field
from importlib import resources

import numpy as np

from spdz.foundations.types import FloatArray, IntArray

ARCHIVE = "data/killian.g2o.zip"
MEMBER = "killian.g2o"

READINGS = 8
"""Position of the number of readings in a ``ROBOTLASER1`` record; the readings follow it."""
STAMP = 12
"""Fields after the readings: remissions (none), two poses of 3, five of the robot; then the time."""


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One drive of a robot with a planar laser scanner; n scans of b beams.

    Attributes:
        poses: ``(n, 3)``; x and y in metres, heading in radians; optimised, in one map frame.
        ranges: ``(n, b)``; metres; readings near the scanner's limit (50 m) mean "nothing seen".
        bearings: ``(b,)``; radians, anticlockwise from the robot's heading.
        odometry: ``(n - 1, 3)``; the pose of scan i + 1 in the frame of scan i: metres, metres, radians.
        stamps: ``(n,)``; seconds since 1970, of the scans.
        loops: ``(m, 2)``; pairs of scans that saw the same place, according to the pose graph.
        loop_poses: ``(m, 3)``; the pose of the second scan of each such pair in the frame of the first.
    """

    poses: FloatArray = field(repr=False)
    ranges: FloatArray = field(repr=False)
    bearings: FloatArray = field(repr=False)
    odometry: FloatArray = field(repr=False)
    stamps: FloatArray = field(repr=False)
    loops: IntArray = field(repr=False)
    loop_poses: FloatArray = field(repr=False)


def load() -> Run:
    """Read the run from the installed ``rtb-data`` package.

    Raises:
        ModuleNotFoundError: ``rtb-data`` is not installed.
        FileNotFoundError: the installed ``rtb-data`` has no such log.
    """
    try:
        archive = resources.files("rtbdata") / ARCHIVE
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("the laser scans are in the package rtb-data, which is missing") from error
    if not archive.is_file():
        raise FileNotFoundError(
            f"rtb-data is installed but has no {ARCHIVE}: pip install --upgrade --force-reinstall rtb-data"
        )
    with zipfile.ZipFile(io.BytesIO(archive.read_bytes())) as members:
        return parse(members.read(MEMBER).decode("ascii").splitlines())


def parse(lines: Iterable[str]) -> Run:
    """Read a g2o log in which every vertex is followed by its scan.

    Args:
        lines: The log's lines; comments (``#``) and empty lines are skipped.

    Raises:
        ValueError: a record is unknown or damaged, a vertex has no scan, scans differ in their beams, or an
            odometry edge is missing.
    """
    poses: list[list[float]] = []
    ranges: list[list[float]] = []
    stamps: list[float] = []
    beams: set[tuple[float, float, int]] = set()
    edges: dict[tuple[int, int], list[float]] = {}
    for number, line in enumerate(lines, 1):
        fields = line.split()
        if not fields or fields[0].startswith("#"):
            continue
        kind = fields[0]
        try:
            if kind == "VERTEX_SE2" and int(fields[1]) == len(poses) == len(ranges):
                poses.append([float(x) for x in fields[2:5]])
            elif kind == "ROBOTLASER1" and len(poses) == len(ranges) + 1:
                count = int(fields[READINGS])
                beams.add((float(fields[2]), float(fields[4]), count))
                if len(fields) <= READINGS + count + 1 + STAMP:
                    raise ValueError(f"expected {count} readings and the time")
                stamps.append(float(fields[READINGS + count + 1 + STAMP]))
                ranges.append([float(x) for x in fields[READINGS + 1 : READINGS + 1 + count]])
            elif kind == "EDGE_SE2":
                edges[int(fields[1]), int(fields[2])] = [float(x) for x in fields[3:6]]
            else:
                raise ValueError(f"unexpected {kind} record")
        except (ValueError, IndexError) as error:
            raise ValueError(f"line {number} of the g2o log is not readable: {error}") from error
    if len(poses) != len(ranges) or len(beams) != 1:
        raise ValueError("the g2o log must have one scan a vertex, all with the same beams")
    first, resolution, count = beams.pop()
    try:
        odometry = [edges.pop((i, i + 1)) for i in range(len(poses) - 1)]
    except KeyError as error:
        raise ValueError(f"the g2o log lacks the odometry edge {error}") from error
    return Run(
        poses=np.array(poses).reshape(-1, 3),
        ranges=np.array(ranges).reshape(-1, count),
        bearings=np.asarray(first + resolution * np.arange(count), dtype=np.float64),
        odometry=np.array(odometry).reshape(-1, 3),
        stamps=np.array(stamps, dtype=np.float64),
        loops=np.array(list(edges), dtype=np.int64).reshape(-1, 2),
        loop_poses=np.array(list(edges.values()), dtype=np.float64).reshape(-1, 3),
    )
