"""Keyframes and their queries as generic folders, which ``relocbench build-dataset generic`` reads.

Each keyframe stands at a place of its own, far from the others, so that each query has one keyframe only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from relocbench.arrays import Array, Image
from relocbench.errors import DatasetError
from relocbench.geometry import Camera

MAP = "map"
"""the folder of the keyframes"""
DEPTH_SCALE = 1e-3
APART_M = 100.0
"""between the places of two keyframes"""


@dataclass(frozen=True, eq=False)
class Keyframe:
    """An image with depth."""

    time_ns: int
    image: Image
    """(H, W, 3), BGR"""
    depth: Array
    """(H, W) metres along z, 0 where unknown"""
    camera: Camera
    name: str = ""
    """of its camera, in sets with several; its queries have cameras of this name"""


@dataclass(frozen=True, eq=False)
class Query:
    """An image that one keyframe stands for."""

    keyframe: Keyframe
    time_ns: int
    image: Image
    camera: Camera
    T_query_ref: Array


def write(out: Path, folders: Mapping[str, Sequence[Query]]) -> None:
    """Write ``out/map`` with the keyframes and a folder of each name with its queries.

    Raises:
        DatasetError: two keyframes, or two queries of a folder, have one time.
    """
    keyframes = list(dict.fromkeys(query.keyframe for queries in folders.values() for query in queries))
    standing = {keyframe: _standing(place) for place, keyframe in enumerate(keyframes)}
    for name, images in {MAP: keyframes, **folders}.items():
        if len({image.time_ns for image in images}) < len(images):
            raise DatasetError("two images were taken at one time; expected other times", out / name)
    folder = out / MAP
    _write_cameras(folder, {k.name: k.camera for k in keyframes}, {"depth_scale": str(DEPTH_SCALE)})
    for keyframe in keyframes:
        file = Path(keyframe.name) / f"{keyframe.time_ns}.png"
        _save(folder / "images" / file, keyframe.image)
        _save(folder / "depth" / file, np.rint(keyframe.depth / DEPTH_SCALE).astype(np.uint16))
    _write_poses(folder, {k.time_ns: standing[k] for k in keyframes})
    for name, queries in folders.items():
        folder = out / name
        _write_cameras(folder, {query.keyframe.name: query.camera for query in queries}, {})
        for query in queries:
            _save(folder / "images" / query.keyframe.name / f"{query.time_ns}.png", query.image)
        _write_poses(
            folder, {query.time_ns: standing[query.keyframe] @ np.linalg.inv(query.T_query_ref) for query in queries}
        )


def made_up_ns(number: int) -> int:
    """A time for the image with a number: an hour after that of the image before, and with the 19 digits of today's."""
    return 10**18 + number * 3600 * 10**9


def read(path: Path) -> Image:
    """An image (H, W, 3), BGR. Raises DatasetError."""
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise DatasetError("no image that OpenCV can read", path)
    return np.asarray(image)


def middle(image: Image, size: tuple[int, int], where: Path) -> tuple[Image, Array]:
    """The middle of an image, and the place (2,) of its first pixel there, whole pixels.

    Args:
        size: width and height of the middle.
        where: the image's file, for messages.

    Raises:
        DatasetError: the image is smaller.
    """
    height, width = image.shape[:2]
    if width < size[0] or height < size[1]:
        raise DatasetError(f"{width} x {height} pixels; expected at least {size[0]} x {size[1]}", where)
    x, y = (width - size[0]) // 2, (height - size[1]) // 2
    return image[y : y + size[1], x : x + size[0]], np.array([x, y], dtype=np.float64)


def centred(size: tuple[int, int], focal: float) -> Camera:
    """The pinhole camera of a width, height and focal length in pixels that looks through the middle of its image."""
    return Camera("pinhole", *size, focal, focal, (size[0] - 1) / 2, (size[1] - 1) / 2)


def plane_depth(camera: Camera, inverse: Array) -> Array:
    """(H, W) depth of a plane, metres.

    Args:
        inverse: (3,) n / d of the plane in the camera's frame: every point X of it has inverse . X = 1.
    """
    v, u = np.mgrid[: camera.height, : camera.width]
    rays, _ = camera.unproject(np.stack([u, v], axis=-1).reshape(-1, 2))
    return np.asarray(1.0 / (rays @ inverse)).reshape(camera.height, camera.width)


def plane_homography(camera: Camera, T_query_ref: Array, inverse: Array) -> Array:
    """(3, 3) from pixels of the keyframe to those of a query of the same camera, for points of a plane.

    ``K (R + t n^T / d) K^-1`` (Hartley and Zisserman, Multiple View Geometry, 2nd edition, 13.2).

    Args:
        inverse: as of :func:`plane_depth`.
    """
    moved = T_query_ref[:3, :3] + np.outer(T_query_ref[:3, 3], inverse)
    return np.asarray(camera.matrix @ moved @ np.linalg.inv(camera.matrix))


def _standing(place: int) -> Array:
    """``T_world_ref`` of the keyframe with a number."""
    T_world_ref = np.eye(4)
    T_world_ref[0, 3] = APART_M * place
    return T_world_ref


def _write_cameras(folder: Path, cameras: Mapping[str, Camera], more: Mapping[str, str]) -> None:
    """``camera.yaml`` of one camera without a name, or of several by their names."""
    (folder / "images").mkdir(parents=True)
    lines = []
    for name, camera in cameras.items():
        values = {"model": "pinhole", "width": camera.width, "height": camera.height}
        values |= {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy} | more
        indent = "    " if name else ""
        lines += [f"  {name}:"] * bool(name) + [f"{indent}{key}: {value}" for key, value in values.items()]
    head = ["cameras:"] if any(cameras) else []
    (folder / "camera.yaml").write_text("\n".join([*head, *lines]) + "\n")


def _write_poses(folder: Path, poses: Mapping[int, Array]) -> None:
    """A TUM trajectory ``t tx ty tz qx qy qz qw``, in the order of times."""
    rows = []
    for time, T_world_cam in sorted(poses.items()):
        numbers = [*T_world_cam[:3, 3], *Rotation.from_matrix(T_world_cam[:3, :3]).as_quat()]
        rows.append(f"{time} {' '.join(repr(float(number)) for number in numbers)}")
    (folder / "poses.txt").write_text("\n".join(rows) + "\n")


def _save(path: Path, image: Array | Image) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), image):
        raise OSError(f"{path}: could not be written")
