"""Rows of tables of poses and times that look right and are not, at every door that reads such tables."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from fuzz.lidar_drives import SEEDS as DRIVES
from odd_inputs import odd_input
from pose_doors import DOORS, Door, times_of
from refusals import ErrorData, Notes, noted, refused
from two_laps import laps, tum_lines

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.importers.boreas.recording import read_boreas
from relocbench.datasets.importers.clouds.recording import read_clouds
from relocbench.datasets.importers.colmap.model import read_model
from relocbench.datasets.importers.complex_urban.recording import read_complex_urban
from relocbench.datasets.importers.helipr.recording import read_helipr
from relocbench.datasets.importers.kitti.files import KittiSequence
from relocbench.datasets.importers.kitti360.recording import read_kitti360
from relocbench.datasets.importers.lidar_drives.drives import DriveFiles
from relocbench.datasets.importers.mulran.recording import read_mulran
from relocbench.datasets.importers.nclt.recording import read_nclt
from relocbench.datasets.importers.poses import pair_files
from relocbench.datasets.importers.poses import trajectories as poses_alone
from relocbench.datasets.sensors.pose_files import read_pose_file
from relocbench.errors import DatasetError
from relocbench.execution import Run
from relocbench.geometry import rotation_angle

POSES = laps(1)
COLUMNS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")
LOST = ("", "nan " * 11 + "nan", "# 1 0 0 0 0 1 0 0 0 0 1 0")
"""lines that say that there is no pose of a frame"""


@pytest.fixture(params=DOORS)
def door(request: pytest.FixtureRequest, tmp_path: Path) -> Door:
    chosen = DOORS[request.param]
    chosen.write(tmp_path)
    return chosen


def test_rows_whose_time_goes_back_are_named_and_not_sorted(door: Door, tmp_path: Path) -> None:
    table = tmp_path / door.table
    *head, first, second, third = table.read_text().splitlines()[: door.first + 3]
    table.write_text("\n".join([*head, first, third, second]) + "\n")
    line = len(head) + 3
    with refused(DatasetError, table, line, f"line {line - 1}"):
        door.times(tmp_path, Notes())


def test_rows_without_a_pose_and_rows_that_repeat_one_are_left_out_and_counted(door: Door, tmp_path: Path) -> None:
    table = tmp_path / door.table
    *head, first, second, third = table.read_text().splitlines()[: door.first + 3]
    whole = door.times(tmp_path, Notes())[:3]
    between = "," if "," in second else " "
    fields = second.split(between)
    if door.table.endswith("ins.csv"):
        lost = fields[:5] + ["NaN"] * 3 + fields[8:]
    else:
        lost = [fields[0], *["NaN"] * (len(fields) - 1)]
    table.write_text("\n".join([*head, first, first, between.join(lost), third]) + "\n")
    notes = Notes()
    assert door.times(tmp_path, notes) == [whole[0], whole[2]]
    assert noted(notes.notes, "1 rows", f"line {len(head) + 2}")
    assert noted(notes.notes, "NaN", "1", f"line {len(head) + 3}") or noted(notes.notes, "NaN", "2")


@pytest.mark.parametrize(
    ("name", "scans", "read"),
    [
        ("boreas", "lidar", lambda r, n: read_boreas(r / "boreas-2021-01-26-11-22", "a", reporter=n)),
        ("mulran", "Ouster", lambda r, n: read_mulran(r / "DCC01", "a", reporter=n)),
        ("helipr", "LiDAR/Ouster", lambda r, n: read_helipr(r / "KAIST05", "a", ("Ouster",), reporter=n)),
        ("nclt", "velodyne_sync", lambda r, n: read_nclt(r / "2012-01-08", "a", reporter=n)),
        ("complex-urban", "VLP_left", lambda r, n: read_complex_urban(r / "urban28", "a", ("VLP_left",), reporter=n)),
        ("folder-of-clouds", "scans", lambda r, n: read_clouds(r / "summer", "a", n)),
    ],
)
def test_scans_named_in_another_unit_have_the_same_times(
    tmp_path: Path, name: str, scans: str, read: Callable[[Path, Notes], DriveFiles]
) -> None:
    DRIVES[name](tmp_path)
    (tmp_path / "summer/times.txt").unlink(missing_ok=True)
    before = read(tmp_path, Notes()).lidars[0].times_ns
    for path in tmp_path.glob(f"**/{scans}/*.bin"):
        stem = f"{path.stem}000" if len(path.stem) == 16 else path.stem[:-3]
        path.rename(path.with_name(f"{stem}.bin"))
    notes = Notes()
    np.testing.assert_array_equal(read(tmp_path, notes).lidars[0].times_ns, before)
    assert noted(notes.notes, "microseconds") or noted(notes.notes, "nanoseconds")


def test_two_runs_in_one_table_are_not_sorted_into_one_another() -> None:
    folder = odd_input("02_two_runs_interleaved")
    with refused(DatasetError, "global_pose.csv", 17):
        read_mulran(folder / "DCC01", "a", "poses")


def test_a_row_of_nan_is_no_pose_at_its_time() -> None:
    notes = Notes()
    poses = read_pose_file(odd_input("01_nan_rows") / "traj.txt", reporter=notes).by_time
    assert list(poses) == [1_000_000_000, 1_100_000_000, 1_300_000_000]
    assert noted(notes.notes, "1 of 4", "NaN", "line 3")


@pytest.mark.parametrize(("name", "first"), [("us", 1403636580838555000), ("sec", 1403636580000000000)])
def test_whole_times_are_read_by_their_digits_and_said(name: str, first: int) -> None:
    notes = Notes()
    poses = read_pose_file(odd_input("04_seconds_or_microseconds_as_integers") / f"{name}.txt", reporter=notes)
    assert poses.times_ns[0] == first
    assert noted(notes.notes, "microseconds" if name == "us" else "seconds")


def test_a_header_that_names_the_real_part_first_is_obeyed() -> None:
    poses = list(read_pose_file(odd_input("03_header_names_wxyz") / "t.csv").transforms)
    np.testing.assert_allclose(poses[0][:2, :2], [[0, -1], [1, 0]], atol=1e-6)


def rows(header: str, columns: str) -> str:
    """The poses with their columns in the order of names ``t x y z qx qy qz qw``, other ones being zero."""
    lines = []
    for line in tum_lines(POSES).splitlines():
        named = dict(zip(COLUMNS, line.split(), strict=True))
        lines.append(",".join(named.get(column, "0") for column in columns.split()))
    return "\n".join([header, *lines]) + "\n"


HEADERS = {
    "real part first": rows("#t,x,y,z,qw,qx,qy,qz", "t x y z qw qx qy qz"),
    "axes in another order": rows("time,y,x,z,qx,qy,qz,qw", "t y x z qx qy qz qw"),
    "a number before the time": rows("num,t,x,y,z,qx,qy,qz,qw", "n t x y z qx qy qz qw"),
    "EuRoC": rows(
        "#timestamp [s], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], "
        "v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], b_w_RS_S_x [rad s^-1], b_w_RS_S_y [rad s^-1], "
        "b_w_RS_S_z [rad s^-1], b_a_RS_S_x [m s^-2], b_a_RS_S_y [m s^-2], b_a_RS_S_z [m s^-2]",
        "t x y z qw qx qy qz v v v b b b b b b",
    ),
    "rostopic": rows(
        "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.pose.position.x,"
        "field.pose.position.y,field.pose.position.z,field.pose.orientation.x,field.pose.orientation.y,"
        "field.pose.orientation.z,field.pose.orientation.w",
        "a b t c x y z qx qy qz qw",
    ),
    "words, then names and units": "# made up\n"
    + rows("# time (s) tx (m) ty (m) tz (m) qw qx qy qz", "t x y z qw qx qy qz"),
    "no header": "# by hand, x y z in metres\n" + tum_lines(POSES),
}


@pytest.mark.parametrize("name", HEADERS)
def test_columns_are_those_that_the_header_names(tmp_path: Path, name: str) -> None:
    path = tmp_path / "t.csv"
    path.write_text(HEADERS[name])
    found = read_pose_file(path)
    assert found.times_ns.tolist() == list(POSES)
    np.testing.assert_allclose(found.transforms, np.array(list(POSES.values())), atol=1e-12)


@pytest.mark.parametrize(
    ("text", "order", "told"),
    [
        (HEADERS["real part first"], "xyzw", (1, "qw qx qy qz", "xyzw")),
        ("t,x,y,z,roll,pitch,yaw\n1.0,0,0,0,0,0,0\n", None, (1,)),
        ("t,x,y,z,qx,qy,qz,qw\n1.0,0,0,0,0,0,0,1,5\n", None, (2, 8, 9)),
        ("1,5 1,0 2,25 0,0 0,0 0,0 0,0 1,0\n", None, (1, "1,5")),
        ("1,5;1,0;2,25;0,0;0,0;0,0;0,0;1,0\n", None, (1, "1,5")),
        ("1403636580 0 0 0 0 0 0 1\n1403636580838555 1 0 0 0 0 0 1\n", None, (2, 16, 10)),
    ],
)
def test_a_table_that_contradicts_itself_is_refused(tmp_path: Path, text: str, order: str, told: ErrorData) -> None:
    path = tmp_path / "t.csv"
    path.write_text(text)
    with refused(DatasetError, path, *told):
        read_pose_file(path, order)  # type: ignore[arg-type]


def test_a_default_order_of_quaternions_gives_way_to_the_header_and_a_given_one_does_not(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text(HEADERS["real part first"])
    options = {"pair_rule": "step"}
    poses_alone.build([path], poses_alone.Options.model_validate(options), tmp_path / "out", Notes(), Run(1))
    first = next(iter(Dataset(tmp_path / "out").traversal("t").poses.values()))
    assert rotation_angle(first[:3, :3].T @ next(iter(POSES.values()))[:3, :3]) < 1e-6
    given = poses_alone.Options.model_validate({**options, "quaternions": "xyzw"})
    with refused(DatasetError, path, 1):
        poses_alone.build([path], given, tmp_path / "refused", Notes(), Run(1))


# --- joined by position ---


def of_kitti(root: Path, notes: Notes | None = None) -> dict[int, float]:
    """Image -> metres ahead, of what the door ``kitti`` takes of a recording with half a metre between frames."""
    sequence = KittiSequence(root, "00")
    frames = sequence.image_frames("image_0")
    times, poses, _ = sequence.times_and_poses(10.0, max(frames) + 1, notes or Notes())
    for frame in poses.keys() & times.keys():
        assert times[frame] == frame * 100_000_000
    return {frame: float(poses[frame][2, 3]) for frame in frames if frame in poses and frame in times}


@dataclass(frozen=True)
class Sequence:
    """Frames 0 to 5 in the layout of KITTI, half a metre apart."""

    root: Path

    def table(self, name: str) -> Path:
        return self.root / {"poses": "poses/00.txt", "times": "sequences/00/times.txt"}[name]

    def put(self, name: str, frame: int, *lines: str) -> None:
        """Put lines in the place of that of a frame."""
        found = self.table(name).read_text().splitlines()
        found[frame : frame + 1] = lines
        self.table(name).write_text("\n".join(found) + "\n")


@pytest.fixture
def sequence(tmp_path: Path) -> Sequence:
    made = Sequence(tmp_path)
    for i in range(6):
        path = tmp_path / "sequences/00/image_0" / f"{i:06d}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    (tmp_path / "poses").mkdir()
    made.table("poses").write_text("".join(f"1 0 0 0 0 1 0 0 0 0 1 {i / 2}\n" for i in range(6)))
    made.table("times").write_text("".join(f"{i / 10:.6e}\n" for i in range(6)))
    return made


@pytest.mark.parametrize("lost", [*LOST, "  # dropped frame\n"])
@pytest.mark.parametrize("frame", [0, 2, 5])
def test_a_row_without_values_takes_the_pose_of_its_image_alone(sequence: Sequence, lost: str, frame: int) -> None:
    sequence.put("poses", frame, *lost.split("\n"))
    assert of_kitti(sequence.root) == {i: i / 2 for i in range(6) if i != frame}


@pytest.mark.parametrize("frame", [0, 2, 5])
def test_a_row_without_values_takes_the_time_of_its_image_alone(sequence: Sequence, frame: int) -> None:
    sequence.put("times", frame, "")
    assert of_kitti(sequence.root) == {i: i / 2 for i in range(6) if i != frame}


@pytest.mark.parametrize("name", ["poses", "times"])
@pytest.mark.parametrize("frame", [0, 2, 5])
def test_a_missing_row_is_refused_with_both_counts(sequence: Sequence, name: str, frame: int) -> None:
    sequence.put(name, frame)
    with refused(DatasetError, sequence.table(name), None, "5 rows", "number 5"):
        of_kitti(sequence.root)
    (sequence.root / "sequences/00/image_0/000005.png").unlink()  # now images do not tell
    with refused(DatasetError, sequence.table("poses"), None, 5, 6):
        of_kitti(sequence.root)


def test_comments_and_more_rows_than_images_are_read(sequence: Sequence) -> None:
    for name in ("poses", "times"):
        path = sequence.table(name)
        path.write_text(f"# row i is of frame i\n{path.read_text()}\n\n")
    for frame in (0, 3, 5):
        (sequence.root / "sequences/00/image_0" / f"{frame:06d}.png").unlink()
    assert of_kitti(sequence.root) == {1: 0.5, 2: 1.0, 4: 2.0}


@pytest.mark.parametrize(
    ("case", "found"),
    [
        ("14_empty_line_in_times", {0: 0.0, 1: 0.5, 2: 1.0, 4: 2.0, 5: 2.5}),
        ("15_empty_line_in_poses", {0: 0.0, 1: 0.5, 3: 1.5, 4: 2.0, 5: 2.5}),
    ],
)
def test_empty_lines_of_kitti_are_lost_frames(case: str, found: dict[int, float]) -> None:
    assert of_kitti(odd_input(case) / "k") == found


def test_the_first_of_the_poses_of_kitti_is_missing() -> None:
    with refused(DatasetError, "00.txt", None, "5 rows", "6 rows"):
        of_kitti(odd_input("15_first_pose_missing") / "k")


def test_rows_of_poses_and_of_their_times_belong_together(tmp_path: Path) -> None:
    path, times = tmp_path / "k.txt", tmp_path / "k.times.txt"

    def written(lost: str, lost_time: str) -> dict[int, Array]:
        rows = [f"1 0 0 {i} 0 1 0 0 0 0 1 0" for i in range(4)]
        path.write_text("\n".join([rows[0], lost, *rows[2:]]) + "\n")
        times.write_text("\n".join(["1.0", "2.0", lost_time, "4.0"]) + "\n")
        return read_pose_file(path).by_time

    for lost in LOST:
        assert {t // 10**9: T[0, 3] for t, T in written(lost, "3.0").items()} == {1: 0, 3: 2, 4: 3}
    assert {t // 10**9: T[0, 3] for t, T in written("", "").items()} == {1: 0, 4: 3}
    path.write_text("".join(f"1 0 0 {i} 0 1 0 0 0 0 1 0\n" for i in range(3)))
    with refused(DatasetError, times, None, 4, "k.txt", 3):
        read_pose_file(path)


def test_times_of_kitti_360_are_those_of_their_frames(tmp_path: Path) -> None:
    DRIVES["kitti-360"](tmp_path)
    folder = tmp_path / "data_3d_raw/2013_05_28_drive_0000_sync/velodyne_points"
    table = folder / "timestamps.txt"
    dates = table.read_text().splitlines()
    whole = read_kitti360(tmp_path, "0000", "a", "poses")
    table.write_text("\n".join([dates[0], "", dates[2]]) + "\n")
    notes = Notes()
    drive = read_kitti360(tmp_path, "0000", "a", "poses", notes)
    assert drive.lidars[0].times_ns.tolist() == whole.lidars[0].times_ns[[0, 2]].tolist()
    assert times_of(drive.poses) == [t for t in times_of(whole.poses) if t != whole.lidars[0].times_ns[1]]
    assert noted(notes.notes, "1 of 3")
    table.write_text("\n".join([*dates[1:], dates[2].replace(":02.2", ":02.3")]) + "\n")
    with refused(DatasetError, "image_00/timestamps.txt", None, "frame 0"):
        read_kitti360(tmp_path, "0000", "a")


def test_a_cloud_whose_row_of_times_is_empty_is_left_out(tmp_path: Path) -> None:
    DRIVES["folder-of-clouds"](tmp_path)
    folder = tmp_path / "summer"
    times = (folder / "times.txt").read_text().splitlines()
    rows = [f"1 0 0 {i} 0 1 0 0 0 0 1 0" for i in range(3)]
    (folder / "poses.txt").write_text("\n".join(rows) + "\n")
    (folder / "times.txt").write_text("\n".join([times[0], "", times[2]]) + "\n")
    notes = Notes()
    drive = read_clouds(folder, "a", notes)
    assert drive.poses is not None
    assert drive.poses.T_odom_rig[:, 0, 3].tolist() == [0.0, 2.0]
    assert drive.lidars[0].times_ns.tolist() == [int(times[0]), int(times[2])]
    assert noted(notes.notes, "1 of 3")
    for k, path in enumerate(sorted((folder / "scans").iterdir())):
        path.rename(path.with_name(f"{k + (k > 0):06d}.bin"))  # 0, 2, 3: rows are those of these numbers
    rows = [f"1 0 0 {i} 0 1 0 0 0 0 1 0" for i in range(4)]
    (folder / "poses.txt").write_text("\n".join(rows) + "\n")
    (folder / "times.txt").write_text("\n".join(["timestamp", times[0], "", *times[1:]]) + "\n")
    drive = read_clouds(folder, "a", Notes())
    assert drive.lidars[0].times_ns.tolist() == list(map(int, times))
    assert drive.poses is not None
    assert drive.poses.T_odom_rig[:, 0, 3].tolist() == [0.0, 2.0, 3.0]
    (folder / "times.txt").unlink()
    by_rate = read_clouds(folder, "a", Notes(), rate_hz=10.0)
    assert by_rate.lidars[0].times_ns.tolist() == [0, 200_000_000, 300_000_000]
    (folder / "times.txt").write_text("\n".join(times[:2]) + "\n")
    with refused(DatasetError, "times.txt", None, 2, 3):
        read_clouds(folder, "a", Notes())


# --- doors of photographs and of pairs ---


def test_an_image_of_a_model_without_a_pose_is_left_out(tmp_path: Path) -> None:
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 64 48 50 50 32 24\n")
    (tmp_path / "points3D.txt").write_text("")
    rows = [f"{i} 1 0 0 0 0 0 {'nan' if i == 2 else 0} 1 {i}.png\n\n" for i in (1, 2, 3)]
    (tmp_path / "images.txt").write_text("".join(rows))
    notes = Notes()
    assert list(read_model(tmp_path, notes).images) == [1, 3]
    assert noted(notes.notes, "1 of 3", "NaN")


def test_poses_of_microseconds_are_found_for_pairs_of_microseconds(tmp_path: Path) -> None:
    pairs, poses = tmp_path / "a__b__cam0.txt", tmp_path / "poses.txt"
    times = [1403636580838555 + 100_000 * i for i in range(3)]
    pairs.write_text("".join(f"{t} {t + 50_000} 0 0 1 0 0 0 1\n" for t in times))
    poses.write_text("".join(f"{t} {i} 0 0 0 0 0 1\n" for i, t in enumerate(times)))
    notes = Notes()
    options = pair_files.Options.model_validate({"trajectories": (f"a={poses}",)})
    dataset = pair_files.build([pairs], options, tmp_path / "out", notes, Run(1))
    assert list(dataset.traversal("a").poses) == times
    assert noted(notes.notes, "a", "microseconds")


def test_a_pair_without_a_pose_is_withheld(tmp_path: Path) -> None:
    path = tmp_path / "a__b__cam0.txt"
    path.write_text("1 2 0 0 0 0 0 0 1\n3 4 nan nan nan nan nan nan nan\n")
    notes = Notes()
    options = pair_files.Options.model_validate({})
    dataset = pair_files.build([path], options, tmp_path / "out", notes, Run(1))
    assert [pair.T_query_ref is None for pair in dataset.pair_set("a__b__cam0").pairs] == [False, True]
    assert noted(notes.notes, "1 of 2")
