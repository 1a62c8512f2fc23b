"""Make a KITTI folder with corrected scans and poses that follow from them, for a sequence without right poses.

The official poses of KITTI odometry are interpolated in the first frames of a sequence and off by up to a fifth of a
step there. Here successive scans are registered, as ``relocbench`` does for recordings without odometry. The beams of
the real lidar point too low by 0.205 degrees (Deschaud, IMLS-SLAM, ICRA 2018): scans are written with them turned up.
Images and calibration are linked.

    python tools/kitti_lidar_poses.py ROOT SEQUENCE OUT

ROOT holds sequences/SEQUENCE with velodyne/; OUT is made, and refused if it exists.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from relocbench.datasets.importers.kitti.files import KittiSequence
from relocbench.datasets.importers.kitti.recording import REAL_ELEVATION_DEG, raised, read_kitti
from relocbench.datasets.sensors.velodyne import read_scan
from relocbench.errors import DatasetError, RelocbenchError
from relocbench.geometry import invert


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("root", type=Path)
    parser.add_argument("sequence")
    parser.add_argument("out", type=Path)
    options = parser.parse_args()
    if options.out.exists():
        sys.exit(f"{options.out}: exists already; expected a folder that is to be made")
    try:
        write(options.root, options.sequence, options.out)
    except RelocbenchError as bad:
        sys.exit(str(bad))


def write(root: Path, name: str, out: Path) -> None:
    """Link the sequence into a folder of its own, and write its poses there.

    Raises:
        RelocbenchError: there are no scans, too few of them, one is missing, or a scan or the calibration is damaged.
    """
    sequence = KittiSequence(root, name)
    T_cam0_lidar = sequence.calibration.T_cam0_lidar()
    scans = sequence.frames("velodyne", ".bin")
    numbers = list(scans)
    T_first_lidar = read_kitti(root, name, elevation_deg=REAL_ELEVATION_DEG).odometry.T_odom_rig
    if numbers != list(range(len(T_first_lidar))):
        raise DatasetError(f"{len(T_first_lidar)} poses for scans {numbers}; expected 0, 1, 2, ...", sequence.folder)
    T_first_cam0 = T_cam0_lidar @ T_first_lidar @ invert(T_cam0_lidar)
    folder = out / "sequences" / name
    (folder / "velodyne").mkdir(parents=True)
    for path in sequence.folder.iterdir():
        if path.name != "velodyne":
            (folder / path.name).symlink_to(path.resolve(), target_is_directory=path.is_dir())
    for number, scan in scans.items():
        points = raised(read_scan(scan), REAL_ELEVATION_DEG)
        rows = np.column_stack([points, np.zeros(len(points))]).astype("<f4")
        (folder / "velodyne" / f"{number:06d}.bin").write_bytes(rows.tobytes())
    (out / "poses").mkdir()
    np.savetxt(out / "poses" / f"{name}.txt", T_first_cam0[:, :3].reshape(-1, 12), fmt="%.9e")


if __name__ == "__main__":
    main()
