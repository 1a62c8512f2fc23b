"""Bags become datasets whose truth comes from their lidar, by the command a user types."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from command_line import Outcome, relocbench
from fenced_street import fenced_street_mesh
from recording_reading import hashes
from small_street import SolidTexture, StraightRoad, Street

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.importers.robotcar.recording import read_robotcar_drives
from relocbench.datasets.importers.rosbag.recording import open_bag, read_bag
from relocbench.datasets.importers.rosbag.roles import Wanted
from relocbench.datasets.importers.rosbag.settings import BagSettings
from relocbench.datasets.importers.rosbag.writing import Storage, write_bag
from relocbench.datasets.sensors.recording import FieldRecording
from relocbench.datasets.synthetic.conditions.condition import CONDITIONS
from relocbench.datasets.synthetic.jobs.recording import record
from relocbench.errors import ConfigError

SMALL = (
    *("--submap", 20, "--depth-submap", 12, "--keyframe-distance", 2, "--query-distance", 3),
    *("--max-distance", 3, "--correspondences", 20, "--matcher", "fgr"),
)
AS_ROBOTCAR = ("--gnss", "/gnss/pose", "--max-range", 50, "--min-range", 0.1, "--lidar-sigma", 0.012, "--max-gap", 0.5)
STORAGES: tuple[Storage, ...] = get_args(Storage)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def robotcar(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two drives along one street in the RobotCar layout."""
    out = tmp_path_factory.mktemp("robotcar")
    for number, condition in enumerate(("Sunny", "Overcast")):
        record(
            Street(),
            StraightRoad(),
            CONDITIONS[condition].factors,
            out,
            "robotcar",
            frames=52,
            scale=0.06,
            number=number,
            cameras=("stereo/left", "mono_rear"),
            renderer_factory=SolidTexture,
            compose=fenced_street_mesh,
        )
    return sorted(out.glob("2024*"))


@pytest.fixture(scope="module")
def recordings(robotcar: list[Path]) -> list[FieldRecording]:
    return read_robotcar_drives(robotcar)


@pytest.fixture(scope="module")
def bags(recordings: list[FieldRecording], tmp_path_factory: pytest.TempPathFactory) -> dict[Storage, list[Path]]:
    """The same drives as bags, named as the traversals are."""
    out: dict[Storage, list[Path]] = {}
    for storage in STORAGES:
        folder = tmp_path_factory.mktemp(storage)
        out[storage] = [folder / f"{r.name}{'.bag' if storage == 'rosbag1' else ''}" for r in recordings]
        for recording, path in zip(recordings, out[storage], strict=True):
            write_bag(recording, path, storage)
    return out


def build(kind: str, out: Path, *arguments: object) -> Outcome:
    return relocbench("build-dataset", kind, *arguments, "--out", out, "-j", 1, *SMALL)


@pytest.mark.parametrize("storage", STORAGES)
def test_a_bag_holds_all_that_the_recording_told(
    storage: Storage, bags: dict[Storage, list[Path]], recordings: list[FieldRecording]
) -> None:
    how = BagSettings(wanted=Wanted(gnss="/gnss/pose"), min_range_m=0.1, max_range_m=50.0, sigma_m=0.012)
    for path, there in zip(bags[storage], recordings, strict=True):
        here, _ = read_bag(open_bag(path, how.wanted), there.name, how)
        for lidar, original in zip(here.lidars, there.lidars, strict=True):
            assert (lidar.pattern, lidar.sigma_m, lidar.max_range_m) == ("push-broom", 0.012, 50.0)
            assert np.allclose(lidar.T_rig_lidar, original.T_rig_lidar, atol=1e-12)
            assert np.array_equal(lidar.times_ns, original.times_ns)
            for k in range(0, len(lidar.times_ns), 17):
                assert np.array_equal(lidar.read(k).points, original.read(k).points)
                assert np.array_equal(lidar.read(k).times_ns, original.read(k).times_ns)
        assert sorted(here.cameras) == sorted(there.cameras)
        for name, camera in here.cameras.items():
            assert camera.camera == there.cameras[name].camera
            assert np.allclose(camera.T_rig_cam, there.cameras[name].T_rig_cam, atol=1e-12)
            assert np.array_equal(camera.read(5), there.cameras[name].read(5))
        assert np.array_equal(here.odometry.times_ns, there.odometry.times_ns)
        assert np.allclose(here.odometry.T_odom_rig, there.odometry.T_odom_rig, atol=1e-12)
        assert here.prior is not None
        assert there.prior is not None
        assert np.allclose(here.prior.T_odom_rig, there.prior.T_odom_rig, atol=1e-9)


@pytest.fixture(scope="module")
def built(
    robotcar: list[Path], bags: dict[Storage, list[Path]], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, Path, Outcome]:
    """The dataset from the RobotCar layout, that from bags in MCAP, and what building the latter said."""
    out = tmp_path_factory.mktemp("datasets")
    cameras = ("--cameras", "stereo_left")
    first = build("robotcar", out / "robotcar", *robotcar, *cameras)
    assert first.status == 0, first.err
    second = build("rosbag", out / "mcap", *bags["mcap"], *AS_ROBOTCAR, "--cameras", "/stereo_left/image_raw")
    assert second.status == 0, second.err
    return out / "robotcar", out / "mcap", second


def test_bags_give_the_dataset_that_the_robotcar_layout_gives(built: tuple[Path, Path, Outcome]) -> None:
    there, here = Dataset(built[0]), Dataset(built[1])
    assert here.pair_set_names == there.pair_set_names
    pairs = 0
    for name in there.pair_set_names:
        for a, b in zip(there.pair_set(name).pairs, here.pair_set(name).pairs, strict=True):
            assert (a.ref_timestamp_ns, a.query_timestamp_ns) == (b.ref_timestamp_ns, b.query_timestamp_ns)
            assert a.accepted
            assert b.accepted
            assert a.T_query_ref is not None
            assert b.T_query_ref is not None
            # Files hold nine decimals, the last of which may be rounded up in one and down in the other.
            assert np.abs(a.T_query_ref - b.T_query_ref).max() < 1.5e-9
            pairs += 1
    assert pairs >= 5
    pictures = {name: value for name, value in hashes(built[0] / "traversals").items() if "/images/" in name}
    assert pictures
    found = hashes(built[1] / "traversals")
    assert all(found[name] == value for name, value in pictures.items())


def test_the_choice_of_topics_is_told_before_work_starts(built: tuple[Path, Path, Outcome]) -> None:
    lines = built[2].err.splitlines()
    first = next(i for i, line in enumerate(lines) if "reading 2024" in line)
    told = "\n".join(lines[:first])
    for words in ("topic", "/lms_front/points", "lidar", "named by --gnss", "named by --cameras", "not needed"):
        assert words in told, words
    assert "times of points: field 't', ns from the scan's stamp" in built[2].err


def test_a_build_continues_from_its_index_and_ends_with_the_same_bytes(
    built: tuple[Path, Path, Outcome], bags: dict[Storage, list[Path]], tmp_path: Path
) -> None:
    out = tmp_path / "again"
    shutil.copytree(built[1], out)
    (out / "dataset.yaml").unlink()
    shutil.rmtree(out / "pairs")
    outcome = build("rosbag", out, *bags["mcap"], *AS_ROBOTCAR, "--cameras", "/stereo_left/image_raw")
    assert outcome.status == 0, outcome.err
    assert "reading 2024" not in outcome.err
    assert hashes(out) == hashes(built[1])


def test_fixes_alone_give_a_prior_near_the_true_one(
    bags: dict[Storage, list[Path]], recordings: list[FieldRecording]
) -> None:
    how = BagSettings(max_range_m=50.0)
    here, _ = read_bag(open_bag(bags["rosbag1"][0], how.wanted), "drive", how)
    there = recordings[0].prior
    assert here.prior is not None
    assert there is not None
    times = here.prior.times_ns
    assert len(times) > 80
    # Both maps have axes east, north, up, and other origins.
    shift = here.prior.T_odom_rig[:, :3, 3] - there.at(times)[:, :3, 3]
    assert np.ptp(shift, axis=0).max() < 0.5
    forward = np.sum(here.prior.T_odom_rig[:, :3, 0] * there.at(times)[:, :3, 0], axis=1)
    assert forward.min() > np.cos(np.radians(5))


def test_topics_are_listed_by_inspect(bags: dict[Storage, list[Path]]) -> None:
    for storage in STORAGES:
        outcome = relocbench("inspect", bags[storage][0])
        assert outcome.status == 0, outcome.err
        assert "clouds of the frame 'lms_front'" in outcome.out
    outcome = relocbench("inspect", bags["rosbag1"][0], "--pictures", "check")
    assert (outcome.status, "is a recording; --pictures" in outcome.complaint) == (2, True)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ((), "needs a reference and at least one query, got 1"),
        (("--point-time", "t:h:scan"), "neither auto, none nor FIELD:UNIT:BASE"),
        (("--extrinsics", "nothing.yaml"), "nothing.yaml: missing; expected poses of sensors"),
        (("--min-range", 60, "--max-range", 50), "--min-range 60 is not below --max-range 50"),
        (("--odometry", "/ekf"), "--odometry: no topic '/ekf' in"),
    ],
)
def test_mistakes_are_one_line(
    arguments: tuple[object, ...], complaint: str, bags: dict[Storage, list[Path]], tmp_path: Path
) -> None:
    sources = bags["rosbag1"] if arguments else bags["rosbag1"][:1]
    outcome = build("rosbag", tmp_path / "out", *sources, *arguments)
    assert outcome.status == 2
    assert complaint in outcome.complaint


def test_one_bag_given_twice_and_two_of_one_name_are_told(bags: dict[Storage, list[Path]], tmp_path: Path) -> None:
    first = bags["rosbag1"][0]
    assert "is given twice" in build("rosbag", tmp_path / "out", first, first).complaint
    other = tmp_path / first.name
    shutil.copy(first, other)
    assert "is the second called" in build("rosbag", tmp_path / "out", first, other).complaint


def test_without_the_package_one_line_names_the_extra(
    bags: dict[Storage, list[Path]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import sys

    from relocbench.datasets.importers.rosbag import bag

    bag.forget()
    for name in ("rosbags.rosbag1", "rosbags.rosbag2"):
        monkeypatch.setitem(sys.modules, name, None)
    outcome = build("rosbag", tmp_path / "out", *bags["rosbag1"])
    assert outcome.status == 2
    assert "needs the package 'rosbags', which is not installed here (the extra 'bags' brings it)" in outcome.complaint


def test_a_bag_is_never_written_over(bags: dict[Storage, list[Path]], recordings: list[FieldRecording]) -> None:
    with pytest.raises(ConfigError, match="exists already"):
        write_bag(recordings[0], bags["rosbag1"][0])
