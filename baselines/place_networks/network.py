"""What all place-recognition networks have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod

from torch import Tensor, nn

_LEAST_SIDE_PX = 32
"""of an image, of which a ResNet leaves one pixel"""


class PlaceNetwork(nn.Module, ABC):
    """Descriptors (B, dimensions) of norm 1 of normalised images (B, 3, H, W)."""

    on: str
    """its backbone, in words"""
    dimensions: int
    """of a descriptor"""
    least: str = f"{_LEAST_SIDE_PX} pixels a side"
    """how large images must be, in words"""

    @abstractmethod
    def forward(self, images: Tensor) -> Tensor: ...

    def takes(self, height: int, width: int) -> bool:
        """Whether images of so many pixels are large enough."""
        return min(height, width) >= _LEAST_SIDE_PX
