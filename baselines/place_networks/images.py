"""Photographs as place-recognition networks take them: of the size that was asked, normalised as for ImageNet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from relocbench.arrays import Image
from relocbench.errors import MethodError, quoted

_MEAN, _STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""of ImageNet's red, green and blue in [0, 1], with which torchvision's backbones were trained"""
_LEAST_PX, _MOST_PX = 32, 8192


@dataclass(frozen=True)
class ImageSize:
    """The size that images are resized to: a fixed one, one of the shorter side, or none."""

    width: int | None = None
    height: int | None = None
    shorter: int | None = None
    """pixels of the shorter side, with the aspect ratio kept"""

    @classmethod
    def of(cls, given: int | str | None) -> Self:
        """From a parameter: ``WIDTHxHEIGHT``, a number for the shorter side, or None to leave images as they are.

        Raises:
            MethodError: it is none of these, or has fewer than 32 or more than 8192 pixels.
        """
        if given is None:
            return cls()
        words = str(given).split("x")
        if len(words) > 2 or not all(word.isascii() and word.isdigit() and len(word) < 6 for word in words):
            raise MethodError(f"size is {quoted(str(given))}, expected WIDTHxHEIGHT, a number or null")
        sides = [int(word) for word in words]
        if not all(_LEAST_PX <= side <= _MOST_PX for side in sides):
            raise MethodError(f"size is {quoted(str(given))}, expected sides of {_LEAST_PX} to {_MOST_PX} pixels")
        return cls(shorter=sides[0]) if len(sides) == 1 else cls(width=sides[0], height=sides[1])

    def __str__(self) -> str:
        if self.shorter is not None:
            return f"shorter side {self.shorter} px"
        return "unchanged" if self.width is None else f"{self.width}x{self.height} px"

    def resized(self, height: int, width: int, multiple: int = 1) -> tuple[int, int]:
        """Height and width of an image of so many pixels once it is resized.

        The longer side is rounded down where the shorter one is given, as in torchvision's ``Resize``; both are then
        rounded to the nearest multiple.
        """
        if self.width is not None and self.height is not None:
            height, width = self.height, self.width
        elif self.shorter is not None:
            shorter, ratio = min(height, width), self.shorter
            height, width = height * ratio // shorter, width * ratio // shorter
        return _to_multiple(height, multiple), _to_multiple(width, multiple)


def _to_multiple(side: int, multiple: int) -> int:
    return max(round(side / multiple), 1) * multiple


def network_input(images: Sequence[Image], size: tuple[int, int], device: torch.device) -> Tensor:
    """RGB images (H, W, 3) of one size as a normalised tensor (B, 3, h, w) of ``size`` (h, w).

    Images are resized bilinearly, with antialiasing where they are shrunk.
    """
    stacked = torch.from_numpy(np.stack(images)).to(device).permute(0, 3, 1, 2)
    x = stacked.float() / 255
    if tuple(x.shape[-2:]) != size:
        x = functional.interpolate(x, size=size, mode="bilinear", align_corners=False, antialias=True)
    mean, std = (torch.tensor(values, device=device).view(3, 1, 1) for values in (_MEAN, _STD))
    return (x - mean) / std
