"""Which images of a drive take part: one every so many metres of road, where the odometry knows the place."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.groundtruth.blocks import Nodes
from relocbench.datasets.groundtruth.recording import CameraStream, FieldRecording

Times = NDArray[np.int64]


def chosen_images(recording: FieldRecording, stream: CameraStream, nodes: Nodes, apart_m: float) -> list[int]:
    """Indices of images at least ``apart_m`` of road apart, within the drive's nodes; standing still gives one."""
    times = stream.times_ns
    inside = (times >= nodes.times_ns[0]) & (times <= nodes.times_ns[-1])
    known = np.flatnonzero(inside & recording.odometry.covers(times))
    if not len(known):
        return []
    origin = nodes.times_ns[0]
    way = np.interp((times[known] - origin) / 1e9, (nodes.times_ns - origin) / 1e9, nodes.travelled_m)
    chosen: list[int] = []
    last = -np.inf
    for index, metres in zip(known.tolist(), way.tolist(), strict=True):
        if metres - last >= apart_m - 1e-6:
            chosen.append(index)
            last = metres
    return chosen
