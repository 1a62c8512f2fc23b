"""The motion of an Oxford RobotCar traversal: chained visual odometry, and GNSS/INS in a shared map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.importers.robotcar.files import InertialTrack, OdometrySteps
from relocbench.datasets.sensors.recording import Trajectory
from relocbench.geometry import invert, make_transform, project_to_rotation, se3_exp, se3_log

T_RIG_VEHICLE = np.diag([1.0, -1.0, -1.0, 1.0])
"""from the vehicle's axes (x forward, y right, z down)"""
_BRIDGED_NS = 200_000_000
"""gap of a few lost images that is bridged at constant speed (at 1 m/s^2, 5 mm off in the middle)"""
_VO_GAP_NS = 500_000_000
_INS_GAP_NS = 1_000_000_000
_T_ENU_NED = make_transform(np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]), np.zeros(3))


@dataclass(frozen=True)
class MapOrigin:
    """Origin of a dataset's map on the UTM grid. The map's axes are x east, y north, z up."""

    easting_m: float
    northing_m: float
    zone: str

    @classmethod
    def of(cls, track: InertialTrack) -> MapOrigin:
        """The corner of the square kilometre in which a drive begins."""
        northing, easting = np.floor(track.T_ned_ins[0, :2, 3] / 1000.0) * 1000.0
        return cls(float(easting), float(northing), track.zone)

    def __str__(self) -> str:
        return f"easting {self.easting_m:.0f} m, northing {self.northing_m:.0f} m (UTM {self.zone})"


def visual_trajectory(steps: OdometrySteps, inertial: Trajectory | None) -> Trajectory:
    """The trajectory by chained odometry steps, in the frame of the first rig pose.

    Gaps of up to 0.2 s are bridged with the velocity of the step before. A longer gap breaks the trajectory: it
    continues where GNSS/INS, or else the last velocity, says, and nothing is interpolated within the gap.

    Args:
        inertial: ``T_map_rig`` by GNSS/INS, for the gaps.
    """
    count = len(steps.later_ns)
    chain = np.empty((2 * count, 4, 4))
    times = np.empty(2 * count, dtype=np.int64)
    breaks: list[int] = []
    pose, length, last_ns = np.eye(4), 0, -1
    moves = T_RIG_VEHICLE @ steps.T_earlier_later @ T_RIG_VEHICLE
    for i in range(count):
        earlier, later = int(steps.earlier_ns[i]), int(steps.later_ns[i])
        if earlier != last_ns:
            if i > 0:
                pose = pose @ _across_gap(steps, moves, i, inertial)
                if earlier - last_ns > _BRIDGED_NS:
                    breaks.append(length)
            times[length], chain[length] = earlier, pose
            length += 1
        pose = pose @ moves[i]
        times[length], chain[length] = later, pose
        length += 1
        last_ns = later
    track = chain[:length]
    T_odom_rig = make_transform(project_to_rotation(track[:, :3, :3]), track[:, :3, 3])
    return Trajectory(times[:length].copy(), T_odom_rig, _VO_GAP_NS, tuple(breaks))


def _across_gap(steps: OdometrySteps, moves: Array, i: int, inertial: Trajectory | None) -> Array:
    """The rig's motion (4, 4) ``T_before_after`` from the end of step i - 1 to the start of step i."""
    before, after = int(steps.later_ns[i - 1]), int(steps.earlier_ns[i])
    ends = np.array([before, after])
    if after - before > _BRIDGED_NS and inertial is not None and inertial.covers(ends).all():
        T_map_before, T_map_after = inertial.at(ends)
        return np.asarray(invert(T_map_before) @ T_map_after)
    duration = int(steps.later_ns[i - 1] - steps.earlier_ns[i - 1])
    return np.asarray(se3_exp(se3_log(moves[i - 1]) * ((after - before) / duration)))


def map_trajectory(track: InertialTrack, origin: MapOrigin, T_rig_ins: Array) -> Trajectory:
    """``T_map_rig`` by GNSS/INS, converted from north, east, down to east, north, up."""
    T_ned_ins = track.T_ned_ins.copy()
    # The large offsets are subtracted first, so that no digits are lost.
    T_ned_ins[:, 0, 3] -= origin.northing_m
    T_ned_ins[:, 1, 3] -= origin.easting_m
    return Trajectory(track.times_ns, _T_ENU_NED @ T_ned_ins @ invert(T_rig_ins), _INS_GAP_NS, track.breaks)
