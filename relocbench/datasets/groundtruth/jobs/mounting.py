"""Lidars that are mounted the other way up than their extrinsics say.

Upside down, everything still looks like a street: there is a road, above the car, with walls that reach down from it.
A road is a flat layer with nothing beyond it, and with walls or the open sky on the other side of the lidar. Under a
ceiling there is a floor instead.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.blocks.making import BlockOptions, beams_of, reader_of
from relocbench.datasets.groundtruth.blocks.nodes import arc_length_along, make_nodes
from relocbench.datasets.sensors.recording import FieldRecording
from relocbench.errors import DatasetError

_PLACES = 12
"""blocks of a drive that are looked at"""
_FEWEST_PLACES = 4
"""at which a road must be seen"""
_BESIDE_M = 6.0
"""how far from the lidar a road is looked for; farther away it slopes to the gutters"""
_AROUND_M = 20.0
"""how far from it walls are looked for"""
_LAYER_M = 0.08
_LEAST_SHARE = 0.2
"""least share of the points within that distance that lie on a road"""
_TIMES = 4.0
"""so many times as many points lie on a road as on the densest layer on the other side of the lidar"""
_BEYOND, _WALLS = 0.02, 0.1
"""largest share of points beyond a road, and least share of those on tall walls"""
_TALL_M, _FLAT_M = 3.0, 1.0
"""walls reach further up from a lidar than a floor may be below it, unless its beams hardly rise at all"""
_FEWEST = 300


def mounting_faults(recording: FieldRecording) -> list[DatasetError]:
    """The fault of lidars that see the road above themselves at all places where they see one.

    Raises:
        DatasetError: a scan is damaged.
    """
    nodes, options = make_nodes(recording), BlockOptions()
    reader = reader_of(recording, arc_length_along(recording), options)
    heights: dict[str, list[float]] = {lidar.name: [] for lidar in recording.lidars}
    for node in np.unique(np.linspace(0, len(nodes) - 1, _PLACES).astype(int)).tolist():
        beams = beams_of(reader, nodes, node)
        for number, lidar in enumerate(recording.lidars):
            own = beams.lidar == number
            heights[lidar.name].append(road_height(np.asarray(beams.points[own] - beams.origins[own])))
    wrong = {name: seen for name, some in heights.items() if _is_above(seen := [h for h in some if np.isfinite(h)])}
    if not wrong:
        return []
    one = next(iter(wrong.values()))
    names = " and ".join(wrong)
    verb, them = ("see", "them") if len(wrong) > 1 else ("sees", "it")
    message = (
        f"{names} {verb} the road {np.median(one):.1f} m above {them}, with nothing higher, at {len(one)} of "
        f"{len(one)} places: by the extrinsics {'they are' if len(wrong) > 1 else 'it is'} upside down; expected the "
        "road below, where z of the rig points up"
    )
    return [DatasetError(message, recording.folder)]


def _is_above(heights: Sequence[float]) -> bool:
    return len(heights) >= _FEWEST_PLACES and min(heights) > 0


def road_height(points: Array) -> float:
    """Height of the road over or under a lidar, metres, by points (N, 3) relative to it, in the rig's axes; nan if
    neither side has one."""
    away = np.hypot(points[:, 0], points[:, 1])
    z, around = points[away < _BESIDE_M, 2], points[away < _AROUND_M, 2]
    if len(z) < _FEWEST:
        return float("nan")
    sides = [_densest(sign * z[sign * z > 0]) for sign in (1, -1)]
    for sign, (height, count), (_, other) in zip((1, -1), sides, sides[::-1], strict=True):
        dense = count >= max(_LEAST_SHARE * len(z), _TIMES * other)
        beyond = float(np.mean(sign * z > height + 4 * _LAYER_M))
        tall, anything = (float(np.mean(-sign * around > limit)) for limit in (_TALL_M, _FLAT_M))
        ends = beyond <= _BEYOND and (tall >= _WALLS or anything <= _BEYOND)
        if dense and ends:
            return sign * height
    return float("nan")


def _densest(z: Array) -> tuple[float, int]:
    """Middle and number of points of the two neighbouring layers with the most of heights (N,), at least 0."""
    if not len(z):
        return 0.0, 0
    counts = np.bincount((z / _LAYER_M).astype(np.int64), minlength=2)
    pairs = counts[:-1] + counts[1:]
    best = int(np.argmax(pairs))
    return (best + 1) * _LAYER_M, int(pairs[best])
