"""Recordings read back against the exact truth they were simulated from, and damaged ones."""

from __future__ import annotations

import pickle
import shutil
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from refusals import ErrorData, Notes, refused
from scipy.spatial import cKDTree

from relocbench.arrays import Array, Image, Times
from relocbench.datasets.core import images
from relocbench.datasets.core.schema import Transform
from relocbench.datasets.core.traversal import read_poses
from relocbench.datasets.groundtruth.odometry.local_map import plane_normals
from relocbench.datasets.importers.robotcar.recording import read_robotcar, read_robotcar_drives
from relocbench.datasets.sensors.recording import FieldRecording, LidarStream, Trajectory
from relocbench.datasets.synthetic.conditions.condition import condition_named
from relocbench.datasets.synthetic.jobs.recording import path_length, record
from relocbench.datasets.synthetic.layouts import robotcar as robotcar_layout
from relocbench.datasets.synthetic.town.network import Path as Road
from relocbench.datasets.synthetic.town.town import District, make_district
from relocbench.errors import ConfigError, DatasetError
from relocbench.geometry import (
    apply,
    interpolate_trajectory,
    invert,
    make_transform,
    rotation_angle,
)

FRAMES = 64
RANGE_NOISE_M = 0.012


@dataclass(frozen=True)
class Truth:
    """What no importer reads. The importers' rig stands elsewhere on the car than the town's."""

    times_ns: Times
    T_world_town_rig: Array
    T_town_rig: Array

    @classmethod
    def read(cls, folder: Path, T_town_rig: Array) -> Truth:
        poses = read_poses(folder / "poses.csv")
        return cls(np.array(list(poses)), np.array(list(poses.values())), T_town_rig)

    def at(self, times_ns: Times) -> Array:
        """(N, 4, 4) ``T_world_rig``"""
        return interpolate_trajectory(self.times_ns, self.T_world_town_rig, times_ns) @ self.T_town_rig


@cache
def district() -> District:
    return make_district(0, "train", 180.0)


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two drives of 5 s on one street, the second the other way, in other weather."""
    out = tmp_path_factory.mktemp("robotcar")
    town = district()
    road = town.network.drive(path_length(FRAMES, "robotcar") + 1.0, 0)
    back = replace(road, points=road.points[::-1].copy(), heading=road.heading[::-1] + np.pi, streets=())
    assert isinstance(back, Road)
    for number, (path, weather) in enumerate(((road, "Sunny"), (back, "Overcast"))):
        record(town, path, condition_named(weather).factors, out, number=number, frames=FRAMES, cameras=())
    return out


@pytest.fixture(scope="module")
def recordings(drives: Path) -> list[FieldRecording]:
    return read_robotcar_drives(sorted(drives.glob("2024*")))


def truth_of(drives: Path, recording: FieldRecording) -> Truth:
    return Truth.read(
        drives / "truth" / recording.name, robotcar_layout.T_RIG_VEHICLE @ np.diag([1.0, -1.0, -1.0, 1.0])
    )


def cloud(lidar: LidarStream, truth: Truth, late_ns: int = 0) -> Array:
    """(N, 3) all points in the world by the true poses, as if they were measured ``late_ns`` later."""
    parts = []
    for i in range(len(lidar.times_ns)):
        scan = lidar.read(i)
        times = scan.times_ns + late_ns
        there = (times >= truth.times_ns[0]) & (times <= truth.times_ns[-1])
        T_world_lidar = truth.at(times[there]) @ lidar.T_rig_lidar
        parts.append(apply(T_world_lidar, scan.points[there][:, None, :])[:, 0])
    return np.concatenate(parts)


class Planes:
    """Planes through points, thinned so that the neighbours of one do not all lie along one scan."""

    def __init__(self, points: Array) -> None:
        _, first = np.unique(np.floor(points / 0.12).astype(int), axis=0, return_index=True)
        self.points = points[np.sort(first)]
        self.normals, self.flat = plane_normals(self.points, self.points)
        self.tree = cKDTree(self.points)

    def distances(self, query: Array) -> tuple[Array, Array]:
        """Signed distances (M,) of points from the planes of their nearest ones, where there are any, and normals."""
        distance, nearest = (np.asarray(found) for found in self.tree.query(query, distance_upper_bound=0.3))
        met = np.isfinite(distance)
        met[met] = self.flat[nearest[met]]
        normals = self.normals[nearest[met]]
        return np.sum(normals * (query[met] - self.points[nearest[met]]), axis=1), normals

    def displacement(self, query: Array, sigma_m: float = 0.03) -> Array:
        """(3,) by which points lie off the planes: robust point-to-plane fit."""
        moved = np.zeros(3)
        for _ in range(6):
            distances, normals = self.distances(query - moved)
            weights = 1 / (sigma_m**2 + distances**2)
            moved += np.linalg.solve((normals * weights[:, None]).T @ normals, normals.T @ (weights * distances))
        return moved


def robust_sigma(values: Array) -> float:
    return float(1.4826 * np.median(np.abs(values)))


@pytest.mark.thorough
def test_walls_of_two_drives_in_opposite_directions_coincide(drives: Path, recordings: list[FieldRecording]) -> None:
    """To millimetres, and to the noise of ranges: axes, extrinsics and times are right. The same check sees a lidar
    5 cm too far left (the drives go round a corner) and scans that have the time of the next one (0.16 m)."""
    first, second = recordings
    planes = Planes(np.concatenate([cloud(lidar, truth_of(drives, first)) for lidar in first.lidars]))
    lidar: Any = second.lidars[0]
    truth = truth_of(drives, second)
    query = cloud(lidar, truth)[::7]
    found, _ = planes.distances(query)
    assert len(found) > 4000
    assert robust_sigma(found) < RANGE_NOISE_M
    assert np.linalg.norm(planes.displacement(query)) < 0.005
    aside = replace(lidar, T_rig_lidar=make_transform(np.eye(3), [0, 0.05, 0]) @ lidar.T_rig_lidar)
    moved = planes.displacement(cloud(aside, truth)[::7])
    assert np.linalg.norm(moved[:2]) == pytest.approx(0.05 * np.sqrt(2), abs=0.02)
    late = cloud(lidar, truth, 20_000_000)[::7]
    assert np.linalg.norm(planes.displacement(late, sigma_m=0.2)) > 0.05


@pytest.mark.thorough
def test_lidars_are_where_they_were_simulated(drives: Path, recordings: list[FieldRecording]) -> None:
    for recording in recordings:
        settings = yaml.safe_load((drives / "truth" / recording.name / "settings.yaml").read_text())
        T_town_rig = truth_of(drives, recording).T_town_rig
        assert [lidar.name for lidar in recording.lidars] == ["lms_front", "lms_rear"]
        for lidar in recording.lidars:
            expected = Transform.model_validate(settings["sensors"]["T_rig_sensor"][lidar.name]).matrix
            np.testing.assert_allclose(T_town_rig @ lidar.T_rig_lidar, expected, atol=1e-9)


@pytest.mark.thorough
def test_beams_are_fired_one_after_another_about_the_time_of_the_scan(recordings: list[FieldRecording]) -> None:
    lidar = recordings[0].lidars[0]
    scan = lidar.read(10)
    azimuth = np.arctan2(scan.points[:, 1], scan.points[:, 0])
    since = scan.times_ns - lidar.times_ns[10]
    np.testing.assert_allclose(since, azimuth / (2 * np.pi) * 20e6, atol=1.0)
    assert np.linalg.norm(scan.points, axis=1).min() > 0.4


@pytest.mark.thorough
def test_visual_odometry_drifts_as_little_as_it_was_simulated_to(
    drives: Path, recordings: list[FieldRecording]
) -> None:
    for recording in recordings:
        times, T_odom_rig = recording.odometry.times_ns, recording.odometry.T_odom_rig
        T_world_rig = truth_of(drives, recording).at(times)
        error = invert(invert(T_odom_rig[0]) @ T_odom_rig[-1]) @ invert(T_world_rig[0]) @ T_world_rig[-1]
        length = np.linalg.norm(np.diff(T_world_rig[:, :3, 3], axis=0), axis=1).sum()
        assert length > 25
        # 0.8 % of scale, 6e-5 rad/m of bend, 2 mm and 2e-4 rad a step: three sigma of each.
        noise = 0.002 * np.sqrt(len(times))
        bend = 3 * (6e-5 * length + 2e-4 * np.sqrt(len(times)))
        assert np.linalg.norm(error[:3, 3]) < 3 * (0.008 * length + np.sqrt(3) * noise) + bend * length
        assert rotation_angle(error[:3, :3]) < 2 * bend
        np.testing.assert_allclose(T_odom_rig[0], np.eye(4), atol=1e-12)


@pytest.mark.thorough
def test_gnss_puts_all_drives_into_one_map_within_metres(drives: Path, recordings: list[FieldRecording]) -> None:
    offsets = []
    for recording in recordings:
        assert recording.prior is not None
        drawn = yaml.safe_load((drives / "truth" / recording.name / "drawn.yaml").read_text())
        T_world_rig = truth_of(drives, recording).at(recording.prior.times_ns)
        T_map_rig = recording.prior.T_odom_rig
        offset = T_map_rig[:, :3, 3] - T_world_rig[:, :3, 3] - drawn["ins_offset_east_north_up_m"]
        offsets.append(offset.mean(axis=0))
        turned = invert(T_map_rig) @ T_world_rig
        assert np.degrees(rotation_angle(turned[:, :3, :3])).max() < 1.2
    # The map's origin is a whole kilometre from the town's; what is left wandered or comes of the heading's error.
    assert np.abs(offsets[0] - 1000.0 * np.round(offsets[0] / 1000.0)).max() < 0.5
    assert np.abs(offsets[0] - offsets[1]).max() < 0.5


@pytest.mark.thorough
def test_conditions_and_streams_survive_pickling(recordings: list[FieldRecording]) -> None:
    assert [r.condition.weather for r in recordings] == ["sunny", "overcast"]
    lidar = recordings[0].lidars[0]
    copy = pickle.loads(pickle.dumps(lidar))
    np.testing.assert_array_equal(copy.read(3).points, lidar.read(3).points)


@pytest.mark.thorough
def test_a_simulated_drives_condition_is_named_beside_it_and_its_date_means_nothing(copied: Path) -> None:
    assert read_robotcar(copied).condition.season == "spring"
    (copied.parent / "drives.csv").write_text(f"name,condition\n{copied.name},Sunny\n")
    condition = read_robotcar(copied).condition
    assert (condition.season, condition.tags) == ("unknown", ("Sunny",))


@pytest.mark.thorough
def test_ins_can_stand_in_for_odometry(drives: Path, recordings: list[FieldRecording]) -> None:
    folder = recordings[0].folder
    found = read_robotcar(folder, odometry="ins").odometry
    T_world_rig = truth_of(drives, recordings[0]).at(found.times_ns)
    error = invert(invert(found.T_odom_rig[0]) @ found.T_odom_rig) @ invert(T_world_rig[0]) @ T_world_rig
    assert np.linalg.norm(error[:, :3, 3], axis=1).max() < 0.6


@pytest.fixture
def copied(drives: Path, recordings: list[FieldRecording], tmp_path: Path) -> Path:
    """The first drive alone, free to be damaged."""
    for name in ("extrinsics", "tags"):
        shutil.copytree(drives / name, tmp_path / name)
    return shutil.copytree(recordings[0].folder, tmp_path / recordings[0].name)


def scan_file(folder: Path, index: int) -> Path:
    return sorted((folder / "lms_front").iterdir())[index]


@pytest.mark.thorough
def test_missing_scans_are_left_out_and_counted(copied: Path) -> None:
    gone = scan_file(copied, 5)
    gone.unlink()
    notes = Notes()
    lidar = read_robotcar(copied, reporter=notes).lidars[0]
    assert int(gone.stem) * 1000 not in lidar.times_ns
    assert any(note.startswith(f"1 of {len(lidar.times_ns) + 1} scans") for note in notes.notes)


@pytest.mark.thorough
@pytest.mark.parametrize("size", [0, 1000])
def test_a_scan_that_is_cut_off_is_named_before_any_work(copied: Path, size: int) -> None:
    path = scan_file(copied, 5)
    path.write_bytes(path.read_bytes()[:size])
    with refused(DatasetError, path):
        read_robotcar(copied)


@pytest.mark.thorough
def test_a_scan_with_a_value_that_is_not_finite_is_named(copied: Path) -> None:
    values = np.fromfile(scan_file(copied, 5))
    values[30] = np.nan
    values.tofile(scan_file(copied, 5))
    with refused(DatasetError, scan_file(copied, 5)):
        read_robotcar(copied).lidars[0].read(5)


@pytest.mark.thorough
def test_a_scan_without_returns_is_empty(copied: Path) -> None:
    np.zeros(541 * 3).tofile(scan_file(copied, 5))
    assert read_robotcar(copied).lidars[0].read(5).points.shape == (0, 3)


@pytest.mark.thorough
def test_a_scan_that_left_out_beams_gets_its_times_from_their_azimuth(copied: Path) -> None:
    before = read_robotcar(copied).lidars[0].read(5)
    values = np.fromfile(scan_file(copied, 5)).reshape(-1, 3)
    values[np.any(values != 0, axis=1)].tofile(scan_file(copied, 5))
    after = read_robotcar(copied).lidars[0].read(5)
    np.testing.assert_array_equal(after.points, before.points)
    np.testing.assert_allclose(after.times_ns, before.times_ns, atol=1)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("gone", "message"),
    [
        ("vo/vo.csv", ("", None, "vo/vo.csv")),
        ("../extrinsics", ("", None, "extrinsics")),
        ("../extrinsics/lms_rear.txt", ("extrinsics/lms_rear.txt", None, "missing")),
    ],
)
def test_what_is_needed_and_missing_is_named(copied: Path, gone: str, message: ErrorData) -> None:
    path = copied / gone
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink()
    with refused(DatasetError, *message):
        read_robotcar(copied)


@pytest.mark.thorough
def test_without_gnss_there_is_no_prior_and_it_is_said(copied: Path) -> None:
    (copied / "gps" / "ins.csv").unlink()
    notes = Notes()
    assert read_robotcar(copied, reporter=notes).prior is None
    assert any("without GNSS" in note for note in notes.notes)


@pytest.mark.thorough
def test_an_unknown_lidar_or_camera_is_named(copied: Path) -> None:
    with refused(ConfigError, "", None, "lms_top"):
        read_robotcar(copied, lidars=["lms_top"])
    with refused(DatasetError, copied / "stereo" / "left", None, "no such folder"):
        read_robotcar(copied, cameras=["stereo_left"])


def test_a_trajectory_of_one_pose_covers_that_time_alone() -> None:
    track = Trajectory(np.array([5]), np.eye(4)[None])
    assert track.covers(np.array([4, 5, 6])).tolist() == [False, True, False]
    assert track.pieces(np.array([5])).tolist() == [0]


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, robotcar_layout.RobotCarLayout]:
    """A drive with two images of each of three cameras, smooth in colour, as the layout writes them."""
    out = tmp_path_factory.mktemp("filmed")
    town = district()
    road = town.network.drive(path_length(2, "robotcar") + 1.0, 0)
    recorded = record(town, road, condition_named("Sunny").factors, out, frames=2, scale=0.1, cameras=())
    start_us = int((recorded.folder / "vo" / "vo.csv").read_text().splitlines()[1].split(",")[1])
    layout = robotcar_layout.RobotCarLayout(out, 2, 0.1, ("stereo/centre", "stereo/right", "mono_left"), start_us)
    for name, mount in layout.cameras.items():
        for i, time in enumerate(layout.times[name].tolist()):
            layout.write_image(name, layout.path(name, i), picture(mount.camera.size))
            with (recorded.folder / f"{name.split('/')[0]}.timestamps").open("a") as stream:
                if name != "stereo/right":  # shares those of the centre camera
                    stream.write(f"{time // 1000} 1\n")
    return recorded.folder, layout


def picture(size: tuple[int, int]) -> Image:
    """(H, W, 3) that changes by less than two grey levels a pixel, each colour otherwise."""
    v, u = np.mgrid[: size[1], : size[0]]
    return np.stack([60 + u, 200 - u, 40 + u // 2 + v], axis=-1).astype(np.uint8)


@pytest.mark.thorough
def test_cameras_are_where_they_were_simulated(filmed: tuple[Path, robotcar_layout.RobotCarLayout]) -> None:
    folder, layout = filmed
    found = read_robotcar(folder).cameras
    assert list(found) == ["stereo_centre", "stereo_right", "mono_left"]
    T_town_rig = robotcar_layout.T_RIG_VEHICLE @ np.diag([1.0, -1.0, -1.0, 1.0])
    for stream, (name, mount) in zip(found.values(), layout.cameras.items(), strict=True):
        np.testing.assert_allclose(T_town_rig @ stream.T_rig_cam, mount.T_rig_cam, atol=2e-6)
        assert stream.camera.size == mount.camera.size
        np.testing.assert_allclose(stream.camera.matrix, mount.camera.matrix, atol=1e-6)
        assert stream.times_ns.tolist() == layout.times[name].tolist()


@pytest.mark.thorough
def test_images_are_developed_to_their_colours(filmed: tuple[Path, robotcar_layout.RobotCarLayout]) -> None:
    """Stereo mosaics begin with GB/RG, mono ones with RG/GB; taken for another one, red would be blue."""
    for stream in read_robotcar(filmed[0]).cameras.values():
        error = stream.read(0).astype(int) - picture(stream.camera.size)
        assert np.abs(error[2:-2, 2:-2]).max() <= 2
        assert stream.file(0) is None


@pytest.mark.thorough
def test_the_look_up_table_says_where_pixels_come_from(
    filmed: tuple[Path, robotcar_layout.RobotCarLayout], tmp_path: Path
) -> None:
    stream: Any = read_robotcar(filmed[0]).cameras["stereo_right"]
    width, height = stream.camera.size
    v, u = np.mgrid[:height, :width].astype(np.float64)
    table = tmp_path / "lut.bin"
    table.write_bytes(np.stack([u.ravel() + 3, v.ravel() + 1]).tobytes())
    shifted = replace(stream, look_up_table=table).read(0)
    plain = replace(stream, look_up_table=None).read(0)
    np.testing.assert_array_equal(shifted[:-1, :-3], plain[1:, 3:])
    assert not shifted[:, -3:].any()
    short = tmp_path / "short.bin"
    short.write_bytes(b"\0" * 16)
    with refused(DatasetError, short):
        replace(stream, look_up_table=short).read(0)


@pytest.mark.thorough
def test_the_published_centre_lens_stands_between_the_others(real_data: Any, copied: Path) -> None:
    """The narrow models count from the centre lens: taken at its word, it would stand where the left one does."""
    models = real_data("robotcar_sdk_calibration") / "models"
    times = [int(line.split()[0]) for line in (copied / "lms_front.timestamps").read_text().splitlines()[:1]]
    for lens in ("left", "centre", "right"):
        images.write_image(copied / "stereo" / lens / f"{times[0]}.png", np.zeros((960, 1280), dtype=np.uint8))
    notes = Notes()
    found = read_robotcar(copied, models=models, reporter=notes).cameras
    places = [found[f"stereo_{lens}"].T_rig_cam[1, 3] for lens in ("left", "centre", "right")]
    assert places == pytest.approx([0.0, -0.119986, -0.239983], abs=1e-9)
    assert sum("no look-up table for stereo_left, stereo_centre, stereo_right" in note for note in notes.notes) == 1
