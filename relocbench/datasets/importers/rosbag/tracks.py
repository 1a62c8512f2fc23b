"""The odometry and the GNSS prior of a bag, as trajectories of the rig."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from relocbench.arrays import Array, Times
from relocbench.datasets.core.schema import Transform
from relocbench.datasets.importers.lidar_drives.drives import rig_trajectory
from relocbench.datasets.importers.rosbag import motion
from relocbench.datasets.importers.rosbag.index import Poses
from relocbench.datasets.importers.rosbag.motion import GeodeticOrigin
from relocbench.datasets.importers.rosbag.reading import Reading
from relocbench.datasets.importers.rosbag.stamps import check_one_pose_a_time
from relocbench.datasets.sensors.plausible_poses import plausible
from relocbench.datasets.sensors.pose_tables import PoseTable
from relocbench.datasets.sensors.recording import Trajectory
from relocbench.errors import DatasetError
from relocbench.geometry import invert, make_transform

_PRIOR_SIGMA_M = 10.0


def odometry(reading: Reading) -> Trajectory | None:
    """The motion of the rig from its first pose, by a topic or by tf; None if it has to be computed from scans."""
    chosen = reading.roles.odometry
    if chosen == "lidar":
        return None
    if chosen in reading.index.poses:
        found, what = reading.index.poses[chosen], chosen
    else:
        link = _moving_link(reading, required=chosen == "tf")
        if link is None:
            return None
        found, what = link, f"tf, '{link.child}' in '{link.parent}'"
        reading.note(f"odometry is that of {what}")
    tell_left_out(reading, what, found)
    times, kept = reading.times(what, found.times_ns, found.received_ns)
    if len(times) < 2:
        raise DatasetError(f"{what} holds {len(times)} poses; odometry needs at least 2", reading.source)
    table = PoseTable(reading.source, times, motion.poses(found.values[kept]))
    T_body_rig = _T_body_rig(reading, found, reading.settings.extrinsics.T_rig_odometry)
    track = rig_trajectory(table, reading.reporter, T_body_rig, reading.settings.max_gap_ns)
    return replace(track, T_odom_rig=np.asarray(invert(track.T_odom_rig[0]) @ track.T_odom_rig))


def tell_left_out(reading: Reading, what: str, poses: Poses) -> None:
    """Note the messages without a pose, and check that there is one at a time."""
    check_one_pose_a_time(poses.times_ns, poses.values, what, reading.source)
    if poses.left_out:
        count = poses.left_out + len(poses.times_ns)
        reading.note(f"{what}: {poses.left_out} of {count} messages have no pose (NaN)")


def _T_body_rig(reading: Reading, poses: Poses, mounted: Transform | None) -> Array:
    """From the rig to the frame whose poses are given.

    Args:
        mounted: its pose on the rig by the extrinsics.
    """
    if mounted is not None:
        return np.asarray(invert(reading.settings.extrinsics.T_new_rig @ mounted.matrix))
    if not poses.child:
        reading.note(f"the poses in '{poses.parent}' name no frame of the vehicle; they are taken for those of the rig")
        return np.asarray(invert(reading.settings.extrinsics.T_new_rig))
    if reading.settings.extrinsics_file is not None and poses.child not in reading.frames:
        return np.asarray(invert(reading.settings.extrinsics.T_new_rig))
    return reading.frames.transform(poses.child, reading.base)


def _moving_link(reading: Reading, required: bool) -> Poses | None:
    """The transform that changes and leads to the rig; that from 'odom' if there are several."""
    available = [link for link in reading.frames.moving if reading.frames.connected(link.child, reading.base)]
    best = [link for link in available if link.parent == "odom"] or available
    if len(best) > 1:
        names = ", ".join(f"{link.parent} to {link.child}" for link in best)
        raise DatasetError(f"tf has several moving transforms ({names}); name a topic by --odometry", reading.source)
    if required and not best:
        raise DatasetError(f"--odometry tf: no transform that changes leads to {reading.base!r}", reading.source)
    return best[0] if best else None


def fix_times(reading: Reading) -> tuple[Times, Times] | None:
    """Times (M,) of the messages of GNSS, and their indices (M,); None without GNSS."""
    chosen = reading.roles.gnss
    found = reading.index.fixes.get(chosen) or reading.index.poses.get(chosen)
    if not chosen or found is None:
        return None
    return reading.times(chosen, found.times_ns, found.received_ns)


PriorOf = Callable[[Trajectory], Trajectory | None]
"""called with the odometry, which tells how the rig is turned: the prior ``T_map_rig``, None without positions"""


def prior(
    reading: Reading, origin: GeodeticOrigin | None, times: tuple[Times, Times] | None
) -> tuple[PriorOf, float, GeodeticOrigin | None]:
    """What makes the prior of the odometry, its sigma in metres, and the origin of its map.

    Args:
        origin: that of the drives before; None: this drive's own.
        times: what :func:`fix_times` returned.
    """
    chosen = reading.roles.gnss
    if times is None:
        return _without, _PRIOR_SIGMA_M, origin
    at, kept = times
    if chosen in reading.index.poses:
        found = reading.index.poses[chosen]
        tell_left_out(reading, chosen, found)
        T_map_rig = motion.poses(found.values[kept]) @ _T_body_rig(
            reading, found, reading.settings.extrinsics.T_rig_gnss
        )
        table = plausible(PoseTable(reading.source, at, T_map_rig), reading.reporter, jumps=False)
        known = Trajectory(table.times_ns, table.transforms, breaks=table.breaks) if len(at) else None
        return (lambda _: known), _PRIOR_SIGMA_M, origin
    fixes = reading.index.fixes[chosen]
    if fixes.left_out:
        reading.note(f"{chosen}: {fixes.left_out} messages without a fix are left out")
    if not len(at):
        reading.note(f"{chosen} has no fix; drives are registered without GNSS")
        return _without, _PRIOR_SIGMA_M, origin
    start = origin or GeodeticOrigin.of(fixes)
    if origin is None:
        reading.note(f"GNSS positions are relative to {start}")
    antenna = _antenna(reading, fixes.frame)
    positions = make_transform(np.eye(3), motion.east_north_up(fixes.values[kept, :3], start))
    try:
        table = PoseTable(reading.source, at, positions)
        placed = plausible(table, reading.reporter, jumps=False, axes=False)
    except DatasetError as bad:
        reading.note(f"{chosen} {bad.expected}; drives are registered without GNSS")
        return _without, _PRIOR_SIGMA_M, origin

    def fitted(measured: Trajectory) -> Trajectory | None:
        found = motion.map_of_fixes(placed, measured, antenna)
        if found is None:
            reading.note(f"{chosen}: the drive is too short to tell its heading; it is registered without GNSS")
        return found

    sigmas = fixes.values[kept, 3]
    sigma = float(np.median(sigmas[sigmas > 0])) if (sigmas > 0).any() else 0.0
    return fitted, max(_PRIOR_SIGMA_M, sigma), start


def _without(measured: Trajectory) -> None:
    """No positions, no prior."""


def _antenna(reading: Reading, frame: str) -> Array:
    """Position (3,) of the antenna on the rig."""
    given = reading.settings.extrinsics.T_rig_gnss
    if given is not None:
        return np.asarray((reading.settings.extrinsics.T_new_rig @ given.matrix)[:3, 3])
    if frame and reading.frames.connected(reading.base, frame):
        return np.asarray(reading.frames.transform(reading.base, frame)[:3, 3])
    reading.note(f"the place of the antenna ('{frame}') on the rig is unknown; it is taken for the rig's origin")
    return np.zeros(3)
