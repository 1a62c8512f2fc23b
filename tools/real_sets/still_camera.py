"""Pairs with exact poses from images of a camera that stays where it is, such as a webcam through a year.

The scene is taken to be a slanted plane, 6 m away at the bottom of the image and 20 m at the top, as a street is. What
a moved camera sees of a plane is a homography, so that every pose has its exact view of a real photograph. Each
keyframe is the middle of an image; its query is the middle of an image of another day and hour, as seen after a drawn
motion. Only light, weather, season and what stands in the scene are real; geometry and motion are made up. The poses
are exact for the warp; what the camera itself shifts between two days comes on top. Marks of the camera, such as dirt
on the lens or the blocks of compression, move with the scene, which they do not for a camera that moves.

Every image belongs to one pair at most, and of images with the same content one is used. Each FOLDER holds the images
of one camera, named YYYYMMDD_HHMMSS; there must be no other. OUT has a folder of queries for each camera.

With --night GREY, pairs are of unlike light: an image is one of the night if the mean of its grey levels is below
GREY (of 255), and one of the day otherwise. OUT has two folders for each camera: CAMERA_to_night has queries of the
night with keyframes of the day, CAMERA_to_day the reverse. --pairs is then the number of each. An image of the night is
in one pair of each folder at most, one of the day in one pair.
"""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
from generic_folder import MAP, Keyframe, Query, centred, middle, plane_depth, plane_homography, read
from scipy.spatial.transform import Rotation

from relocbench.arrays import Array, Image
from relocbench.errors import DatasetError

SIZE = 480, 320
"""width and height of keyframes and queries, pixels"""
FOCAL = 480.0
NEAR_M, FAR_M = 6.0, 20.0
"""depth of the plane at the bottom and at the top of the image"""
MOST_M, MOST_DEG = 1.0, 6.0
"""the drawn motion: translation is drawn from a ball, rotation about any axis"""
CAMERA = centred(SIZE, FOCAL)
PLANE = np.array([0.0, (1 / NEAR_M - 1 / FAR_M) * FOCAL / SIZE[1], (1 / NEAR_M + 1 / FAR_M) / 2])
"""n / d of the plane in the keyframe's frame: every point X of it has PLANE . X = 1"""


@dataclass(frozen=True)
class Pair:
    """A keyframe and a query of one camera, and the motion between them."""

    reference: Path
    query: Path
    T_query_ref: Array


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folders", type=Path, nargs="+", metavar="FOLDER")
    parser.add_argument("--pairs", type=int, default=16, help="pairs of each camera")
    parser.add_argument("--night", type=float, metavar="GREY", help="pair images below this mean grey with others")
    parser.add_argument("--seed", type=int, default=0)


def made(options: argparse.Namespace) -> dict[str, list[Query]]:
    """The queries of each folder. Raises DatasetError: images that do not serve."""
    rng = np.random.default_rng(options.seed)
    found: dict[str, list[Pair]] = {}
    for name, folder in named(options.folders).items():
        if options.night is None:
            found[name] = draw(folder, options.pairs, rng)
        else:
            to_night, to_day = draw_unlike(folder, options.pairs, options.night, rng)
            found |= {f"{name}_to_night": to_night, f"{name}_to_day": to_day}
    return views(found)


def draw(folder: Path, count: int, rng: np.random.Generator) -> list[Pair]:
    """Pairs of images of one camera; no image is in two of them."""
    files = images_of(folder)
    if count < 1 or len(files) < 2 * count:
        raise DatasetError(
            f"holds {len(files)} different images; expected two for each of {count} pairs, 1 or more", folder
        )
    size = one_size(files)
    chosen = rng.permutation(len(files))[: 2 * count].reshape(count, 2)
    return [Pair(files[reference], files[query], drawn_motion(size, rng)) for reference, query in chosen]


def draw_unlike(folder: Path, count: int, grey: float, rng: np.random.Generator) -> tuple[list[Pair], list[Pair]]:
    """Pairs with a query of the night and a keyframe of the day, and pairs the other way round.

    Args:
        grey: images with a lower mean grey level are of the night.
    """
    files = images_of(folder)
    size = one_size(files)
    dark = [float(cv2.cvtColor(read(path), cv2.COLOR_BGR2GRAY).mean()) < grey for path in files]
    nights = [path for path, night in zip(files, dark, strict=True) if night]
    days = [path for path, night in zip(files, dark, strict=True) if not night]
    if count < 1 or len(nights) < count or len(days) < 2 * count:
        raise DatasetError(
            f"holds {len(nights)} different images with a mean grey below {grey:g} and {len(days)} others; expected "
            f"one and two for each of {count} pairs, 1 or more",
            folder,
        )
    of_day = [days[i] for i in rng.permutation(len(days))[: 2 * count]]
    of_night = [[nights[i] for i in rng.permutation(len(nights))[:count]] for _ in range(2)]
    to_night = zip(of_day[:count], of_night[0], strict=True)
    to_day = zip(of_night[1], of_day[count:], strict=True)
    first, second = ([Pair(*paths, drawn_motion(size, rng)) for paths in each] for each in (to_night, to_day))
    return first, second


def named(folders: Sequence[Path]) -> dict[str, Path]:
    """The folders by the name of their camera."""
    found = {folder.resolve().name: folder for folder in folders}
    if len(found) < len(folders) or MAP in found:
        raise DatasetError(
            f"folders are named {', '.join(folder.resolve().name for folder in folders)}; expected different names, "
            f"none of them '{MAP}'"
        )
    return found


def images_of(folder: Path) -> list[Path]:
    """The image files of a folder in the order of their names, without those whose content an earlier one has."""
    if not folder.is_dir():
        raise DatasetError("no such folder; expected the images of one camera", folder)
    first: dict[str, Path] = {}
    for path in sorted(folder.glob("*")):
        if path.suffix.lower() in (".jpg", ".jpeg", ".png"):
            first.setdefault(hashlib.sha256(path.read_bytes()).hexdigest(), path)
    return list(first.values())


def one_size(files: Sequence[Path]) -> tuple[int, int]:
    """Width and height of all images; there is one at least."""
    size: tuple[int, int] | None = None
    for path in files:
        height, width = read(path).shape[:2]
        if size not in (None, (width, height)):
            raise DatasetError(f"{width} x {height} pixels; expected {size[0]} x {size[1]} as {files[0].name}", path)
        size = width, height
    assert size is not None
    return size


def drawn_motion(size: tuple[int, int], rng: np.random.Generator) -> Array:
    """A motion ``T_query_ref`` after which the query shows nothing beyond an image of this width and height."""
    for _ in range(10_000):
        step = rng.normal(size=3)
        step *= MOST_M * rng.uniform() ** (1 / 3) / np.linalg.norm(step)
        turn = rng.normal(size=3)
        turn *= np.radians(MOST_DEG) * rng.uniform() / np.linalg.norm(turn)
        T_query_ref = np.eye(4)
        T_query_ref[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
        T_query_ref[:3, 3] = step
        corners = np.array([[0.0, 0.0], [SIZE[0] - 1, 0.0], [0.0, SIZE[1] - 1], [SIZE[0] - 1, SIZE[1] - 1]])
        seen = corners @ np.eye(2, 3) + [0.0, 0.0, 1.0]
        back = seen @ np.linalg.inv(homography(T_query_ref)).T
        places = back[:, :2] / back[:, 2:] + (np.array(size) - SIZE) // 2
        if np.all(back[:, 2] > 0) and np.all(places >= 0) and np.all(places <= np.array(size) - 1):
            return T_query_ref
    raise DatasetError(
        f"images of {size[0]} x {size[1]} pixels leave no room around {SIZE[0]} x {SIZE[1]}; expected larger ones"
    )


def homography(T_query_ref: Array) -> Array:
    """(3, 3) from pixels of the keyframe to those of the query, for points of the plane."""
    return plane_homography(CAMERA, T_query_ref, PLANE)


def views(folders: dict[str, list[Pair]]) -> dict[str, list[Query]]:
    """What keyframes and queries show."""
    depth = plane_depth(CAMERA, PLANE)
    return {name: [_view(pair, depth) for pair in pairs] for name, pairs in folders.items()}


def _view(pair: Pair, depth: Array) -> Query:
    shown, _ = middle(read(pair.reference), SIZE, pair.reference)
    keyframe = Keyframe(_taken_ns(pair.reference), shown, depth, CAMERA)
    image = read(pair.query)
    return Query(keyframe, _taken_ns(pair.query), _moved(image, pair), CAMERA, pair.T_query_ref)


def _moved(image: Image, pair: Pair) -> Image:
    """What the moved camera sees of the image on the plane."""
    _, (x, y) = middle(image, SIZE, pair.query)
    crop = np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], [0.0, 0.0, 1.0]])
    H = homography(pair.T_query_ref) @ crop
    return np.asarray(cv2.warpPerspective(image, H, SIZE, flags=cv2.INTER_CUBIC))


def _taken_ns(path: Path) -> int:
    """When an image was taken, by its name."""
    try:
        return int(datetime.strptime(path.stem, "%Y%m%d_%H%M%S").replace(tzinfo=UTC).timestamp()) * 10**9
    except ValueError:
        raise DatasetError("expected a name YYYYMMDD_HHMMSS", path) from None
