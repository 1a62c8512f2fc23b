"""Folders of clouds with times: what is found in them, and what is said where it cannot be told."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from command_line import relocbench
from lidar_layouts import compensated, matrix_rows, pose_times, quaternion_rows, scans_of, write
from projected_depth import agrees
from recorded_street import SMALL, StreetDrive, assert_pairs_are_right, errors_of, from_poses, with_camera
from refusals import ErrorData, Notes, noted, refused

from relocbench.arrays import Array, Indices
from relocbench.datasets.importers.clouds.recording import SweptClouds, read_clouds
from relocbench.datasets.synthetic.lidar.lidar import LidarScene
from relocbench.errors import DatasetError
from relocbench.geometry import invert, transform_to_tq


def write_clouds(
    drive: StreetDrive, folder: Path, name: Callable[[int, int], str], content: Callable[[Array, int], bytes]
) -> Path:
    """Clouds with names by number and time; content from columns x y z intensity ring seconds and the time."""
    for number, scan in enumerate(scans_of(drive)):
        ones = np.ones(len(scan.points))
        table = np.column_stack([scan.points, 0.3 * ones, scan.ring, scan.offsets_ns / 1e9])
        write(folder / name(number, scan.middle_ns), content(table, scan.middle_ns))
    return folder


def floats(columns: int, kind: str = "<f4") -> Callable[[Array, int], bytes]:
    return lambda table, _: table[:, :columns].astype(kind).tobytes()


def pcd(time_field: str, kind: str, factor: float, absolute: bool) -> Callable[[Array, int], bytes]:
    def content(table: Array, time_ns: int) -> bytes:
        row = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), (time_field, kind)])
        out = np.empty(len(table), dtype=row)
        for k, axis in enumerate("xyz"):
            out[axis] = table[:, k]
        offsets = np.rint(table[:, 5] * 1e9).astype(np.int64)
        out[time_field] = (offsets + (time_ns if absolute else 0)) * factor if "f" in kind else offsets + time_ns
        size = np.dtype(kind).itemsize
        head = (
            f"VERSION 0.7\nFIELDS x y z {time_field}\nSIZE 4 4 4 {size}\nTYPE F F F {'F' if 'f' in kind else 'U'}\n"
            f"COUNT 1 1 1 1\nWIDTH {len(out)}\nHEIGHT 1\nPOINTS {len(out)}\nDATA binary\n"
        )
        return head.encode() + out.tobytes()

    return content


def by_time(suffix: str) -> Callable[[int, int], str]:
    return lambda _, time_ns: f"{time_ns}.{suffix}"


def read(folder: Path, **options: object) -> tuple[Notes, list[Indices]]:
    """What was said, and the times of the points of the third cloud relative to its own."""
    spoken = Notes()
    lidar = read_clouds(folder, "a", spoken, **options).lidars[0]  # type: ignore[arg-type]
    scan = lidar.read(3)
    return spoken, [lidar.times_ns, scan.times_ns - lidar.times_ns[3]]


@pytest.mark.parametrize(
    ("content", "suffix", "said"),
    [
        (floats(4), "bin", "float32 x y z intensity, no times of points; taken to be motion-compensated"),
        (floats(3), "bin", "float32 x y z, no times of points"),
        (floats(6), "bin", "float32 x y z intensity ring time, times of points in time, s, relative to the cloud's"),
        (floats(4, "<f8"), "bin", "float64 x y z intensity, no times of points"),
        (floats(3, "<f8"), "bin", "float64 x y z, no times of points"),
        (pcd("timestamp", "<f8", 1e-9, True), "pcd", "times of points in timestamp, s, absolute"),
        (pcd("t", "<f4", 1.0, False), "pcd", "times of points in t, ns, relative to the cloud's"),
        (pcd("time", "<f4", 1e-6, False), "pcd", "times of points in time, ms, relative to the cloud's"),
        (pcd("offset_time", "<u8", 1.0, True), "pcd", "times of points in offset_time, ns, absolute"),
    ],
)
def test_columns_types_and_times_of_points_are_found(
    drives: list[StreetDrive], tmp_path: Path, content: Callable[[Array, int], bytes], suffix: str, said: str
) -> None:
    write_clouds(drives[0], tmp_path, by_time(suffix), content)
    spoken, (times, since) = read(tmp_path)
    assert any(said in note for note in spoken.notes), spoken.notes
    np.testing.assert_array_equal(times, drives[0].layout.times["lidar"])
    scan = scans_of(drives[0])[3]
    if "no times" in said:
        assert not since.any()
    else:
        assert np.abs(since.min() - scan.offsets_ns.min()) < 2_000_000
        assert np.abs(np.ptp(since) - np.ptp(scan.offsets_ns)) < 2_000_000


def test_points_in_firing_order_are_told_from_other_columns(drives: list[StreetDrive], tmp_path: Path) -> None:
    """Beam by beam of one azimuth after the other, as many recorders write them."""
    for columns in (3, 4, 6):
        folder = tmp_path / str(columns)

        def content(table: Array, _: int, columns: int = columns) -> bytes:
            return table[np.lexsort((table[:, 4], table[:, 5]))][:, :columns].astype("<f4").tobytes()

        spoken, _ = read(write_clouds(drives[0], folder, by_time("bin"), content))
        names = ["x", "y", "z", "intensity", "ring", "time"][:columns]
        assert any(f"float32 {' '.join(names)}, " in note for note in spoken.notes), spoken.notes


@pytest.mark.parametrize(
    ("unit", "form"),
    [
        ("nanoseconds", str),
        ("microseconds", lambda ns: str(ns // 1000)),
        ("milliseconds", lambda ns: str(ns // 10**6)),
        ("seconds", lambda ns: f"{ns // 10**9}.{ns % 10**9:09d}"),
    ],
)
@pytest.mark.parametrize("where", ["names", "a time a line", "name and time", "time and name"])
def test_times_are_found_in_names_and_files(
    drives: list[StreetDrive], tmp_path: Path, unit: str, form: Callable[[int], str], where: str
) -> None:
    if where == "names":
        write_clouds(drives[0], tmp_path / "clouds", lambda _, ns: f"{form(ns)}.bin", floats(4))
    else:
        write_clouds(drives[0], tmp_path / "clouds", lambda number, _: f"cloud {number}.bin", floats(4))
        times = drives[0].layout.times["lidar"].tolist()
        rows = {
            "a time a line": [form(t) for t in times],
            "name and time": [f"cloud-{i}.bin,{form(t)}" for i, t in enumerate(times)],
            "time and name": ["time cloud", *(f"{form(t)} clouds/cloud-{i}.bin" for i, t in enumerate(times))],
        }[where]
        for path in (tmp_path / "clouds").iterdir():
            path.rename(path.with_name(path.name.replace(" ", "-")))
        write(tmp_path / "times.txt", "\n".join(rows) + "\n")
    spoken, (times_ns, _) = read(tmp_path)
    np.testing.assert_array_equal(times_ns, drives[0].layout.times["lidar"])
    assert f", in {unit}" in spoken.notes[0]


def test_clouds_with_times_of_points_are_where_the_surfaces_are(
    drives: list[StreetDrive], scene: LidarScene, tmp_path: Path
) -> None:
    drive = drives[0]
    write_clouds(drive, tmp_path, by_time("pcd"), pcd("timestamp", "<f8", 1e-9, True))
    times = pose_times(drive)
    write(tmp_path / "poses.txt", quaternion_rows(times, drive.T_world_car(times) @ drive.T_car_lidar))
    recording = with_camera(drive, from_poses(read_clouds(tmp_path, "a", Notes())))
    assert agrees(errors_of(drive, recording, "camera", 6, scene))
    write(tmp_path / "poses.txt", quaternion_rows(times, invert(drive.T_world_car(times) @ drive.T_car_lidar)))
    recording = with_camera(drive, from_poses(read_clouds(tmp_path, "a", Notes())))
    assert not agrees(errors_of(drive, recording, "camera", 6, scene))


def test_distorted_clouds_without_times_are_placed_by_azimuth(
    drives: list[StreetDrive], scene: LidarScene, tmp_path: Path
) -> None:
    drive = drives[0]
    write_clouds(drive, tmp_path, by_time("bin"), floats(4))
    at = drive.layout.times["lidar"]
    poses = drive.T_world_car(at) @ drive.T_car_lidar
    write(tmp_path / "poses.txt", matrix_rows(at, poses, " "))
    rows = [line.split(" ", 1)[1] for line in (tmp_path / "poses.txt").read_text().splitlines()]
    write(tmp_path / "poses.txt", "\n".join(rows) + "\n")  # twelve numbers for each cloud
    right = read_clouds(tmp_path, "a", Notes(), motion="distorted")
    assert agrees(errors_of(drive, with_camera(drive, from_poses(right)), "camera", 6, scene))
    wrong = read_clouds(tmp_path, "a", Notes())
    assert not agrees(errors_of(drive, with_camera(drive, from_poses(wrong)), "camera", 6, scene))
    write(tmp_path / "poses.txt", "\n".join(rows[1:]) + "\n")
    with refused(DatasetError, "poses.txt", None, "25", "26"):
        read_clouds(tmp_path, "a", Notes())


@pytest.mark.thorough
def test_whether_motion_distorts_clouds_is_told_from_them(drives: list[StreetDrive], tmp_path: Path) -> None:
    drive = drives[0]
    write_clouds(drive, tmp_path / "distorted", by_time("bin"), floats(4))
    for found in scans_of(drive):
        points = compensated(drive, found)
        table = np.column_stack([points, np.ones(len(points))]).astype("<f4")
        write(tmp_path / "compensated" / f"{found.middle_ns}.bin", table.tobytes())
    for motion, turning in (("distorted", True), ("compensated", False)):
        spoken = Notes()
        lidar = read_clouds(tmp_path / motion, "a", spoken, motion="auto").lidars[0]
        assert isinstance(lidar, SweptClouds) == turning, spoken.notes
        assert noted(spoken.notes, motion), spoken.notes
    write_clouds(drive, tmp_path / "timed", by_time("bin"), floats(6))
    spoken = Notes()
    read_clouds(tmp_path / "timed", "a", spoken, motion="auto")
    assert not noted(spoken.notes, "--motion")


def numbered(number: int, _: int) -> str:
    return f"{number}.bin"


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda d: None, ("25.bin", None, "times.txt", "--rate-hz")),
        (lambda d: write(d / "times.txt", "1.5\n2.5\n"), ("times.txt", None, "2", "26")),
        (
            lambda d: write(d / "times.txt", "".join(f"{i}.5 7.bin\n" for i in range(26))),
            ("times.txt", 2, "7.bin"),
        ),
        (lambda d: write(d / "times.txt", "1.5 99.bin\n"), ("times.txt", 1)),
        (lambda d: write(d / "times.txt", "1.5 2 3\n"), ("times.txt", 1)),
        (lambda d: write(d / "times.txt", "1.5\n" * 26), ("times.txt",)),
        (lambda d: write(d / "times.txt", ""), ("times.txt",)),
        (lambda d: write(d / "3.pcd", b"x"), ("", None, "26 .bin")),
        (lambda d: write(d / "3.bin", b""), ("3.bin",)),
        (lambda d: [p.unlink() for p in d.iterdir()], ("", None, ".ply", ".pcd")),
    ],
)
def test_what_cannot_be_told_is_said(
    drives: list[StreetDrive], tmp_path: Path, spoil: Callable[[Path], object], words: ErrorData
) -> None:
    write_clouds(drives[0], tmp_path, numbered, floats(4))
    spoil(tmp_path)
    with refused(DatasetError, *words):
        read_clouds(tmp_path, "a", Notes())


def test_bytes_that_are_no_points_are_refused_and_columns_can_be_given(
    drives: list[StreetDrive], tmp_path: Path
) -> None:
    noise = np.random.default_rng(0)

    def junk(_: Array, __: int) -> bytes:
        return noise.bytes(4800)

    write_clouds(drives[0], tmp_path / "junk", by_time("bin"), junk)
    with refused(DatasetError, "1709287200040000000.bin", None, "float32", "float64"):
        read_clouds(tmp_path / "junk", "a", Notes())

    def swapped(table: Array, _: int) -> bytes:
        return table[:, [5, 0, 1, 2, 3]].astype("<f4").tobytes()

    folder = write_clouds(drives[0], tmp_path / "swapped", by_time("bin"), swapped)
    spoken, (_, since) = read(folder, columns=("time", "x", "y", "z", "intensity"))
    assert any("times of points in time, s" in note for note in spoken.notes)
    assert np.ptp(since) > 50_000_000


def test_a_cloud_without_points_in_the_middle_of_the_drive_does_no_harm(
    drives: list[StreetDrive], tmp_path: Path
) -> None:
    write_clouds(drives[0], tmp_path, by_time("bin"), floats(4))
    sorted(tmp_path.iterdir())[13].write_bytes(np.zeros((300, 4), dtype="<f4").tobytes())
    spoken = Notes()
    lidar = read_clouds(tmp_path, "a", spoken).lidars[0]
    assert noted(spoken.notes, "float32 x y z intensity")
    assert (len(lidar.read(13).points), len(lidar.read(12).points) > 200) == (0, True)


def test_a_rate_numbers_clouds_in_the_order_that_people_count(drives: list[StreetDrive], tmp_path: Path) -> None:
    write_clouds(drives[0], tmp_path, numbered, floats(4))
    lidar = read_clouds(tmp_path, "a", Notes(), rate_hz=10.0).lidars[0]
    np.testing.assert_array_equal(lidar.times_ns, np.arange(26) * 100_000_000)
    np.testing.assert_allclose(lidar.read(10).points[:50], scans_of(drives[0])[10].points[:50])


@pytest.mark.thorough
@pytest.mark.parametrize("posed", [True, False])
def test_folders_with_a_camera_are_brought_together_by_one_command(
    drives: list[StreetDrive], tmp_path: Path, posed: bool
) -> None:
    """Without poses, odometry is computed from the clouds, which takes longer than all else."""
    folders = [tmp_path / name for name in ("summer", "winter")]
    for drive, folder in zip(drives, folders, strict=True):
        if posed:
            times = pose_times(drive)
            write(folder / "poses.txt", quaternion_rows(times, drive.T_world_car(times) @ drive.T_car_lidar))
        write_clouds(drive, folder / "scans", by_time("pcd"), pcd("timestamp", "<f8", 1e-9, True))
        for path in (drive.folder / "camera").iterdir():
            target = folder / "images" / f"{int(path.stem) * 1000}.png"
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, target)
        t, q = transform_to_tq(invert(drive.T_car_lidar) @ drive.T_car_cam)
        pose = {"translation_m": t.tolist(), "quaternion_xyzw": q.tolist()}
        camera = drive.layout.cameras["camera"].camera.to_dict()
        write(folder / "camera.yaml", yaml.safe_dump({**camera, "T_rig_cam": pose}))
    out = tmp_path / "dataset"
    outcome = relocbench("build-dataset", "clouds", *folders, "--out", out, "-j", 1, *SMALL)
    assert outcome.status == 0, outcome.err
    assert "timestamp" in outcome.err
    assert_pairs_are_right(out, "summer__winter__cam0", *drives)
