"""Bags become datasets whose truth comes from their lidar, by the command a user types."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import recorded_street
from command_line import Outcome, relocbench
from made_bags import Storage, write_bag
from recorded_street import StreetDrive, assert_pairs_are_right
from recording_reading import hashes
from refusals import assert_names
from robotcar_street import SMALL, Built, RobotCarStreet

from relocbench.datasets.importers.robotcar.recording import read_robotcar_drives
from relocbench.datasets.importers.rosbag.reading import BagSettings
from relocbench.datasets.importers.rosbag.recording import open_bag, read_bag
from relocbench.datasets.importers.rosbag.roles import Wanted
from relocbench.datasets.sensors.recording import FieldRecording

AS_ROBOTCAR = ("--gnss", "/gnss/pose", "--max-range", 50, "--min-range", 0.1, "--lidar-sigma", 0.012, "--max-gap", 0.5)
STORAGES: tuple[Storage, ...] = get_args(Storage)


@pytest.fixture(scope="module")
def recordings(robotcar_street: RobotCarStreet) -> list[FieldRecording]:
    """Two drives along one street; without the right lens, of which bags would hold one more topic like the others."""
    return read_robotcar_drives(robotcar_street.folders, cameras=("stereo_left", "mono_rear"))


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


def build(out: Path, *arguments: object) -> Outcome:
    return relocbench("build-dataset", "rosbag", *arguments, "--out", out, "-j", 1, *SMALL)


@pytest.mark.thorough
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
def built(bags: dict[Storage, list[Path]], tmp_path_factory: pytest.TempPathFactory) -> Built:
    """The dataset from bags in MCAP."""
    out = tmp_path_factory.mktemp("datasets") / "mcap"
    outcome = build(out, *bags["mcap"], *AS_ROBOTCAR, "--cameras", "/stereo_left/image_raw")
    assert outcome.status == 0, outcome.err
    return Built(out, outcome)


@pytest.mark.thorough
def test_bags_give_the_dataset_that_the_robotcar_layout_gives(built: Built, robotcar_built: Built) -> None:
    there, here = robotcar_built.dataset, built.dataset
    assert here.pair_set_names == there.pair_set_names
    pairs = 0
    for name in there.pair_set_names:
        for a, b in zip(there.pair_set(name).pairs, here.pair_set(name).pairs, strict=True):
            assert (a.ref_timestamp_ns, a.query_timestamp_ns) == (b.ref_timestamp_ns, b.query_timestamp_ns)
            assert a.accepted == b.accepted
            if not a.accepted:
                continue
            assert a.T_query_ref is not None
            assert b.T_query_ref is not None
            # Files hold nine decimals, the last of which may be rounded up in one and down in the other.
            assert np.abs(a.T_query_ref - b.T_query_ref).max() < 1.5e-9
            pairs += 1
    assert pairs >= 5
    pictures = {name: value for name, value in hashes(robotcar_built.root / "traversals").items() if "/images/" in name}
    assert pictures
    found = hashes(built.root / "traversals")
    assert all(found[name] == value for name, value in pictures.items())


@pytest.mark.thorough
def test_bags_of_a_spinning_lidar_are_brought_together_by_one_command(
    drives: list[StreetDrive], tmp_path: Path
) -> None:
    """Which topics are read stands before the work starts."""
    paths = [tmp_path / drive.folder.name for drive in drives]
    for drive, path in zip(drives, paths, strict=True):
        write_bag(drive.source, path, "mcap")
    out = tmp_path / "dataset"
    chosen = ("--gnss", "/gnss/pose", "--cameras", "/camera/image_raw")
    outcome = relocbench("build-dataset", "rosbag", *paths, *chosen, "--out", out, "-j", 1, *recorded_street.SMALL)
    assert outcome.status == 0, outcome.err
    lines = outcome.err.splitlines()
    first = next(i for i, line in enumerate(lines) if "reading boreas" in line)
    assert_names("\n".join(lines[:first]), "", None, "/lidar/points", "--gnss", "--cameras")
    assert_pairs_are_right(out, f"{paths[0].name}__{paths[1].name}__camera", *drives)


@pytest.mark.thorough
def test_a_build_continues_from_its_index_and_ends_with_the_same_bytes(
    built: Built, bags: dict[Storage, list[Path]], tmp_path: Path
) -> None:
    out = shutil.copytree(built.root, tmp_path / "again")
    (out / "dataset.yaml").unlink()
    shutil.rmtree(out / "pairs")
    outcome = build(out, *bags["mcap"], *AS_ROBOTCAR, "--cameras", "/stereo_left/image_raw")
    assert outcome.status == 0, outcome.err
    assert "reading 2024" not in outcome.err
    assert hashes(out) == hashes(built.root)


@pytest.mark.thorough
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


@pytest.mark.thorough
def test_topics_are_listed_by_inspect(bags: dict[Storage, list[Path]]) -> None:
    for storage in STORAGES:
        outcome = relocbench("inspect", bags[storage][0])
        assert outcome.status == 0, outcome.err
        assert "'lms_front'" in outcome.out
    outcome = relocbench("inspect", bags["rosbag1"][0], "--pictures", "check")
    assert outcome.status == 2
    assert_names(outcome.complaint, bags["rosbag1"][0].name, None, "--pictures")


@pytest.mark.parametrize(
    ("arguments", "place", "names"),
    [
        ((), "", ("1",)),
        (("--point-time", "t:h:scan"), "", ("t:h:scan",)),
        (("--extrinsics", "nothing.yaml"), "nothing.yaml", ()),
        (("--min-range", 60, "--max-range", 50), "", ("--min-range 60", "--max-range 50")),
        (("--odometry", "/ekf"), "", ("--odometry", "/ekf")),
    ],
)
def test_mistakes_are_one_line(
    arguments: tuple[object, ...],
    place: str,
    names: tuple[str, ...],
    bags: dict[Storage, list[Path]],
    tmp_path: Path,
) -> None:
    sources = bags["rosbag1"] if arguments else bags["rosbag1"][:1]
    outcome = build(tmp_path / "out", *sources, *arguments)
    assert outcome.status == 2
    assert_names(outcome.complaint, place, None, *names)


def test_one_bag_given_twice_and_two_of_one_name_are_refused(bags: dict[Storage, list[Path]], tmp_path: Path) -> None:
    first = bags["rosbag1"][0]
    other = tmp_path / first.name
    shutil.copy(first, other)
    for second in (first, other):
        outcome = build(tmp_path / "out", first, second)
        assert outcome.status == 2
        assert_names(outcome.complaint, second.name)


def test_without_the_package_one_line_names_the_extra(
    bags: dict[Storage, list[Path]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import sys

    copies = [Path(shutil.copy(path, tmp_path)) for path in bags["rosbag1"]]  # which nothing has open
    for name in ("rosbags.rosbag1", "rosbags.rosbag2"):
        monkeypatch.setitem(sys.modules, name, None)
    outcome = build(tmp_path / "out", *copies)
    assert outcome.status == 2
    assert_names(outcome.complaint, "", None, "rosbags", "bags")
