"""Places by drone and by satellite in University-1652's layout, made in no time: ``make_small_views``."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

SIDE = 32


def make_small_views(
    root: Path, *, places: int = 8, drones: int = 2, distractors: int = 1, noise: float = 12.0
) -> Path:
    """``test/`` with queries and galleries of both views; ``distractors`` stand in the satellite gallery alone.

    A place is a pattern of 8 x 8 blocks; each image of it has noise of its own, so that thumbnails find places well,
    and the worse the more noise there is.
    """
    rng = np.random.default_rng(0)
    for place in range(places + distractors):
        pattern = np.repeat(np.repeat(rng.integers(40, 216, (8, 8, 3)), SIDE // 8, axis=0), SIDE // 8, axis=1)
        views = {"gallery_satellite": 1}
        if place < places:
            views |= {"query_satellite": 1, "query_drone": drones, "gallery_drone": drones}
        for folder, count in views.items():
            for k in range(count):
                path = root / "test" / folder / f"{place:04d}" / f"{k}.png"
                path.parent.mkdir(parents=True, exist_ok=True)
                image = pattern + rng.normal(scale=noise, size=pattern.shape)
                cv2.imwrite(str(path), np.clip(image, 0, 255).astype(np.uint8))
    return root
