"""A contact sheet of one place in several conditions."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import cv2
import numpy as np

from relocbench.arrays import Image
from relocbench.datasets.synthetic.camera.shot import Shot, camera_twists
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.conditions.views import draw_view
from relocbench.datasets.synthetic.drives.drive import MARGIN_M, RATE_HZ, Drive, DriveStyle, Route
from relocbench.datasets.synthetic.drives.passers import all_that_moves
from relocbench.datasets.synthetic.drives.rig import rig_named
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.datasets.synthetic.jobs.scenes import DistrictSpec
from relocbench.progress import Reporter

_ROW_LENGTH = 5
_ROUTE_M = 300.0
_GAP = 4
"""pixels between pictures"""
_EXTENT_M = 250.0
_PASSERS = 58
"""number of the random stream of what moves"""


def contact_sheet(
    conditions: Mapping[str, Factors],
    *,
    seed: int,
    split: str,
    at_m: float,
    size: tuple[int, int],
    reporter: Reporter,
    views: int = 0,
) -> Image:
    """The front camera's view ``at_m`` metres along the drive in each condition, with labels, (H, W, 3) RGB.

    A condition's own camera moves at the mean speed of drives.

    Args:
        size: (width, height) of each picture in pixels.
        views: number of drawn views that each condition is shown by, beside the plain one.
    """
    place, route = place_and_route(seed, split)
    step_m = DriveStyle().speed_mps / RATE_HZ
    T_world_rig = np.array([route.pose(MARGIN_M + at_m + k * step_m) for k in (-1, 0, 1)])
    pictures = []
    with reporter.stage("rendering", len(conditions) * (views + 1)) as advance:
        for (k, (label, factors)), n in product(enumerate(conditions.items()), range(views + 1)):
            view = draw_view(np.random.default_rng([seed, 57, k, n]), size).model_copy(update={"size": None})
            camera, T_rig_cam = rig_named("front").cameras(*size, view if n else None)["front"]
            poses = T_world_rig @ T_rig_cam
            twist = camera_twists(poses, 1 / RATE_HZ)[1]
            shot = Shot(factors.imaging, 0.0, twist) if factors.imaging is not None else None
            moment = Drive(np.array([MARGIN_M + at_m]), T_world_rig[1:2])
            rng = np.random.default_rng([seed, _PASSERS, k])
            moving = all_that_moves(scenes.district(place).footpaths, route, moment, factors, rng)[0]
            renderer = scenes.renderer(place, factors.scene, moving)
            car, distortion = (T_world_rig[1], view.distortion) if n else (None, 0.0)
            frame = renderer.render(camera, poses[1], scenes.frame_seed(seed, k, 0, 0), car, shot, distortion)
            pictures.append(labelled(frame.rgb, f"{label}, view {n}" if n else label))
            advance(1)
    return tiled(pictures)


def place_and_route(seed: int, split: str) -> tuple[DistrictSpec, Route]:
    """The district that sheets show, and the route along which they do."""
    place = DistrictSpec(seed, split, _EXTENT_M)
    return place, scenes.district(place).network.drive(_ROUTE_M, seed)


def labelled(picture: Image, label: str) -> Image:
    """The picture (H, W, 3) with its label in white on a darkened strip along the bottom."""
    out = np.ascontiguousarray(picture.copy())
    scale = picture.shape[1] / 640
    strip = out[-round(44 * scale) :]
    strip[:] = strip // 3
    at = round(10 * scale), picture.shape[0] - round(14 * scale)
    cv2.putText(out, label, at, cv2.FONT_HERSHEY_SIMPLEX, scale, (255, 255, 255), max(1, round(scale)), cv2.LINE_AA)
    return out


def tiled(pictures: list[Image]) -> Image:
    """Pictures of the same size in rows of nearly equal length, on white."""
    rows = -(-len(pictures) // _ROW_LENGTH)
    columns = -(-len(pictures) // rows)
    height, width = pictures[0].shape[:2]
    sheet = np.full((rows * (height + _GAP) - _GAP, columns * (width + _GAP) - _GAP, 3), 255, dtype=np.uint8)
    for k, picture in enumerate(pictures):
        y, x = k // columns * (height + _GAP), k % columns * (width + _GAP)
        sheet[y : y + height, x : x + width] = picture
    return sheet
