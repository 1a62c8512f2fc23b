"""A dataset whose exported numbers can be worked out by hand: ``from dataset_by_hand import make_dataset_by_hand``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from small_dataset import CAMERA

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.core.schema import CameraEntry, TraversalFile
from relocbench.datasets.core.writer import DatasetWriter
from relocbench.geometry import Camera, make_transform


def make_dataset_by_hand(root: Path) -> Dataset:
    """One keyframe at (1, 2, 3) looking along the world's x axis; one query a metre further along x."""
    looking_along_x = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    camera = Camera("pinhole", 8, 6, 10.0, 11.0, 3.5, 2.5)
    writer = DatasetWriter(root, "hand", {"kind": "hand"})
    for name, position in (("map", [1.0, 2.0, 3.0]), ("drive", [2.0, 2.0, 3.0])):
        file = TraversalFile(name=name, cameras={CAMERA: CameraEntry.of(camera)})
        writer.traversal(file, {5: make_transform(looking_along_x, position)})
        writer.image(name, CAMERA, 5, np.zeros((6, 8), np.uint8))
    points = writer.layout.traversal("map").points(CAMERA, 5)
    points.parent.mkdir(parents=True)
    points.write_text("u,v,inverse_depth,sigma\n3.5,2.5,0.5,0.0\n5.5,2.5,0.25,0.0\n")
    writer.pairs("map", "drive", CAMERA, [Pair(5, 5, make_transform(np.eye(3), [0.0, 0.0, -1.0]))])
    return writer.finish({})
