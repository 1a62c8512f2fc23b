"""Drives recorded by the command line: which is which, the same bytes, and formats that others can read."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from command_line import relocbench
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_reading import RobotCarReading, Truth, hashes
from refusals import assert_names

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.synthetic.conditions.condition import condition_named
from relocbench.datasets.synthetic.drives.drive import MARGIN_M, DriveStyle, drive, route_length
from relocbench.datasets.synthetic.drives.routes import RouteName, route
from relocbench.datasets.synthetic.lidar.lidar import LidarScene
from relocbench.datasets.synthetic.town.network import LANE_M, StreetNetwork, make_network
from relocbench.datasets.synthetic.town.network import Path as Route
from relocbench.datasets.synthetic.town.streets import periodic_street
from relocbench.datasets.synthetic.town.town import compose, make_district
from relocbench.errors import ConfigError
from relocbench.geometry import interpolate_trajectory, invert

SMOKE = ("build-dataset", "synthetic", "--preset", "smoke", "--quiet")
ROBOTCAR = (*SMOKE, "--recording", "robotcar", "--image-scale", 0.08, "--steps", 5)
DRIVES = ("2024-03-01-10-00-00", "2024-03-02-10-00-00")
CONDITIONS = ("Neutral", "Rain")
CAMERAS = {
    "stereo": (("stereo/left", "stereo/centre", "stereo/right"), (102, 77), 62_500),
    "mono_left": (("mono_left",), (82, 82), 90_000),
    "mono_right": (("mono_right",), (82, 82), 90_000),
    "mono_rear": (("mono_rear",), (82, 82), 90_000),
}
LASERS = {"lms_front": 3_000, "lms_rear": 14_000}
"""microseconds from the first image to the first scan"""


def command(out: Path, workers: int) -> list[str]:
    return [*map(str, ROBOTCAR), "--conditions", ",".join(CONDITIONS), "--workers", str(workers), "--out", str(out)]


@pytest.fixture(scope="module")
def robotcar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("field") / "robotcar"
    outcome = relocbench(*command(out, 1))
    assert outcome.status == 0, outcome.err
    return out


def read_drives(root: Path) -> list[dict[str, str]]:
    with (root / "drives.csv").open() as stream:
        return list(csv.DictReader(stream))


@pytest.mark.thorough
def test_a_table_says_which_drive_is_which(robotcar: Path) -> None:
    rows = read_drives(robotcar)
    assert [(r["name"], r["condition"]) for r in rows] == list(zip(DRIVES, CONDITIONS, strict=True))
    for row in rows:
        assert (row["split"], row["route"], row["traversal"]) == ("test", "common", "0")
        folder = robotcar / row["folder"]
        assert int(row["images"]) == len(list(folder.rglob("*.png")))
        assert int(row["scans"]) == len(list(folder.rglob("*.bin")))
        tags = yaml.safe_load((robotcar / "tags" / f"{row['name']}.yaml").read_text())
        assert ("rain" in tags) == (row["condition"] == "Rain")
    # The folder's names tell drives from what belongs to all.
    assert {p.name for p in robotcar.iterdir()} == {
        *DRIVES, "drives.csv", "recording.yaml", "extrinsics", "models", "tags", "truth",
    }  # fmt: skip


def world_points(root: Path, name: str) -> Array:
    """(N, 3) of all scans along the true poses, each beam at its own time."""
    reading, truth = RobotCarReading(root, name), Truth(root / "truth" / name)
    _, left_image = reading.model("stereo_wide_left")
    T_rig_vehicle = truth.T_rig["stereo/left"] @ invert(left_image)
    found = []
    for sensor in LASERS:
        T_vehicle_laser = reading.extrinsics(sensor)
        for stamp, path in reading.files(sensor, ".bin").items():
            scan = reading.scan(path)
            beams = np.flatnonzero(np.hypot(scan[:, 0], scan[:, 1]) > 0)
            fired = stamp * 1000 + np.rint((beams - 270) * 0.5 / 360 * 20e6).astype(np.int64)
            T_world_laser = interpolate_trajectory(truth.times, truth.poses, fired) @ T_rig_vehicle @ T_vehicle_laser
            points = np.column_stack([scan[beams, :2], np.zeros(len(beams)), np.ones(len(beams))])
            found.append(np.einsum("nij,nj->ni", T_world_laser, points)[:, :3])
    return np.concatenate(found)


@pytest.mark.thorough
def test_scans_of_both_drives_lie_on_the_one_town(robotcar: Path) -> None:
    town = make_district(0, "test", 190.0)
    for name, condition in zip(DRIVES, CONDITIONS, strict=True):
        factors = condition_named(condition).factors
        assert factors.traffic == 0
        scene = LidarScene(compose(town, factors))
        points = world_points(robotcar, name)
        assert len(points) > 5000
        nearest = np.full(len(points), np.inf)
        for axis in np.vstack([np.eye(3), -np.eye(3)]):
            nearest = np.minimum(nearest, scene.hits(points - 1e-3 * axis, np.broadcast_to(axis, points.shape)).range)
        # Rain sends echoes of its own, and the noise grows where little comes back.
        assert np.median(nearest) < 0.015
        assert np.mean(nearest < 0.1) > 0.93


@pytest.mark.thorough
def test_rain_takes_echoes_from_the_lidar(robotcar: Path) -> None:
    shares = []
    for name in DRIVES:
        reading = RobotCarReading(robotcar, name)
        scans = [reading.scan(path) for sensor in LASERS for path in reading.files(sensor, ".bin").values()]
        shares.append(np.mean([np.hypot(scan[:, 0], scan[:, 1]) > 0 for scan in scans]))
    assert 0.3 < shares[1] < shares[0] - 0.03


@pytest.fixture(scope="module")
def kitti(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("field") / "kitti"
    options = ("--rings", 32, "--azimuths", 500, "--recording-cameras", "image_0", "--image-scale", 0.25, "--json")
    drives = ("--conditions", "Neutral", "--traversals", 2)
    outcome = relocbench(*SMOKE, "--recording", "kitti", "--workers", 1, *drives, *options, "--out", out)
    assert outcome.status == 0, outcome.err
    told = json.loads(outcome.out)
    assert told["layout"] == "kitti"
    assert [(d["folder"], d["traversal"], d["images"], d["scans"]) for d in told["drives"]] == [
        ("sequences/00", 0, 4, 4),
        ("sequences/01", 1, 4, 4),
    ]
    return out


@pytest.mark.thorough
def test_the_kitti_importer_makes_datasets_of_recordings(kitti: Path, tmp_path: Path) -> None:
    build = ("build-dataset", "kitti", "--quiet", "--workers", 1, "--correspondences", 20, "--depth", "velodyne")
    outcome = relocbench(*build, kitti, "--sequence", "00", "--out", tmp_path / "one")
    assert outcome.status == 0, outcome.err
    assert len(Dataset(tmp_path / "one").pair_sets()[0].pairs) == 3
    # With the exact poses in the place of the measured ones all sequences share a world.
    exact = tmp_path / "exact"
    shutil.copytree(kitti, exact)
    for name in ("00", "01"):
        shutil.copy(kitti / "truth" / name / "poses_cam0.txt", exact / "poses" / f"{name}.txt")
    outcome = relocbench(*build, exact, "--sequence", "00,01", "--out", tmp_path / "across")
    assert outcome.status == 0, outcome.err
    truths = [Truth(kitti / "truth" / name) for name in ("00", "01")]
    pairs = Dataset(tmp_path / "across").pair_sets()[0].pairs
    assert len(pairs) >= 3
    for pair in pairs:
        T_world_ref, T_world_query = (
            truth.rig(stamp) @ truth.T_rig["image_0"]
            for truth, stamp in zip(truths, (pair.ref_timestamp_ns, pair.query_timestamp_ns), strict=True)
        )
        assert pair.T_query_ref is not None
        np.testing.assert_allclose(pair.T_query_ref, invert(T_world_query) @ T_world_ref, atol=1e-6)
    (exact / "poses" / "00.txt").unlink()
    assert_names(relocbench(*build, exact, "--sequence", "00", "--out", tmp_path / "none").complaint, "poses/00.txt")


@pytest.mark.thorough
def test_the_boreas_layout_is_written_by_one_command_and_goes_on_where_it_was_cut(tmp_path: Path) -> None:
    options = ("--rings", 16, "--azimuths", 360, "--image-scale", 0.06, "--conditions", "Neutral", "--json")
    arguments = (*SMOKE, "--recording", "boreas", "--workers", 1, *options, "--out", tmp_path / "made")
    outcome = relocbench(*arguments)
    assert outcome.status == 0, outcome.err
    (drive,) = json.loads(outcome.out)["drives"]
    assert (drive["folder"], drive["images"], drive["scans"]) == ("boreas-2024-03-01-10-00", 4, 4)
    before = hashes(tmp_path / "made")
    scan = sorted((tmp_path / "made" / drive["folder"] / "lidar").iterdir())[1]
    scan.write_bytes(scan.read_bytes()[:-7])
    assert relocbench(*arguments).status == 0
    assert hashes(tmp_path / "made") == before
    other = relocbench(*arguments, "--seed", 1)
    assert other.status == 2
    assert_names(other.complaint, tmp_path / "made", None, "seed")
    assert hashes(tmp_path / "made") == before


@pytest.mark.parametrize(
    ("options", "names"),
    [
        (("--recording", "euroc"), ("--recording", "robotcar", "kitti", "boreas")),
        (("--recording", "robotcar", "--cameras", "stereo"), ("--cameras",)),
        (("--recording", "kitti", "--pair-step", "1,2"), ("--pair-step",)),
        (("--recording", "robotcar", "--rings", "32"), ("--rings", "kitti", "boreas")),
        (("--recording", "boreas", "--motion-distorted"), ("--motion-distorted", "kitti")),
        (("--recording", "boreas", "--recording-cameras", "image_0"), ("image_0", "camera")),
        (("--rings", "32"), ("--rings", "--depth lidar", "recordings")),
        (("--recording", "kitti", "--rings", "12"), ("--rings", "16")),
        (("--recording", "kitti", "--image-scale", "2"), ("--image-scale", "1")),
        (("--recording", "kitti", "--recording-cameras", "left"), ("left",)),
        (("--recording", "robotcar", "--recording-cameras", "mono_rear,mono_rear"), ("--recording-cameras",)),
        (("--recording", "kitti", "--route", "common,common"), ("--route",)),
        (("--recording", "kitti", "--route", "detour"), ("detour",)),
        (("--recording", "kitti", "--conditions", "Hail"), ("Hail",)),
    ],
)
def test_mistakes_are_named(tmp_path: Path, options: tuple[str, ...], names: tuple[str, ...]) -> None:
    outcome = relocbench(*SMOKE, *options, "--out", tmp_path / "out")
    assert outcome.status == 2
    assert_names(outcome.complaint, "", None, *names)
    assert not (tmp_path / "out").exists()


def test_a_folder_that_holds_something_else_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    outcome = relocbench(*SMOKE, "--recording", "kitti", "--recording-cameras", "none", "--out", tmp_path)
    assert outcome.status == 2
    assert_names(outcome.complaint, tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]


def streets(seed: int) -> tuple[StreetNetwork, int]:
    network = make_network(np.random.default_rng([seed, 2, 0]), 250.0)
    return network, periodic_street(network)


def driven(path: Route) -> slice:
    """Samples of the part that is driven."""
    margin = int(MARGIN_M / path.step)
    return slice(margin, len(path.points) - margin)


def found_routes(name: RouteName, length_m: float) -> list[tuple[Route, Route, int]]:
    """The route, the common one and the periodic street of each of some seeds that has one."""
    found = []
    for seed in range(8):
        town = streets(seed)
        try:
            found.append((route(*town, name, length_m, seed), route(*town, "common", length_m, seed), town[1]))
        except ConfigError:
            continue
    assert len(found) >= 4
    return found


def distance(path: Route, other: Route) -> Array:
    """(N,) metres from each driven sample to the other's driven part."""
    a, b = path.points[driven(path)], other.points[driven(other)]
    return np.array([np.linalg.norm(b - p, axis=1).min() for p in a])


def test_the_common_route_is_that_of_the_datasets() -> None:
    network, periodic = streets(0)
    np.testing.assert_array_equal(route(network, periodic, "common", 300.0, 5).points, network.drive(300.0, 5).points)


@pytest.mark.thorough
def test_a_detour_leaves_the_common_route_and_comes_back() -> None:
    for path, common, _ in found_routes("detour", 480.0):
        away = distance(path, common)
        assert away[: int(10 / path.step)].max() < 0.3
        assert (away > 15).sum() * path.step > 40
        # After the farthest place it runs over the common route again.
        back = away[np.argmax(away > 15) :] < 0.5
        back = back[np.argmax(back) :]
        assert back[: int(8 / path.step)].all()
        assert len(back) >= 8 / path.step
        assert path.length == pytest.approx(480.0)


@pytest.mark.thorough
def test_a_crossing_is_passed_in_another_direction() -> None:
    for path, common, _ in found_routes("crossing", 320.0):
        a, b = driven(path), driven(common)
        gap = np.linalg.norm(path.points[a][:, None] - common.points[b][None], axis=2)
        turned = np.cos(path.heading[a][:, None] - common.heading[b][None])
        assert gap[turned < np.cos(np.radians(40))].min() < 4.0
        assert (distance(path, common) > 15).sum() * path.step > 60


@pytest.mark.thorough
def test_the_other_lane_is_that_of_the_way_back() -> None:
    for path, common, _ in found_routes("other-lane", 320.0):
        window = int(25 / path.step)  # outer lanes of bends are longer, and a drive may cross itself
        for i in range(window, len(path.points) - window, 20):
            offset = common.points[i - window : i + window] - path.points[i]
            nearest = offset[np.linalg.norm(offset, axis=1).argmin()]
            to_right = np.array([np.sin(path.heading[i]), -np.cos(path.heading[i])])
            assert LANE_M - 0.1 < nearest @ to_right < LANE_M + 0.9  # corners of crossings are rounded differently
        assert (path.left_lane, path.other_lane_m) == (True, -LANE_M)
    backs = found_routes("return", 320.0)
    for (path, _, _), (back, _, _) in zip(found_routes("other-lane", 320.0), backs, strict=True):
        assert np.median(distance(path, back)) < 0.3


def test_the_periodic_route_runs_along_the_repeating_facades() -> None:
    for path, _, periodic in found_routes("periodic", 200.0):
        stretches = [(start, end) for start, end, name in path.streets if name == periodic]
        along = sum(min(end, path.length - MARGIN_M) - max(start, MARGIN_M) for start, end in stretches)
        assert along > 40


@pytest.mark.thorough
def test_routes_turn_no_sharper_than_a_lane_does() -> None:
    names: tuple[RouteName, ...] = ("detour", "crossing", "periodic", "other-lane")
    for name in names:
        for path, _, _ in found_routes(name, 480.0):
            assert np.abs(np.gradient(path.heading, path.step)).max() < 1 / 5.0
            np.testing.assert_allclose(np.linalg.norm(np.diff(path.points, axis=0), axis=1), path.step, rtol=0.05)


class Straight:
    length = 1e6
    other_lane_m = 3.2

    def pose(self, s: float, lateral_m: float = 0.0, yaw_rad: float = 0.0) -> Array:
        return np.eye(4)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31), st.integers(3, 300), st.floats(1, 25))
def test_nobody_brakes_harder_than_two_metres_per_second_squared(seed: int, steps: int, speed: float) -> None:
    style = DriveStyle(speed)
    along = drive(Straight(), steps, style, np.random.default_rng(seed)).along
    assert np.abs(np.diff(along, 2)).max() * 100 <= 2.0 + 1e-6
    assert along[-1] - along[0] == pytest.approx((steps - 1) * speed / 10)
    assert along[-1] < route_length(steps, style)
