"""JPEG compression, whose traces stay in the image although it is stored without loss."""

from __future__ import annotations

import cv2
import numpy as np

from relocbench.arrays import Image
from relocbench.datasets.core.images import jpeg_bytes


def through_jpeg(rgb: Image, quality: float) -> Image:
    """The image (H, W, 3) after JPEG compression with a quality of 1 to 100, rounded, and colour at half the size."""
    data = np.frombuffer(jpeg_bytes(rgb, round(quality)), dtype=np.uint8)
    back = cv2.imdecode(data, cv2.IMREAD_COLOR)
    assert back is not None
    return np.ascontiguousarray(back[..., ::-1], dtype=np.uint8)
