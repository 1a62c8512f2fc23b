"""The network's input: square RGB images, prepared alike in training and evaluation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from relocbench.arrays import Image


def resized(image: Image, size: int) -> Image:
    """An image (H, W, 3) resized to (size, size, 3), bicubic with antialiasing; the aspect ratio is not kept."""
    if image.shape[:2] == (size, size):
        return image
    x = torch.from_numpy(np.ascontiguousarray(image).copy()).permute(2, 0, 1)[None].float()
    small = functional.interpolate(x, size=(size, size), mode="bicubic", antialias=True)
    small = small[0].round().clamp(0, 255).to(torch.uint8)
    return np.ascontiguousarray(small.permute(1, 2, 0).numpy())


def as_bytes(images: Sequence[Image]) -> Tensor:
    """Square images as one tensor (B, 3, S, S) uint8."""
    return torch.from_numpy(np.stack(images)).permute(0, 3, 1, 2).contiguous()


def as_network_takes_them(images: Tensor, device: torch.device) -> Tensor:
    """Images (B, 3, S, S) uint8 as float32 in [0, 1] on a device, channels last."""
    moved = images.to(device, non_blocking=True).float() / 255
    return moved.contiguous(memory_format=torch.channels_last)
