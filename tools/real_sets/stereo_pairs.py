"""Pairs of the two cameras of a stereo rig, with exact pose and dense depth: the layout of Middlebury's stereo data.

Each FOLDER is a scene of the Stereo Evaluation, version 3: ``im0.png`` (left) is the keyframe, ``im1.png`` (right) the
query, and the disparity in ``disp0GT.pfm`` with ``calib.txt`` gives the depth ``baseline f / (disparity + doffs)``.
Nothing is made up. The cameras do not turn against each other and stand a baseline apart, 0.16 to 0.19 m, so that the
keyframe's own pose is right within 0.25 m; finer thresholds tell trackers apart, and ``relocbench probe`` starts them
farther off. A dataset keeps depth to 1/256 m.

OUT has a folder ``other_light`` with the queries of scenes whose two images were taken in different light or with
different exposure (ArtL, PianoL, MotorcycleE), and a folder ``same_light`` with the others. Each scene is a camera of
its own, named after it.
"""

from __future__ import annotations

import argparse
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from generic_folder import Keyframe, Query, made_up_ns, read

from relocbench.arrays import Array
from relocbench.errors import DatasetError
from relocbench.geometry import Camera

OTHER_LIGHT = ("ArtL", "PianoL", "MotorcycleE")
_PFM = re.compile(rb"Pf\s+(\d+)\s+(\d+)\s+([-+.\deE]+)\s(.*)", re.DOTALL)
_ENTRY = re.compile(r"(\w+)\s*=\s*(?:\[([^\]]*)\]|(\S+))")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folders", type=Path, nargs="+", metavar="FOLDER")


def made(options: argparse.Namespace) -> dict[str, list[Query]]:
    """The queries by light. Raises DatasetError: a file of a scene that is missing or damaged."""
    found: dict[str, list[Query]] = {}
    for number, scene in enumerate(options.folders):
        light = "other_light" if scene.resolve().name in OTHER_LIGHT else "same_light"
        found.setdefault(light, []).append(pair_of(scene, made_up_ns(number)))
    return found


def pair_of(scene: Path, time_ns: int) -> Query:
    """The right image as the query of the left one."""
    images = [read(scene / name) for name in ("im0.png", "im1.png")]
    left, right, baseline, doffs = read_calibration(scene / "calib.txt")
    disparity = read_pfm(scene / "disp0GT.pfm")
    shapes = {(left.height, left.width), disparity.shape, *(image.shape[:2] for image in images)}
    if len(shapes) > 1:
        raise DatasetError("images, disparities and calib.txt differ in size; expected one width and height", scene)
    depth = np.where(np.isfinite(disparity), baseline * left.fx / (disparity + doffs), 0.0)
    T_query_ref = np.eye(4)
    T_query_ref[0, 3] = -baseline
    return Query(
        Keyframe(time_ns, images[0], depth, left, scene.resolve().name), time_ns, images[1], right, T_query_ref
    )


def read_calibration(path: Path) -> tuple[Camera, Camera, float, float]:
    """Both cameras, the baseline in metres, and ``doffs``, the disparity of what is infinitely far, negated."""
    if not path.is_file():
        raise DatasetError("no such file; expected the calibration of a scene", path)
    entries = {name: (matrix or value) for name, matrix, value in _ENTRY.findall(path.read_text())}
    try:
        matrices = [_matrix(entries[name]) for name in ("cam0", "cam1")]
        width, height = (int(entries[name]) for name in ("width", "height"))
        baseline, doffs = (float(entries[name]) for name in ("baseline", "doffs"))
    except (KeyError, ValueError):
        wanted = "cam0, cam1 (3 x 3), doffs, baseline (mm), width and height"
        raise DatasetError(f"expected {wanted}", path) from None
    K = matrices[0]
    left = Camera("pinhole", width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    return left, replace(left, cx=matrices[1][0, 2], cy=matrices[1][1, 2]), baseline / 1000, doffs


def read_pfm(path: Path) -> Array:
    """The numbers (H, W) of a grey PFM file; its rows begin at the bottom.

    Its scale is not applied, as by the data's makers; OpenCV's reader multiplies by it.
    """
    found = _PFM.match(path.read_bytes()) if path.is_file() else None
    width, height = (int(found[1]), int(found[2])) if found else (0, 0)
    if found is None or len(found[4]) != 4 * width * height:
        raise DatasetError("no grey PFM file; expected disparities", path)
    order = "<f4" if found[3].startswith(b"-") else ">f4"
    return np.frombuffer(found[4], dtype=order).reshape(height, width)[::-1].astype(np.float64)


def _matrix(text: str) -> Array:
    return np.array([row.split() for row in text.split(";")], dtype=np.float64).reshape(3, 3)
