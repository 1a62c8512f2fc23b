"""A small KITTI odometry recording of a wall: ``from kitti_wall import write_kitti_recording``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from relocbench.arrays import Image
from relocbench.datasets.core import images

WIDTH, HEIGHT, FOCAL, BASELINE = 160, 96, 100.0, 0.5
CALIBRATION = (
    "P0: 100 0 80 0  0 100 48 0  0 0 1 0\nP1: 100 0 80 -50  0 100 48 0  0 0 1 0\nTr: 0 -1 0 0  0 0 -1 0  1 0 0 0\n"
)


def wall_image(x: float, depth: float) -> Image:
    """A textured wall at ``depth`` seen by a camera at (x, 0, 0)."""
    texture = np.random.default_rng(5).integers(0, 255, size=(HEIGHT // 2, 400)).astype(np.uint8)
    blurred = cv2.GaussianBlur(cv2.resize(texture, (800, HEIGHT)), (0, 0), 1.0)
    u, v = np.meshgrid(np.arange(WIDTH, dtype=np.float32), np.arange(HEIGHT, dtype=np.float32))
    return np.asarray(cv2.remap(blurred, u + np.float32(300 + FOCAL * x / depth), v, cv2.INTER_LINEAR))


def write_kitti_recording(root: Path, frames: Sequence[int] = (2, 3, 4, 6, 9), posed: int = 8) -> Path:
    """Sequence 03 of a made-up recording: each frame is 0.2 m further to the right, beside a wall at 5 m.

    Args:
        frames: numbers of the frames there are; the last two have no right image.
        posed: frames from this on have no pose, but an empty line in the file of poses.
    """
    folder = root / "sequences" / "03"
    for number in frames:
        images.write_image(folder / "image_0" / f"{number:06d}.png", wall_image(0.2 * number, 5.0))
        if number not in frames[-2:]:
            right = wall_image(0.2 * number + BASELINE, 5.0)
            images.write_image(folder / "image_1" / f"{number:06d}.png", right)
    (folder / "calib.txt").write_text(CALIBRATION)
    (folder / "times.txt").write_text("".join(f"{0.1 * i:.6e}\n" for i in range(max(frames) + 1)))
    (root / "poses").mkdir()
    lines = [f"1 0 0 {0.2 * i!r} 0 1 0 0 0 0 1 0\n" for i in range(posed)]
    (root / "poses" / "03.txt").write_text("".join(lines) + "\n" * (max(frames) + 1 - posed))
    return root
