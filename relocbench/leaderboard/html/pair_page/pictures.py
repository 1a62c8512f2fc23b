"""Small pictures of a pair for its page: images without distortion, and a keyframe's depth on a grid.

The page warps the keyframe itself, so that the poses of all methods are shown with one picture. It knows pinhole
cameras alone: every image is undistorted to one here, and depth is looked up at the pixels of that camera.

A method may tell some of its matches in ``info["shown_matches"]``: a list of ``[u, v of the keyframe, u, v of the
query, 1 if it agrees with the answer, else 0]``, in pixels of the images that it was given.
"""

from __future__ import annotations

import base64
import json
import math
from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np

from relocbench.arrays import Array, Floats, Image, Indices
from relocbench.datasets.core.images import jpeg_bytes
from relocbench.geometry import Camera
from relocbench.tracking import Reference

_PIXELS = 480 * 360
"""pixels of a small picture at most"""
_NODES = 20_000
"""nodes of a grid of depth at most"""
_SPARSE = 0.3
"""share of pixels with depth below which each of them counts for the cell of the grid around it"""
_LEVELS = 65535


def small_camera(camera: Camera) -> Camera:
    """The pinhole camera of the small picture of a camera's images; it is never larger than the image."""
    factor = min(1.0, math.sqrt(_PIXELS / (camera.width * camera.height)))
    width, height = max(1, round(camera.width * factor)), max(1, round(camera.height * factor))
    across, down = width / camera.width, height / camera.height
    return replace(
        camera.pinhole(),
        width=width,
        height=height,
        fx=camera.fx * across,
        fy=camera.fy * down,
        cx=(camera.cx + 0.5) * across - 0.5,
        cy=(camera.cy + 0.5) * down - 0.5,
    )


def small_image(image: Image, camera: Camera) -> Image:
    """An image (H, W[, 3]) as :func:`small_camera` sees it; black where the image shows nothing."""
    target = small_camera(camera)
    small = np.asarray(cv2.resize(image, target.size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    if camera.model == "pinhole":
        return small
    u, v = _undistortion(camera)
    return np.asarray(cv2.remap(small, u, v, cv2.INTER_LINEAR), dtype=np.uint8)


def shown_columns(camera: Camera) -> Indices | None:
    """(H, 2) for each row of the small picture the first column that shows something, and the one after the last.

    What is outside is black in the picture, and must not be compared. None where nothing is outside.
    """
    if camera.model == "pinhole":
        return None
    u, v = _undistortion(camera)
    target = small_camera(camera)
    inside = (u >= 0) & (u <= target.width - 1) & (v >= 0) & (v <= target.height - 1)
    if inside.all():
        return None
    any_inside = inside.any(axis=1)
    first = np.where(any_inside, inside.argmax(axis=1), 0)
    after = np.where(any_inside, target.width - inside[:, ::-1].argmax(axis=1), 0)
    return np.stack([first, after], axis=1)


def image_payload(image: Image, camera: Camera) -> dict[str, object]:
    """The small picture as the page takes it: a JPEG as an address, and the pinhole camera that sees it.

    Where parts of it lie outside the image, ``shown`` has :func:`shown_columns`, base64 of little-endian uint16.
    """
    target = small_camera(camera)
    jpeg = base64.b64encode(jpeg_bytes(small_image(image, camera), 82)).decode()
    columns = shown_columns(camera)
    shown = {} if columns is None else {"shown": base64.b64encode(columns.astype("<u2").tobytes()).decode()}
    return {
        "src": f"data:image/jpeg;base64,{jpeg}",
        "camera": [target.width, target.height, target.fx, target.fy, target.cx, target.cy],
        **shown,
    }


@lru_cache(maxsize=8)
def _undistortion(camera: Camera) -> tuple[Floats, Floats]:
    """For each pixel of the small picture the pixel (u, v) of the distorted image of its size."""
    target = small_camera(camera)
    return replace(target, model=camera.model, distortion=camera.distortion).undistortion_map(target)


def inverse_depth_grid(reference: Reference) -> tuple[Floats, int]:
    """Inverse depth (rows, columns) in 1/m on a grid over the small picture, 0 where unknown, and its step in pixels.

    The node of row i and column j lies in the middle of the cell of ``step`` pixels that begins at (j step, i step). A
    dense depth is looked up there; of sparse points in the cell the nearest to the camera counts.
    """
    small = small_camera(reference.camera)
    step = max(1, math.ceil(math.sqrt(small.width * small.height / _NODES)))
    shape = max(1, small.height // step), max(1, small.width // step)
    grid = np.zeros(shape, dtype=np.float32)
    known = reference.inverse_depth_map
    if reference.depth is not None and np.count_nonzero(known) >= _SPARSE * known.size:
        rows, columns = np.indices(shape)
        nodes = np.stack([columns, rows], axis=-1) * step + (step - 1) / 2
        pixels, valid = small.undistort(nodes, reference.camera)
        valid &= reference.camera.contains(pixels)
        u, v = _rounded(pixels[valid])
        grid[valid] = known[v, u]
        return grid, step
    points = reference.points
    pixels, valid = reference.camera.undistort(points.uv, small)
    u, v = _rounded((pixels[valid] - (step - 1) / 2) / step)
    inside = (u >= 0) & (v >= 0) & (u < shape[1]) & (v < shape[0])
    np.maximum.at(grid, (v[inside], u[inside]), points.inverse_depth[valid][inside].astype(np.float32))
    return grid, step


def depth_payload(reference: Reference) -> dict[str, object]:
    """The grid as the page takes it: base64 of little-endian uint16, in units of the nearest point's share."""
    grid, step = inverse_depth_grid(reference)
    nearest = float(grid.max(initial=0.0))
    stored = np.rint(grid / (nearest or 1.0) * _LEVELS)
    stored[(grid > 0) & (stored < 1)] = 1
    return {
        "rows": grid.shape[0],
        "columns": grid.shape[1],
        "step": step,
        "unit": nearest / _LEVELS,
        "data": base64.b64encode(stored.astype("<u2").tobytes()).decode(),
    }


def _rounded(pixels: Array) -> tuple[Indices, Indices]:
    """u and v of the nearest pixels."""
    u, v = np.rint(pixels).astype(np.int64).T
    return u, v


KEY = "shown_matches"
MOST = 500
"""matches at most that are drawn of one answer"""


def shown_matches(info: str, reference: Camera, query: Camera) -> list[list[float]]:
    """The matches of an answer in pixels of the small pictures, without those that a picture does not show.

    Args:
        info: of the answer, JSON.
        reference, query: the cameras of both images.
    """
    matches = _stated(info)
    if not len(matches):
        return []
    of_reference, seen = reference.undistort(matches[:, :2], small_camera(reference))
    of_query, also_seen = query.undistort(matches[:, 2:4], small_camera(query))
    pixels = np.hstack([of_reference, of_query]).round(1)[seen & also_seen].tolist()
    agrees = (matches[seen & also_seen, 4] > 0.5).astype(int).tolist()
    return [[*both, one] for both, one in zip(pixels, agrees, strict=True)]


def _stated(info: str) -> Array:
    """(N, 5) the matches of an info; (0, 5) where it holds none that can be read."""
    none = np.zeros((0, 5))
    if KEY not in info:
        return none
    try:
        matches = np.array(json.loads(info).get(KEY, [])[:MOST], dtype=np.float64)
    except (ValueError, TypeError, AttributeError, OverflowError):
        return none
    return matches if matches.shape[1:] == (5,) and np.isfinite(matches).all() else none
