"""Images of places for tests of retrievers: a pattern a place, seen from a drone and by satellite."""

from __future__ import annotations

from functools import partial
from typing import Any

import cv2
import numpy as np
from torch import nn
from torchvision.models.resnet import BasicBlock  # type: ignore[import-untyped]

from relocbench.arrays import Image
from relocbench.retrieval import ImageView, PlaceData, PlaceImage

TINY: dict[str, Any] = {
    "size": 64,
    "steps_per_epoch": 1,
    "batch": 2,
    "pad": 2,
    "log_every": 1,
    "validate_every": 1,
    "checkpoint_every": 1,
    "network": {"backbone": "resnet18", "width": 8},
}
"""options of a training that takes a second"""


def picture(place: int, view: str, number: int, side: int = 64) -> Image:
    """(side, side, 3): the place's colours, turned and lit as the view and the number say."""
    rng = np.random.default_rng([place])
    coarse = rng.uniform(30, 225, (4, 4, 3)).astype(np.float32)
    image = cv2.resize(coarse, (side, side), interpolation=cv2.INTER_CUBIC)
    image = np.rot90(image, number % 4) if view == "drone" else image
    noise = np.random.default_rng([place, len(view), number]).normal(0, 4, image.shape)
    out: Image = np.clip(image * (1.0 if view == "drone" else 0.9) + noise, 0, 255).astype(np.uint8)
    return out


def made_places(places: int = 4, drones: int = 3, views: tuple[str, ...] = ("drone", "satellite")) -> PlaceData:
    """``drones`` drone images and one image of each other view of each place."""
    images = [
        PlaceImage(ImageView(f"{view}/{place}/{number}", view, partial(picture, place, view, number)), place)
        for place in range(places)
        for view in views
        for number in range(drones if view == "drone" else 1)
    ]
    return PlaceData(places, tuple(images), (("made", "0" * 12),))


class NarrowResNet(nn.Module):
    """A ResNet of eight to 64 channels and one block a stage, with torchvision's names: milliseconds an image."""

    def __init__(self, weights: None = None) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 8, 7, stride=2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(8)
        inside = 8
        for number, (width, stride) in enumerate(((8, 1), (16, 2), (32, 2), (64, 2)), start=1):
            shortcut = nn.Sequential(nn.Conv2d(inside, width, 1, stride, bias=False), nn.BatchNorm2d(width))
            block = BasicBlock(inside, width, stride, shortcut if stride > 1 else None)
            self.add_module(f"layer{number}", nn.Sequential(block))
            inside = width
        self.fc = nn.Linear(inside, 1000)
