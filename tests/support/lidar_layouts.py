"""The drives of ``recorded_street`` written in the layouts of other lidar datasets, by their descriptions alone.

The lidar, the camera and their motion stay those of the drive; each layout gets the calibration, in its own
conventions, under which its files say the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from recorded_street import StreetDrive

from relocbench.geometry import apply, transform_to_tq

Array = NDArray[np.float64]
TURN_NS = 100_000_000


@dataclass(frozen=True, eq=False)
class RawScan:
    """A scan of the drive's lidar, beam by beam."""

    middle_ns: int
    """the middle of its turn"""
    points: Array
    """(N, 3) in the lidar's frame; beams without a return are left out"""
    offsets_ns: NDArray[np.int64]
    """(N,) from the middle of the turn"""
    ring: NDArray[np.int64]
    column: NDArray[np.int64]


def scans_of(drive: StreetDrive) -> list[RawScan]:
    found = []
    for path in sorted((drive.folder / "lidar").iterdir()):
        table = np.fromfile(path, "<f4").reshape(-1, 6).astype(np.float64)
        offsets = np.rint(table[:, 5] * 1e9).astype(np.int64)
        column = np.floor((offsets + TURN_NS / 2) / TURN_NS * drive.options.azimuths).astype(np.int64)
        found.append(RawScan(int(path.stem) * 1000, table[:, :3], offsets, table[:, 4].astype(np.int64), column))
    return found


def pose_times(drive: StreetDrive, period_ns: int = 10_000_000) -> NDArray[np.int64]:
    """Times while all sensors record."""
    scans = drive.layout.times["lidar"]
    return np.arange(int(scans[0]) - 2 * TURN_NS, int(scans[-1]) + 2 * TURN_NS, period_ns, dtype=np.int64)


def matrix_rows(times: NDArray[np.int64], poses: Array, between: str = ",") -> str:
    """A time and twelve numbers a line."""
    rows = (
        between.join([str(t), *(repr(v) for v in pose[:3].ravel().tolist())])
        for t, pose in zip(times.tolist(), poses, strict=True)
    )
    return "\n".join(rows) + "\n"


def quaternion_rows(times: NDArray[np.int64], poses: Array) -> str:
    """``time x y z qx qy qz qw``"""
    values = np.hstack(transform_to_tq(poses)).tolist()
    return "".join(f"{t} {' '.join(map(repr, row))}\n" for t, row in zip(times.tolist(), values, strict=True))


def write(path: Path, content: bytes | str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())


def utm(poses: Array) -> Array:
    """Poses on a grid whose numbers are large."""
    moved = poses.copy()
    moved[:, :3, 3] += [345_000.0, 4_023_000.0, 20.0]
    return moved


def write_mulran(drive: StreetDrive, folder: Path, T_base_ouster: Array) -> None:
    """Scans named by the start of their turns, column by column of 64 beams, zeros for those without a return."""
    for scan in scans_of(drive):
        grid = np.zeros((drive.options.azimuths, 64, 4), dtype="<f4")
        grid[scan.column, scan.ring, :3] = scan.points
        write(folder / "sensor_data" / "Ouster" / f"{scan.middle_ns - TURN_NS // 2}.bin", grid.tobytes())
    times = pose_times(drive)
    T_car_base = drive.T_car_lidar @ np.linalg.inv(T_base_ouster)
    write(folder / "global_pose.csv", matrix_rows(times, utm(drive.T_world_car(times) @ T_car_base)))


def write_helipr(drive: StreetDrive, folder: Path, T_ins_lidar: dict[str, Array], *, aeva_intensity: bool) -> None:
    """All four lidars measure the points of the drive's one, which is taken for the Ouster, at the same moments."""
    T_car_ins = drive.T_car_lidar @ np.linalg.inv(T_ins_lidar["Ouster"])
    for scan in scans_of(drive):
        start = scan.middle_ns - TURN_NS // 2
        since = scan.offsets_ns + TURN_NS // 2
        count = len(scan.points)
        for name, pose in T_ins_lidar.items():
            p = apply(np.linalg.inv(pose) @ T_ins_lidar["Ouster"], scan.points).astype("<f4")
            one = np.ones(count)
            columns: list[tuple[str, NDArray[np.generic]]] = [("<f4", p[:, 0]), ("<f4", p[:, 1]), ("<f4", p[:, 2])]
            if name == "Ouster":
                columns += [("<f4", one), ("<u4", since), ("<u2", one), ("<u2", scan.ring), ("<u2", one)]
            elif name == "Velodyne":
                columns += [("<f4", one), ("<u2", scan.ring), ("<f4", since / 1e9)]
            elif name == "Aeva":
                columns += [("<f4", one), ("<f4", one), ("<i4", since), ("u1", scan.ring)]
                columns += [("<f4", one)] if aeva_intensity else []
            else:
                columns += [("u1", one), ("u1", one), ("u1", scan.ring), ("<u4", since)]
            row = np.dtype([(f"f{k}", kind) for k, (kind, _) in enumerate(columns)])
            table = np.empty(count, dtype=row)
            for k, (_, values) in enumerate(columns):
                table[f"f{k}"] = values
            write(folder / "LiDAR" / name / f"{start}.bin", table.tobytes())
    times = pose_times(drive, TURN_NS)
    for name, pose in T_ins_lidar.items():
        T_world_lidar = drive.T_world_car(times) @ T_car_ins @ pose
        write(folder / "LiDAR_GT" / f"{name}_gt.txt", quaternion_rows(times, T_world_lidar))
        write(folder / "LiDAR_GT" / f"global_{name}_gt.txt", quaternion_rows(times, utm(T_world_lidar)))
