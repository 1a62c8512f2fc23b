"""The files ``vo/vo.csv``, ``gps/ins.csv`` and ``gps/gps.csv`` of the Oxford RobotCar layout."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from relocbench.arrays import Array, Times
from relocbench.datasets.synthetic.drives import odometry, utm

VO_COLUMNS = "source_timestamp,destination_timestamp,x,y,z,roll,pitch,yaw"
INS_COLUMNS = (
    "timestamp,ins_status,latitude,longitude,altitude,northing,easting,down,utm_zone,"
    "velocity_north,velocity_east,velocity_down,roll,pitch,yaw"
)
GPS_COLUMNS = (
    "timestamp,num_satellites,latitude,longitude,altitude,latitude_sigma,longitude_sigma,altitude_sigma,"
    "northing,easting,down,utm_zone"
)
_GRID_ORIGIN = (5_735_000.0, 620_000.0)
"""northing and easting of the town's origin, in Oxford's zone"""
_ZONE = 30
_RECEIVER_EVERY = 10
"""INS solutions per fix of the receiver"""
_R_NED_WORLD = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def vo_text(
    times_ns: Times, T_world_vehicle: Array, rng: np.random.Generator, errors: odometry.OdometryErrors | None = None
) -> str:
    """Text of ``vo.csv``, with the steps of visual odometry.

    The source of a row is the later image: x, y, z, roll, pitch, yaw are the vehicle's pose at the source time, in its
    frame at the destination time.

    Args:
        times_ns: (N,) times of the images.
        T_world_vehicle: (N, 4, 4), x forward, y right, z down.
    """
    steps = odometry.visual_odometry(T_world_vehicle, errors or odometry.OdometryErrors(), rng)
    values = odometry.xyzrpy_from_transform(steps)
    rows = (
        [str(later // 1000), str(earlier // 1000), *(f"{v:.9f}" for v in step)]
        for later, earlier, step in zip(times_ns[1:].tolist(), times_ns[:-1].tolist(), values.tolist(), strict=True)
    )
    return _table(VO_COLUMNS, rows)


def gps_texts(times_ns: Times, T_world_ins: Array, rng: np.random.Generator) -> tuple[dict[str, str], dict[str, Any]]:
    """Texts of ``ins.csv`` and ``gps.csv``, and the random errors in them. Attitudes are in north, east, down.

    Args:
        times_ns: (N,) times of the INS solutions.
        T_world_ins: (N, 4, 4), x forward, y right, z down.
    """
    errors = odometry.InertialErrors()
    solution = odometry.inertial(times_ns, T_world_ins, errors, rng)
    fixes = odometry.receiver(solution, _RECEIVER_EVERY, errors, rng)
    satellites = rng.integers(8, 14, size=len(fixes.times_ns)).tolist()
    sigma = [f"{errors.receiver_m:.3f}"] * 3
    attitude = odometry.rpy_from_rotation(_R_NED_WORLD @ solution.T_world_body[:, :3, :3])
    motion = np.hstack([solution.velocity @ _R_NED_WORLD.T, attitude]).tolist()
    ins = (
        [str(time // 1000), "INS_SOLUTION_GOOD", *globe, *grid, f"{_ZONE}U", *(f"{v:.6f}" for v in rest)]
        for time, globe, grid, rest in zip(solution.times_ns.tolist(), *_places(solution), motion, strict=True)
    )
    gps = (
        [str(time // 1000), str(count), *globe, *sigma, *grid, f"{_ZONE}U"]
        for time, count, globe, grid in zip(fixes.times_ns.tolist(), satellites, *_places(fixes), strict=True)
    )
    texts = {"ins.csv": _table(INS_COLUMNS, ins), "gps.csv": _table(GPS_COLUMNS, gps)}
    origin = {"northing": _GRID_ORIGIN[0], "easting": _GRID_ORIGIN[1], "zone": f"{_ZONE}U"}
    return texts, {"ins_offset_east_north_up_m": solution.offset_m.tolist(), "grid_origin_m": origin}


def _places(solution: odometry.Solution) -> tuple[list[list[str]], list[list[str]]]:
    """Latitude, longitude and altitude, and northing, easting and down, at each time."""
    east, north, up = solution.T_world_body[:, :3, 3].T
    northing, easting = _GRID_ORIGIN[0] + north, _GRID_ORIGIN[1] + east
    latitude, longitude = utm.latitude_longitude(northing, easting, _ZONE)
    globe = [[f"{a:.9f}", f"{o:.9f}", f"{u:.6f}"] for a, o, u in zip(latitude, longitude, up, strict=True)]
    grid = [[f"{n:.6f}", f"{e:.6f}", f"{-u:.6f}"] for n, e, u in zip(northing, easting, up, strict=True)]
    return globe, grid


def _table(columns: str, rows: Iterable[Sequence[str]]) -> str:
    return "".join(",".join(row) + "\n" for row in (columns.split(","), *rows))
