"""Recordings read by the descriptions of their formats alone, with none of our own code for them."""

from __future__ import annotations

import csv
import hashlib
import math
from pathlib import Path

import numpy as np
import yaml

from relocbench.arrays import Array
from relocbench.geometry import interpolate_trajectory, transform_from_tq


def hashes(root: Path) -> dict[str, str]:
    files = sorted(p for p in root.rglob("*") if p.is_file())
    return {str(p.relative_to(root)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


class Truth:
    """``truth/NAME``, read on its own."""

    def __init__(self, folder: Path) -> None:
        rows = list(csv.DictReader((folder / "poses.csv").open()))
        self.times = np.array([int(r["timestamp_ns"]) for r in rows])
        t = np.array([[float(r[k]) for k in ("tx", "ty", "tz")] for r in rows])
        q = np.array([[float(r[k]) for k in ("qx", "qy", "qz", "qw")] for r in rows])
        self.poses = transform_from_tq(t, q)
        settings = yaml.safe_load((folder / "settings.yaml").read_text())
        self.T_rig = {
            name: transform_from_tq(v["translation_m"], v["quaternion_xyzw"])
            for name, v in settings["sensors"]["T_rig_sensor"].items()
        }
        self.cameras = settings["sensors"]["cameras"]
        self.drawn = yaml.safe_load((folder / "drawn.yaml").read_text())

    def rig(self, time_ns: int) -> Array:
        return np.asarray(interpolate_trajectory(self.times, self.poses, np.array([time_ns]))[0])


def matrix_of(x: float, y: float, z: float, roll: float, pitch: float, yaw: float) -> Array:
    """``Rz(yaw) Ry(pitch) Rx(roll)``, written out."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    rz = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    rx = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rz @ ry @ rx, (x, y, z)
    return out


class RobotCarReading:
    """The layout read by its description alone."""

    def __init__(self, root: Path, traversal: str) -> None:
        self.root, self.folder = root, root / traversal

    def timestamps(self, sensor: str) -> list[tuple[int, int]]:
        lines = (self.folder / f"{sensor}.timestamps").read_text().splitlines()
        return [(int(stamp), int(chunk)) for stamp, chunk in (line.split(" ") for line in lines)]

    def files(self, folder: str, suffix: str) -> dict[int, Path]:
        return {int(p.stem): p for p in sorted((self.folder / folder).iterdir()) if p.suffix == suffix}

    def scan(self, path: Path) -> Array:
        return np.fromfile(path, dtype=np.float64).reshape(-1, 3)

    def extrinsics(self, name: str) -> Array:
        values = [float(v) for v in (self.root / "extrinsics" / f"{name}.txt").read_text().split()]
        assert len(values) == 6
        return matrix_of(*values)

    def model(self, name: str) -> tuple[list[float], Array]:
        rows = [[float(v) for v in line.split()] for line in (self.root / "models" / f"{name}.txt").open()]
        assert [len(row) for row in rows] == [4, 4, 4, 4, 4]
        return rows[0], np.array(rows[1:])

    def table(self, name: str) -> list[dict[str, str]]:
        return list(csv.DictReader((self.folder / name).open()))


def read_vo(rows: list[dict[str, str]]) -> list[tuple[int, int, Array]]:
    names = ("x", "y", "z", "roll", "pitch", "yaw")
    return [
        (
            int(r["source_timestamp"]),
            int(r["destination_timestamp"]),
            matrix_of(*(float(r[n]) for n in names)),
        )
        for r in rows
    ]
