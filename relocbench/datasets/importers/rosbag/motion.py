"""The motion of a drive by its bag: poses, and positions by GNSS in a map that all drives share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Times
from relocbench.datasets.importers.rosbag.index import Fixes
from relocbench.datasets.sensors.geodesy import R_enu_ecef, ecef_from_geodetic
from relocbench.datasets.sensors.pose_tables import PoseTable
from relocbench.datasets.sensors.recording import Trajectory
from relocbench.geometry import make_transform, path_lengths, transform_from_tq

_AROUND_M = 50.0
"""metres of road before and after a fix that its heading is fitted to"""
_LEAST_M = 5.0
"""least extent of these metres"""
_GNSS_GAP_NS = 2_000_000_000


@dataclass(frozen=True)
class GeodeticOrigin:
    """Origin of the map of all drives. Its axes are x east, y north, z up at the origin (a tangent plane)."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float

    @classmethod
    def of(cls, fixes: Fixes) -> GeodeticOrigin:
        """The first fix, rounded to a hundredth of a degree."""
        latitude, longitude, altitude, _ = fixes.values[0]
        return cls(round(float(latitude), 2), round(float(longitude), 2), float(np.floor(altitude)))

    @property
    def ecef(self) -> Array:
        """(3,) metres"""
        return ecef_from_geodetic(np.array([self.latitude_deg, self.longitude_deg, self.altitude_m]))

    @property
    def R_enu_ecef(self) -> Array:
        """(3, 3) from ECEF to the map's axes."""
        return R_enu_ecef(self.latitude_deg, self.longitude_deg)

    def __str__(self) -> str:
        return f"latitude {self.latitude_deg:g}, longitude {self.longitude_deg:g}, {self.altitude_m:g} m"


def east_north_up(values: Array, origin: GeodeticOrigin) -> Array:
    """Positions (N, 3) in metres of latitudes and longitudes in degrees and altitudes in metres (N, 3).

    Through Cartesian coordinates of WGS 84 (Hofmann-Wellenhof et al., GNSS, 2008, chapter 8): exact, whatever the
    distance from the origin.
    """
    difference = ecef_from_geodetic(values) - origin.ecef
    return np.asarray(difference @ origin.R_enu_ecef.T)


def in_order(times_ns: Times) -> Times:
    """Indices that sort times; of equal ones the first."""
    order = np.argsort(times_ns, kind="stable")
    first = np.concatenate([[True], np.diff(times_ns[order]) > 0]) if len(order) else np.zeros(0, dtype=bool)
    return np.asarray(order[first], dtype=np.int64)


def poses(values: Array) -> Array:
    """(N, 4, 4) of tx, ty, tz, qx, qy, qz, qw (N, 7); quaternions are normalised."""
    q = values[:, 3:]
    norms = np.linalg.norm(q, axis=1, keepdims=True)
    # What is a unit quaternion already keeps its digits.
    q = np.where(np.abs(norms - 1.0) < 1e-15, q, q / norms)
    return np.asarray(transform_from_tq(values[:, :3], q))


def map_of_fixes(fixes: PoseTable, motion: Trajectory, antenna: Array) -> Trajectory | None:
    """``T_map_rig`` at the times of fixes that the odometry covers; None if none can be placed.

    GNSS tells positions, odometry tells how the rig is turned relative to its own frame. The angle between this frame
    and the map is fitted to the metres of road around each fix (Procrustes in the plane), so that it follows the drift
    of the odometry and holds also where the rig stands or reverses.

    Args:
        fixes: positions of the antenna, without rotations.
        antenna: (3,) position of the antenna on the rig.
    """
    times_ns = fixes.times_ns
    kept = motion.covers(times_ns)
    if kept.sum() < 2:
        return None
    times, p_map = times_ns[kept], fixes.transforms[kept, :3, 3]
    T_odom_rig = motion.at(times)
    p_odom = (T_odom_rig @ np.append(antenna, 1.0))[:, :3]
    travelled = path_lengths(p_odom[:, :2])
    begin = np.searchsorted(travelled, travelled - _AROUND_M, side="left")
    end = np.searchsorted(travelled, travelled + _AROUND_M, side="right")
    a, b = (p[:, 0] + 1j * p[:, 1] for p in (p_odom, p_map))
    heading = np.full(len(times), np.nan)
    for i, (first, last) in enumerate(zip(begin.tolist(), end.tolist(), strict=True)):
        p, q = a[first:last] - a[first:last].mean(), b[first:last] - b[first:last].mean()
        if np.abs(p).max() >= _LEAST_M / 2 and np.abs(q).max() >= _LEAST_M / 2:
            heading[i] = np.angle(np.sum(np.conj(p) * q))
    known = np.flatnonzero(np.isfinite(heading))
    if not len(known):
        return None
    cosine, sine = np.cos(heading[known]), np.sin(heading[known])
    R = np.zeros((len(known), 3, 3))
    R[:, 0, 0], R[:, 0, 1], R[:, 1, 0], R[:, 1, 1], R[:, 2, 2] = cosine, -sine, sine, cosine, 1.0
    R_map_rig = R @ T_odom_rig[known, :3, :3]
    position = p_map[known] - R_map_rig @ antenna
    breaks = np.unique(np.searchsorted(times[known], times_ns[list(fixes.breaks)]))
    inside = tuple(breaks[(breaks > 0) & (breaks < len(known))].tolist())
    return Trajectory(times[known], make_transform(R_map_rig, position), _GNSS_GAP_NS, inside)
