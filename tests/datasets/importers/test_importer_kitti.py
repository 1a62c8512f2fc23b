"""KITTI odometry recordings become datasets."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import relocbench
from kitti_wall import BASELINE, CALIBRATION, FOCAL, write_kitti_recording
from refusals import ErrorData, Notes, assert_names, noted, refused

from relocbench.datasets.core import images
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.importers.kitti import dataset as kitti
from relocbench.datasets.importers.kitti.files import Calibration
from relocbench.datasets.pairs.correspondence_file import read_correspondences
from relocbench.datasets.sensors.stereo import StereoGeometry, stereo_depth
from relocbench.datasets.sensors.velodyne import hidden, project_scan, read_scan
from relocbench.errors import ConfigError, DatasetError
from relocbench.execution import Run
from relocbench.geometry import Camera, invert, rotation_angle


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Frames 2, 3, 4, 6 of sequence 03 move along the wall, frame 6 has no right image; frame 9 has no pose."""
    return write_kitti_recording(tmp_path / "recording")


def build(root: Path, out: Path, notes: Notes | None = None, workers: int = 1, **options: object) -> Dataset:
    settings = {"correspondences": 100, "max_disparity": 64, **options}
    return kitti.build([root], kitti.Options.model_validate(settings), out, notes or Notes(), Run(workers))


def test_frames_keep_their_numbers_times_and_poses(recording: Path, tmp_path: Path) -> None:
    notes = Notes()
    dataset = build(recording, tmp_path / "out", notes, pair_step=(1, 2))
    traversal = dataset.traversal("kitti_03")
    assert traversal.timestamps("image_0") == [200_000_000, 300_000_000, 400_000_000, 600_000_000]
    assert traversal.keyframe_timestamps("image_0") == [200_000_000, 300_000_000, 400_000_000]
    pairs = dataset.pair_set("kitti_03__kitti_03__image_0").pairs
    tenths = [(p.ref_timestamp_ns // 10**8, p.query_timestamp_ns // 10**8, p.group) for p in pairs]
    assert tenths == [(2, 3, "step_1"), (2, 4, "step_2"), (3, 4, "step_1"), (4, 6, "step_2")]
    for pair, step in zip(pairs, (1, 2, 1, 2), strict=True):
        assert pair.T_query_ref is not None
        np.testing.assert_allclose(pair.T_query_ref[:3, 3], [-0.2 * step, 0, 0], atol=2e-9)
    assert noted(notes.notes, "1 of 5", "000009.png")
    assert noted(notes.notes, "1 of 4")


def test_stereo_depth_of_a_wall_is_its_distance(recording: Path, tmp_path: Path) -> None:
    traversal = build(recording, tmp_path / "out").traversal("kitti_03")
    depth = traversal.depth("image_0", 200_000_000)
    assert depth is not None
    known = depth > 0
    assert known.mean() > 0.8
    # A quarter of a pixel in ten.
    assert np.median(np.abs(depth[known] - 5.0)) < 0.125


def test_correspondences_of_the_wall_shift_by_the_disparity_of_the_step(recording: Path, tmp_path: Path) -> None:
    dataset = build(recording, tmp_path / "out")
    path = dataset.layout.correspondence_file("kitti_03__kitti_03__image_0")
    rows = read_correspondences(path, (200_000_000, 300_000_000))
    assert len(rows) == 100
    shift = (rows.uv_query - rows.uv_ref)[rows.visible]
    np.testing.assert_allclose(np.median(shift, axis=0), [-FOCAL * 0.2 / 5.0, 0], atol=0.2)


def test_images_are_links_unless_copies_are_asked_for(recording: Path, tmp_path: Path) -> None:
    linked = build(recording, tmp_path / "a").traversal("kitti_03").layout.image("image_0", 200_000_000)
    copied = build(recording, tmp_path / "b", copy_images=True).traversal("kitti_03")
    assert linked.resolve() == recording / "sequences" / "03" / "image_0" / "000002.png"
    assert not copied.layout.image("image_0", 200_000_000).is_symlink()


@pytest.mark.thorough
def test_workers_do_not_change_the_bytes(recording: Path, tmp_path: Path) -> None:
    assert build(recording, tmp_path / "a").fingerprint == build(recording, tmp_path / "b", workers=2).fingerprint


def test_a_folder_with_something_else_is_left_alone(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "thesis"
    out.mkdir()
    (out / "chapter.tex").write_text("years of work")
    with refused(DatasetError, out, None, "something else"):
        build(recording, out)
    assert [p.name for p in out.iterdir()] == ["chapter.tex"]


def test_the_recording_is_not_touched(recording: Path, tmp_path: Path) -> None:
    def state() -> list[tuple[str, int, int]]:
        return [(str(p), p.stat().st_size, p.stat().st_mtime_ns) for p in sorted(recording.rglob("*"))]

    before = state()
    build(recording, tmp_path / "out")
    told = relocbench("build-dataset", "kitti", recording, "--out", recording / "out")
    assert told.status == 2
    assert_names(told.complaint, recording / "out")
    assert state() == before


def replace_line(path: Path, number: int, line: str | None) -> None:
    """Put ``line`` in place of the 1-based line, or take it out."""
    lines = path.read_text().splitlines()
    lines[number - 1 : number] = [] if line is None else [line]
    path.write_text("\n".join(lines) + "\n")


def test_a_missing_calibration_line_is_named(recording: Path, tmp_path: Path) -> None:
    replace_line(recording / "sequences/03/calib.txt", 2, None)
    with refused(DatasetError, "calib.txt", None, "P1:"):
        build(recording, tmp_path / "out")


def test_a_line_of_the_calibration_too_many_or_without_a_focal_length_is_named(recording: Path, tmp_path: Path) -> None:
    path = recording / "sequences/03/calib.txt"
    replace_line(path, 1, "P0: 0 0 1 0 0 0 1 0 0 0 1 0")
    with refused(DatasetError, path, None, "P0:", "projection"):
        build(recording, tmp_path / "out")
    path.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 6)
    with refused(DatasetError, path, 6, "at most"):
        build(recording, tmp_path / "out")


def test_what_stereo_depth_lacks_is_named(recording: Path, tmp_path: Path) -> None:
    path = recording / "sequences/03/calib.txt"
    first, second, *_ = path.read_text().splitlines()
    replace_line(path, 1, second.replace("P1", "P0"))
    replace_line(path, 2, first.replace("P0", "P1"))
    with refused(DatasetError, path, None, "right camera"):
        build(recording, tmp_path / "out")
    shutil.rmtree(recording / "sequences/03/image_1")
    for depth in ("auto", "stereo"):
        with refused(DatasetError, "sequences/03", None, "image_1"):
            build(recording, tmp_path / "out", depth=depth)


def test_what_a_sequence_lacks_is_named(recording: Path, tmp_path: Path) -> None:
    (recording / "poses/03.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    with refused(DatasetError, "poses/03.txt", None, "1 rows", "10 rows"):
        build(recording, tmp_path / "out")
    for path in (recording / "sequences/03/image_0").iterdir():
        path.unlink()
    with refused(DatasetError, "image_0", None, "no images"):
        build(recording, tmp_path / "out")
    (recording / "sequences/04").mkdir()
    with refused(ConfigError, "", None, "--sequence", "03, 04"):
        build(recording, tmp_path / "out")
    with refused(ConfigError, "", None, "one folder", "got 2"):
        kitti.build([recording] * 2, kitti.Options(), tmp_path / "out", Notes(), Run(1))


def test_a_missing_lidar_calibration_is_named(recording: Path, tmp_path: Path) -> None:
    replace_line(recording / "sequences/03/calib.txt", 3, None)
    scans = recording / "sequences/03/velodyne"
    scans.mkdir()
    (scans / "000002.bin").write_bytes(np.array([[5, 0, 0, 0]], dtype="<f4").tobytes())
    with refused(DatasetError, "calib.txt", None, "Tr:"):
        build(recording, tmp_path / "out", depth="velodyne")


def test_a_calibration_without_names_is_read_in_order(recording: Path, tmp_path: Path) -> None:
    path = recording / "sequences/03/calib.txt"
    lines = [line.split(": ")[1] for line in CALIBRATION.splitlines()]
    path.write_text("\n".join(lines[:2]) + "\n")
    assert build(recording, tmp_path / "out").traversal("kitti_03").camera("image_0").fx == FOCAL


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("1 0 0 0 0 1 0 0 0 0 1", ("03.txt", 3, "12 numbers", "found 11")),
        ("1 0 0 0 0 1 0 0 0 0 2 0", ("03.txt", 3, "3x3")),
        ("1 0 0 0 0 one 0 0 0 0 1 0", ("03.txt", 3, "one", "r22")),
    ],
)
def test_a_bad_pose_is_named_with_its_line(recording: Path, tmp_path: Path, line: str, said: ErrorData) -> None:
    replace_line(recording / "poses/03.txt", 3, line)
    with refused(DatasetError, *said):
        build(recording, tmp_path / "out")


@pytest.mark.parametrize("folder", ["image_0", "image_1"])
def test_a_truncated_image_is_named(recording: Path, tmp_path: Path, folder: str) -> None:
    path = recording / "sequences/03" / folder / "000003.png"
    path.write_bytes(path.read_bytes()[:-100])
    with refused(DatasetError, f"{folder}/000003.png", None, "truncated"):
        build(recording, tmp_path / "out")


def test_missing_poses_are_named(recording: Path, tmp_path: Path) -> None:
    (recording / "poses/03.txt").unlink()
    with refused(DatasetError, "poses/03.txt", None, "missing", "03"):
        build(recording, tmp_path / "out")


def test_missing_times_are_said_and_replaced_by_the_rate(recording: Path, tmp_path: Path) -> None:
    (recording / "sequences/03/times.txt").unlink()
    notes = Notes()
    dataset = build(recording, tmp_path / "out", notes, rate_hz=5.0)
    assert dataset.traversal("kitti_03").timestamps("image_0")[0] == 400_000_000
    assert noted(notes.notes, "times.txt", "5")


def test_times_that_go_back_are_named(recording: Path, tmp_path: Path) -> None:
    replace_line(recording / "sequences/03/times.txt", 4, "1.0e-01")
    with refused(DatasetError, "times.txt", 4, "1.0e-01"):
        build(recording, tmp_path / "out")


def test_options_that_give_no_pair_leave_no_folder_behind(recording: Path, tmp_path: Path) -> None:
    with refused(DatasetError, "sequences/03", None, "+1", "--pair-step 1"):
        build(recording, tmp_path / "out", pair_step=(7,))
    assert not (tmp_path / "out").exists()


def test_stereo_depth_of_a_right_camera_is_refused(recording: Path, tmp_path: Path) -> None:
    with refused(ConfigError, "", None, "left"):
        build(recording, tmp_path / "out", camera="image_1", depth="stereo")


def test_the_second_camera_stands_a_baseline_to_the_right(recording: Path) -> None:
    calibration = Calibration.read(recording / "sequences/03/calib.txt")
    np.testing.assert_allclose(calibration.T_cam0_cam("image_1")[:3, 3], [BASELINE, 0, 0], atol=1e-12)


def test_two_sequences_are_paired_across(recording: Path, tmp_path: Path) -> None:
    shutil.copytree(recording / "sequences/03", recording / "sequences/04")
    shutil.copy(recording / "poses/03.txt", recording / "poses/04.txt")
    notes = Notes()
    dataset = build(recording, tmp_path / "out", notes, sequence=("03", "04"))
    assert dataset.pair_set_names == ["kitti_03__kitti_04__image_0"]
    assert noted(notes.notes, "kitti_03", "kitti_04")
    pairs = dataset.pair_set("kitti_03__kitti_04__image_0").pairs
    assert [p.distance_m for p in pairs] == pytest.approx([0, 0, 0, 0.4], abs=1e-9)


def test_a_lidar_point_seen_through_a_nearer_surface_is_hidden() -> None:
    nearest = np.full((60, 60), np.inf, dtype=np.float32)
    nearest[::4, ::3] = 5.0
    nearest[30, 31] = 20.0
    assert np.argwhere(hidden(nearest)).tolist() == [[30, 31]]


def test_a_road_does_not_hide_itself() -> None:
    nearest = np.full((120, 60), np.inf, dtype=np.float32)
    rows = np.arange(10, 120, 5)
    nearest[rows, ::3] = (150.0 / rows)[:, None]
    assert not hidden(nearest).any()


def test_half_a_scan_is_named(tmp_path: Path) -> None:
    path = tmp_path / "000000.bin"
    path.write_bytes(b"\0" * 30)
    with refused(DatasetError, "000000.bin", None, "30"):
        read_scan(path)


def test_real_lidar_and_stereo_agree(real_data: Callable[[str], Path]) -> None:
    folder = real_data("kitti_odometry") / "sequences" / "00"
    calibration = Calibration.read(folder / "calib.txt")
    left, right = (images.read_image(folder / c / "000000.png") for c in ("image_0", "image_1"))
    p0, p1 = calibration.projection("image_0"), calibration.projection("image_1")
    geometry = StereoGeometry(p0[0, 3] - p1[0, 3])
    camera = Camera("pinhole", left.shape[1], left.shape[0], p0[0, 0], p0[1, 1], p0[0, 2], p0[1, 2])
    stereo = stereo_depth(left, right, geometry)
    scan = read_scan(folder / "velodyne" / "000000.bin")
    lidar = project_scan(scan, camera, calibration.T_cam0_lidar())
    both = (stereo > 0) & (lidar > 0)
    error = np.abs(geometry.focal_baseline / stereo[both] - geometry.focal_baseline / lidar[both])
    assert both.sum() > 10_000
    # The data's description gives a median of 0.42 px and 88 % below 2 px before hidden points are removed.
    assert np.median(error) < 0.5
    assert np.mean(error < 2) > 0.90


@pytest.mark.thorough
def test_real_stereo_depth_carries_pose_estimation_to_centimetres(
    real_data: Callable[[str], Path], tmp_path: Path
) -> None:
    notes = Notes()
    dataset = build(real_data("kitti_odometry"), tmp_path / "out", notes, sequence=("06",), max_disparity=128)
    assert noted(notes.notes, "20 of 25")
    pair_set = dataset.pair_sets()[0]
    assert len(pair_set.pairs) == 5
    sift = cv2.SIFT.create(3000)
    errors = []
    for pair in pair_set.pairs:
        reference, query = dataset.reference(pair_set, pair), dataset.query(pair_set, pair)
        assert reference.depth is not None
        assert pair.T_query_ref is not None
        assert pair.distance_m == pytest.approx(1.2, abs=0.05)
        keys, described = zip(*(sift.detectAndCompute(i, None) for i in (reference.image, query.image)), strict=True)
        matches = [
            m for m, n in cv2.BFMatcher().knnMatch(described[0], described[1], k=2) if m.distance < 0.8 * n.distance
        ]
        uv = np.array([keys[0][m.queryIdx].pt for m in matches])
        seen = np.array([keys[1][m.trainIdx].pt for m in matches])
        z = reference.depth[tuple(np.rint(uv[:, ::-1]).astype(int).T)].astype(np.float64)
        near = (z > 0) & (z < 40)
        points = reference.camera.unproject(uv)[0] * z[:, None]
        k = reference.camera.matrix
        found = cv2.solvePnPRansac(points[near], seen[near], k, None, reprojectionError=2, iterationsCount=500)
        inliers = found[3][:, 0]
        r, t = cv2.solvePnPRefineLM(points[near][inliers], seen[near][inliers], k, None, found[1], found[2])
        estimate = np.eye(4)
        estimate[:3, :3], estimate[:3, 3] = cv2.Rodrigues(r)[0], t[:, 0]
        delta = pair.T_query_ref @ invert(estimate)
        errors.append((np.linalg.norm(delta[:3, 3]), np.degrees(rotation_angle(delta[:3, :3]))))
    # The data's description gives 1 to 2 cm and below 0.1 degrees one frame on.
    assert np.mean(errors, axis=0)[0] < 0.03
    assert np.mean(errors, axis=0)[1] < 0.1


def test_a_real_sequence_without_poses_names_the_file(real_data: Callable[[str], Path], tmp_path: Path) -> None:
    with refused(DatasetError, "poses/00.txt"):
        build(real_data("kitti_odometry"), tmp_path / "out", sequence=("00",))
