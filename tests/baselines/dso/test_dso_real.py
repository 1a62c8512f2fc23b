"""The DSO trackers on recordings: KITTI odometry with stereo depth, TUM RGB-D with its depth camera."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from baselines.dso import Dso, DsoMultiStart
from relocbench.arrays import Array, Image
from relocbench.geometry import Camera, compose, invert, rotation_angle, transform_from_tq
from relocbench.tracking import Query, Reference

Pair = tuple[Reference, Query, Array]
RealData = Callable[[str], Path]

pytestmark = pytest.mark.thorough

KITTI_FOCAL_LENGTH, KITTI_BASELINE_TIMES_FOCAL_LENGTH = 707.0912, 379.8145  # calib.txt of sequence 06
STEREO_FRAMES = (20, 25, 30, 35, 40)
LAST_FRAME = 44
TUM_FREIBURG1 = Camera(
    "radtan", 640, 480, 517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)
)  # as published with the benchmark


def grey(path: Path) -> Image:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert image is not None, path
    return image.astype(np.uint8)


def kitti_reference(sequence: Path, frame: int) -> Reference:
    left, right = (grey(sequence / f"image_{side}" / f"{frame:06d}.png") for side in (0, 1))
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=128,
        blockSize=5,
        P1=8 * 25,
        P2=32 * 25,
        disp12MaxDiff=1,
        uniquenessRatio=10,
        speckleWindowSize=100,
        speckleRange=2,
    )
    disparity = matcher.compute(left, right).astype(np.float32) / 16
    depth = np.zeros_like(disparity, dtype=np.float32)
    known = disparity > 1
    depth[known] = KITTI_BASELINE_TIMES_FOCAL_LENGTH / disparity[known]
    half_pixel = 0.5 / KITTI_BASELINE_TIMES_FOCAL_LENGTH
    return Reference(str(frame), frame, left, kitti_camera(left), depth=depth, depth_sigma=(0.0, 0.0, half_pixel))


def kitti_camera(image: Image) -> Camera:
    height, width = image.shape
    return Camera("pinhole", width, height, KITTI_FOCAL_LENGTH, KITTI_FOCAL_LENGTH, 601.8873, 183.1104)


def kitti_pairs(root: Path, step: int) -> Iterator[Pair]:
    """Keyframe, query ``step`` frames (1.2 m each) later, T_query_ref."""
    sequence = root / "sequences" / "06"
    rows = np.loadtxt(root / "poses" / "06.txt").reshape(-1, 3, 4)
    poses = np.concatenate([rows, np.broadcast_to([[[0.0, 0.0, 0.0, 1.0]]], (len(rows), 1, 4))], axis=1)
    for frame in STEREO_FRAMES:
        if frame + step > LAST_FRAME:
            continue
        image = grey(sequence / "image_0" / f"{frame + step:06d}.png")
        query = Query(str(frame + step), frame + step, image, kitti_camera(image))
        yield kitti_reference(sequence, frame), query, invert(poses[frame + step]) @ poses[frame]


def tum_pairs(root: Path, step: int) -> Iterator[Pair]:
    """Undistorted pairs of freiburg1_xyz; the files are named by the time of their ground-truth row."""
    folder = root / "rgbd_dataset_freiburg1_xyz"
    truth = np.loadtxt(folder / "groundtruth.txt")
    u, v = TUM_FREIBURG1.undistortion_map()
    pinhole = TUM_FREIBURG1.pinhole()
    images, depths, poses = [], [], []
    for path in sorted((folder / "rgb").glob("*.png")):
        raw = cv2.imread(str(folder / "depth" / path.name), cv2.IMREAD_UNCHANGED)
        assert raw is not None
        images.append(cv2.remap(grey(path), u, v, cv2.INTER_LINEAR).astype(np.uint8))
        # Nearest, not linear: between two depths across an edge there is no surface.
        depths.append(cv2.remap(raw.astype(np.float32) / 5000, u, v, cv2.INTER_NEAREST).astype(np.float32))
        row = truth[np.argmin(np.abs(truth[:, 0] - float(path.stem)))]
        poses.append(transform_from_tq(row[1:4], row[4:8]))
    assert len(images) == 10
    for first in range(len(images) - step):
        second = first + step
        reference = Reference(
            str(first), first, images[first], pinhole, depth=depths[first], depth_sigma=(0, 0, 0.0025)
        )
        yield reference, Query(str(second), second, images[second], pinhole), invert(poses[second]) @ poses[first]


def errors(tracker: Dso, pairs: Iterator[Pair], from_truth: bool = False) -> Array:
    """(N, 2) metres between camera centres and degrees; infinite where there is no answer."""
    out = []
    for reference, query, truth in pairs:
        result = tracker.track(tracker.prepare(reference), query, truth if from_truth else None)
        if result.T_query_ref is None:
            out.append((np.inf, np.inf))
            continue
        centre = invert(result.T_query_ref)[:3, 3] - invert(truth)[:3, 3]
        delta = compose(result.T_query_ref, invert(truth))
        out.append((float(np.linalg.norm(centre)), float(np.rad2deg(rotation_angle(delta[:3, :3])))))
    return np.array(out)


def test_kitti_from_the_identity_at_2_4_metres(real_data: RealData) -> None:
    found = errors(Dso(), kitti_pairs(real_data("kitti_odometry"), 2))
    assert len(found) == 5
    metres, degrees = np.median(found, axis=0)
    assert metres <= 0.05
    assert degrees <= 0.1


def test_kitti_stays_at_the_truth_when_started_9_6_metres_away(real_data: RealData) -> None:
    found = errors(Dso(), kitti_pairs(real_data("kitti_odometry"), 8), from_truth=True)
    assert found[:, 0].max() <= 0.35
    assert np.median(found[:, 1]) <= 0.15


def test_kitti_one_start_does_not_bridge_4_8_metres_and_several_do(real_data: RealData) -> None:
    alone = errors(Dso(), kitti_pairs(real_data("kitti_odometry"), 4))
    several = errors(DsoMultiStart(), kitti_pairs(real_data("kitti_odometry"), 4))
    assert np.median(alone[:, 0]) > 1
    assert np.median(several[:, 0]) <= 0.15


def test_tum_desk_from_the_identity(real_data: RealData) -> None:
    found = errors(Dso(), tum_pairs(real_data("tum_rgbd"), 4))
    assert len(found) == 6
    metres, degrees = np.median(found, axis=0)
    assert metres <= 0.015
    assert degrees <= 0.6
