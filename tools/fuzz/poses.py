"""Datasets of poses alone: trajectories in every format, and files of pairs with the table and poses beside them."""

from __future__ import annotations

from pathlib import Path

from fuzz.asking import asks, write
from fuzz.parser import Parser, Place

_START_NS = 1_600_000_000_000_000_000
_COUNT = 4
_UNIT = "0 0 0 1"
_HEADER = (
    "ref_timestamp_ns,query_timestamp_ns,group,distance_m,angle_deg,overlap,sigma_translation_m,sigma_rotation_deg"
)


def write_poses(root: Path) -> None:
    """One drive in each format, a second one beside it, and their pairs."""
    times = [_START_NS + i * 10**9 for i in range(_COUNT)]
    seconds = [f"{time // 10**9}.{time % 10**9:09d}" for time in times]
    write(root / "tum.txt", "# t tx ty tz qx qy qz qw", *(f"{s} {i} 0 0 {_UNIT}" for i, s in enumerate(seconds)))
    rows = (f"{t},{i},0.5,0,{_UNIT.replace(' ', ',')}" for i, t in enumerate(times))
    write(root / "own.csv", "timestamp_ns,tx,ty,tz,qx,qy,qz,qw", *rows)
    matrices = [f"1 0 0 {i} 0 1 0 0.25 0 0 1 0" for i in range(_COUNT)]
    write(root / "kitti.txt", *matrices)
    write(root / "kitti.times.txt", *seconds)
    write(root / "timed.txt", *(f"{s} {row}" for s, row in zip(seconds, matrices, strict=True)))
    write(root / "tum__own__rig.txt", *(f"{t} {t} 0 -0.5 0 {_UNIT}" for t in times))
    table = (f"{t},{t},nearest,0.5,0.0,,,,poses of both,true," for t in times)
    write(root / "tum__own__rig.csv", f"{_HEADER},source,accepted,reason", *table)


def _read(name: str) -> object:
    def run(place: Place) -> None:

        from relocbench.datasets.motion.orientation import likely_order
        from relocbench.datasets.sensors.pose_files import read_pose_file

        poses = read_pose_file(place.root / name).transforms
        likely_order(poses, "xyzw")

    return run


_FILES = ("tum.txt", "own.csv", "kitti.txt", "timed.txt")
_BUILD = ("--out", "{out}/ds", "-j", 1, "-q")
SEEDS = {"poses": write_poses}
PARSERS = (
    *(Parser(f"poses-{Path(name).stem}", "poses", (name,), _read(name), text=True) for name in _FILES),  # type: ignore[arg-type]
    Parser("poses-times", "poses", ("kitti.times.txt",), _read("kitti.txt"), text=True),  # type: ignore[arg-type]
    Parser(
        "poses-command",
        "poses",
        _FILES,
        asks("build-dataset", "poses", "{root}/tum.txt", "{root}/own.csv", "{root}/timed.txt", *_BUILD),
        text=True,
        brief=False,
    ),
    Parser(
        "pair-files-command",
        "poses",
        ("tum__own__rig.*", "tum.txt"),
        asks(
            "build-dataset", "pair-files", "{root}/tum__own__rig.txt", "--trajectories", "tum={root}/tum.txt", *_BUILD
        ),
        text=True,
        brief=False,
    ),
)
