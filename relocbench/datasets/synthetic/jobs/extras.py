"""Extra images of a build: normals, objects, classes, and changes since the reference.

They are written to ``extras/TRAVERSAL/KIND/CAMERA/TIMESTAMP.png`` beside ``traversals/``. No score depends on them, so
neither the manifest nor the fingerprint covers them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Floats, Mask
from relocbench.datasets.core import images
from relocbench.files import write_bytes


def extra_path(root: Path, traversal: str, kind: str, camera: str, timestamp_ns: int) -> Path:
    """Path of an extra image below the dataset's folder."""
    return root / "extras" / traversal / kind / camera / f"{timestamp_ns}.png"


def write_normals(path: Path, normal: Floats) -> None:
    """Write unit normals (H, W, 3) in world axes as 16-bit RGB ``(n + 1) 32767.5``; the sky, (0, 0, 0), is mid grey."""
    _write_png(path, np.rint((np.clip(normal, -1, 1) + 1) * 32767.5).astype(np.uint16)[..., ::-1])


def write_instance(path: Path, instance: NDArray[np.uint32]) -> None:
    """Write object numbers (H, W) as 8-bit RGB: ``R + 256 G + 65536 B``."""
    parts = [(instance >> shift & 255).astype(np.uint8) for shift in (0, 8, 16)]
    images.write_image(path, np.stack(parts, axis=-1))


def write_mask(path: Path, mask: Mask) -> None:
    """Write a mask (H, W) as 8-bit grey, 255 where it is true."""
    images.write_image(path, np.where(mask, 255, 0).astype(np.uint8))


def _write_png(path: Path, image: NDArray[Any]) -> None:
    done, data = cv2.imencode(".png", np.ascontiguousarray(image), [cv2.IMWRITE_PNG_COMPRESSION, 4])
    if not done:
        raise ValueError(f"cannot encode an image of {image.dtype} {image.shape}")
    write_bytes(path, bytes(data))
