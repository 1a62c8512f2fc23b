"""kapture folders that are exported: what the kapture package reads, numbers by hand, and back into a dataset."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from dataset_by_hand import make_dataset_by_hand
from small_dataset import ACROSS, CAMERA, WITHIN, make_small_dataset

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import Pair, PoseLine
from relocbench.datasets.core.schema import CameraEntry, TraversalFile
from relocbench.datasets.core.writer import DatasetWriter
from relocbench.datasets.importers.kapture import dataset as importer
from relocbench.datasets.importers.kapture.folder import read_folder
from relocbench.evaluation.tracking.absolute_poses import query_poses
from relocbench.evaluation.tracking.exports import export_poses, truth_lines
from relocbench.evaluation.tracking.kapture_export import export_kapture
from relocbench.execution import Run
from relocbench.geometry import Camera, apply, invert, make_transform, so3_exp
from relocbench.progress import Silent


@pytest.fixture(scope="module", params=[False, True], ids=["dense", "sparse"])
def dataset(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("kapture") / "small", sparse=request.param)


def disturbed(lines: list[PoseLine]) -> list[PoseLine]:
    fault = make_transform(so3_exp([0.01, 0.03, 0.0]), [0.05, 0.0, 0.02])
    return [PoseLine(*line.key, fault @ line.T_query_ref) for line in lines if line.T_query_ref is not None]


def test_the_tables_have_the_numbers_worked_out_by_hand(tmp_path: Path) -> None:
    """As in the test of the COLMAP model: at (1, 2, 3), looking along the world's x axis, t = -R c = (2, 3, -1)."""
    dataset = make_dataset_by_hand(tmp_path / "hand")
    (name,) = dataset.pair_set_names
    out = tmp_path / "out"
    assert export_kapture(dataset, name, truth_lines(dataset, name), out, Silent()) == 1
    for part, device_pose, image in (
        ("mapping", [5, 0.5, 0.5, -0.5, 0.5, 2, 3, -1], "map/cam0/5.png"),
        ("query", [5, 0.5, 0.5, -0.5, 0.5, 2, 3, -2], "drive/cam0/5.png"),
    ):
        version, form, line = (out / part / "sensors/trajectories.txt").read_text().splitlines()
        assert (version, form) == ("# kapture format: 1.1", "# timestamp, device_id, qw, qx, qy, qz, tx, ty, tz")
        time, device, *numbers = line.split(", ")
        assert device == CAMERA
        np.testing.assert_allclose([float(time), *map(float, numbers)], device_pose, atol=1e-12)
        sensors = (out / part / "sensors/sensors.txt").read_text().splitlines()
        assert sensors[2:] == ["cam0, , camera, PINHOLE, 8, 6, 10.0, 11.0, 4.0, 3.0"]
        assert (out / part / "sensors/records_camera.txt").read_text().splitlines()[2:] == [f"5, cam0, {image}"]
        assert (out / part / "sensors/records_data" / image).is_symlink()
    table = (out / "mapping/reconstruction/points3d.txt").read_text().splitlines()
    np.testing.assert_allclose(list(map(float, table[2].split(", "))), [3, 2, 3], atol=1e-12)
    assert (out / "pairs.txt").read_text().splitlines()[2:] == ["drive/cam0/5.png, map/cam0/5.png, 1"]


@pytest.mark.thorough
def test_the_kapture_package_reads_poses_images_and_depth_back(dataset: Dataset, tmp_path: Path) -> None:
    pytest.importorskip("kapture.io.csv", reason="the kapture package is not installed")
    pytest.importorskip("kapture.io.records", reason="the kapture package is not installed")
    pytest.importorskip("kapture.io.features", reason="the kapture package is not installed")
    kapture: Any = pytest.importorskip("kapture")
    lines = disturbed(truth_lines(dataset, ACROSS))
    assert export_kapture(dataset, ACROSS, lines, tmp_path, Silent()) == 4
    mapping, query = (kapture.io.csv.kapture_from_dir(str(tmp_path / part)) for part in ("mapping", "query"))
    drive = dataset.traversal("summer")
    expected = {t: drive.T_world_cam(CAMERA, t) for t in {p.ref_timestamp_ns for p in dataset.pair_set(ACROSS).pairs}}
    predicted = {p.query_timestamp_ns: p.T_world_query for p in query_poses(dataset, ACROSS, lines)}
    world = np.random.default_rng(0).uniform(-5, 5, (20, 3))
    for found, poses in ((mapping, expected), (query, predicted)):
        assert sorted(found.records_camera) == sorted(poses)
        for time, T_world_cam in poses.items():
            pose = found.trajectories[time, CAMERA]
            moved = pose.transform_points(world)
            np.testing.assert_allclose(moved, apply(invert(T_world_cam), world), atol=1e-9)
    camera = drive.camera(CAMERA)
    for found in (mapping, query):
        numbers = [camera.width, camera.height, camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5]
        np.testing.assert_allclose(found.sensors[CAMERA].camera_params, numbers, atol=1e-9)
    for time, T_world_cam in expected.items():
        image = mapping.records_camera[time, CAMERA]
        pixels = cv2.imread(kapture.io.records.get_image_fullpath(str(tmp_path / "mapping"), image), 0)
        np.testing.assert_array_equal(pixels, drive.image(CAMERA, time))
        depth = drive.depth(CAMERA, time)
        if depth is not None:
            name = mapping.records_depth[time, f"{CAMERA}_depth"]
            path = kapture.io.records.get_depth_map_fullpath(str(tmp_path / "mapping"), name)
            np.testing.assert_array_equal(kapture.io.records.depth_map_from_file(path, camera.size), depth)
            continue
        path = kapture.io.features.get_keypoints_fullpath("relocbench", str(tmp_path / "mapping"), image)
        keypoints = kapture.io.features.image_keypoints_from_file(path, mapping.keypoints["relocbench"].dtype, 2)
        rows = [(point, of["relocbench"][0]) for point, of in mapping.observations.items()]
        seen = {index: point for point, (name, index) in rows if name == image}
        assert sorted(seen) == list(range(len(keypoints)))
        in_world = mapping.points3d.as_array()[[seen[index] for index in range(len(keypoints))]]
        shown, _ = camera.project(apply(invert(T_world_cam), in_world))
        np.testing.assert_allclose(shown + 0.5, keypoints, atol=1e-9)


def relative_poses(dataset: Dataset, pair_set: str) -> list[Array]:
    return [p.T_query_ref for p in dataset.pair_set(pair_set).pairs if p.T_query_ref is not None]


def test_what_is_exported_is_imported_again(dataset: Dataset, tmp_path: Path) -> None:
    """Pairs, poses and depth are those of before."""
    (out,) = export_poses(dataset, [ACROSS], "kapture", tmp_path / "e", tmp_path, None)
    settings = importer.Options(pairs=out / "pairs.txt", min_track=1, correspondences=0)
    again = importer.build([out], settings, tmp_path / "again", Silent(), Run(1))
    first, second = relative_poses(dataset, ACROSS), relative_poses(again, "mapping__query__photo")
    assert len(first) == len(second)
    key = lambda T: tuple(np.round(T[:3, 3], 6))  # noqa: E731
    for before, after in zip(sorted(first, key=key), sorted(second, key=key), strict=True):
        np.testing.assert_allclose(before, after, atol=1e-8)
    drive, mapped = dataset.traversal("summer"), again.traversal("mapping")
    for time, name in mapped.names.items():
        stem = int(Path(name).stem)
        np.testing.assert_array_equal(mapped.image("photo", time), drive.image(CAMERA, stem))
        dense, dense_again = drive.depth(CAMERA, stem), mapped.depth("photo", time)
        assert (dense is None) == (dense_again is None)
        if dense is not None and dense_again is not None:
            np.testing.assert_array_equal(dense, dense_again)
        else:
            known, found = drive.points(CAMERA, stem), mapped.points("photo", time)
            assert known is not None
            assert found is not None
            np.testing.assert_allclose(found.uv, known.uv, atol=1e-6)
            np.testing.assert_allclose(found.inverse_depth, known.inverse_depth, rtol=1e-6)


def test_queries_without_answer_have_no_pose_and_frames_may_be_in_both_folders(
    dataset: Dataset, tmp_path: Path
) -> None:
    lines = truth_lines(dataset, ACROSS)
    times = sorted({line.query_timestamp_ns for line in lines})
    kept = [line for line in lines if line.query_timestamp_ns != times[0]]
    assert export_kapture(dataset, ACROSS, kept, tmp_path / "a", Silent()) == len(times) - 1
    folder = read_folder(tmp_path / "a" / "query")
    assert [record.timestamp for record in folder.images] == times
    assert [folder.T_device_world(CAMERA, time) is None for time in times] == [True, *[False] * (len(times) - 1)]
    export_kapture(dataset, WITHIN, truth_lines(dataset, WITHIN), tmp_path / "w", Silent())
    mapping, query = ({r.name for r in read_folder(tmp_path / "w" / part).images} for part in ("mapping", "query"))
    assert mapping & query


def test_images_with_cameras_of_their_own_have_sensors_of_their_own(tmp_path: Path) -> None:
    writer = DatasetWriter(tmp_path / "d", "d", {"kind": "d"})
    usual, other = Camera("pinhole", 8, 6, 10, 11, 3, 2), Camera("pinhole", 8, 6, 12, 12, 3, 2)
    poses = {time: make_transform(np.eye(3), [0.0, 0.0, 0.1 * time]) for time in (1, 2, 3)}
    for name in ("map", "drive"):
        writer.traversal(TraversalFile(name=name, cameras={CAMERA: CameraEntry.of(usual)}), poses)
        writer.intrinsics(name, CAMERA, {2: other})
        for time in poses:
            writer.image(name, CAMERA, time, np.zeros((6, 8), np.uint8))
            writer.depth(name, CAMERA, time, np.full((6, 8), 2.0))
    writer.pairs("map", "drive", CAMERA, [Pair(time, time, np.eye(4)) for time in poses])
    dataset = writer.finish({})
    (name,) = dataset.pair_set_names
    export_kapture(dataset, name, truth_lines(dataset, name), tmp_path / "out", Silent())
    folder = read_folder(tmp_path / "out" / "mapping")
    assert [record.device for record in folder.images] == ["cam0", "cam0_2", "cam0"]
    assert [folder.camera(record.device) for record in folder.images] == [usual, other, usual]
    depths = [folder.depth_of(record) for record in folder.images]
    assert [depth and depth.device for depth in depths] == ["cam0_depth", "cam0_2_depth", "cam0_depth"]
