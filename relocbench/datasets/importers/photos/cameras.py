"""COLMAP's camera models, by which kapture and lists of queries tell intrinsics too.

Their pixel centres are at 0.5, 1.5, ...; here they are at integers.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from relocbench.errors import DatasetError, quoted
from relocbench.files import parse_count, parse_floats
from relocbench.geometry import Camera

PARAMETERS = {
    "SIMPLE_PINHOLE": 3,
    "PINHOLE": 4,
    "SIMPLE_RADIAL": 4,
    "RADIAL": 5,
    "OPENCV": 8,
    "OPENCV_FISHEYE": 8,
    "FULL_OPENCV": 12,
    "FOV": 5,
    "SIMPLE_RADIAL_FISHEYE": 4,
    "RADIAL_FISHEYE": 5,
    "THIN_PRISM_FISHEYE": 12,
    "RAD_TAN_THIN_PRISM_FISHEYE": 16,
}
"""number of parameters of each model, in the order of their numbers in COLMAP's binary files"""
_READ = tuple(name for name in PARAMETERS if "PRISM" not in name and name != "FOV")
_ONE_FOCAL_LENGTH = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")


def camera_of(model: str, width: int, height: int, parameters: list[float]) -> Camera:
    """The camera of a line of ``cameras.txt``.

    Raises:
        ValueError: the model is not one of those that OpenCV has too, or its numbers are not those of a camera.
    """
    if model not in _READ:
        raise ValueError(f"camera model {quoted(model)} cannot be read; expected one of {', '.join(_READ)}")
    if len(parameters) != PARAMETERS[model]:
        raise ValueError(f"{model} has {PARAMETERS[model]} parameters, found {len(parameters)}")
    if not np.all(np.isfinite(parameters)):
        raise ValueError("a parameter is not finite")
    if model in _ONE_FOCAL_LENGTH:
        parameters = [parameters[0], *parameters]
    fx, fy, cx, cy, *distortion = parameters
    if min(width, height) < 1 or min(fx, fy) <= 0:
        raise ValueError("size and focal lengths must be positive")
    kind = "pinhole"
    if "FISHEYE" in model:
        kind, distortion = "equidistant", [*distortion, *[0.0] * (4 - len(distortion))]
    elif distortion:
        kind, distortion = "radtan", [*distortion, *[0.0] * (4 - len(distortion))]
    return Camera(kind, width, height, fx, fy, cx - 0.5, cy - 0.5, tuple(distortion))  # type: ignore[arg-type]


def parse_camera(fields: list[str], path: Path, line: int) -> Camera:
    """The camera of three fields or more, ``MODEL WIDTH HEIGHT PARAMS...``. Raises DatasetError with file and line."""
    model, *sizes = fields[:3]
    width, height = (parse_count(text, "the size", path, line, DatasetError) for text in sizes)
    names = " ".join(["parameter"] * len(fields[3:]))
    try:
        return camera_of(model, width, height, parse_floats(fields[3:], path, line, names, DatasetError))
    except ValueError as bad:
        raise DatasetError(str(bad), path, line) from None
