"""kapture folders: rigs in rigs, parts of poses, depth maps, points, lists, and every fault with its file and line."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from command_line import relocbench
from refusals import Notes, assert_names, refused
from scipy.spatial.transform import Rotation
from small_dataset import photograph, render, small_pose

from relocbench.arrays import Array
from relocbench.datasets.checks.validation import validate_dataset
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.importers.kapture import dataset as importer
from relocbench.datasets.importers.kapture.depth import read_depth_map, seen_by
from relocbench.datasets.importers.kapture.folder import KaptureFolder, read_folder
from relocbench.errors import ConfigError, DatasetError
from relocbench.execution import Run
from relocbench.geometry import Camera, apply, invert, make_transform, so3_exp
from relocbench.progress import Silent

LEFT = Camera("pinhole", 192, 144, 150.0, 152.0, 96.5, 70.25)
HALF = LEFT.scaled(0.5)
RIGHT = Camera("radtan", 200, 150, 160.0, 158.0, 99.0, 75.0, (-0.12, 0.02, 0.001, -0.0005))
PHONE = Camera("radtan", 176, 132, 130.0, 130.0, 88.0, 66.0, (-0.05, 0.0, 0.0, 0.0))
T_car_mast = make_transform(so3_exp([0.02, 0.05, -0.01]), [0.1, -0.3, 0.2])
T_mast_left = make_transform(so3_exp([0.0, 0.02, 0.0]), [-0.2, 0.0, 0.05])
T_mast_right = make_transform(so3_exp([0.0, -0.03, 0.01]), [0.2, 0.01, 0.0])
MOUNTS = {"left": (T_mast_left, LEFT), "right": (T_mast_right, RIGHT)}
TIMES = (10, 20, 30)
SENSORS = f"""# kapture format: 1.1
# sensor_id, name, sensor_type, [sensor_params]+

left, Basler A, camera, PINHOLE, 192, 144, 150, 152.0, {LEFT.cx + 0.5}, {LEFT.cy + 0.5}
right,, camera, OPENCV, 200, 150, 160, 158, 99.5, 75.5, -0.12, 0.02, 0.001, -0.0005
left_depth , lidar in the view of A, depth, PINHOLE, 96, 72, 75, 76, {HALF.cx + 0.5}, {HALF.cy + 0.5}
phone, , camera, SIMPLE_RADIAL, 176, 132, 130, 88.5, 66.5, -0.05
# nobody calibrated this one
old, , camera, UNKNOWN_CAMERA, 64, 48
gps, , gnss, EPSG:4326
wifi, , wifi
"""


def car_at(time: int) -> Array:
    """``T_world_car``."""
    return small_pose(time // 10, lateral_m=0.004 * time, yaw_deg=0.05 * time)


def true_pose(time: int, device: str) -> Array:
    """``T_world_cam`` of a camera on the car's mast."""
    return car_at(time) @ T_car_mast @ MOUNTS[device][0]


def words(T_world_device: Array) -> str:
    """``qw, qx, qy, qz, tx, ty, tz`` of the transform from world to device."""
    T_device_world = invert(T_world_device)
    x, y, z, w = Rotation.from_matrix(T_device_world[:3, :3]).as_quat()
    return ", ".join(repr(float(value)) for value in (w, x, y, z, *T_device_world[:3, 3]))


RIGS = f"""# kapture format: 1.0
# rig_id, sensor_id, qw, qx, qy, qz, tx, ty, tz
car, mast, {words(T_car_mast)}
mast, left, {words(T_mast_left)}
mast, left_depth, {words(T_mast_left)}
mast, right, {words(T_mast_right)}
car, wifi, , , , , , ,
"""


def write(root: Path, name: str, text: str) -> Path:
    path = root / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def take(root: Path, name: str, camera: Camera, T_world_cam: Array) -> None:
    path = root / "sensors" / "records_data" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), photograph(camera, T_world_cam))


def world_points() -> Array:
    """Points on surfaces that the left camera sees first."""
    uv = np.random.default_rng(3).uniform([2, 2], [189, 141], (250, 2)).round()
    z = render(LEFT, true_pose(10, "left"))[1][uv[:, 1].astype(int), uv[:, 0].astype(int)].astype(np.float64)
    rays, _ = LEFT.unproject(uv[z > 0])
    return apply(true_pose(10, "left"), rays * z[z > 0, None])


def write_mapping(root: Path) -> None:
    """Three posed moments of both cameras, depth maps of the left one, points, and an image posed in part."""
    write(root, "sensors/sensors.txt", SENSORS)
    write(root, "sensors/rigs.txt", RIGS)
    poses = "".join(f"  {time:04d}, car, {words(car_at(time))}\n" for time in TIMES)
    write(root, "sensors/trajectories.txt", f"# kapture format: 1.1\n{poses}\n40, car, 1, 0, 0, 0, , ,\n")
    images = [f"{time}, {device}, map/{device}/{time}.png" for time in TIMES for device in MOUNTS]
    images.append("40, left, map/left/40.png")
    write(root, "sensors/records_camera.txt", "# kapture format: 1.1\n" + "\n".join(reversed(images)) + "\n")
    depths = "".join(f"{time}, left_depth, map/left/{time}.depth\n" for time in TIMES)
    write(root, "sensors/records_depth.txt", f"# kapture format: 1.1\n{depths}")
    points = world_points()
    numbers = "".join(", ".join(map(repr, map(float, point))) + ", 9, 9, 9\n" for point in points)
    write(root, "reconstruction/points3d.txt", f"# kapture format: 1.1\n# X, Y, Z, R, G, B\n{numbers}")
    seen: list[list[str]] = [[] for _ in points]
    for time in TIMES:
        depth = render(HALF, true_pose(time, "left"))[1].astype("<f4")
        depth[0, :3] = [np.nan, -1.0, np.inf]
        write(root, f"sensors/records_data/map/left/{time}.depth", "").write_bytes(depth.tobytes())
        for device, (_, camera) in MOUNTS.items():
            name = f"map/{device}/{time}.png"
            take(root, name, camera, true_pose(time, device))
            pixels, valid = camera.project(apply(invert(true_pose(time, device)), points))
            rows = np.flatnonzero(valid & camera.contains(pixels))
            keypoints = write(root, f"reconstruction/keypoints/sift/{name}.kpt", "")
            keypoints.write_bytes((pixels[rows] + 0.5).astype("<f4").tobytes())
            for index, row in enumerate(rows):
                seen[row].append(f"{name}, {index}")
    take(root, "map/left/40.png", LEFT, true_pose(10, "left"))
    write(root, "reconstruction/keypoints/sift/keypoints.txt", "# kapture format: 1.1\nsift, float32, 2\n")
    observations = "".join(f"{row}, sift, {', '.join(of)}\n" for row, of in enumerate(seen) if of)
    write(root, "reconstruction/observations.txt", f"# kapture format: 1.1\n{observations}")


def write_queries(root: Path) -> None:
    """One image posed by its rig, one by a trajectory of its own, one whose pose is withheld."""
    write(root, "sensors/sensors.txt", SENSORS)
    write(root, "sensors/rigs.txt", RIGS)
    poses = f"15, car, {words(car_at(15))}\n25, right, {words(true_pose(25, 'right'))}\n"
    write(root, "sensors/trajectories.txt", f"# kapture format: 1.1\n{poses}")
    images = "15, left, q/l15.png\n25, right, q/r25.png\n35, phone, q/p35.png\n"
    write(root, "sensors/records_camera.txt", f"# kapture format: 1.1\n{images}")
    take(root, "q/l15.png", LEFT, true_pose(15, "left"))
    take(root, "q/r25.png", RIGHT, true_pose(25, "right"))
    take(root, "q/p35.png", PHONE, phone_at_35())


def phone_at_35() -> Array:
    return small_pose(3, lateral_m=0.1, yaw_deg=1.0)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("kapture") / "town"
    write_mapping(root / "mapping")
    write_queries(root / "query")
    return root


@pytest.fixture
def copy(made: Path, tmp_path: Path) -> Path:
    """A copy of the folders that a test may damage."""
    return Path(shutil.copytree(made, tmp_path / "town"))


def build(sources: Path | list[Path], out: Path, reporter: Silent | None = None, **options: Any) -> Dataset:
    settings = importer.Options.model_validate({"correspondences": 20, **options})
    given = sources if isinstance(sources, list) else [sources]
    return importer.build(given, settings, out, reporter or Silent(), Run(1))


def times_of(dataset: Dataset, traversal: str) -> dict[str, int]:
    return {name: time for time, name in dataset.traversal(traversal).names.items()}


def test_poses_are_from_world_to_device_with_rigs_in_between(tmp_path: Path) -> None:
    """By hand: the rig stands at (1, 2, 3) and looks along the world's x axis, its camera is 0.5 m to its right.

    x right is -y of the world then, y down is -z: R is the quaternion (w x y z) = (.5, .5, -.5, .5) and t = -R c =
    (2, 3, -1). The point (11, 1, 2) is 10 m ahead of the rig, 1 m to the right and 1 m down, in the camera thus at
    (0.5, 1, 10), which f = 100 and a centre of (32, 24), in pixels whose centres are at +0.5, show at (36.5, 33.5).
    """
    write(tmp_path, "sensors/sensors.txt", "# kapture format: 1.0\nc, , camera, SIMPLE_PINHOLE, 64, 48, 100, 32, 24\n")
    write(tmp_path, "sensors/rigs.txt", "r, c, 1, 0, 0, 0, -0.5, 0, 0\n")
    write(tmp_path, "sensors/trajectories.txt", "7, r, 0.5, 0.5, -0.5, 0.5, 2, 3, -1\n")
    write(tmp_path, "sensors/records_camera.txt", "7, c, a.png\n")
    folder = read_folder(tmp_path)
    T_cam_world = folder.T_device_world("c", 7)
    assert T_cam_world is not None
    np.testing.assert_allclose(invert(T_cam_world)[:3, 3], [1, 1.5, 3], atol=1e-12)
    in_camera = apply(T_cam_world, np.array([[11.0, 1.0, 2.0]]))
    np.testing.assert_allclose(in_camera, [[0.5, 1.0, 10.0]], atol=1e-12)
    np.testing.assert_allclose(folder.camera("c").project(in_camera)[0], [[36.5, 33.5]], atol=1e-12)


def test_cameras_and_poses_are_those_that_were_written(made: Path) -> None:
    mapping, query = read_folder(made / "mapping"), read_folder(made / "query")
    assert [mapping.camera(name) for name in ("left", "right", "left_depth")] == [LEFT, RIGHT, HALF]
    assert query.camera("phone") == PHONE
    for folder, moments in (
        (mapping, [(time, device) for time in TIMES for device in MOUNTS]),
        (query, [(15, "left"), (15, "right"), (25, "right")]),
    ):
        for time, device in moments:
            T_cam_world = folder.T_device_world(device, time)
            assert T_cam_world is not None
            np.testing.assert_allclose(invert(T_cam_world), true_pose(time, device), atol=1e-12)
    assert mapping.T_device_world("left", 40) is None  # a rotation alone is no pose
    assert query.T_device_world("left", 25) is None
    assert mapping.T_device_world("wifi", 10) is None  # nobody measured where it is on the car
    assert [(r.timestamp, r.device) for r in mapping.images[:3]] == [(10, "left"), (10, "right"), (20, "left")]


def test_a_pose_of_the_camera_goes_before_that_of_its_rig(copy: Path) -> None:
    path = copy / "query/sensors/trajectories.txt"
    path.write_text(path.read_text() + f"15, left, {words(true_pose(30, 'left'))}\n")
    T_cam_world = read_folder(copy / "query").T_device_world("left", 15)
    assert T_cam_world is not None
    np.testing.assert_allclose(invert(T_cam_world), true_pose(30, "left"), atol=1e-12)


def test_map_and_queries_become_a_dataset(made: Path, tmp_path: Path) -> None:
    notes = Notes()
    dataset = build([made / "mapping", made / "query"], tmp_path / "d", notes)
    assert not validate_dataset(dataset.root, Silent()).faults
    assert notes.notes[:2] == [
        "mapping: 1 of 7 images have no pose and are left out",
        "query: 1 of 3 images have no pose: they are in no pair",
    ]
    drive, query = dataset.traversal("mapping"), dataset.traversal("query")
    assert list(drive.names.values()) == [f"map/{device}/{time}.png" for time in TIMES for device in MOUNTS]
    assert list(query.names.values()) == ["q/l15.png", "q/r25.png", "q/p35.png"]
    for name, at in times_of(dataset, "mapping").items():
        _, device, stem = Path(name).with_suffix("").parts
        assert drive.camera("photo", at) == MOUNTS[device][1].pinhole()
        np.testing.assert_allclose(drive.T_world_cam("photo", at), true_pose(int(stem), device), atol=1e-9)
    assert query.camera("photo", times_of(dataset, "query")["q/p35.png"]) == PHONE.pinhole()
    assert times_of(dataset, "query")["q/p35.png"] not in query.poses
    pairs = dataset.pair_set("mapping__query__photo").pairs
    assert len(pairs) == 2


def test_keyframe_depth_is_where_the_query_sees_the_same_surface(made: Path, tmp_path: Path) -> None:
    """Depth maps and points alike are moved into the query by the pair's pose alone."""
    dataset = build(made, tmp_path / "d")
    pair_set = dataset.pair_set("mapping__query__photo")
    asked = {at: name for name, at in times_of(dataset, "query").items()}
    kinds = set()
    for pair in pair_set.pairs:
        reference = dataset.reference(pair_set, pair)
        kinds.add("map" if reference.depth is not None else "points")
        points = reference.points
        rays, _ = reference.camera.unproject(points.uv)
        assert pair.T_query_ref is not None
        in_query = apply(pair.T_query_ref, rays / points.inverse_depth[:, None])
        camera = dataset.query(pair_set, pair).camera
        pixels, valid = camera.project(in_query)
        valid = valid & camera.contains(pixels)
        device, time = ("left", 15) if asked[pair.query_timestamp_ns] == "q/l15.png" else ("right", 25)
        depth = render(camera, true_pose(time, device))[1]
        column, row = np.rint(pixels[valid]).astype(int).T
        error = np.abs(depth[row, column] - in_query[valid][:, 2]) / in_query[valid][:, 2]
        assert valid.sum() > 50
        assert np.median(error) < 0.01
    assert kinds == {"map", "points"}


def test_a_smaller_depth_map_keeps_its_values_where_they_are_shown(made: Path, tmp_path: Path) -> None:
    dataset = build(made, tmp_path / "d")
    drive = dataset.traversal("mapping")
    depth = drive.depth("photo", times_of(dataset, "mapping")["map/left/20.png"])
    assert depth is not None
    assert drive.points("photo", times_of(dataset, "mapping")["map/left/20.png"]) is None
    truth = render(LEFT, true_pose(20, "left"))[1]
    known = depth > 0
    assert 0.24 < known.mean() < 0.26
    assert not known[0, :5].any()  # what is not a number, negative or infinite is unknown
    assert np.median(np.abs(depth[known] - truth[known]) / truth[known]) < 0.01
    sparse = drive.points("photo", times_of(dataset, "mapping")["map/right/20.png"])
    assert sparse is not None
    assert len(sparse) > 50
    assert np.all(sparse.sigma > 0)


def test_depth_maps_of_the_same_camera_stay_as_they_are() -> None:
    depth = np.arange(192 * 144, dtype=np.float32).reshape(144, 192)
    np.testing.assert_array_equal(seen_by(depth, LEFT, LEFT), depth)
    small = np.zeros((72, 96), np.float32)
    small[10, 20] = 3.0
    shown = seen_by(small, HALF, LEFT)
    # the centre of a pixel of the half image is the corner of four of the whole one
    assert [tuple(at) for at in np.argwhere(shown)] in [[(v, u)] for v in (20, 21) for u in (40, 41)]
    near = np.zeros((144, 192), np.float32)
    near[20, 40], near[20, 41] = 5.0, 4.0
    assert seen_by(near, LEFT, HALF)[10, 20] == 4.0


def test_a_depth_sensor_elsewhere_is_not_used(copy: Path, tmp_path: Path) -> None:
    rigs = copy / "mapping/sensors/rigs.txt"
    rigs.write_text(rigs.read_text().replace(f"left_depth, {words(T_mast_left)}", f"left_depth, {words(T_mast_right)}"))
    records = copy / "mapping/sensors/records_camera.txt"
    records.write_text("\n".join(line for line in records.read_text().split("\n") if "right" not in line))
    notes = Notes()
    dataset = build(copy, tmp_path / "d", notes)
    assert any(note.startswith("mapping: no depth map is used: none is of the time of") for note in notes.notes)
    at = times_of(dataset, "mapping")["map/left/10.png"]
    assert dataset.traversal("mapping").depth("photo", at) is None
    assert dataset.traversal("mapping").points("photo", at) is not None


def test_one_folder_is_map_and_queries_by_name_or_both_at_once(made: Path, tmp_path: Path) -> None:
    apart = build(made / "mapping", tmp_path / "a", queries=["map/right/*"], metres_per_unit=2.0)
    assert [len(apart.traversal(name).names) for name in ("map", "query")] == [3, 3]
    expected = true_pose(10, "right")
    expected[:3, 3] *= 2.0
    at = times_of(apart, "query")["map/right/10.png"]
    np.testing.assert_allclose(apart.traversal("query").T_world_cam("photo", at), expected, atol=1e-9)
    within = build(made / "mapping", tmp_path / "b", cameras=["l*"], pair_step=[1, 2])
    assert list(within.traversal("map").names.values()) == [f"map/left/{time}.png" for time in TIMES]
    assert len(within.pair_set("map__map__photo").pairs) == 3


@pytest.mark.parametrize("text", ["# kapture format: 1.1\n\n{}, {}, 0.7\n{}, {}, 0.5\n", "{} {}\n{} {}\n"])
def test_pairs_may_be_listed_and_truth_withheld(made: Path, tmp_path: Path, text: str) -> None:
    listed = ("q/p35.png", "map/left/30.png", "q/l15.png", "map/right/10.png")
    pairs = write(tmp_path, "pairs.txt", text.format(*listed))
    withheld = build(made, tmp_path / "withheld", pairs=pairs)
    times, asked = times_of(withheld, "mapping"), times_of(withheld, "query")
    found = {p.key: p.T_query_ref for p in withheld.pair_set("mapping__query__photo").pairs}
    assert set(found) == {(times[listed[1]], asked[listed[0]]), (times[listed[3]], asked[listed[2]])}
    assert found[times[listed[1]], asked[listed[0]]] is None
    posed = found[times[listed[3]], asked[listed[2]]]
    assert posed is not None
    np.testing.assert_allclose(posed, invert(true_pose(15, "left")) @ true_pose(10, "right"), atol=1e-8)
    truth = write(tmp_path, "poses.txt", f"q/p35.png {words(phone_at_35()).replace(',', '')}\n")
    told = build(made, tmp_path / "told", pairs=pairs, query_poses=truth)
    by_key = told.pair_set("mapping__query__photo").by_key
    expected = invert(phone_at_35()) @ true_pose(30, "left")
    T_query_ref = by_key[times[listed[1]], asked[listed[0]]].T_query_ref
    assert T_query_ref is not None
    np.testing.assert_allclose(T_query_ref, expected, atol=1e-8)


def test_several_query_folders_share_a_list(made: Path, tmp_path: Path) -> None:
    night = shutil.copytree(made / "query", tmp_path / "night")
    records = night / "sensors/records_camera.txt"
    records.write_text(records.read_text().replace("q/", "n/"))
    (night / "sensors/records_data/q").rename(night / "sensors/records_data/n")
    pairs = write(tmp_path, "pairs.txt", "q/l15.png, map/left/10.png\nn/r25.png, map/left/20.png, 3\n")
    dataset = build([made / "mapping", made / "query", night], tmp_path / "d", pairs=pairs)
    assert {name: len(dataset.pair_set(name).pairs) for name in dataset.pair_set_names} == {
        "mapping__night__photo": 1,
        "mapping__query__photo": 1,
    }
    pairs.write_text("q/l15.png, map/left/10.png\n")
    with refused(DatasetError, "", None, "night"):
        build([made / "mapping", made / "query", night], tmp_path / "e", pairs=pairs)


def replaced(name: str, old: str, new: str) -> Callable[[Path], Path]:
    def change(root: Path) -> Path:
        path = root / name
        assert old in path.read_text()
        path.write_text(path.read_text().replace(old, new, 1))
        return path

    return change


def without(name: str) -> Callable[[Path], Path]:
    def change(root: Path) -> Path:
        (root / name).unlink()
        return root / name

    return change


def added(name: str, line: str) -> Callable[[Path], Path]:
    def change(root: Path) -> Path:
        path = root / name
        path.write_text(path.read_text() + line + "\n")
        return path

    return change


TABLES = "mapping/sensors"
RECONSTRUCTION = "mapping/reconstruction"
UNIT = "1, 0, 0, 0, 0, 0, 0"
FAULTS: list[tuple[Callable[[Path], Path], int | None, tuple[str, ...]]] = [
    (replaced(f"{TABLES}/sensors.txt", "1.1", "0.9"), 1, ("0.9", "1.0", "1.1")),
    (replaced(f"{TABLES}/sensors.txt", "1.1", "2.0"), 1, ("2.0",)),
    (replaced(f"{TABLES}/sensors.txt", "# kapture format: 1.1", "#"), 1, ("# kapture format: 1.1",)),
    (added(f"{TABLES}/sensors.txt", "left, , wifi"), 12, ("left", "again")),
    (added(f"{TABLES}/sensors.txt", "x, y"), 12, ("sensor_id", "sensor_type", "2 fields")),
    (added(f"{TABLES}/sensors.txt", "x, , camera"), 12, ("model", "width")),
    (added(f"{TABLES}/sensors.txt", "x, , depth, PINHOLE, 4.5, 4, 1, 1, 1, 1"), 12, ("4.5 x 4",)),
    (replaced(f"{TABLES}/sensors.txt", "PINHOLE, 192", "PINHOLE2, 192"), 4, ("left", "PINHOLE2")),
    (replaced(f"{TABLES}/sensors.txt", "PINHOLE, 192", "FOV, 192"), 4, ("left", "FOV")),
    (replaced(f"{TABLES}/sensors.txt", "152.0, ", ""), 4, ("left", "4 parameters", "3")),
    (replaced(f"{TABLES}/sensors.txt", "150, 152.0", "150, x"), 4, ("parameter", "x")),
    (
        replaced("query/sensors/records_camera.txt", "35, phone", "35, old"),
        9,
        ("old", "UNKNOWN_CAMERA"),
    ),
    (added(f"{TABLES}/rigs.txt", f"left, right, {UNIT}"), 8, ("left", "like a sensor")),
    (added(f"{TABLES}/rigs.txt", f"mast, lefty, {UNIT}"), 8, ("sensors.txt", "lefty")),
    (added(f"{TABLES}/rigs.txt", f"mast, left, {UNIT}"), 8, ("left", "mast", "second time")),
    (added(f"{TABLES}/rigs.txt", f"mast, car, {UNIT}"), None, ("mast", "itself")),
    (added(f"{TABLES}/rigs.txt", "mast, left, 1, 0"), 8, ("rig_id", "sensor_id", "4 fields")),
    (added(f"{TABLES}/trajectories.txt", f"50, lefty, {UNIT}"), 7, ("sensors.txt", "lefty")),
    (added(f"{TABLES}/trajectories.txt", f"10, car, {UNIT}"), 7, ("second pose", "car", "10")),
    (added(f"{TABLES}/trajectories.txt", "50, car, 2, 0, 0, 0, 0, 0, 0"), 7, ("norm 2", "1")),
    (added(f"{TABLES}/trajectories.txt", "50, car, 1, 0, 0, 0, 0, 0"), 7, ("8 fields",)),
    (added(f"{TABLES}/trajectories.txt", "5.5, car, 1, 0, 0, 0, 0, 0, 0"), 7, ("timestamp", "5.5")),
    (without(f"{TABLES}/trajectories.txt"), None, ("no image of the map",)),
    (without(f"{TABLES}/records_camera.txt"), None, ("missing", "device_id")),
    (added(f"{TABLES}/records_camera.txt", "50, lefty, a.png"), 9, ("sensors.txt", "lefty")),
    (added(f"{TABLES}/records_camera.txt", "50, gps, a.png"), 9, ("gps", "gnss")),
    (added(f"{TABLES}/records_camera.txt", "10, left, a.png"), 9, ("second record", "left", "10")),
    (added(f"{TABLES}/records_camera.txt", "50, left, map/left/10.png"), 9, ("map/left/10.png", "again")),
    (added(f"{TABLES}/records_camera.txt", "50, left,"), 9, ("path", "none")),
    (
        added(f"{TABLES}/records_camera.txt", f"50, left, {'a' * 256}"),
        9,
        ("1000",),
    ),
    (replaced(f"{TABLES}/records_camera.txt", "left/30.png", "left/31.png"), 4, ("no image", "map/left/31.png")),
    (added(f"{TABLES}/records_depth.txt", "50, wifi, a.depth"), 5, ("wifi",)),
    (without(f"{TABLES}/records_data/map/left/10.depth"), None, ("missing", "depth map")),
    (replaced(f"{RECONSTRUCTION}/points3d.txt", ", 9, 9, 9\n", ", q\n1, 2\n"), 4, ("2 fields",)),
    (without(f"{RECONSTRUCTION}/points3d.txt"), None, ("missing",)),
    (
        added(f"{RECONSTRUCTION}/observations.txt", "9999, sift, map/left/10.png, 0"),
        None,
        ("point 9999", "points3d.txt"),
    ),
    (
        added(f"{RECONSTRUCTION}/observations.txt", "1, map/left/10.png, 0"),
        None,
        ("point3d_id", "keypoints_type"),
    ),
]


@pytest.mark.parametrize(("change", "line", "names"), FAULTS)
def test_a_fault_is_told_with_its_file_and_line(
    copy: Path, tmp_path: Path, change: Callable[[Path], Path], line: int | None, names: tuple[str, ...]
) -> None:
    path = change(copy)
    with refused(DatasetError, path.with_name("sensors.txt") if "old" in names else path, line, *names):
        build(copy, tmp_path / "d", correspondences=0)


def test_a_depth_map_of_another_size_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.depth"
    path.write_bytes(b"\0" * 40)
    with refused(DatasetError, "a.depth", None, "40", "48", "32-bit", "4x3"):
        read_depth_map(path, (4, 3))


def test_cameras_that_take_no_part_may_be_unknown(copy: Path, tmp_path: Path) -> None:
    records = copy / "mapping/sensors/records_camera.txt"
    records.write_text(records.read_text() + "10, old, old.png\n")
    assert build(copy / "mapping", tmp_path / "d", cameras=["left", "right"], correspondences=0)
    assert build(copy / "mapping", tmp_path / "e", correspondences=0)  # it has no pose and is left out


@pytest.mark.thorough
def test_options_and_lists_that_do_not_fit_are_refused(made: Path, tmp_path: Path) -> None:
    unposed = shutil.copytree(made / "query", tmp_path / "unposed")
    (unposed / "sensors/trajectories.txt").unlink()
    pairs, poses = tmp_path / "pairs.txt", tmp_path / "poses.txt"
    both = [made / "mapping", made / "query"]
    for sources, options, told in (
        (both, {"queries": ["q/*"]}, ("", None, "--queries")),
        (both, {"cameras": ["top*"]}, ("", None, "top*", "left, right")),
        ([made / "mapping"], {"queries": ["night/*"]}, ("", None, "night/*")),
        ([made / "mapping"], {"queries": ["*"]}, ()),
        (both, {"pairs": pairs, "elsewhere": 3}, ("", None, "--pairs")),
        ([made / "mapping", unposed], {}, ("", None, "unposed")),
        ([made / "mapping", tmp_path], {}, ("", None, "sensors/sensors.txt")),
        ([tmp_path / "none"], {}, ("none",)),
        ([made / "query" / "sensors"], {}, ("query/sensors",)),
    ):
        with refused((DatasetError, ConfigError), *told):
            build(sources, tmp_path / "d", **options)
    for text, fault in (
        ("q/l15.png, map/left/11.png\n", ("pairs.txt", 1, "map/left/11.png")),
        ("q/l16.png map/left/10.png\n", ("pairs.txt", 1, "q/l16.png")),
        ("q/l15.png, map/left/10.png, 1, 2\n", ("pairs.txt", 1, 4)),
        ("q/l15.png, map/left/10.png\nq/l15.png, map/left/10.png\n", ("pairs.txt", 2)),
        ("# nothing\n", ("pairs.txt",)),
    ):
        pairs.write_text(text)
        with refused(DatasetError, *fault):
            build(both, tmp_path / "p", pairs=pairs)
    for name, other in (("q/x.png", "q/x.png"), ("q/l15.png", "trajectories.txt")):
        poses.write_text(f"{name} 1 0 0 0 0 0 0\n")
        with refused(DatasetError, "", None, other):
            build(both, tmp_path / "q", query_poses=poses)


def test_the_command_builds_and_names_what_is_wrong(copy: Path, tmp_path: Path) -> None:
    done = relocbench("build-dataset", "kapture", copy, "--out", tmp_path / "d", "-q")
    assert done.status == 0, done.err
    assert Dataset(tmp_path / "d").name == "kapture_town"
    added("query/sensors/records_camera.txt", "5, top, a.png")(copy)
    bad = relocbench("build-dataset", "kapture", copy, "--out", tmp_path / "e")
    assert bad.status == 2
    assert_names(bad.complaint, "query/sensors/records_camera.txt", 5, "top")


def test_observations_of_version_1_0_have_no_type(copy: Path) -> None:
    root = copy / "mapping"
    new = read_folder(root)
    replaced("sensors/sensors.txt", "1.1", "1.0")(root)
    path = root / "reconstruction/observations.txt"
    path.write_text(path.read_text().replace(", sift", ""))
    old = read_folder(root)
    assert old.observed.keys() == new.observed.keys()
    for name, points in new.observed.items():
        np.testing.assert_array_equal(old.observed[name], points)


# --- the kapture package ---


@pytest.fixture(scope="module")
def kapture() -> Any:
    """The package, with its reader and writer."""
    pytest.importorskip("kapture.io.csv", reason="the kapture package is not installed")
    pytest.importorskip("kapture.io.records", reason="the kapture package is not installed")
    return pytest.importorskip("kapture")


def assert_same(kapture: Any, theirs: Any, ours: KaptureFolder) -> None:
    """What the package read is what our reader did; points are projected by the package's own transforms."""
    for carried in theirs.rigs.values():
        for device in [name for name, pose in carried.items() if pose.r is None]:
            del carried[device]  # the package cannot compose a pose that is left blank
    posed = kapture.rigs_remove(theirs.trajectories, theirs.rigs)
    records = {(time, device): name for time, device, name in kapture.flatten(theirs.records_camera)}
    assert records == {(record.timestamp, record.device): record.name for record in ours.images}
    points = world_points()
    compared = 0
    for time, device in records:
        T_cam_world = ours.T_device_world(device, time)
        pose = posed.get(time, {}).get(device)
        assert (pose is None or pose.r is None or pose.t is None) == (T_cam_world is None)
        if T_cam_world is not None:
            np.testing.assert_allclose(apply(T_cam_world, points), pose.transform_points(points), atol=1e-9)
            compared += 1
    assert compared >= 2


@pytest.mark.thorough
@pytest.mark.parametrize("part", ["mapping", "query"])
def test_the_kapture_package_reads_the_same(kapture: Any, copy: Path, part: str) -> None:
    root = copy / part
    ours = read_folder(root)
    # Nor can it compose one that is told in part.
    trajectories = root / "sensors/trajectories.txt"
    trajectories.write_text(trajectories.read_text().replace("40, car, 1, 0, 0, 0, , ,\n", ""))
    theirs = kapture.io.csv.kapture_from_dir(str(root))
    assert_same(kapture, theirs, ours)
    for name, sensor in theirs.sensors.items():
        if sensor.sensor_type in ("camera", "depth") and name != "old":
            width, height, *_ = sensor.camera_params
            assert ours.camera(name).size == (width, height)
    if part == "query":
        return
    np.testing.assert_array_equal(theirs.points3d.as_array()[:, :3], ours.points)
    seen: dict[str, list[int]] = {}
    for point, of in theirs.observations.items():
        for name, _ in of["sift"]:
            seen.setdefault(name, []).append(point)
    assert {name: sorted(points) for name, points in seen.items()} == {k: v.tolist() for k, v in ours.observed.items()}
    path = root / "sensors/records_data/map/left/10.depth"
    known = read_depth_map(path, HALF.size)
    depth = kapture.io.records.depth_map_from_file(str(path), HALF.size)
    np.testing.assert_array_equal(known[known > 0], depth[known > 0])
    assert not (np.isfinite(depth) & (depth > 0))[known == 0].any()


@pytest.mark.thorough
def test_what_the_kapture_package_writes_is_read(kapture: Any, made: Path, tmp_path: Path) -> None:
    theirs = kapture.io.csv.kapture_from_dir(str(made / "query"))
    kapture.io.csv.kapture_to_dir(str(tmp_path / "again"), theirs)
    assert_same(kapture, theirs, read_folder(tmp_path / "again"))
    assert read_folder(tmp_path / "again").camera("right") == RIGHT
