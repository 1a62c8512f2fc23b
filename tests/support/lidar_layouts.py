"""The drives of ``recorded_street`` written in the layouts of other lidar datasets, by their descriptions alone.

The lidar, the camera and their motion stay those of the drive; each layout gets the calibration, in its own
conventions, under which its files say the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from recorded_street import StreetDrive

from relocbench.arrays import Array, Floats, Indices, Times
from relocbench.datasets.synthetic.conditions.condition import Factors
from relocbench.datasets.synthetic.layouts.robotcar import mosaic
from relocbench.datasets.synthetic.lidar.lidar import Lidar, LidarScene
from relocbench.datasets.synthetic.lidar.lidar import scan as simulate
from relocbench.geometry import Camera, apply, invert, make_transform, transform_to_tq

TURN_NS = 100_000_000


@dataclass(frozen=True, eq=False)
class RawScan:
    """A scan of the drive's lidar, beam by beam."""

    middle_ns: int
    """the middle of its turn"""
    points: Array
    """(N, 3) in the lidar's frame; beams without a return are left out"""
    offsets_ns: Times
    """(N,) from the middle of the turn"""
    ring: Indices
    column: Indices


def scans_of(drive: StreetDrive) -> list[RawScan]:
    found = []
    for path in sorted((drive.folder / "lidar").iterdir()):
        table = np.fromfile(path, "<f4").reshape(-1, 6).astype(np.float64)
        offsets = np.rint(table[:, 5] * 1e9).astype(np.int64)
        column = np.floor((offsets + TURN_NS / 2) / TURN_NS * drive.options.azimuths).astype(np.int64)
        found.append(RawScan(int(path.stem) * 1000, table[:, :3], offsets, table[:, 4].astype(np.int64), column))
    return found


def compensated(drive: StreetDrive, found: RawScan) -> Array:
    """(N, 3) points of a scan as seen from the lidar's pose at the scan's time, without the drive's motion."""
    at = found.middle_ns
    T_lidar_fired = (
        invert(drive.T_world_car(np.array([at]))[0] @ drive.T_car_lidar)
        @ drive.T_world_car(at + found.offsets_ns)
        @ drive.T_car_lidar
    )
    return np.asarray(apply(T_lidar_fired, found.points[:, None, :])[:, 0])


def pose_times(drive: StreetDrive, period_ns: int = 10_000_000) -> Times:
    """Times while all sensors record."""
    scans = drive.layout.times["lidar"]
    return np.arange(int(scans[0]) - 2 * TURN_NS, int(scans[-1]) + 2 * TURN_NS, period_ns, dtype=np.int64)


def matrix_rows(times: Times, poses: Array, between: str = ",") -> str:
    """A time and twelve numbers a line."""
    rows = (
        between.join([str(t), *(repr(v) for v in pose[:3].ravel().tolist())])
        for t, pose in zip(times.tolist(), poses, strict=True)
    )
    return "\n".join(rows) + "\n"


def quaternion_rows(times: Times, poses: Array) -> str:
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


DOWN_DEG = 10.67 - np.arange(32) * 4 / 3
"""elevations of the beams of an HDL-32E by its data sheet"""
FIRING_POINT_M = 0.0908
HDL_COLUMNS, HDL_TURN_NS = 360, 50_000_000


def write_velodynes(
    drive: StreetDrive, folder: Path, scene: LidarScene, T_car_lidar: dict[str, Array], *, raw: bool
) -> None:
    """Scans of HDL-32E in the layout of the Oxford Radar RobotCar dataset, named by their first firings.

    Args:
        T_car_lidar: (4, 4) by name, of frames with z down.
        raw: write raw scans instead of binary ones.
    """
    hundredths = np.rint(np.degrees(1.0) * 100 + np.arange(HDL_COLUMNS) / HDL_COLUMNS * 36000) % 36000
    angle, down = np.radians(hundredths / 100)[:, None], np.radians(-DOWN_DEG)[None, :]
    level, ones = np.cos(down), np.ones((HDL_COLUMNS, 32))
    directions = np.stack([np.sin(angle) * level, -np.cos(angle) * level, np.sin(down) * ones], axis=-1)
    since = np.rint(np.arange(HDL_COLUMNS) / HDL_COLUMNS * HDL_TURN_NS / 1000).astype(np.int64) * 1000
    model = Lidar(directions.reshape(-1, 3), np.repeat(since, 32), HDL_TURN_NS, 0.02, 1.1, 90.0, 50.0)
    for name, pose in T_car_lidar.items():
        motion = Mounted(drive, pose @ make_transform(np.eye(3), [0.0, 0.0, -FIRING_POINT_M]))
        for number, start in enumerate(pose_times(drive, HDL_TURN_NS).tolist()[:-1]):
            start = start // 1000 * 1000
            found = simulate(model, scene, motion, start, Factors(), np.random.default_rng(number))
            ranges = np.where(found.returned, np.linalg.norm(found.points, axis=1), 0.0).reshape(HDL_COLUMNS, 32)
            where = folder / name / f"{start // 1000}"
            if raw:
                image = np.empty((106, HDL_COLUMNS), dtype=np.uint8)
                image[:32] = 7
                image[32:96] = np.rint(ranges / 0.002).astype("<u2").view(np.uint8).reshape(HDL_COLUMNS, 64).T
                image[96:98] = hundredths.astype("<u2").view(np.uint8).reshape(HDL_COLUMNS, 2).T
                image[98:] = ((start + since) // 1000).astype("<i8").view(np.uint8).reshape(HDL_COLUMNS, 8).T
                where.parent.mkdir(parents=True, exist_ok=True)
                assert cv2.imwrite(f"{where}.png", image)
            else:
                points = ranges[..., None] * directions - [0.0, 0.0, FIRING_POINT_M]
                by_beam = np.swapaxes(points, 0, 1)[ranges.T > 0]
                four = np.column_stack([by_beam, np.ones(len(by_beam))]).T
                write(where.with_suffix(".bin"), np.ascontiguousarray(four).astype("<f4").tobytes())


@dataclass(frozen=True, eq=False)
class Mounted:
    """The motion of a sensor on the car."""

    drive: StreetDrive
    T_car_sensor: Array

    def __call__(self, times_ns: Times, /) -> Array:
        return np.asarray(self.drive.T_world_car(times_ns) @ self.T_car_sensor)


def write_nclt(drive: StreetDrive, folder: Path, T_car_body: Array, xyzrpy: Callable[[Array], Array]) -> None:
    """Scans that are motion-compensated to the times in their names, in the body frame with z down.

    Args:
        xyzrpy: x, y, z, roll, pitch, yaw (N, 6) in metres and radians of transforms (N, 4, 4).
    """
    for found in scans_of(drive):
        at = found.middle_ns // 1000 * 1000
        T_body_lidar = (
            np.linalg.inv(drive.T_world_car(np.array([at]))[0] @ T_car_body)
            @ drive.T_world_car(found.middle_ns + found.offsets_ns)
            @ drive.T_car_lidar
        )
        points = apply(T_body_lidar, found.points[:, None, :])[:, 0]
        row = np.dtype([("x", "<u2"), ("y", "<u2"), ("z", "<u2"), ("i", "u1"), ("l", "u1")])
        table = np.zeros(len(points), dtype=row)
        for k, axis in enumerate("xyz"):
            table[axis] = np.rint((points[:, k] + 100.0) / 0.005)
        write(folder / "velodyne_sync" / f"{at // 1000}.bin", table.tobytes())
    times = pose_times(drive)
    down = np.diag([1.0, -1.0, -1.0, 1.0])
    six = xyzrpy(down @ drive.T_world_car(times) @ T_car_body)
    rows = [f"{t // 1000}, {', '.join(map(repr, v))}" for t, v in zip(times.tolist(), six.tolist(), strict=True)]
    name = folder.name
    first = f"{int(times[0]) // 1000 - 1}, " + ", ".join(["NaN"] * 6)
    write(folder / f"groundtruth_{name}.csv", "\n".join([first, *rows]) + "\n")
    write(folder / "odometry_mu_100hz.csv", "\n".join(rows) + "\n")


def write_kitti360(drive: StreetDrive, root: Path, number: int, T_car_imu: Array, R_rect_cam: Array) -> None:
    """A sequence of the drive; the frame whose scan has the time of its middle has its lidar facing along x then."""
    name = f"2013_05_28_drive_{number:04d}_sync"
    scans = root / "data_3d_raw" / name / "velodyne_points"
    times = drive.layout.times["camera"]
    for frame, found in enumerate(scans_of(drive)):
        points = np.column_stack([found.points, np.ones(len(found.points))]).astype("<f4")
        write(scans / "data" / f"{frame:010d}.bin", points.tobytes())
    write(scans / "timestamps.txt", dates(drive.layout.times["lidar"]))
    pictures = root / "data_2d_raw" / name / "image_00"
    for frame, path in enumerate(sorted((drive.folder / "camera").iterdir())):
        write(pictures / "data_rect" / f"{frame:010d}.png", path.read_bytes())
    write(pictures / "timestamps.txt", dates(times))
    T_rect_cam = make_transform(R_rect_cam, np.zeros(3))
    T_car_cam = drive.T_car_cam @ T_rect_cam
    T_imu_cam = np.linalg.inv(T_car_imu) @ T_car_cam
    T_velo_cam = np.linalg.inv(drive.T_car_lidar) @ T_car_cam
    write(root / "calibration" / "calib_cam_to_velo.txt", numbers(T_velo_cam[:3]) + "\n")
    write(root / "calibration" / "calib_cam_to_pose.txt", f"image_00: {numbers(T_imu_cam[:3])}\n")
    K = drive.layout.cameras["camera"].camera.matrix
    lines = f"calib_time: 1\nS_rect_00: 1 1\nP_rect_00: {numbers(np.column_stack([K, np.zeros(3)]))}\n"
    write(root / "calibration" / "perspective.txt", f"{lines}R_rect_00: {numbers(R_rect_cam)}\n")
    poses = utm(drive.T_world_car(drive.layout.times["lidar"]) @ T_car_imu)
    rows = [f"{k} {numbers(pose[:3])}" for k, pose in enumerate(poses) if k != 2]
    write(root / "data_poses" / name / "poses.txt", "\n".join(rows) + "\n")


def numbers(matrix: Array) -> str:
    return " ".join(map(repr, matrix.ravel().tolist()))


def dates(times: Times) -> str:
    """A date and a time of day with nine decimals a line."""
    parts = [(datetime.fromtimestamp(t // 10**9, UTC), t % 10**9) for t in times.tolist()]
    return "".join(f"{second:%Y-%m-%d %H:%M:%S}.{rest:09d}\n" for second, rest in parts)


def write_complex_urban(drive: StreetDrive, folder: Path, lens: Camera, R_rect_cam: Array) -> None:
    """The drive's lidar as the left VLP, named by the ends of its turns; its camera, seen through a lens, as the left.

    Args:
        lens: the distorted camera whose undistorted images are those of the drive.
        R_rect_cam: rotations of the rectification, of both cameras.
    """
    for found in scans_of(drive):
        order = np.lexsort((found.ring, found.offsets_ns))
        points = np.column_stack([found.points, np.ones(len(found.points))])[order].astype("<f4")
        write(folder / "sensor_data" / "VLP_left" / f"{found.middle_ns + TURN_NS // 2}.bin", points.tobytes())
    calibration = folder / "calibration"
    for name, pose in (("Vehicle2LeftVLP", drive.T_car_lidar), ("Vehicle2Stereo", drive.T_car_cam)):
        head = f"{name}.txt\nextrinsic calibration parameter from vehicle\nRPY(roll/pitch/yaw, degree): 1 2 3\n"
        write(calibration / f"{name}.txt", f"{head}R: {numbers(pose[:3, :3])}\nT: {numbers(pose[:3, 3])}\n")
    u, v = undistorted_pixels(lens)
    for time, path in zip(
        drive.layout.times["camera"].tolist(), sorted((drive.folder / "camera").iterdir()), strict=True
    ):
        seen = cv2.imread(str(path), cv2.IMREAD_COLOR)
        assert seen is not None
        rgb = cv2.remap(seen, u, v, cv2.INTER_LINEAR)[..., ::-1]
        for side in ("left", "right"):
            target = folder / "image" / f"stereo_{side}" / f"{time}.png"
            target.parent.mkdir(parents=True, exist_ok=True)
            assert cv2.imwrite(str(target), mosaic(np.ascontiguousarray(rgb), "RGGB"))
    for side, shift in (("left", 0.0), ("right", -0.475 * lens.fx)):
        projection = np.column_stack([lens.matrix, [shift, 0.0, 0.0]])
        entries = {
            "camera_matrix": lens.matrix, "distortion_coefficients": np.array(lens.distortion),
            "rectification_matrix": R_rect_cam, "projection_matrix": projection,
        }  # fmt: skip
        lines = [f"image_width: {lens.width}", f"image_height: {lens.height}", "distortion_model: plumb_bob"]
        lines += [f"{name}:\n  data: {values.ravel().tolist()}" for name, values in entries.items()]
        write(calibration / f"{side}.yaml", "\n".join(lines) + "\n")
    times = pose_times(drive)
    write(folder / "global_pose.csv", matrix_rows(times, utm(drive.T_world_car(times))))


def undistorted_pixels(lens: Camera) -> tuple[Floats, Floats]:
    """u and v (H, W) in the pinhole image of each pixel of the lens."""
    v, u = np.mgrid[: lens.height, : lens.width].astype(np.float64)
    pixels, _ = lens.undistort(np.stack([u, v], axis=-1), lens.pinhole())
    return pixels[..., 0].astype(np.float32), pixels[..., 1].astype(np.float32)
