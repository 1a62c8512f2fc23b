"""Posed training images made in memory: ``from made_views import MadeViews, TINY_POSE_NET, tiny_encoder``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from small_dataset import render, small_camera, small_pose

from baselines.gn_net.network import FeatureNet
from baselines.gn_net.options import NetworkOptions
from baselines.gn_net.weights import save_weights
from relocbench.geometry import Camera, invert
from relocbench.tracking import KeyframePoints, Query, Reference
from relocbench.training import PairLabel, PosedPair, TrainingPair, TrainingView

TINY_POSE_NET: dict[str, Any] = {
    "steps": 6,
    "batch": 2,
    "warm_up": 2,
    "log_every": 2,
    "validate_every": 6,
    "checkpoint_every": 2,
    "network": {
        "side": 32,
        "focal": 24.0,
        "stage": 2,
        "descriptor": 8,
        "channels": [8, 8],
        "kernels": [1, 3],
        "hidden": 8,
    },
}
"""options of a training that takes a second, with the weights of :func:`tiny_encoder`"""
POSES = [
    small_pose(0),
    small_pose(3, lateral_m=0.2),
    small_pose(5, yaw_deg=6),
    small_pose(2, lateral_m=-0.3, yaw_deg=-4),
]
"""(4, 4) ``T_world_cam``"""


def tiny_encoder(folder: Path) -> Path:
    """A file of weights of a small feature network, as they were drawn."""
    path = folder / "encoder.safetensors"
    save_weights(path, FeatureNet(NetworkOptions(widths=(4, 6, 8), dim=4, levels=2)), {})
    return path


def keyframe(camera: Camera, pose: int = 0) -> Reference:
    """The small street from one of the poses, with depth."""
    image, depth = render(camera, POSES[pose])
    return Reference(f"ref{pose}", None, image, camera, depth=depth)


def query(camera: Camera, pose: int = 1) -> Query:
    """The same without depth."""
    return Query(f"query{pose}", None, render(camera, POSES[pose])[0], camera)


class MadeViews:
    """All pairs of different images of the small street."""

    def __init__(self) -> None:
        self.camera = small_camera(48, 40)
        self.reads: list[str] = []
        """names of the images that were read"""
        self._pairs = [(i, j) for i in range(len(POSES)) for j in range(len(POSES)) if i != j]

    def __len__(self) -> int:
        return len(self._pairs)

    def label(self, index: int) -> PairLabel:
        return PairLabel("made", "dry-0", "dry-0", "front", "dry", "dry")

    def posed(self, index: int) -> PosedPair:
        ref, query = self._pairs[index]
        return PosedPair(str(ref), str(query), invert(POSES[query]) @ POSES[ref])

    def view(self, name: str, *, depth: bool) -> TrainingView:
        self.reads.append(name)
        reference = keyframe(self.camera, int(name))
        points = reference.points if depth else KeyframePoints(np.zeros((0, 2)), *np.zeros((2, 0)))
        return TrainingView(np.repeat(reference.image[..., None], 3, axis=-1), self.camera, points)

    def load(self, index: int) -> TrainingPair:
        raise AssertionError("a trainer of poses reads images one by one")

    def describe(self) -> Mapping[str, str]:
        return {"made": "1" * 64}
