"""Real scans with poses from a published pose graph, for ``real_clouds.py``."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.blocks.blocks import Surface
from relocbench.datasets.groundtruth.submaps.prepared import PreparedSubmap
from relocbench.datasets.groundtruth.submaps.submaps import Submap
from relocbench.datasets.importers.kitti.recording import REAL_ELEVATION_DEG, raised
from relocbench.errors import DatasetError
from relocbench.geometry import apply, invert, transform_from_tq

Pair = tuple[int, int]

_NEIGHBOURS = 15
_NEAR_M = 0.3
"""the largest distance, in metres, of a neighbour in the other scan"""


@dataclass(frozen=True)
class Source:
    """Five scans of one place."""

    title: str
    folder: str
    files: str
    """by number"""
    step: int
    """between the numbers of files"""
    elevation_deg: float = 0.0
    """angle by which the beams are raised"""


SOURCES = (
    Source("KITTI 07 as it is", "kitti_07_dump", "{:06d}/points.bin", 1),
    Source("KITTI 07, beams raised", "kitti_07_dump", "{:06d}/points.bin", 1, REAL_ELEVATION_DEG),
    Source("Newer College", "newer_01", "planes_{:06d}.bin", 10),
)


@dataclass(frozen=True, eq=False)
class Scans:
    """Scans as they are registered, with the graph's poses."""

    source: Source
    points: tuple[Array, ...]
    """(N, 3) each, in the lidar's frame"""
    sides: tuple[PreparedSubmap, ...]
    T_graph_scan: Array
    """(5, 4, 4)"""

    @property
    def pairs(self) -> list[Pair]:
        return list(combinations(range(len(self.points)), 2))

    @property
    def triangles(self) -> Iterator[tuple[int, int, int]]:
        return combinations(range(len(self.points)), 3)

    def by_graph(self, pair: Pair) -> Array:
        """``T_ref_query`` (4, 4) of the graph."""
        return np.asarray(invert(self.T_graph_scan[pair[0]]) @ self.T_graph_scan[pair[1]])

    def overlap(self, pair: Pair) -> float:
        """The share of the query's points that have a neighbour in the reference at the graph's pose."""
        there = apply(self.by_graph(pair), self.points[pair[1]])
        return float(np.mean(cKDTree(self.points[pair[0]]).query(there)[0] < _NEAR_M))


def read_scans(folder: Path, source: Source) -> Scans:
    """Read the scans and poses of a set.

    Raises:
        DatasetError: a file, which is named, is missing or damaged.
    """
    path = folder / source.folder / "graph.txt"
    try:
        rows = np.loadtxt(path, usecols=range(1, 8), ndmin=2)
        files = [folder / source.folder / source.files.format(source.step * k) for k in range(len(rows))]
        clouds = [np.fromfile(file, "<f4").reshape(-1, 3).astype(np.float64) for file in files]
    except (OSError, ValueError) as bad:
        raise DatasetError(f"expected a graph of poses and one file of points each ({bad})", path) from None
    points = [raised(cloud, source.elevation_deg) if source.elevation_deg else cloud for cloud in clouds]
    sides = tuple(PreparedSubmap(submap(cloud)) for cloud in points)
    return Scans(source, tuple(points), sides, transform_from_tq(rows[:, :3], rows[:, 3:]))


def submap(points: Array) -> Submap:
    """A scan from points (N, 3) in its own frame. Planes are fitted to a fixed number of neighbours instead of those
    within a radius, since single scans are sparse."""
    neighbours = points[cKDTree(points).query(points, k=_NEIGHBOURS)[1]]
    centred = neighbours - neighbours.mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred) / _NEIGHBOURS)
    normals = vectors[:, :, 0] * np.where(np.sum(vectors[:, :, 0] * points, axis=1) > 0, -1.0, 1.0)[:, None]
    flat, level = values[:, 0] < 0.05 * values[:, 1], np.abs(normals[:, 2]) > 0.9
    surface = np.where(flat, np.where(level, Surface.GROUND, Surface.STRUCTURE), Surface.ROUGH)
    return Submap(
        points=points.astype(np.float32),
        normals=np.where(flat[:, None], normals, 0.0).astype(np.float32),
        origins=np.zeros(points.shape, np.float32),
        surface=surface.astype(np.uint8),
        steady=np.ones(len(points), np.float32),
        block=np.zeros(len(points), np.int32),
    )
