"""Files of poses are read alike in every format, and quaternions in the wrong order are found out."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from refusals import ErrorData, refused
from repository import ROOT
from two_laps import START_NS, laps, matrix_lines, tum_lines

from relocbench.datasets.motion.orientation import likely_order
from relocbench.datasets.sensors.pose_files import read_pose_file
from relocbench.errors import DatasetError

POSES = laps(1)
REAL = Path(os.environ.get("RELOCBENCH_REAL_DATA", ROOT.parent / "shared" / "data")) / "fourseasons_trajectories"


def _own(path: Path) -> None:
    header = "timestamp_ns,tx,ty,tz,qx,qy,qz,qw\n"
    rows = tum_lines(POSES, between=",").splitlines()
    times = (str(time) for time in POSES)
    path.write_text(header + "".join(f"{t},{row.split(',', 1)[1]}\n" for t, row in zip(times, rows, strict=True)))


def _kitti(path: Path) -> None:
    path.write_text(matrix_lines(POSES, timed=False))
    path.with_name(f"{path.stem}.times.txt").write_text("".join(f"{t}\n" for t in POSES))


FORMATS: dict[str, Callable[[Path], object]] = {
    "TUM": lambda path: path.write_text(tum_lines(POSES)),
    "TUM with a comment and commas": lambda path: path.write_text("# t, tx\n" + tum_lines(POSES, between=", ")),
    "poses.csv": _own,
    "KITTI with times beside": _kitti,
    "KITTI with times before": lambda path: path.write_text(matrix_lines(POSES, timed=True)),
}


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_same_poses(tmp_path: Path, name: str) -> None:
    path = tmp_path / "a drive.txt"
    FORMATS[name](path)
    found = read_pose_file(path)
    assert found.times_ns.tolist() == list(POSES)
    np.testing.assert_allclose(found.transforms, np.array(list(POSES.values())), atol=1e-12)


def test_both_orders_of_quaternions_are_read_as_told(tmp_path: Path) -> None:
    path = tmp_path / "t.txt"
    path.write_text(tum_lines(POSES, "wxyz"))
    np.testing.assert_allclose(read_pose_file(path, "wxyz").transforms, list(POSES.values()), atol=1e-12)
    assert not np.allclose(read_pose_file(path).transforms, list(POSES.values()), atol=0.1)


@pytest.mark.parametrize("written", ["xyzw", "wxyz"])
@pytest.mark.parametrize("read", ["xyzw", "wxyz"])
def test_the_order_in_which_a_car_drives_ahead_is_the_likely_one(tmp_path: Path, written: str, read: str) -> None:
    path = tmp_path / "t.txt"
    path.write_text(tum_lines(POSES, written))
    poses = read_pose_file(path, read).transforms  # type: ignore[arg-type]
    assert likely_order(poses, read) == written  # type: ignore[arg-type]


def test_of_what_drives_straight_or_stands_no_order_is_told() -> None:
    straight = np.tile(np.eye(4), (50, 1, 1))
    assert likely_order(straight, "xyzw") == "xyzw"
    straight[:, 0, 3] = np.arange(50)
    assert likely_order(straight, "xyzw") == "xyzw"
    assert likely_order(straight, "wxyz") == "wxyz"


@pytest.mark.thorough
@pytest.mark.skipif(not REAL.is_dir(), reason=f"no real trajectories at {REAL}")
def test_the_order_of_real_trajectories_is_found() -> None:
    files = sorted(REAL.glob("*.txt"))
    assert len(files) == 3
    for path in files:
        wrong, right = (read_pose_file(path, order).transforms for order in ("xyzw", "wxyz"))
        assert (likely_order(wrong, "xyzw"), likely_order(right, "wxyz")) == ("wxyz", "wxyz"), path.name


LINE = f"{START_NS} 1 0 0 0 0 1 0 0 0 0 1 0"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ("t.txt",)),
        ("# nothing\n", ("t.txt",)),
        (
            "1.0 2 3\n",
            ("t.txt", 1, 8, 12),
        ),
        ("1.0 0 0 0 0 0 0 1\n2.0 0 0 0\n", ("t.txt", 2, 8, 4)),
        ("1.0 0 0 0 0 0 0 2\n", ("t.txt", 1, "qx qy qz qw", 2)),
        ("2.0 0 0 0 0 0 0 1\n1.0 0 0 0 0 0 0 1\n", ("t.txt", 2, "1.0")),
        (f"{LINE}\n{LINE[:-1]}1\n", ("t.txt", 2, START_NS, "line 1")),
        (f"{LINE} 7\n", ("t.txt", 1, 14)),
        (f"{LINE}\n{START_NS + 1} 1\n", ("t.txt", 2, 13, 2)),
        (LINE.replace(" 1 ", " 2 ", 1), ("t.txt", 1)),
        (LINE.replace(" 1 ", " x ", 1), ("t.txt", 1, "r11", "x")),
        ("timestamp_ns,tx,ty,tz,qx,qy,qz,qw\n", ("t.txt",)),
        (LINE.split(" ", 1)[1], ("t.txt", None, 12, "t.times.txt", "--times")),
    ],
)
def test_a_bad_file_is_refused_in_one_line(tmp_path: Path, text: str, words: ErrorData) -> None:
    path = tmp_path / "t.txt"
    path.write_text(text)
    with refused(DatasetError, *words):
        read_pose_file(path)


@pytest.mark.parametrize(
    ("times", "words"),
    [
        ("1.0\n", ("times.txt", None, "1", "t.txt", "2")),
        ("1.0\n2.0\n3.0\n", ("times.txt", None, "3", "t.txt", "2")),
        ("1.0\n1.0\n", ("times.txt", 2, "1.0")),
        ("1.0 2.0\n", ("times.txt", 1, "2")),
        ("1.0\ntwo\n", ("times.txt", 2, "two")),
    ],
)
def test_times_that_do_not_fit_are_refused(tmp_path: Path, times: str, words: ErrorData) -> None:
    path, of = tmp_path / "t.txt", tmp_path / "times.txt"
    path.write_text(matrix_lines(dict(list(POSES.items())[:2]), timed=False))
    of.write_text(times)
    with refused(DatasetError, *words):
        read_pose_file(path, times=of)


def test_a_folder_is_no_file_of_poses(tmp_path: Path) -> None:
    with refused(DatasetError, tmp_path):
        read_pose_file(tmp_path)
