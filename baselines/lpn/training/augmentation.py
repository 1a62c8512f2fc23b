"""Augmentation of training images as in LPN's recipe: padding, rotation, cropping and mirroring."""

from __future__ import annotations

import cv2
import numpy as np

from baselines.lpn.training.options import TrainOptions
from relocbench.arrays import Image


def augmented(image: Image, view: str, options: TrainOptions, rng: np.random.Generator) -> Image:
    """A changed copy of a square image (S, S, 3).

    The image is padded with the pixels of its border, rotated (only satellite images), cropped at a random position to
    its old size, and mirrored at random.
    """
    pad, side = options.pad, len(image)
    wide: Image = np.pad(image, ((pad, pad), (pad, pad), (0, 0)), mode="edge")
    if view == "satellite" and options.satellite_turn_deg:
        wide = _turned(wide, rng.uniform(-options.satellite_turn_deg, options.satellite_turn_deg))
    top, left = rng.integers(0, 2 * pad + 1, 2)
    cut = wide[top : top + side, left : left + side]
    return np.ascontiguousarray(cut[:, ::-1] if rng.random() < options.flip else cut, dtype=np.uint8)


def _turned(image: Image, angle_deg: float) -> Image:
    middle = (len(image) - 1) / 2
    turn = cv2.getRotationMatrix2D((middle, middle), angle_deg, 1.0)
    return np.asarray(cv2.warpAffine(image, turn, image.shape[1::-1], flags=cv2.INTER_LINEAR), dtype=np.uint8)
