"""Where the cameras of a drive are mounted and what they see, compared with the plain rig, and how that is drawn."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, TypeAdapter, WrapValidator

from relocbench.datasets.core.build_options import ImageSize, width_height
from relocbench.datasets.core.schema import Strict
from relocbench.datasets.synthetic.conditions.imaging import Range, rounded

_LEAST_PX = 32
"""least side of drawn images"""


class CameraView(Strict):
    """How the cameras of a drive differ from the rig that the dataset names. With the defaults they do not.

    All cameras of a rig are turned and lifted as one body, so that stereo cameras stay a stereo camera.
    """

    focal: float = Field(1.0, ge=0.3, le=4)
    """factor of the focal length, as a share of the image's width"""
    size: ImageSize | None = None
    """pixels, WIDTHxHEIGHT; by default the dataset's"""
    up_m: float = Field(0.0, ge=-1.2, le=10)
    """metres above the plain mount"""
    down_deg: float = Field(0.0, ge=-45, le=90)
    """degrees below the plain mount's direction, before ``yaw_deg``"""
    yaw_deg: float = Field(0.0, ge=-180, le=180)
    """degrees to the left; 180 looks back"""
    distortion: float = Field(0.0, ge=-0.3, le=0.3)
    """share of their distance from the centre by which the lens moves the corners of the image, which is then rectified
    to a pinhole camera; negative for barrel distortion"""


RANGES: dict[str, Range] = {
    "focal": Range(0.7, 1.5, logarithmic=True),
    "size": Range(0.5, 1.0),
    "up_m": Range(-0.4, 0.7),
    "down_deg": Range(-5.0, 8.0),
    "yaw_deg": Range(-15.0, 15.0),
    "distortion": Range(-0.2, 0.05),
}
"""What ``--views varied`` draws each value from; ``size`` is a factor of the dataset's."""


def draw_view(rng: np.random.Generator, size: tuple[int, int]) -> CameraView:
    """The view of a drive.

    Args:
        size: (width, height) of the dataset's images in pixels. Sides are even and at least 32 pixels long, and their
            ratio is that of ``size`` but for rounding.
    """
    values: dict[str, float | str] = {}
    for name, each in RANGES.items():
        drawn = each.draw(rng)
        assert drawn is not None
        values[name] = rounded(drawn)
        if name == "size":
            factor = max(drawn, _LEAST_PX / min(size))
            values[name] = "x".join(str(2 * round(factor * side / 2)) for side in size)
    return CameraView.model_validate(values)


_BY_WORD: TypeAdapter[str] = TypeAdapter(Literal["same", "varied"])
_BY_HAND: TypeAdapter[dict[str, CameraView]] = TypeAdapter(dict[str, CameraView])


def _by_word_or_hand(value: object, _: object) -> str | dict[str, CameraView]:
    """What was meant, so that a fault is told once, at its place, and not for each kind of value."""
    return _BY_HAND.validate_python(value) if isinstance(value, dict) else _BY_WORD.validate_python(value)


Views = Annotated[Literal["same", "varied"] | dict[str, CameraView], WrapValidator(_by_word_or_hand)]
"""an option: all drives have the plain rig, drawn views, or those that are given for conditions by name"""


def image_size(view: CameraView | None, size: tuple[int, int]) -> tuple[int, int]:
    """(width, height) in pixels of the images of a view, or else of the dataset's."""
    return size if view is None or view.size is None else width_height(view.size)
