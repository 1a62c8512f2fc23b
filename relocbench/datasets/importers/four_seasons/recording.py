"""The content of a 4Seasons or MLAD recording folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.importers.four_seasons.files import (
    keyframe_files,
    read_gnss_poses,
    read_times,
    read_transformations,
)
from relocbench.datasets.sensors.plausible_poses import plausible
from relocbench.datasets.sensors.pose_tables import read_trajectory
from relocbench.datasets.sensors.trajectories import timed_files
from relocbench.geometry import invert
from relocbench.progress import SILENT, Reporter

CAMERAS = ("cam0", "cam1")
GNSS_POSES, MLAD_POSES = "GNSSPoses.txt", "poses.txt"
TRACK = "septentrio.nmea"


@dataclass(frozen=True, eq=False)
class Recording:
    """One recording. Frames: ``cam`` is rectified cam0, ``w`` the recording's SLAM world in metres."""

    name: str
    root: Path
    T_w_cam: dict[int, Array]
    """timestamp_ns -> (4, 4), in time order"""
    pose_source: str
    """name of the file that the poses come from; empty if there is none"""
    scales: dict[int, float]
    """metres per unit of the keyframe files, by keyframe"""
    default_scale: float
    """the same for keyframes without a pose"""
    T_e_w: Array | None
    """(4, 4) from ``w`` to the earth (ECEF); None if unknown"""
    keyframes: dict[int, Path]
    images: dict[str, dict[int, Path]]
    """camera -> timestamp_ns -> rectified image"""

    @property
    def has_images(self) -> bool:
        return bool(self.images[CAMERAS[0]])

    @cached_property
    def times(self) -> frozenset[int]:
        """Timestamps of all known frames, whether or not their images are present."""
        listed = read_times(self.root / "times.txt") if (self.root / "times.txt").exists() else []
        return frozenset({*listed, *self.images[CAMERAS[0]], *self.keyframes, *self.T_w_cam})

    def scale(self, timestamp_ns: int) -> float:
        """Metres per unit of a keyframe file."""
        return self.scales.get(timestamp_ns, self.default_scale)


def read_recording(root: Path, name: str, reporter: Reporter = SILENT) -> Recording:
    """Read poses and transforms of a recording and list its files; keyframes and images are not opened.

    Raises:
        DatasetError: with file and line: a file cannot be parsed.
    """
    file = root / "Transformations.txt"
    transformations = read_transformations(file) if file.exists() else None
    if (root / GNSS_POSES).exists():
        gnss = read_gnss_poses(root / GNSS_POSES, reporter)
        poses = {t: pose.metric for t, pose in gnss.items()}
        source, scales = GNSS_POSES, {t: pose.scale for t, pose in gnss.items()}
    else:
        file = root / MLAD_POSES
        poses = plausible(read_trajectory(file, reporter=reporter), reporter).by_time if file.exists() else {}
        source, scales = MLAD_POSES if poses else "", {}
    # Nothing says that the world of MLAD's poses.txt is the one that Transformations.txt refers to.
    on_earth = transformations is not None and source == GNSS_POSES
    return Recording(
        name=name,
        root=root,
        T_w_cam=poses,
        pose_source=source,
        scales=scales,
        default_scale=transformations.scale if transformations is not None else 1.0,
        T_e_w=transformations.T_e_w if transformations is not None and on_earth else None,
        keyframes=keyframe_files(root),
        images={camera: timed_files(root / "undistorted_images" / camera) for camera in CAMERAS},
    )


def common_frames(recordings: Sequence[Recording], reporter: Reporter) -> dict[str, Array]:
    """Transforms (4, 4) from each recording's ``w`` to that of the first one, by traversal name.

    They are ``inv(T_e_w_first) @ T_e_w``; recordings for which this is unknown are left out.
    """
    first, *others = recordings
    frames = {first.name: np.eye(4)}
    for other in others:
        if first.T_e_w is not None and other.T_e_w is not None:
            frames[other.name] = invert(first.T_e_w) @ other.T_e_w
        else:
            without = first if first.T_e_w is None else other
            reporter.note(
                f"{without.name} lacks {GNSS_POSES} or Transformations.txt: the frames of {first.name} and "
                f"{other.name} cannot be related, and pairs between them can come from relocalization files only"
            )
    return frames
