"""Make a KITTI folder whose poses follow from its lidar scans, for a sequence whose own poses are missing or wrong.

The official poses of KITTI odometry are interpolated in the first frames of a sequence and off by up to a fifth of a
step there. Here successive scans are registered, as ``relocbench`` does for recordings without odometry. The images,
scans and the calibration are linked.

    python tools/kitti_lidar_poses.py ROOT SEQUENCE OUT

ROOT holds sequences/SEQUENCE with velodyne/; OUT is made, and refused if it exists.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from relocbench.datasets.importers.kitti.files import KittiSequence
from relocbench.datasets.importers.kitti.recording import read_kitti
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
    numbers = list(sequence.frames("velodyne", ".bin"))
    T_first_lidar = read_kitti(root, name).odometry.T_odom_rig
    if numbers != list(range(len(T_first_lidar))):
        raise DatasetError(f"{len(T_first_lidar)} poses for scans {numbers}; expected 0, 1, 2, ...", sequence.folder)
    T_first_cam0 = T_cam0_lidar @ T_first_lidar @ invert(T_cam0_lidar)
    (out / "sequences").mkdir(parents=True)
    (out / "sequences" / name).symlink_to(sequence.folder.resolve(), target_is_directory=True)
    (out / "poses").mkdir()
    np.savetxt(out / "poses" / f"{name}.txt", T_first_cam0[:, :3].reshape(-1, 12), fmt="%.9e")


if __name__ == "__main__":
    main()
