"""Exports: what evo reads back, COLMAP numbers by hand, submissions byte by byte."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
from dataset_by_hand import make_dataset_by_hand
from evo.tools import file_interface
from refusals import refused
from small_dataset import ACROSS, CAMERA, WITHIN, make_small_dataset

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import PoseLine, read_pose_lines, write_pose_lines
from relocbench.errors import PredictionError
from relocbench.evaluation.common.results import DatasetResults
from relocbench.evaluation.tracking.absolute_poses import query_poses
from relocbench.evaluation.tracking.colmap_export import colmap_camera, export_colmap
from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods
from relocbench.evaluation.tracking.exports import export_kitti, export_mlad, export_poses, export_tum, truth_lines
from relocbench.geometry import Camera, invert, make_transform, rotation_angle, so3_exp
from relocbench.progress import Silent


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("exports") / "small", sparse=True)


def true_poses(dataset: Dataset, traversal: str) -> dict[int, Array]:
    return {t: dataset.traversal(traversal).T_world_cam(CAMERA, t) for t in dataset.traversal(traversal).poses}


def disturbed(lines: list[PoseLine]) -> list[PoseLine]:
    fault = make_transform(so3_exp([0.0, 0.03, 0.0]), [0.05, 0.0, 0.0])
    return [PoseLine(*line.key, fault @ line.T_query_ref) for line in lines if line.T_query_ref is not None]


def test_absolute_poses_of_the_truth_are_the_poses_of_the_query_traversal(dataset: Dataset) -> None:
    truth = true_poses(dataset, "winter")
    poses = query_poses(dataset, ACROSS, truth_lines(dataset, ACROSS))
    assert [p.query_timestamp_ns for p in poses] == sorted(truth)
    for pose in poses:
        np.testing.assert_allclose(pose.T_world_query, truth[pose.query_timestamp_ns], atol=2e-8)


def test_an_error_of_the_prediction_appears_in_the_querys_own_frame(dataset: Dataset) -> None:
    """T_world_query = T_world_ref inv(F T_query_ref) = (true T_world_query) inv(F)."""
    truth = true_poses(dataset, "winter")
    lines = truth_lines(dataset, ACROSS)
    fault = make_transform(so3_exp([0.0, 0.03, 0.0]), [0.05, 0.0, 0.0])
    for pose in query_poses(dataset, ACROSS, disturbed(lines)):
        np.testing.assert_allclose(pose.T_world_query, truth[pose.query_timestamp_ns] @ invert(fault), atol=2e-8)


def test_of_several_answers_for_one_query_the_nearest_keyframes_is_taken(dataset: Dataset) -> None:
    lines = truth_lines(dataset, ACROSS)
    query = max(line.query_timestamp_ns for line in lines)
    answers = [line for line in lines if line.query_timestamp_ns == query]
    assert len(answers) == 2
    nearest = min(answers, key=lambda line: float(np.linalg.norm(line.T_query_ref[:3, 3])))  # type: ignore[index]
    for order in (answers, answers[::-1]):
        (pose,) = query_poses(dataset, ACROSS, order)
        assert pose.ref_timestamp_ns == nearest.ref_timestamp_ns


def test_evo_reads_the_tum_file_back_to_the_same_trajectory(dataset: Dataset, tmp_path: Path) -> None:
    truth = true_poses(dataset, "winter")
    assert export_tum(dataset, ACROSS, truth_lines(dataset, ACROSS), tmp_path / "t.txt") == len(truth)
    trajectory = file_interface.read_tum_trajectory_file(str(tmp_path / "t.txt"))
    np.testing.assert_allclose(trajectory.timestamps, np.array(sorted(truth)) * 1e-9, atol=3e-7)
    for pose, time in zip(trajectory.poses_se3, sorted(truth), strict=True):
        np.testing.assert_allclose(pose, truth[time], atol=2e-8)


def test_tum_times_are_exact_to_the_nanosecond(dataset: Dataset, tmp_path: Path) -> None:
    export_tum(dataset, ACROSS, truth_lines(dataset, ACROSS), tmp_path / "t.txt")
    stamps = [line.split()[0] for line in (tmp_path / "t.txt").read_text().splitlines()]
    assert [int(s.replace(".", "")) for s in stamps] == sorted(true_poses(dataset, "winter"))
    assert all(len(s.split(".")[1]) == 9 for s in stamps)


def test_evo_reads_the_kitti_file_back_and_its_times_lie_beside_it(dataset: Dataset, tmp_path: Path) -> None:
    truth = true_poses(dataset, "winter")
    export_kitti(dataset, ACROSS, truth_lines(dataset, ACROSS), tmp_path / "k.txt")
    path = file_interface.read_kitti_poses_file(str(tmp_path / "k.txt"))
    for pose, time in zip(path.poses_se3, sorted(truth), strict=True):
        np.testing.assert_allclose(pose, truth[time], atol=2e-8)
    assert len((tmp_path / "k.times.txt").read_text().splitlines()) == len(truth)


@pytest.fixture
def by_hand(tmp_path: Path) -> Dataset:
    return make_dataset_by_hand(tmp_path / "hand")


def test_colmap_model_has_the_numbers_worked_out_by_hand(by_hand: Dataset, tmp_path: Path) -> None:
    """cam_from_world R = inverse of [x right = -y, y down = -z, z forward = x] is the quaternion (w x y z) =
    (.5, .5, -.5, .5); t = -R c: the map at (1, 2, 3) has t = (2, 3, -1). The point 2 m ahead of the keyframe is at
    (3, 2, 3); the one of 4 m at pixel +2 is 0.8 m to the right, at (5, 1.2, 3)."""
    name = by_hand.pair_set_names[0]
    out = tmp_path / "model"
    assert export_colmap(by_hand, name, truth_lines(by_hand, name), out) == 1
    assert (out / "cameras.txt").read_text() == "1 PINHOLE 8 6 10.0 11.0 4.0 3.0\n"
    key_line, key_points, query_line, query_points = (out / "images.txt").read_text().splitlines()
    for line, image_id, t, image in (
        (key_line, 1, [2, 3, -1], "map/images/cam0/5.png"),
        (query_line, 2, [2, 3, -2], "drive/images/cam0/5.png"),
    ):
        fields = line.split()
        assert int(fields[0]) == image_id
        np.testing.assert_allclose([float(f) for f in fields[1:5]], [0.5, 0.5, -0.5, 0.5], atol=1e-12)
        np.testing.assert_allclose([float(f) for f in fields[5:8]], t, atol=1e-12)
        assert fields[8:] == ["1", image]
    assert key_points == "4.0 3.0 1 6.0 3.0 2"
    assert query_points == ""
    first, second = ([float(f) for f in s.split()] for s in (out / "points3D.txt").read_text().splitlines())
    np.testing.assert_allclose(first, [1, 3, 2, 3, 128, 128, 128, 0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(second, [2, 5, 1.2, 3, 128, 128, 128, 0, 1, 1], atol=1e-12)


def test_colmap_points_project_to_their_pixels_by_colmaps_own_convention(dataset: Dataset, tmp_path: Path) -> None:
    """Everything from the written text: x = K (R X + t), with half-pixel centres throughout."""
    export_colmap(dataset, ACROSS, truth_lines(dataset, ACROSS), tmp_path)
    fx, fy, cx, cy = (float(f) for f in (tmp_path / "cameras.txt").read_text().split()[4:])
    in_world = {}
    for line in (tmp_path / "points3D.txt").read_text().splitlines():
        in_world[int(line.split()[0])] = np.array([float(f) for f in line.split()[1:4]])
    lines = (tmp_path / "images.txt").read_text().splitlines()
    seen = 0
    for pose, points in zip(lines[0::2], lines[1::2], strict=True):
        w, x, y, z, *t = (float(f) for f in pose.split()[1:8])
        rotation = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        for u, v, point_id in np.array(points.split(), dtype=float).reshape(-1, 3):
            p = rotation @ in_world[int(point_id)] + t
            np.testing.assert_allclose([fx * p[0] / p[2] + cx, fy * p[1] / p[2] + cy], [u, v], atol=1e-9)
            seen += 1
    assert seen == len(in_world) > 100


def test_dense_keyframes_leave_points_empty(tmp_path: Path) -> None:
    dense = make_small_dataset(tmp_path / "dense", frames=2)
    export_colmap(dense, WITHIN, truth_lines(dense, WITHIN), tmp_path / "model")
    assert (tmp_path / "model" / "points3D.txt").read_text() == ""
    names = [line.split()[-1] for line in (tmp_path / "model" / "images.txt").read_text().splitlines()[0::2]]
    assert len(names) == len(set(names)) == 2


@pytest.mark.parametrize(
    ("camera", "expected"),
    [
        (Camera("pinhole", 8, 6, 10, 11, 3, 2), "PINHOLE 8 6 10.0 11.0 3.5 2.5"),
        (Camera("radtan", 8, 6, 10, 11, 3, 2, (0.1, 0.2, 0.3, 0.4)), "OPENCV 8 6 10.0 11.0 3.5 2.5 0.1 0.2 0.3 0.4"),
        (
            Camera("radtan", 8, 6, 10, 11, 3, 2, (0.1, 0.2, 0.3, 0.4, 0.5)),
            "FULL_OPENCV 8 6 10.0 11.0 3.5 2.5 0.1 0.2 0.3 0.4 0.5 0.0 0.0 0.0",
        ),
        (
            Camera("equidistant", 8, 6, 10, 11, 3, 2, (0.1, 0.2, 0.3, 0.4)),
            "OPENCV_FISHEYE 8 6 10.0 11.0 3.5 2.5 0.1 0.2 0.3 0.4",
        ),
    ],
)
def test_cameras_have_colmaps_names_and_centres(camera: Camera, expected: str) -> None:
    assert colmap_camera(camera) == expected


def test_mlad_zip_has_one_text_a_pair_set_in_its_root_and_the_same_bytes_each_time(
    dataset: Dataset, tmp_path: Path
) -> None:
    predictions = {name: truth_lines(dataset, name) for name in (WITHIN, ACROSS)}
    count = export_mlad(dataset, predictions, tmp_path / "a.zip")
    assert count == sum(map(len, predictions.values()))
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        assert archive.namelist() == sorted(f"{name}.txt" for name in predictions)
        archive.extractall(tmp_path / "out")
        assert all(info.date_time == (1980, 1, 1, 0, 0, 0) for info in archive.infolist())
    back = read_pose_lines(tmp_path / "out" / f"{ACROSS}.txt")
    assert [line.key for line in back] == [line.key for line in predictions[ACROSS]]
    for line, given in zip(back, predictions[ACROSS], strict=True):
        assert line.T_query_ref is not None
        assert given.T_query_ref is not None
        np.testing.assert_array_equal(line.T_query_ref[:3, 3], given.T_query_ref[:3, 3])
        assert rotation_angle(line.T_query_ref[:3, :3].T @ given.T_query_ref[:3, :3]) < 1e-12
    export_mlad(dataset, dict(reversed(predictions.items())), tmp_path / "b.zip")
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()


def test_mlad_zip_takes_names_and_order_from_the_challenges_files(dataset: Dataset, tmp_path: Path) -> None:
    lines = truth_lines(dataset, ACROSS)
    asked = [PoseLine(*line.key, None) for line in reversed(lines)]
    files = [tmp_path / "relocalizationFile_A_easy.txt", tmp_path / "relocalizationFile_A_hard.txt"]
    write_pose_lines(files[0], asked[:3])
    write_pose_lines(files[1], asked[3:])
    assert export_mlad(dataset, {ACROSS: lines[1:]}, tmp_path / "s.zip", files) == len(lines) - 1
    with zipfile.ZipFile(tmp_path / "s.zip") as archive:
        assert archive.namelist() == [f.name for f in files]
        texts = [archive.read(f.name).decode().splitlines() for f in files]
    keys = [tuple(map(int, s.split()[:2])) for text in texts for s in text]
    assert keys == [line.key for line in asked if line.key != lines[0].key]


def test_pairs_outside_the_set_are_refused(dataset: Dataset, tmp_path: Path) -> None:
    with refused(PredictionError, "", None, "1 2"):
        export_tum(dataset, ACROSS, [PoseLine(1, 2, np.eye(4))], tmp_path / "t.txt")
    with refused(PredictionError, "", None, "1 2"):
        export_mlad(dataset, {ACROSS: [PoseLine(1, 2, np.eye(4))]}, tmp_path / "t.zip")
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_exported_from_no_pose(dataset: Dataset, tmp_path: Path) -> None:
    failed = [PoseLine(*line.key, None) for line in truth_lines(dataset, ACROSS)]
    with refused(PredictionError, "", None, ACROSS):
        export_tum(dataset, ACROSS, failed, tmp_path / "t.txt")


def test_ground_truth_and_predictions_are_exported_by_name(dataset: Dataset, tmp_path: Path) -> None:
    results = tmp_path / "results"
    options = EvaluateOptions(dataset=dataset.root, methods=("s=trackers_for_tests:Shift",), out=results, workers=0)
    report = evaluate_methods(options, Silent())
    written = export_poses(dataset, [ACROSS, WITHIN], "tum", tmp_path / "truth", results, None)
    assert [p.name for p in written] == [f"{ACROSS}.txt", f"{WITHIN}.txt"]
    (answers,) = export_poses(dataset, [ACROSS], "tum", tmp_path / "s", results, "s")
    predicted = read_pose_lines(DatasetResults(report.results).method("s").predictions(ACROSS))
    export_tum(dataset, ACROSS, predicted, tmp_path / "direct.txt")
    assert answers.read_bytes() == (tmp_path / "direct.txt").read_bytes() != written[0].read_bytes()
    (model,) = export_poses(dataset, [ACROSS], "colmap", tmp_path / "c", results, "s")
    assert sorted(p.name for p in model.iterdir()) == ["cameras.txt", "images.txt", "points3D.txt"]
    with refused(PredictionError, "", None, "dso"):
        export_poses(dataset, [ACROSS], "tum", tmp_path / "x", results, "dso")


def test_withheld_truth_is_not_exported(tmp_path: Path) -> None:
    withheld = make_small_dataset(tmp_path / "withheld", frames=2, truth=False)
    with refused(PredictionError, "", None, ACROSS, "withheld"):
        export_poses(withheld, [ACROSS], "mlad", tmp_path / "s.zip", tmp_path, None)
