"""Selection of the images of a drive that are paired, or of poses of its rig, at equal distances along the road."""

from __future__ import annotations

import numpy as np

from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.blocks.nodes import nearest_nodes
from relocbench.datasets.sensors.recording import CameraStream, FieldRecording, RigStream


def select_images(
    recording: FieldRecording, stream: CameraStream | RigStream, nodes: Nodes, apart_m: float, *, in_gaps: bool = False
) -> list[int]:
    """Indices of images at least ``apart_m`` of road apart, between the first and the last node of the drive.

    Args:
        in_gaps: also select images at times that the odometry does not cover, as many as at the drive's mean speed, so
            that their rejection is recorded.
    """
    times = stream.times_ns
    inside = (times >= nodes.times_ns[0]) & (times <= nodes.times_ns[-1])
    known = recording.odometry.covers(times) & (nearest_nodes(nodes, recording.odometry, times) >= 0)
    rows = np.flatnonzero(inside if in_gaps else inside & known)
    if not len(rows):
        return []
    seconds = (times - nodes.times_ns[0]) / 1e9
    at_nodes = (nodes.times_ns - nodes.times_ns[0]) / 1e9
    travelled = np.interp(seconds, at_nodes, nodes.travelled_m)
    segments = nodes.segments()
    same = segments[1:] == segments[:-1]
    driven, spent = np.diff(nodes.travelled_m)[same].sum(), np.diff(at_nodes)[same].sum()
    wait_s = apart_m * spent / driven if driven > 0 else np.inf
    chosen: list[int] = []
    for index in rows.tolist():
        if chosen:
            last = chosen[-1]
            waited = not (known[index] and known[last]) and seconds[index] - seconds[last] >= wait_s - 1e-9
            if not waited and travelled[index] - travelled[last] < apart_m - 1e-6:
                continue
        chosen.append(index)
    return chosen
