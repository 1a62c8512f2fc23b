"""Poses that no drive can have are named, and nothing is interpolated towards them or paired across them."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path

import cv2
import numpy as np
import pytest
from odd_inputs import odd_input
from pose_doors import DOORS
from refusals import Notes, noted, refused
from scipy.spatial.transform import Rotation

from relocbench.arrays import Array, Times
from relocbench.datasets.checks.validation import validate_dataset
from relocbench.datasets.core.build_options import DatasetOptions
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.schema import Condition
from relocbench.datasets.groundtruth.odometry.jumps import interrupted
from relocbench.datasets.importers import importer
from relocbench.datasets.importers.lidar_drives.drives import rig_trajectory
from relocbench.datasets.motion.collections import far_from_all
from relocbench.datasets.motion.holes import find_holes
from relocbench.datasets.motion.judging import judge
from relocbench.datasets.motion.orientation import doubts_of_axes
from relocbench.datasets.motion.worlds import doubt_of_world
from relocbench.datasets.sensors.plausible_poses import plausible
from relocbench.datasets.sensors.pose_tables import PoseTable
from relocbench.datasets.sensors.recording import FieldRecording, Trajectory
from relocbench.errors import DatasetError
from relocbench.execution import Run
from relocbench.geometry import invert, make_transform, so3_exp
from relocbench.progress import Silent

COUNT = 300


def drive(rate_hz: float = 10.0, metres: float = 1.0) -> tuple[Times, Array]:
    """A car that follows a winding road, with noise of 1 cm and 0.05 deg; ``metres`` a second of a tenth."""
    rng = np.random.default_rng(1)
    along = np.arange(COUNT) * metres * 10.0 / rate_hz
    yaw = 0.8 * np.sin(along / 60.0)
    position = np.cumsum(np.column_stack([np.cos(yaw), np.sin(yaw), 0 * yaw]) * (along[1] - along[0]), axis=0)
    noise = rng.normal(size=(COUNT, 6)) * [0.01, 0.01, 0.01, 1e-3, 1e-3, 1e-3]
    rotation = so3_exp(np.column_stack([0 * yaw, 0 * yaw, yaw]) + noise[:, 3:])
    return (1e9 + np.arange(COUNT) * 1e9 / rate_hz).astype(np.int64), make_transform(rotation, position + noise[:, :3])


def built(kind: str, sources: list[Path], out: Path, **options: object) -> tuple[Dataset, Notes]:
    module, notes = importer(kind), Notes()
    chosen = module.Options.model_validate(options)
    assert isinstance(chosen, DatasetOptions)
    return module.build(sources, chosen, out, notes, Run(workers=0)), notes


@pytest.mark.parametrize("metres", [3.36e9, 40.0, 5.0])
@pytest.mark.parametrize(("first", "last"), [(0, 0), (120, 120), (120, 124), (COUNT - 1, COUNT - 1)])
def test_outlier_poses_are_left_out_by_line_and_the_way_between_is_unknown(
    metres: float, first: int, last: int
) -> None:
    times, T = drive()
    T[first : last + 1, :3, 3] += [0.0, metres, 0.0]
    notes = Notes()
    found = plausible(PoseTable(Path("poses.txt"), times, T, range(2, COUNT + 2)), notes)
    assert sorted(set(times.tolist()) - set(found.times_ns.tolist())) == times[first : last + 1].tolist()
    assert found.breaks == ((first,) if first > 0 and last < COUNT - 1 else ())
    assert noted(notes.notes, f"poses.txt:{first + 2}")
    assert len(notes.notes) == 1


COLUMNS = {
    "boreas": 1, "mulran": 4, "helipr": 1, "nclt": 1, "complex-urban": 4, "clouds": 1, "robotcar": 5, "four-seasons": 1
}  # fmt: skip
"""door -> a column of positions"""


@pytest.mark.parametrize("name", COLUMNS)
@pytest.mark.parametrize("fault", ["outlier", "hole"])
def test_every_door_names_an_outlier_and_a_hole_with_its_line(name: str, fault: str, tmp_path: Path) -> None:
    door, notes, column = DOORS[name], Notes(), COLUMNS[name]
    door.write(tmp_path)
    table = tmp_path / door.table
    lines = table.read_text().splitlines()
    head, first, second = (
        lines[: door.first],
        *(Decimal(line.split(",")[0].split()[0]) for line in lines[door.first :][:2]),
    )
    between = "," if "," in lines[door.first] else " "
    fields = lines[door.first].split(between)
    rows = []
    for k in range(12):
        x = Decimal(fields[column]) + (k if k != 6 or fault == "hole" else 10**9)
        if fault == "hole" and k >= 6:
            x, k = x + 50, k + 30
        rows.append(between.join([str(first + k * (second - first)), *fields[1:column], str(x), *fields[column + 1 :]]))
    table.write_text("\n".join([*head, *rows]) + "\n")
    assert len(door.times(tmp_path, notes)) == (11 if fault == "outlier" else 12)
    assert noted(notes.notes, f"{table.name}:{len(head) + 7}", *(["51 m"] if fault == "hole" else []))


def test_a_shift_of_gnss_is_told_and_both_sides_stay() -> None:
    times, T = drive()
    T[150:, :3, 3] += [2.0, 2.0, 0.0]
    notes = Notes()
    found = plausible(PoseTable(Path("poses.txt"), times, T, range(1, COUNT + 1)), notes)
    assert len(found.times_ns) == COUNT
    assert found.breaks == (150,)
    assert noted(notes.notes, "poses.txt:151", "2.81 m")


def test_a_hole_is_bridged_only_up_to_a_gap_that_the_user_says() -> None:
    times, T = drive()
    rows = np.delete(np.arange(COUNT), np.arange(100, 109))
    table = PoseTable(Path("poses.txt"), times[rows], T[rows])
    inside, notes = times[[90, 104]], Notes()
    assert rig_trajectory(table, notes).covers(inside).tolist() == [True, False]
    assert noted(notes.notes, times[109], "1 s", "10 m")
    assert rig_trajectory(table, notes, max_gap_ns=10**9).covers(inside).all()


def test_odometry_that_is_computed_from_scans_is_interrupted_at_its_holes(tmp_path: Path) -> None:
    times, T = drive()
    rows, notes = np.delete(np.arange(COUNT), np.arange(100, 109)), Notes()
    recording = FieldRecording("a", tmp_path, Condition(), Trajectory(times[rows], T[rows]), (), odometry_lidar="top")
    assert interrupted(recording, notes).odometry.breaks == (100,)
    assert noted(notes.notes, times[109], "1 s")


def test_poses_of_a_system_that_lost_track_are_left_out_however_many_they_are() -> None:
    times, T = drive()
    T[180:240] = np.eye(4)
    (one,) = judge(times, T).outliers
    assert (one.first, one.last) == (180, 239)


def test_right_drives_are_silent_at_any_rate() -> None:
    for rate_hz, metres in ((10.0, 1.0), (200.0, 3.0), (1000.0, 1.0), (2.0, 1.5), (30.0, 0.05)):
        notes = Notes()
        plausible(PoseTable(Path("poses.txt"), *drive(rate_hz, metres)), notes)
        assert notes.notes == [], rate_hz


def test_what_cannot_be_one_drive_is_refused() -> None:
    times, T = drive()
    rng = np.random.default_rng(0)
    in_millimetres = T.copy()
    in_millimetres[:, :3, 3] *= 1000.0
    for wrong in (in_millimetres, T[rng.permutation(COUNT)]):
        with refused(DatasetError, "poses.txt"):
            plausible(PoseTable(Path("poses.txt"), times, wrong), Silent())


def test_numbers_of_frames_are_no_times() -> None:
    _, T = drive()
    assert judge(np.arange(COUNT, dtype=np.int64), T) == judge(np.arange(COUNT, dtype=np.int64) * 10**9, T)
    assert not judge(np.arange(COUNT, dtype=np.int64), T).hopeless


def test_a_stop_is_no_hole_and_a_slower_rate_is_none() -> None:
    times, T = drive()
    rows = np.delete(np.arange(COUNT), np.arange(100, 160))
    assert [hole.index for hole in find_holes(times[rows], T[rows])] == [100]
    standing = times + np.where(np.arange(COUNT) >= 100, 30 * 10**9, 0)
    T[100:, :3, 3] -= T[100, :3, 3] - T[99, :3, 3]
    assert find_holes(standing, T) == ()
    slower = np.concatenate([np.arange(150), np.arange(150, COUNT, 7)])
    assert find_holes(times[slower], T[slower]) == ()


@pytest.mark.parametrize("turn", [np.radians(30.0), np.radians(-90.0)])
def test_drives_of_one_shape_in_worlds_of_their_own_are_doubted(turn: float) -> None:
    times, T = drive()
    own = make_transform(so3_exp([0, 0, turn]), [40.0, -20.0, 0.0]) @ T
    summer, winter = (dict(zip(times.tolist(), poses, strict=True)) for poses in (T, own))
    assert f"{abs(np.degrees(turn)):.1f} deg" in doubt_of_world(summer, winter)
    assert doubt_of_world(summer, dict(summer), starts=False) == ""
    again = T + np.pad(np.array([[0.0, 0, 0, 1.5]]), ((0, 3), (0, 0)))
    assert doubt_of_world(summer, dict(zip(times.tolist(), again, strict=True))) == ""
    starts_alike = {time: make_transform(np.eye(3), T[0, :3, 3] + [0, k, 0]) for k, time in enumerate(times.tolist())}
    assert "millimetre" in doubt_of_world(summer, starts_alike)


def test_a_vehicle_with_other_axes_for_a_while_is_doubted() -> None:
    times, T = drive()
    assert list(doubts_of_axes(times, T)) == []
    T[200:220, :3, :3] = T[200:220, :3, :3] @ so3_exp([0.0, 0.0, np.radians(90.0)])
    (doubt,) = doubts_of_axes(times, T)
    assert str(times[200]) in doubt
    (inverse,) = doubts_of_axes(times, invert(drive()[1]))
    assert "inverted" in inverse


def test_a_photograph_far_from_all_others_is_found() -> None:
    positions = np.random.default_rng(0).normal(size=(40, 3)) * [300.0, 200.0, 5.0]
    assert far_from_all(positions) == []
    positions[7] = [3.36e9, 0.0, 0.0]
    assert [row for row, _ in far_from_all(positions)] == [7]


def test_an_outlier_takes_part_in_nothing_and_validate_finds_it_in_older_datasets(tmp_path: Path) -> None:
    folder = odd_input("12_outlier_pose")
    alone, notes = built("poses", [folder / "a.txt"], tmp_path / "alone")
    assert noted(notes.notes, "a.txt:5")
    assert max(p.distance_m or 0 for p in alone.pair_sets()[0].pairs) < 1
    generic, notes = built("generic", [folder / "drive"], tmp_path / "generic")
    assert noted(notes.notes, "poses.txt:5")
    poses = generic.traversal("drive").poses
    assert max(float(np.linalg.norm(T[:3, 3])) for T in poses.values()) < 10
    assert len(generic.pair_sets()[0].pairs) == 3
    table = alone.layout.traversal("a").poses
    table.write_text(table.read_text().replace("\n1500000000,2", "\n1500000000,1e6,0,0,0,0,0,1\n1500000001,2"))
    assert any(f.path == table and f.line == 6 for f in validate_dataset(alone.layout.root, Silent()).faults)


def write_kapture(root: Path, times: list[int], T_world_cam: Array) -> Path:
    """A drive of one camera with depth maps."""
    tables, posed, seen, deep = root / "sensors", [], [], []
    (tables / "records_data").mkdir(parents=True)
    size = "PINHOLE, 32, 24, 30, 30, 16, 12"
    (tables / "sensors.txt").write_text(f"# kapture format: 1.1\ncam, , camera, {size}\ndeep, , depth, {size}\n")
    for k, (time, T) in enumerate(zip(times, invert(T_world_cam), strict=True)):
        x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
        numbers = ", ".join(str(float(value)) for value in (w, x, y, z, *T[:3, 3]))
        posed += [f"{time}, {device}, {numbers}" for device in ("cam", "deep")]
        seen.append(f"{time}, cam, {k:04d}.png")
        deep.append(f"{time}, deep, {k:04d}.depth")
        cv2.imwrite(str(tables / "records_data" / f"{k:04d}.png"), np.full((24, 32), k, np.uint8))
        (tables / "records_data" / f"{k:04d}.depth").write_bytes(np.full((24, 32), 5.0, "<f4").tobytes())
    for name, rows in (("trajectories", posed), ("records_camera", seen), ("records_depth", deep)):
        (tables / f"{name}.txt").write_text("# kapture format: 1.1\n" + "\n".join(rows) + "\n")
    return root


@pytest.mark.thorough
@pytest.mark.parametrize("unit_ns", [1, 1000, 0])
def test_kapture_with_real_times_is_judged_as_a_drive_and_with_numbers_is_not(unit_ns: int, tmp_path: Path) -> None:
    _, T = drive()
    rows = np.delete(np.arange(60), np.arange(40, 50))
    T[20, :3, 3] += [0.0, 12.0, 0.0]
    times = [(1_553_180_224_000_000_000 + k * 100_000_000) // unit_ns if unit_ns else k for k in rows.tolist()]
    dataset, notes = built("kapture", [write_kapture(tmp_path / "drive", times, T[rows])], tmp_path / "set")
    names = set(dataset.traversal("map").names.values())
    assert ("0020.png" in names) == (unit_ns == 0)
    pairs = dataset.pair_sets()[0].pairs
    assert len(pairs) == (49 if unit_ns == 0 else 46)
    assert noted(notes.notes, "records_camera.txt:22") == (unit_ns > 0)
    assert noted(notes.notes, "records_camera.txt:42", "1.1 s") == (unit_ns > 0)


@pytest.mark.parametrize(("rate_hz", "metres", "left_out"), [(10.0, 1.5, 1), (2.0, 9.0, 1), (1.0, 20.0, 0)])
def test_an_outlier_exceeds_four_times_what_8_m_s2_do_between_two_poses(
    rate_hz: float, metres: float, left_out: int
) -> None:
    times, T = drive(rate_hz)
    T[120, :3, 3] += [0.0, 0.0, metres]
    assert len(judge(times, T).outliers) == left_out


def test_no_pair_steps_over_a_hole(tmp_path: Path) -> None:
    dataset, notes = built("poses", [odd_input("08_pair_across_hole") / "circle.txt"], tmp_path / "set")
    assert len(dataset.pair_sets()[0].pairs) == 287
    assert noted(notes.notes, "21.2", "17.1")


def test_worlds_and_quaternions_of_few_poses_are_doubted(tmp_path: Path) -> None:
    worlds = odd_input("11_own_worlds")
    _, notes = built("poses", [worlds / "summer.txt", worlds / "winter.txt"], tmp_path / "worlds")
    assert noted(notes.notes, "30.0")
    _, notes = built("poses", [odd_input("13_few_poses_no_hint") / "arc20.txt"], tmp_path / "arc")
    assert noted(notes.notes, "wxyz")
