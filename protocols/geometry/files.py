"""Pose graphs and trajectories as the files that SLAM tools read and write.

- g2o (Kümmerle et al., "g2o: A general framework for graph optimization", ICRA 2011): ``VERTEX_SE2 id x y
  theta`` and ``EDGE_SE2 i j dx dy dtheta`` with the upper half of the information matrix.
- TUM (Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", IROS 2012): ``stamp tx ty tz qx
  qy qz qw``, seconds, metres and a unit quaternion; here in the plane.

Numbers are written so that reading gives the same bits back.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from protocols.geometry.pose_graph import PoseGraph
from spdz.foundations.types import FloatArray

UPPER = np.triu_indices(3)
LEVEL = 1e-6
"""How far a quaternion may be from a turn about the vertical, or from length 1."""


def write_g2o(path: Path, graph: PoseGraph, poses: FloatArray) -> None:
    """Write a pose graph with these poses, ``(n, 3)``; the first is fixed."""
    lines = [f"VERTEX_SE2 {number} {_words(pose)}" for number, pose in enumerate(poses)]
    lines.insert(1, "FIX 0")
    for (i, j), measured, information in zip(graph.pairs, graph.measured, graph.information, strict=True):
        lines.append(f"EDGE_SE2 {i} {j} {_words(measured)} {_words(information[UPPER])}")
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def read_g2o(path: Path) -> PoseGraph:
    """Read a pose graph in the plane. Vertices are numbered from 0 in the order of their ids.

    Edges that do not join a vertex to the next are taken to be loops, and doubtful.

    Raises:
        ValueError: a record is of another kind or damaged, or an edge names no vertex; with the line.
        OSError: the file cannot be read.
    """
    vertices: dict[int, FloatArray] = {}
    edges: list[tuple[int, int]] = []
    values: list[FloatArray] = []
    for number, words in _records(path):
        try:
            if words[0] == "VERTEX_SE2" and len(words) == 5 and int(words[1]) not in vertices:
                vertices[int(words[1])] = _numbers(words[2:])
            elif words[0] == "EDGE_SE2" and len(words) == 12:
                edges.append((int(words[1]), int(words[2])))
                values.append(_numbers(words[3:]))
            elif words[0] != "FIX":
                raise ValueError(f"an unexpected {words[0]} record of {len(words)} words")
        except ValueError as error:
            raise ValueError(f"{path}, line {number}: {error}") from error
    order = {vertex: index for index, vertex in enumerate(sorted(vertices))}
    lost = [vertex for edge in edges for vertex in edge if vertex not in order]
    if lost:
        raise ValueError(f"{path}: an edge names vertex {lost[0]}, which is not there")
    pairs = np.array([(order[i], order[j]) for i, j in edges], dtype=np.int64).reshape(-1, 2)
    table = np.array(values).reshape(-1, 9)
    information = np.zeros((len(edges), 3, 3))
    information[:, UPPER[0], UPPER[1]] = information[:, UPPER[1], UPPER[0]] = table[:, 3:]
    poses = np.array([vertices[vertex] for vertex in sorted(vertices)]).reshape(-1, 3)
    try:
        return PoseGraph(poses, pairs, table[:, :3], information, pairs[:, 1] != pairs[:, 0] + 1)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def write_tum(path: Path, stamps: FloatArray, poses: FloatArray) -> None:
    """Write a trajectory: ``(n,)`` seconds and ``(n, 3)`` poses, at height 0.

    Raises:
        ValueError: there are not as many stamps as poses, or a number is not finite.
        OSError: the file cannot be written.
    """
    if stamps.shape != (len(poses),) or poses.shape != (len(stamps), 3):
        raise ValueError(f"expected (n,) stamps and (n, 3) poses, got {stamps.shape} and {poses.shape}")
    if not (np.isfinite(stamps).all() and np.isfinite(poses).all()):
        raise ValueError("a trajectory holds finite numbers alone")
    zero, half = np.zeros(len(poses)), poses[:, 2] / 2
    rows = np.column_stack([stamps, poses[:, :2], zero, zero, zero, np.sin(half), np.cos(half)])
    path.write_text("".join(f"{_words(row)}\n" for row in rows), encoding="ascii")


def read_tum(path: Path) -> tuple[FloatArray, FloatArray]:
    """Read a trajectory in the plane: ``(n,)`` stamps in seconds and ``(n, 3)`` poses.

    Raises:
        ValueError: a line is damaged, or turns about another axis than the vertical; with the line.
        OSError: the file cannot be read.
    """
    rows = []
    for number, words in _records(path):
        try:
            if len(words) != 8:
                raise ValueError(f"expected 8 numbers, got {len(words)}")
            row = _numbers(words)
            if np.abs(row[4:6]).max() > LEVEL or abs(np.hypot(row[6], row[7]) - 1) > LEVEL:
                raise ValueError("expected a unit quaternion about the vertical")
            rows.append((row[0], row[1], row[2], 2 * np.arctan2(row[6], row[7])))
        except ValueError as error:
            raise ValueError(f"{path}, line {number}: {error}") from error
    table = np.array(rows, dtype=np.float64).reshape(-1, 4)
    table[:, 3] = (table[:, 3] + np.pi) % (2 * np.pi) - np.pi
    return table[:, 0], table[:, 1:]


def _records(path: Path) -> Iterator[tuple[int, list[str]]]:
    """The lines that say something, with their numbers."""
    with path.open(encoding="ascii") as lines:
        for number, line in enumerate(lines, 1):
            words = line.split()
            if words and not words[0].startswith("#"):
                yield number, words


def _numbers(words: list[str]) -> FloatArray:
    values = np.array([float(word) for word in words])
    if not np.isfinite(values).all():
        raise ValueError("a number that is not finite")
    return values


def _words(values: FloatArray) -> str:
    return " ".join(repr(float(value)) for value in values)
