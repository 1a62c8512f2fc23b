"""Importers of lidar datasets: drives of each layout, with all that is read of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from fuzz.asking import write
from fuzz.parser import Parser, Place, Read
from fuzz.sensors import read_all

if TYPE_CHECKING:
    from relocbench.datasets.importers.lidar_drives.drives import DriveFiles

_START_NS = 1_600_000_000_000_000_000
_TIMES = [_START_NS + i * 100_000_000 for i in range(3)]
_ROWS = ("1 0 0", "0 1 0", "0 0 1")
_POSE = "1 0 0 {} 0 1 0 0 0 0 1 0"
_SIZE = (16, 12)
_FORD = "2017-08-04-V2-Log1"


def _points(count: int = 40) -> np.ndarray:
    """(N, 3) points around a lidar, in the order of their azimuths."""
    angle = np.linspace(0, -6.2, count)
    return np.column_stack([5 * np.cos(angle), 5 * np.sin(angle), np.linspace(-1, 1, count)])


def _binary(path: Path, *columns: tuple[str, object]) -> None:
    table = np.zeros(40, dtype=[(f"f{k}", kind) for k, (kind, _) in enumerate(columns)])
    for k, (_, values) in enumerate(columns):
        table[f"f{k}"] = values
    path.parent.mkdir(parents=True, exist_ok=True)
    table.tofile(path)


def _floats(path: Path, *more: object) -> None:
    """Points as float32, with further columns."""
    _binary(path, *(("<f4", values) for values in (*_points().T, *more)))


def _image(path: Path, size: tuple[int, int] = _SIZE, *, colour: bool = False) -> None:
    shape = (size[1], size[0], 3) if colour else (size[1], size[0])
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.arange(int(np.prod(shape)), dtype=np.uint64).reshape(shape).astype(np.uint8))


def _global_poses() -> list[str]:
    return [f"{t},{_POSE.format(i).replace(' ', ',')}" for i, t in enumerate(_TIMES)]


def write_boreas(root: Path) -> None:
    folder = root / "boreas-2021-01-26-11-22"
    names = "easting,northing,altitude,roll,pitch,heading"
    for time in _TIMES:
        _floats(folder / "lidar" / f"{time // 1000}.bin", 0.5, 3, np.linspace(-0.05, 0.05, 40))
        _image(folder / "camera" / f"{time // 1000}.png")
    rows = [f"{t // 10**9}.{t % 10**9:09d},{i},0,0,0,0,0.1" for i, t in enumerate(_TIMES)]
    write(folder / "applanix" / "gps_post_process.csv", f"GPSTime,{names}", *rows)
    for name in ("T_applanix_lidar", "T_camera_lidar"):
        write(folder / "calib" / f"{name}.txt", *(f"{row} 0.25" for row in _ROWS), "0 0 0 1")
    write(folder / "calib" / "P_camera.txt", "20 0 8 0", "0 20 6 0", "0 0 1 0", "0 0 0 1")


def write_mulran(root: Path) -> None:
    for time in _TIMES:
        _floats(root / "DCC01" / "sensor_data" / "Ouster" / f"{time}.bin", 0.5)
    write(root / "DCC01" / "global_pose.csv", *_global_poses())


def write_helipr(root: Path) -> None:
    folder, xyz = root / "KAIST05", [("<f4", axis) for axis in _points().T]
    for time in _TIMES:
        since = np.arange(40) * 1_000_000
        _binary(folder / "LiDAR" / "Ouster" / f"{time}.bin", *xyz, ("<f4", 1), ("<u4", since), *[("<u2", 1)] * 3)
        _binary(folder / "LiDAR" / "Velodyne" / f"{time}.bin", *xyz, ("<f4", 1), ("<u2", 1), ("<f4", since / 1e9))
        _binary(folder / "LiDAR" / "Aeva" / f"{time}.bin", *xyz, ("<f4", 1), ("<f4", 1), ("<i4", since), ("u1", 1))
        _binary(folder / "LiDAR" / "Avia" / f"{time}.bin", *xyz, *[("u1", 1)] * 3, ("<u4", since))
    write(folder / "LiDAR_GT" / "Ouster_gt.txt", *(f"{t} {i} 0 0 0 0 0 1" for i, t in enumerate(_TIMES)))


def write_nclt(root: Path) -> None:
    folder = root / "2012-01-08"
    packed = np.rint((_points() + 100) / 0.005)
    for time in _TIMES:
        _binary(folder / "velodyne_sync" / f"{time // 1000}.bin", *(("<u2", p) for p in packed.T), ("u1", 1), ("u1", 2))
        _image(folder / "lb3" / "Cam5" / f"{time // 1000}.tiff", colour=True)
    rows = [f"{t // 1000}, {i}, 0, 0, 0, 0, 0.1" for i, t in enumerate(_TIMES)]
    write(folder / "groundtruth_2012-01-08.csv", f"{_START_NS // 1000 - 1}, nan, nan, nan, nan, nan, nan", *rows)
    write(root / "cam_params" / "K_cam5.csv", "20,0,8", "0,20,6", "0,0,1")
    write(root / "cam_params" / "x_lb3_c5.csv", "0.04,0,0,160,89,160")
    table = (f"{v} {u} {v} {u}" for v in range(_SIZE[1]) for u in range(_SIZE[0]))
    write(root / "cam_params" / "U2D_Cam5_1616X1232.txt", "width/cols = 16 , height/rows = 12", *table)


def write_kitti360(root: Path) -> None:
    name = "2013_05_28_drive_0000_sync"
    dates = [f"2013-05-28 08:46:02.{i}04094464" for i in range(3)]
    scans, pictures = root / "data_3d_raw" / name / "velodyne_points", root / "data_2d_raw" / name / "image_00"
    for folder in (scans, pictures):
        write(folder / "timestamps.txt", *dates)
    for i in range(3):
        _floats(scans / "data" / f"{i:010d}.bin", 0.5)
        _image(pictures / "data_rect" / f"{i:010d}.png")
    write(root / "calibration" / "calib_cam_to_velo.txt", _POSE.format(0.25))
    write(root / "calibration" / "calib_cam_to_pose.txt", f"image_00: {_POSE.format(0.5)}")
    lines = ("P_rect_00: 20 0 8 0 0 20 6 0 0 0 1 0", "R_rect_00: 1 0 0 0 1 0 0 0 1")
    write(root / "calibration" / "perspective.txt", *lines)
    write(root / "data_poses" / name / "poses.txt", *(f"{i} {_POSE.format(i)}" for i in range(3)))


def write_complex_urban(root: Path) -> None:
    folder = root / "urban28"
    for time in _TIMES:
        _floats(folder / "sensor_data" / "VLP_left" / f"{time}.bin", 0.5)
        _binary(folder / "sensor_data" / "SICK_back" / f"{time}.bin", ("<f4", 4), ("<f4", 0.5))
        _image(folder / "image" / "stereo_left" / f"{time}.png")
    for name in ("Vehicle2LeftVLP", "Vehicle2BackSick", "Vehicle2Stereo"):
        write(folder / "calibration" / f"{name}.txt", "RPY: 0 0 0", "R: 1 0 0 0 1 0 0 0 1", "T: 0 0 1")
    entries = {
        "camera_matrix": "20, 0, 8, 0, 20, 6, 0, 0, 1",
        "distortion_coefficients": "0.01, 0, 0, 0, 0",
        "rectification_matrix": "1, 0, 0, 0, 1, 0, 0, 0, 1",
        "projection_matrix": "20, 0, 8, 0, 0, 20, 6, 0, 0, 0, 1, 0",
    }
    lines = [f"{name}: {{rows: 1, data: [{data}]}}" for name, data in entries.items()]
    write(folder / "calibration" / "left.yaml", "image_width: 16", "image_height: 12", *lines)
    write(folder / "global_pose.csv", *_global_poses())


def write_velodynes(root: Path) -> None:
    folder = root / "2019-01-10-11-46-21-radar-oxford-10k"
    for time in _TIMES:
        image = np.full((106, 20), 3, dtype=np.uint8)
        image[98:] = (time // 1000 + np.arange(20)).astype("<i8").view(np.uint8).reshape(20, 8).T
        path = folder / "velodyne_left" / f"{time // 1000}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(path), image)
        right = folder / "velodyne_right" / f"{time // 1000}.bin"
        right.parent.mkdir(parents=True, exist_ok=True)
        np.column_stack([_points(), np.ones(40)]).T.astype("<f4").tofile(right)
    for name in ("velodyne_left", "velodyne_right"):
        write(root / "extrinsics" / f"{name}.txt", "-0.6 -0.3 -0.2 0 0 -3.1")
    write(folder / "vo" / "vo.csv", "source_timestamp,destination_timestamp,x,y,z,roll,pitch,yaw",
          f"{_TIMES[1] // 1000},{_TIMES[0] // 1000},0.5,0,0,0,0,0")  # fmt: skip


def write_ford(root: Path) -> None:
    from ford_layout import calibration_file, stamped, urdf_pose, write_yaml
    from made_bags import Bag
    from velodyne_packets import BLOCK_US, packet

    calibration, bag = root / "Calibration-V2", Bag()
    for i, time in enumerate(_TIMES):
        bag.pose_stamped("/pose_ground_truth", time, (i, 0, 0, 0, 0, 0, 1))
        azimuths = np.rint((90.0 + np.arange(12) * BLOCK_US * 1e-6 * 3600.0) * 100).astype(np.int64)
        ranges = np.tile(np.linspace(4.0, 30.0, 32), (12, 1))
        bag.packets("/lidar_red_scan", time, [(time, packet(azimuths, ranges, time // 1000))], "lidar_red")
        bag.image("/image_front_left", time, np.full((12, 16, 3), 7, np.uint8), "bgr8", "camera_front_left")
        _image(root / f"{_FORD}-FL" / f"{time // 1000}.png", colour=True)
    for sensor in ("lidar_red", "camera_front_left"):
        write_yaml(calibration / calibration_file(sensor), stamped(urdf_pose(sensor), sensor))
    intrinsics = {"height": 12, "width": 16, "K": [20, 0, 8, 0, 20, 6, 0, 0, 1], "D": [0.0] * 5}
    projection = {"P": [20, 0, 8, 0, 0, 20, 6, 0, 0, 0, 1, 0]}
    write_yaml(calibration / "cameraFrontLeftIntrinsics.yaml", intrinsics | projection)
    bag.write(root / f"{_FORD}.bag")


def write_clouds(root: Path) -> None:
    for time in _TIMES:
        _floats(root / "summer" / "scans" / f"{time}.bin", 0.5)
    write(root / "summer" / "times.txt", *map(str, _TIMES))
    write(root / "summer" / "poses.txt", *(f"{t} {i} 0 0 0 0 0 1" for i, t in enumerate(_TIMES)))


def _all_of(drive: DriveFiles) -> None:
    from relocbench.datasets.importers.nclt.images import read_table

    read_table.cache_clear()
    drive.with_times_only()
    read_all(drive)


def _reads(name: str) -> Read:
    def run(place: Place) -> None:
        from relocbench.datasets.importers.boreas.recording import read_boreas
        from relocbench.datasets.importers.clouds.recording import read_clouds
        from relocbench.datasets.importers.complex_urban.recording import read_complex_urban
        from relocbench.datasets.importers.ford_av.files import find_logs
        from relocbench.datasets.importers.ford_av.recording import ReadingOptions, read_ford
        from relocbench.datasets.importers.helipr.recording import LIDARS, read_helipr
        from relocbench.datasets.importers.kitti360.recording import read_kitti360
        from relocbench.datasets.importers.mulran.recording import read_mulran
        from relocbench.datasets.importers.nclt.recording import read_nclt
        from relocbench.progress import Silent

        root = place.root
        readers: dict[str, Callable[[], DriveFiles]] = {
            "boreas": lambda: read_boreas(root / "boreas-2021-01-26-11-22", "a"),
            "mulran": lambda: read_mulran(root / "DCC01", "a", "poses"),
            "helipr": lambda: read_helipr(root / "KAIST05", "a", LIDARS, "poses"),
            "nclt": lambda: read_nclt(root / "2012-01-08", "a", "poses"),
            "kitti-360": lambda: read_kitti360(root, "0000", "a", "poses"),
            "complex-urban": lambda: read_complex_urban(root / "urban28", "a", ["VLP_left", "SICK_back"], "poses"),
            "ford-av": lambda: read_ford(
                find_logs([root / f"{_FORD}.bag"], None)[0], ReadingOptions(axes="ros"), Silent()
            ),
            "folder-of-clouds": lambda: read_clouds(root / "summer", "a", Silent()),
        }
        _all_of(readers[name]())

    return run


def _velodynes(place: Place) -> None:
    from relocbench.datasets.importers.robotcar.recording import read_robotcar

    read_all(read_robotcar(place.root / "2019-01-10-11-46-21-radar-oxford-10k"))


SEEDS: dict[str, Any] = {
    "boreas": write_boreas,
    "mulran": write_mulran,
    "helipr": write_helipr,
    "nclt": write_nclt,
    "kitti-360": write_kitti360,
    "complex-urban": write_complex_urban,
    "ford-av": write_ford,
    "folder-of-clouds": write_clouds,
    "velodynes": write_velodynes,
}
PARSERS = (
    *(
        Parser(f"{name}-drive", name, ("*", "*/**/*"), _reads(name), names=True)
        for name in SEEDS
        if name != "velodynes"
    ),
    Parser("velodynes-drive", "velodynes", ("*/**/*",), _velodynes, names=True),
)
