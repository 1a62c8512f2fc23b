"""Readers of datasets: descriptions, poses, pairs, images, depth, points, correspondences, the manifest."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fuzz.asking import asks
from fuzz.parser import Parser, Place
from relocbench.arrays import Image

ACROSS = "summer__winter__cam0"
CAMERA = "cam0"
PAIRS = f"ds/pairs/{ACROSS}"


def write_dataset(root: Path) -> None:
    """A whole dataset of tiny images, with dense depth and correspondences, and one with points."""
    from small_dataset import make_small_dataset

    make_small_dataset(root / "ds", frames=3, size=(24, 18), correspondences=6, rejected=1)
    make_small_dataset(root / "sparse", frames=2, size=(24, 18), sparse=True)


def write_images(root: Path) -> None:
    """A picture in the formats that images come in, depth, and pictures in formats that are not read."""
    rng = np.random.default_rng(0)
    grey = rng.integers(0, 256, (12, 16), dtype=np.uint8)
    colour = rng.integers(0, 256, (12, 16, 3), dtype=np.uint8)
    depth = rng.integers(0, 65536, (12, 16), dtype=np.uint16)
    pictures: dict[str, Image | NDArray[np.uint16]] = {
        "grey.png": grey,
        "colour.png": colour,
        "alpha.png": np.dstack([colour, grey]),
        "deep.png": depth,
        "grey.jpg": grey,
        "colour.jpeg": colour,
        "colour.bmp": colour,
        "colour.tiff": colour,
        "colour.webp": colour,
        "grey.pgm": grey,
        "colour.ppm": colour,
    }
    for name, picture in pictures.items():
        folder = root / ("images" if name.endswith(("png", "jpg", "jpeg")) else "foreign")
        folder.mkdir(exist_ok=True)
        assert cv2.imwrite(str(folder / name), picture), name


def _description(place: Place) -> None:
    from relocbench.datasets.core.dataset import Dataset
    from relocbench.datasets.inspect.summary import take_inventory

    take_inventory(Dataset(place.root / "ds"))


def _traversal(place: Place) -> None:
    from relocbench.datasets.core.layout import TraversalLayout
    from relocbench.datasets.core.traversal import Traversal

    traversal = Traversal(TraversalLayout(place.target.parent))
    for camera in traversal.cameras:
        traversal.camera(camera)
        traversal.T_rig_cam(camera)
        str(traversal.condition)


def _frames(place: Place) -> None:
    """All that a tracker is given."""
    from relocbench.datasets.core.layout import DatasetLayout
    from relocbench.datasets.core.traversal import Traversal

    for name, folder in (("summer", "ds"), ("winter", "ds"), ("summer", "sparse")):
        traversal = Traversal(DatasetLayout(place.root / folder).traversal(name))
        for time in traversal.timestamps(CAMERA):
            traversal.reference(CAMERA, time, neighbours=1)


def _poses(place: Place) -> None:
    from relocbench.datasets.core.traversal import read_poses

    read_poses(place.target)


def _pairs(place: Place) -> None:
    from relocbench.datasets.core.pair_table import read_pairs
    from relocbench.datasets.core.pairfile import distances_and_angles

    pairs = read_pairs(place.root / f"{PAIRS}.txt", place.root / f"{PAIRS}.csv")
    distances_and_angles(pairs)


def _pose_lines(place: Place) -> None:
    from relocbench.datasets.core.pairfile import read_pose_lines

    read_pose_lines(place.target, allow_non_finite=True)


def _manifest(place: Place) -> Iterable[str]:
    from relocbench.datasets.core import fingerprint
    from relocbench.datasets.core.layout import DatasetLayout

    layout = DatasetLayout(place.root / "ds")
    fingerprint.read_manifest(layout)
    return [str(fault) for fault in fingerprint.faults(layout)]


def _correspondences(place: Place) -> None:
    from relocbench.datasets.pairs.correspondence_file import read_correspondences

    found = read_correspondences(place.target)
    if len(found):
        read_correspondences(place.target, (int(found.ref_timestamp_ns[0]), int(found.query_timestamp_ns[0])))


def _points(place: Place) -> None:
    from relocbench.datasets.core.images import read_points

    read_points(place.target)


def _image(place: Place) -> None:
    from relocbench.datasets.core.images import read_image

    read_image(place.target)


def _depth(place: Place) -> None:
    from relocbench.datasets.core.images import read_depth, read_raw_depth

    read_depth(place.target)
    read_raw_depth(place.target, 1 / 5000)


def _validate(place: Place) -> Iterable[str]:
    from relocbench.datasets.checks.validation import validate_dataset
    from relocbench.progress import Silent

    found = validate_dataset(place.root / "ds", Silent())
    return [str(finding) for finding in (*found.faults, *found.notes)]


SEEDS = {"dataset": write_dataset, "images": write_images}
_WHOLE = ("ds/*.yaml", "ds/*.csv", "ds/pairs/*", "ds/traversals/**/*", "ds/correspondences/*")
PARSERS = (
    Parser("dataset.yaml", "dataset", ("ds/dataset.yaml",), _description, text=True),
    Parser("traversal.yaml", "dataset", ("ds/traversals/*/traversal.yaml",), _traversal, text=True),
    Parser("poses.csv", "dataset", ("ds/traversals/*/poses.csv",), _poses, text=True),
    Parser("pairs", "dataset", (f"{PAIRS}.txt", f"{PAIRS}.csv"), _pairs, text=True),
    Parser("pose-lines", "dataset", (f"ds/pairs/{ACROSS}.txt",), _pose_lines, text=True),
    Parser("manifest.csv", "dataset", ("ds/manifest.csv",), _manifest, text=True),
    Parser("correspondences", "dataset", ("ds/correspondences/*.parquet",), _correspondences),
    Parser("points.csv", "dataset", ("sparse/traversals/summer/points/*/*.csv",), _points, text=True),
    Parser("image", "images", ("images/*",), _image),
    Parser("depth", "images", ("images/deep.png",), _depth),
    Parser("frames", "dataset", ("*/traversals/*/*/*/*",), _frames, names=True),
    Parser("validate-dataset", "dataset", _WHOLE, _validate, names=True),
    Parser("validate-command", "dataset", _WHOLE, asks("validate", "{root}/ds"), names=True, brief=False),
    Parser("inspect-command", "dataset", _WHOLE, asks("inspect", "{root}/ds", "-q"), names=True, brief=False),
    Parser(
        "evaluate-command",
        "dataset",
        _WHOLE,
        asks("evaluate", "-d", "{root}/ds", "-m", "identity", "-o", "{out}/r", "-j", 1, "-q"),
        names=True,
        brief=False,
    ),
)
