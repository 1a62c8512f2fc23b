"""Importers of recordings: KITTI odometry, TUM RGB-D, 4Seasons, Oxford RobotCar, the generic folder."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from fuzz.asking import asks, write
from fuzz.parser import Parser, Place, Read
from fuzz.sensors import points, read_all

_START_NS = 1_600_000_000_000_000_000
_STEP_NS = 100_000_000
_UNIT = "0 0 0 1"


def _picture(path: Path, size: tuple[int, int], *, depth: bool = False, seed: int = 0) -> None:
    width, height = size
    rng = np.random.default_rng(seed)
    coarse = rng.integers(20, 230, (height // 4 + 1, width // 4 + 1), dtype=np.uint8)
    image = np.repeat(np.repeat(coarse, 4, axis=0), 4, axis=1)[:height, :width]
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image.astype(np.uint16) * 100 if depth else image)


def write_kitti(root: Path) -> None:
    """Three frames with scans instead of right images."""
    sequence = root / "kitti" / "sequences" / "00"
    projection = "20 0 15.5 {} 0 20 11.5 0 0 0 1 0"
    write(
        sequence / "calib.txt",
        f"P0: {projection.format(0)}",
        f"P1: {projection.format(-8)}",
        "Tr: 0 -1 0 0 0 0 -1 0 1 0 0 0",
    )
    write(sequence / "times.txt", *(f"{0.1 * i:e}" for i in range(3)))
    write(root / "kitti" / "poses" / "00.txt", *(f"1 0 0 0 0 1 0 0 0 0 1 {0.1 * i}" for i in range(3)))
    for i in range(3):
        _picture(sequence / "image_0" / f"{i:06d}.png", (32, 24), seed=i)
        (sequence / "velodyne").mkdir(exist_ok=True)
        cloud = points(60)
        cloud[:, 1:3] -= 10
        cloud.astype("<f4").tofile(sequence / "velodyne" / f"{i:06d}.bin")


def write_tum(root: Path) -> None:
    """Two frames of a freiburg3 sequence."""
    folder = root / "rgbd_dataset_freiburg3_made_up"
    for kind in ("rgb", "depth"):
        for i in (1, 2):
            _picture(folder / kind / f"1305031102.{i}00000.png", (640, 480), depth=kind == "depth", seed=i)
        write(
            folder / f"{kind}.txt",
            "# made up",
            *(f"1305031102.{i}00000 {kind}/1305031102.{i}00000.png" for i in (1, 2)),
        )
    write(
        folder / "groundtruth.txt", "# made up", *(f"1305031102.{i:02d} {i / 64} 0 0 {_UNIT}" for i in range(0, 40, 5))
    )


def write_four_seasons(root: Path) -> None:
    """One recording with every file that is read, and relocalization files."""
    folder, calibration = root / "recording_2020-10-07_14-47-51", root / "Calibration"
    times = [1602074877390449152 + i * _STEP_NS for i in range(3)]
    for i, time in enumerate(times):
        for camera in ("cam0", "cam1"):
            _picture(folder / "undistorted_images" / camera / f"{time}.png", (32, 24), seed=i)
        body = [line for k in range(3) for line in (f"{5 + k}.0,{6 + k}.0,0.25,4e6,0.5,0,1", "1,2,3,4,5,6,7,8,")]
        gps = ["# GPS Data", "1,0,0,0,1,0,0,0,1", "", "0.5,0.25,0.125"] if i == 0 else []
        head = [
            "# timestamp",
            f"{time}",
            "20.0,20.0,15.5,11.5,32,24,3",
            f"0,0,{0.25 * i},0,0,0,1",
            "# Exposure time (ms)",
            "0.25",
        ]
        write(folder / "KeyFrameData" / f"KeyFrame_{time}.txt", *head, *gps, *body)
    write(folder / "GNSSPoses.txt", "# header", *(f"{t},0,0,{0.25 * i},0,0,0,1,1.0,2" for i, t in enumerate(times)))
    write(folder / "times.txt", *(f"{t} {t // 10**9}.{t % 10**9:09d} 0.25" for t in times))
    titles = ("transform_S_AS", "TS_cam_imu", "transform_w_gpsw", "transform_gps_imu", "transform_e_gpsw")
    parts = [line for title in titles for line in (f"# {title}: translation", "0,0,0,0,0,0,1", "")]
    write(folder / "Transformations.txt", *parts, "# GNSS scale", "1.0")
    sentences = [f"GPGGA,1247{57 + i}.00,4811.40{i},N,01136.60{i},E,4,08,0.9,500.{i},M,45.0,M,," for i in range(3)]
    write(folder / "septentrio.nmea", *(f"${s}*{_checksum(s):02X}" for s in sentences))
    write(folder / "result.txt", *(f"{t // 10**9}.{t % 10**9:09d} 0 0 {i} {_UNIT}" for i, t in enumerate(times)))
    write(root / "mlad" / "poses.txt", *(f"{t} 0 0 {i} {_UNIT}" for i, t in enumerate(times)))
    for k in (0, 1):
        write(
            calibration / f"undistorted_calib_{k}.txt", "Pinhole 20.0 20.0 15.5 11.5 0 0 0 0", "32 24", "crop", "32 24"
        )
    write(calibration / "calib_0.txt", "Equidistant 20.0 20.0 15.5 11.5 0.01 0 0 0", "32 24", "crop", "32 24")
    write(calibration / "undistorted_calib_stereo.txt", "1 0 0 -0.3", "0 1 0 0", "0 0 1 0", "0 0 0 1")
    write(root / "lists" / "relocalizationFile_x_easy.txt", "# ref query", f"{times[0]} {times[1]} 0 0 0.25 {_UNIT}")


def _checksum(sentence: str) -> int:
    value = 0
    for byte in sentence.encode():
        value ^= byte
    return value


def write_robotcar(root: Path) -> None:
    """One traversal with lidar, a camera, odometry and GNSS/INS, and the SDK's folders."""
    folder = root / "2014-11-18-13-20-12"
    times = [1_416_316_800_000_000 + 50_000 * i for i in range(4)]
    scan = np.zeros((541, 3))
    scan[:, 0] = 5
    for time in times:
        (folder / "lms_front").mkdir(parents=True, exist_ok=True)
        scan.astype("<f8").tofile(folder / "lms_front" / f"{time}.bin")
        _picture(folder / "stereo" / "left" / f"{time}.png", (32, 24))
    for sensor in ("lms_front", "stereo"):
        write(folder / f"{sensor}.timestamps", *(f"{time} 1" for time in times))
    steps = (f"{b},{a},0.5,0,0,0,0,0" for a, b in pairwise(times))
    write(folder / "vo" / "vo.csv", "source_timestamp,destination_timestamp,x,y,z,roll,pitch,yaw", *steps)
    columns = (
        "timestamp,ins_status,latitude,longitude,altitude,northing,easting,down,utm_zone,"
        "velocity_north,velocity_east,velocity_down,roll,pitch,yaw"
    )
    rows = (
        f"{t},INS_SOLUTION_GOOD,51.7,-1.2,100,{5735000 + i},620000,-100,30U,0,0,0,0,0,0" for i, t in enumerate(times)
    )
    write(folder / "gps" / "ins.csv", columns, *rows)
    for sensor in ("lms_front", "stereo", "ins"):
        write(root / "extrinsics" / f"{sensor}.txt", "0 0 0 0 0 0")
    write(root / "models" / "stereo_wide_left.txt", "20 20 15.5 11.5", "0 0 1 0", "1 0 0 0", "0 1 0 0", "0 0 0 1")
    v, u = np.mgrid[:24, :32].astype("<f8")
    np.stack([u, v]).tofile(root / "models" / "stereo_wide_left_distortion_lut.bin")
    write(root / "tags" / "2014-11-18-13-20-12.yaml", "- sun", "- roadworks")


def write_generic(root: Path) -> None:
    """A folder of one camera, and one of two."""
    for name in ("one", "two"):
        folder = root / name
        times = [_START_NS + i * _STEP_NS for i in range(3)]
        for i, time in enumerate(times):
            for camera in ("",) if name == "one" else ("left", "right"):
                _picture(folder / "images" / camera / f"{time}.png", (32, 24), seed=i)
            if name == "one":
                _picture(folder / "depth" / f"{time}.png", (32, 24), depth=True)
            else:
                for camera in ("left", "right"):
                    rows = ("5.0,6.0,0.25,0.01", "7.0,8.0,0.5,0.01")
                    write(folder / "points" / camera / f"{time}.csv", "u,v,inverse_depth,sigma", *rows)
        camera = "model: {}, width: 32, height: 24, fx: 20.0, fy: 20.0, cx: 15.5, cy: 11.5, distortion: {}"
        lens = camera.format("radtan", "[0.01, 0, 0, 0]")
        if name == "one":
            flat = camera.format("pinhole", "[]").replace(", ", "\n")
            write(
                folder / "camera.yaml",
                flat,
                "depth_scale: 0.001",
                "condition: {weather: rain, tags: [wet]}",
                "location: corner",
            )
        else:
            write(
                folder / "camera.yaml",
                "cameras:",
                f"  left: {{{camera.format('pinhole', '[]')}}}",
                f"  right: {{{lens}}}",
            )
        write(
            folder / "poses.txt",
            "# t tx ty tz qx qy qz qw",
            *(f"{t} 0 0 {0.25 * i} {_UNIT}" for i, t in enumerate(times)),
        )


def _kitti(read: Callable[[object], object]) -> Read:
    def run(place: Place) -> None:
        from relocbench.datasets.importers.kitti.files import KittiSequence

        read(KittiSequence(place.root / "kitti", "00"))

    return run


def _kitti_times(sequence: object) -> None:
    from relocbench.progress import Silent

    sequence.times(10.0, 3, Silent())  # type: ignore[attr-defined]


def _kitti_calibration(sequence: object) -> None:
    calibration = sequence.calibration  # type: ignore[attr-defined]
    calibration.T_cam0_cam("image_0")
    calibration.T_cam0_lidar()


def _kitti_recording(place: Place) -> None:
    from relocbench.datasets.importers.kitti.recording import read_kitti

    read_all(read_kitti(place.root / "kitti", "00", odometry="poses"))


def _four_seasons(name: str) -> Read:
    def run(place: Place) -> None:
        from relocbench.datasets.importers.four_seasons import calibration as four_seasons_calibration
        from relocbench.datasets.importers.four_seasons import files as four_seasons_files
        from relocbench.datasets.importers.four_seasons import receiver as four_seasons_receiver
        from relocbench.datasets.sensors.pose_tables import read_trajectory

        readers: dict[str, Callable[[Path], object]] = {
            "poses": read_trajectory,
            "times": four_seasons_files.read_times,
            "GNSSPoses": four_seasons_files.read_gnss_poses,
            "Transformations": lambda path: four_seasons_files.read_transformations(path).T_e_w,
            "KeyFrame": lambda path: four_seasons_files.read_keyframe(path).points(1.0),
            "nmea": four_seasons_receiver.read_gga,
            "result": read_trajectory,
            "camera": four_seasons_calibration.read_camera,
            "stereo": four_seasons_calibration.read_stereo,
        }
        readers[name](place.target)

    return run


def _robotcar_files(name: str) -> Read:
    def run(place: Place) -> None:
        from relocbench.datasets.importers.robotcar import files

        readers: dict[str, Callable[[Path], object]] = {
            "timestamps": files.read_timestamps,
            "vo": files.read_visual_odometry,
            "ins": files.read_inertial,
            "extrinsics": files.read_extrinsics,
            "model": files.read_lens_model,
            "tags": files.read_tags,
        }
        readers[name](place.target)

    return run


def _robotcar(place: Place) -> None:
    from relocbench.datasets.importers.robotcar.recording import read_robotcar
    from relocbench.datasets.importers.robotcar.sensors import read_look_up_table

    read_look_up_table.cache_clear()
    read_all(read_robotcar(place.root / "2014-11-18-13-20-12"))


def _generic(place: Place) -> None:
    from relocbench.datasets.importers.generic.dataset import read_folder, rig_trajectory

    for name in ("one", "two"):
        rig_trajectory(read_folder(place.root / name, name), 1.0)


_BUILD = ("--out", "{out}/ds", "-j", 1, "-q", "--correspondences", 5)
_RECORDING = "recording_2020-10-07_14-47-51"
SEEDS = {
    "kitti": write_kitti,
    "tum": write_tum,
    "four-seasons": write_four_seasons,
    "robotcar": write_robotcar,
    "generic": write_generic,
}
PARSERS = (
    Parser("kitti-poses", "kitti", ("kitti/poses/00.txt",), _kitti(lambda s: s.poses()), text=True),  # type: ignore[attr-defined]
    Parser("kitti-times", "kitti", ("kitti/sequences/00/times.txt",), _kitti(_kitti_times), text=True),
    Parser("kitti-calib", "kitti", ("kitti/sequences/00/calib.txt",), _kitti(_kitti_calibration), text=True),
    Parser("kitti-recording", "kitti", ("kitti/**/*",), _kitti_recording, names=True),
    Parser(
        "kitti-command",
        "kitti",
        ("kitti/**/*",),
        asks("build-dataset", "kitti", "{root}/kitti", "--pair-step", 1, *_BUILD),
        names=True,
        brief=False,
    ),
    Parser(
        "tum-command",
        "tum",
        ("*/*", "*/*/*"),
        asks("build-dataset", "tum-rgbd", "{root}/rgbd_dataset_freiburg3_made_up", "--pair-step", 1, *_BUILD),
        names=True,
        brief=False,
    ),
    Parser(
        "tum-lists",
        "tum",
        ("*/*.txt",),
        asks("build-dataset", "tum-rgbd", "{root}/rgbd_dataset_freiburg3_made_up", "--pair-step", 1, *_BUILD),
        text=True,
        brief=False,
    ),
    Parser("4seasons-poses", "four-seasons", ("mlad/poses.txt",), _four_seasons("poses"), text=True),
    Parser("4seasons-times", "four-seasons", ("*/times.txt",), _four_seasons("times"), text=True),
    Parser("4seasons-gnss", "four-seasons", ("*/GNSSPoses.txt",), _four_seasons("GNSSPoses"), text=True),
    Parser(
        "4seasons-transformations",
        "four-seasons",
        ("*/Transformations.txt",),
        _four_seasons("Transformations"),
        text=True,
    ),
    Parser("4seasons-keyframe", "four-seasons", ("*/KeyFrameData/*",), _four_seasons("KeyFrame"), text=True),
    Parser("4seasons-nmea", "four-seasons", ("*/septentrio.nmea",), _four_seasons("nmea"), text=True),
    Parser("4seasons-trajectory", "four-seasons", ("*/result.txt",), _four_seasons("result"), text=True),
    Parser("4seasons-camera", "four-seasons", ("Calibration/*calib_0.txt",), _four_seasons("camera"), text=True),
    Parser("4seasons-stereo", "four-seasons", ("Calibration/*stereo.txt",), _four_seasons("stereo"), text=True),
    Parser(
        "4seasons-command",
        "four-seasons",
        ("recording*/*", "recording*/*/*", "recording*/*/*/*", "Calibration/*"),
        asks("build-dataset", "four-seasons", f"{{root}}/{_RECORDING}", "--pair-step", 1, *_BUILD),
        names=True,
        brief=False,
    ),
    Parser(
        "4seasons-lists",
        "four-seasons",
        ("lists/*",),
        asks(
            "build-dataset", "four-seasons", f"{{root}}/{_RECORDING}", "--relocalization-files", "{root}/lists", *_BUILD
        ),
        text=True,
        brief=False,
    ),
    *(
        Parser(f"robotcar-{name}", "robotcar", (files,), _robotcar_files(name), text=True)
        for name, files in (
            ("timestamps", "*/*.timestamps"),
            ("vo", "*/vo/vo.csv"),
            ("ins", "*/gps/ins.csv"),
            ("extrinsics", "extrinsics/*"),
            ("model", "models/*.txt"),
            ("tags", "tags/*"),
        )
    ),
    Parser("robotcar-recording", "robotcar", ("*/*", "*/*/*", "*/*/*/*"), _robotcar, names=True),
    Parser("generic-camera.yaml", "generic", ("*/camera.yaml",), _generic, text=True),
    Parser("generic-poses", "generic", ("*/poses.txt",), _generic, text=True),
    Parser("generic-folder", "generic", ("*/*/*", "*/*/*/*"), _generic, names=True),
    Parser(
        "generic-command",
        "generic",
        ("*/*", "*/*/*", "*/*/*/*"),
        asks("build-dataset", "generic", "{root}/one", "--pair-step", 1, *_BUILD),
        names=True,
        brief=False,
    ),
    Parser(
        "generic-rig-command",
        "generic",
        ("two/*", "two/*/*", "two/*/*/*"),
        asks("build-dataset", "generic", "{root}/two", "--pair-step", 1, *_BUILD),
        names=True,
        brief=False,
    ),
)
