"""Make a recording with exact poses from images of a camera that stays where it is, such as a webcam through a year.

The scene is taken to be a slanted plane, 6 m away at the bottom of the image and 20 m at the top, as a street is. What
a moved camera sees of a plane is a homography, so that every pose has its exact view of a real photograph. Each
keyframe is the middle of an image; its query is the middle of an image of another day and hour, as seen after a drawn
motion. Only light, weather, season and what stands in the scene are real; geometry and motion are made up. The poses
are exact for the warp; what the camera itself shifts between two days comes on top. Marks of the camera, such as dirt
on the lens or the blocks of compression, move with the scene, which they do not for a camera that moves.

Every image belongs to one pair at most, and of images with the same content one is used.

    python tools/still_camera.py OUT FOLDER [FOLDER ...] [--pairs N] [--seed S]

Each FOLDER holds the images of one camera, named YYYYMMDD_HHMMSS; there must be no other. OUT/map and one folder for
each camera are generic folders for ``relocbench build-dataset generic``: the keyframes of all cameras, which stand far
from each other, and the queries. A folder that exists already is refused.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from relocbench.arrays import Array, Image
from relocbench.datasets.moved_views.surfaces import plane_homography
from relocbench.geometry import Camera

SIZE = 480, 320
"""width and height of keyframes and queries, pixels"""
FOCAL = 480.0
NEAR_M, FAR_M = 6.0, 20.0
"""depth of the plane at the bottom and at the top of the image"""
MOST_M, MOST_DEG = 1.0, 6.0
"""the drawn motion: translation is drawn from a ball, rotation about any axis"""
DEPTH_SCALE = 1e-3
APART_M = 100.0
"""between the places of two keyframes, so that each query has one keyframe only"""
CAMERA = Camera("pinhole", *SIZE, FOCAL, FOCAL, (SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2)
K = CAMERA.matrix
PLANE = np.array([0.0, (1 / NEAR_M - 1 / FAR_M) * FOCAL / SIZE[1], (1 / NEAR_M + 1 / FAR_M) / 2])
"""n / d of the plane in the keyframe's frame: every point X of it has PLANE . X = 1"""


@dataclass(frozen=True)
class Pair:
    """A keyframe and a query of one camera, and the motion between them."""

    reference: Path
    query: Path
    T_query_ref: Array


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("folders", type=Path, nargs="+", metavar="FOLDER")
    parser.add_argument("--pairs", type=int, default=16, help="pairs of each camera")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if options.out.exists():
        sys.exit(f"{options.out}: exists already; expected a folder that is to be made")
    rng = np.random.default_rng(options.seed)
    write(options.out, {name: draw(path, options.pairs, rng) for name, path in named(options.folders).items()})


def draw(folder: Path, count: int, rng: np.random.Generator) -> list[Pair]:
    """Pairs of images of one camera; no image is in two of them."""
    if not folder.is_dir():
        sys.exit(f"{folder}: no such folder; expected the images of one camera")
    files = unlike([path for path in sorted(folder.glob("*")) if path.suffix.lower() in (".jpg", ".jpeg", ".png")])
    if count < 1 or len(files) < 2 * count:
        sys.exit(f"{folder}: holds {len(files)} different images; expected two for each of {count} pairs, 1 or more")
    size = one_size(files)
    chosen = rng.permutation(len(files))[: 2 * count].reshape(count, 2)
    return [Pair(files[reference], files[query], drawn_motion(size, rng)) for reference, query in chosen]


def named(folders: Sequence[Path]) -> dict[str, Path]:
    """The folders by the name of their camera."""
    found = {folder.resolve().name: folder for folder in folders}
    if len(found) < len(folders) or "map" in found:
        sys.exit(
            f"folders are named {', '.join(folder.resolve().name for folder in folders)}; expected different names, "
            "none of them 'map'"
        )
    return found


def unlike(files: Sequence[Path]) -> list[Path]:
    """The files without those whose content an earlier one has."""
    first: dict[str, Path] = {}
    for path in files:
        first.setdefault(hashlib.sha256(path.read_bytes()).hexdigest(), path)
    return list(first.values())


def one_size(files: Sequence[Path]) -> tuple[int, int]:
    """Width and height of all images."""
    size: tuple[int, int] | None = None
    for path in files:
        height, width = read(path).shape[:2]
        if size not in (None, (width, height)):
            sys.exit(f"{path}: {width} x {height} pixels; expected {size[0]} x {size[1]} as {files[0].name}")
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
        places = back[:, :2] / back[:, 2:] + offset(size)
        if np.all(back[:, 2] > 0) and np.all(places >= 0) and np.all(places <= np.array(size) - 1):
            return T_query_ref
    sys.exit(f"images of {size[0]} x {size[1]} pixels leave no room around {SIZE[0]} x {SIZE[1]}; expected larger ones")


def homography(T_query_ref: Array) -> Array:
    """(3, 3) from pixels of the keyframe to those of the query, for points of the plane."""
    return plane_homography(CAMERA, CAMERA, T_query_ref, PLANE)


def offset(size: tuple[int, int]) -> Array:
    """(2,) the place of the keyframe's first pixel in the image, whole pixels."""
    return np.array([(size[0] - SIZE[0]) // 2, (size[1] - SIZE[1]) // 2], dtype=np.float64)


def read(path: Path) -> Image:
    """An image (H, W, 3), BGR."""
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        sys.exit(f"{path}: no image that OpenCV can read")
    return np.asarray(image)


def keyframe(image: Image) -> Image:
    """The middle of an image."""
    height, width = image.shape[:2]
    if width < SIZE[0] or height < SIZE[1]:
        sys.exit(f"an image has {width} x {height} pixels; expected at least {SIZE[0]} x {SIZE[1]}")
    x, y = offset((width, height)).astype(int)
    return image[y : y + SIZE[1], x : x + SIZE[0]]


def query(image: Image, T_query_ref: Array) -> Image:
    """What the moved camera sees of the image on the plane."""
    height, width = image.shape[:2]
    x, y = offset((width, height))
    crop = np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], [0.0, 0.0, 1.0]])
    return np.asarray(cv2.warpPerspective(image, homography(T_query_ref) @ crop, SIZE, flags=cv2.INTER_CUBIC))


def depth() -> Array:
    """(H, W) depth of the plane in the keyframe, metres."""
    rays_y = (np.arange(SIZE[1]) - K[1, 2]) / FOCAL
    return np.broadcast_to(1.0 / (PLANE[1] * rays_y + PLANE[2])[:, None], SIZE[::-1])


def write(out: Path, cameras: dict[str, list[Pair]]) -> None:
    """Write the keyframes of all cameras and the queries of each as generic folders."""
    places = {pair.reference: i for i, pair in enumerate(pair for pairs in cameras.values() for pair in pairs)}
    keyframes = {taken_ns(pair.reference): pair for pairs in cameras.values() for pair in pairs}
    if len(keyframes) < len(places):
        sys.exit("two keyframes were taken in one second; expected other times")
    plane = np.rint(depth() / DEPTH_SCALE).astype(np.uint16)
    folder = started(out / "map", f"depth_scale: {DEPTH_SCALE}\n")
    (folder / "depth").mkdir()
    for time, pair in keyframes.items():
        save(folder / "images" / f"{time}.png", keyframe(read(pair.reference)))
        save(folder / "depth" / f"{time}.png", plane)
    write_poses(folder, {time: standing(places[pair.reference]) for time, pair in keyframes.items()})
    for name, pairs in cameras.items():
        folder = started(out / name)
        poses = {}
        for pair in pairs:
            time = taken_ns(pair.query)
            save(folder / "images" / f"{time}.png", query(read(pair.query), pair.T_query_ref))
            poses[time] = standing(places[pair.reference]) @ np.linalg.inv(pair.T_query_ref)
        write_poses(folder, poses)


def standing(place: int) -> Array:
    """``T_world_ref`` of the keyframe with a number."""
    T_world_ref = np.eye(4)
    T_world_ref[0, 3] = APART_M * place
    return T_world_ref


def taken_ns(path: Path) -> int:
    """When an image was taken, by its name."""
    try:
        return int(datetime.strptime(path.stem, "%Y%m%d_%H%M%S").replace(tzinfo=UTC).timestamp()) * 10**9
    except ValueError:
        sys.exit(f"{path}: expected a name YYYYMMDD_HHMMSS")


def started(folder: Path, more: str = "") -> Path:
    (folder / "images").mkdir(parents=True)
    lines = f"model: pinhole\nwidth: {SIZE[0]}\nheight: {SIZE[1]}\n"
    lines += f"fx: {FOCAL}\nfy: {FOCAL}\ncx: {K[0, 2]}\ncy: {K[1, 2]}\n"
    (folder / "camera.yaml").write_text(lines + more)
    return folder


def write_poses(folder: Path, poses: dict[int, Array]) -> None:
    """A TUM trajectory ``t tx ty tz qx qy qz qw``, in the order of times."""
    rows = []
    for time, T_world_cam in sorted(poses.items()):
        numbers = [*T_world_cam[:3, 3], *Rotation.from_matrix(T_world_cam[:3, :3]).as_quat()]
        rows.append(f"{time} {' '.join(repr(float(number)) for number in numbers)}")
    (folder / "poses.txt").write_text("\n".join(rows) + "\n")


def save(path: Path, image: Image) -> None:
    if not cv2.imwrite(str(path), image):
        raise OSError(f"{path}: could not be written")


if __name__ == "__main__":
    main()
