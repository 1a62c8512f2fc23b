"""A sheet of what maps of each kind know of the depth of one place."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import cv2
import numpy as np

from relocbench.arrays import Array, Floats, Image
from relocbench.datasets.core.images import as_grey
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.drives.drive import MARGIN_M
from relocbench.datasets.synthetic.drives.rig import rig_named
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.datasets.synthetic.jobs.contact_sheet import labelled, place_and_route, tiled
from relocbench.datasets.synthetic.jobs.keyframe_depth import Keyframe, Scan
from relocbench.datasets.synthetic.map_depth.kinds import DepthKind, MapDepth
from relocbench.progress import Reporter
from relocbench.tracking import KeyframePoints

_NEAREST_SHOWN_M = 4.0
"""depth that is drawn in the colour of the nearest surfaces"""


def depth_sheet(
    factors: Factors, *, seed: int, split: str, at_m: float, size: tuple[int, int], reporter: Reporter
) -> Image:
    """The front camera's view ``at_m`` metres along the drive, and what each kind of map knows of its depth there.

    Near surfaces are red, far ones blue, by their inverse depth.

    Args:
        size: (width, height) of each picture in pixels.
    """
    place, route = place_and_route(seed, split)
    camera, T_rig_cam = rig_named("front").cameras(*size)["front"]
    T_world_rig = route.pose(MARGIN_M + at_m)
    number = scenes.frame_seed(seed, 0, 0, 0)
    frame = scenes.renderer(place, factors.scene).render(camera, T_world_rig @ T_rig_cam, number)
    keyframe = Keyframe(frame, camera, T_world_rig @ T_rig_cam, number)
    scanned = replace(keyframe, scan=Scan(place, factors.scene, (), T_world_rig, number))
    pictures = [labelled(frame.rgb, "image")]
    with reporter.stage("drawing depth", len(get_args(DepthKind))) as advance:
        for kind in get_args(DepthKind):
            known = MapDepth(kind)
            if known.stored_as == "depth":
                drawn = _over(frame.rgb, keyframe.depth(known))
            else:
                drawn = _dotted(frame.rgb, (scanned if kind == "lidar" else keyframe).points(known))
            pictures.append(labelled(drawn, kind))
            advance(1)
    return tiled(pictures)


def _over(rgb: Image, depth: Floats) -> Image:
    """Depth (H, W), 0 where unknown, in colours over a dimmed image (H, W, 3)."""
    known = depth > 0
    inverse = np.where(known, 1.0 / np.where(known, depth, 1.0), 0.0)
    return np.where(known[..., None], _coloured(inverse), _dimmed(rgb))


def _dotted(rgb: Image, points: KeyframePoints) -> Image:
    """Points as dots over a dimmed image (H, W, 3); they are larger where there are few."""
    out = _dimmed(rgb)
    radius = round(0.18 * float(np.sqrt(rgb[..., 0].size / max(len(points), 1))))
    colours = _coloured(points.inverse_depth[:, None])[:, 0].tolist()
    for (u, v), colour in zip(np.rint(points.uv).astype(int).tolist(), colours, strict=True):
        cv2.circle(out, (u, v), radius, colour, cv2.FILLED)
    return out


def _coloured(inverse_depth: Array) -> Image:
    """Colours (H, W, 3) of inverse depth (H, W)."""
    grey = np.clip(inverse_depth * _NEAREST_SHOWN_M * 255, 0, 255).astype(np.uint8)
    return np.ascontiguousarray(cv2.applyColorMap(grey, cv2.COLORMAP_TURBO)[..., ::-1])


def _dimmed(rgb: Image) -> Image:
    return np.repeat(as_grey(rgb)[..., None] // 3 + 110, 3, axis=2)
