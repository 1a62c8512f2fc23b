"""A traversal of the Oxford RobotCar dataset, read as a recording: lidar, cameras, odometry, GNSS/INS, conditions.

The rig's origin is that of the vehicle, the left lens of the stereo camera; its axes are x forward, y left, z up. The
folders ``extrinsics``, ``models`` and ``tags`` come from the dataset's SDK and are looked for in the traversal's folder
and the two folders above it. Traversals of the Oxford Radar RobotCar dataset have two Velodynes in addition. LD-MRS and
radar scans are not read.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.schema import Condition
from relocbench.datasets.groundtruth.odometry.lidar_odometry import FromLidar, lidar_odometry
from relocbench.datasets.importers.lidar_drives.conditions import simulated_condition
from relocbench.datasets.importers.lidar_drives.drives import chosen_of
from relocbench.datasets.importers.lidar_drives.files import camera_of, image_size
from relocbench.datasets.importers.robotcar import files
from relocbench.datasets.importers.robotcar.lidars import VELODYNES, read_lidars
from relocbench.datasets.importers.robotcar.sensors import RobotCarCamera, present_files
from relocbench.datasets.importers.robotcar.track import T_RIG_VEHICLE, MapOrigin, map_trajectory, visual_trajectory
from relocbench.datasets.sensors.recording import CameraStream, FieldRecording, Trajectory
from relocbench.datasets.sensors.trajectories import traversal_names
from relocbench.errors import DatasetError
from relocbench.geometry import invert, make_transform
from relocbench.progress import SILENT, Reporter

OdometrySource = Literal["auto", "vo", "ins", "lidar"]

_PRIOR_SIGMA_M = 10.0
_NO_MOTION = (
    "has no odometry: it needs vo/vo.csv, or scans of a Velodyne to compute it from (those of lms_front and lms_rear "
    "are single planes), or --odometry ins with gps/ins.csv"
)
_POOR_PRIOR_SIGMA_M = 30.0
"""for traversals tagged poor-gps"""
_NAME = re.compile(r"([0-9]{4})-([0-9]{2})-([0-9]{2})-[0-9]{2}-[0-9]{2}-[0-9]{2}(-radar-.*)?")


@dataclass(frozen=True)
class Lens:
    """One camera of the car, each lens of the stereo camera counted separately."""

    folder: str
    model: str
    bayer: Literal["GBRG", "RGGB"]

    @property
    def sensor(self) -> str:
        """The device that timestamps and extrinsics belong to: ``stereo`` for all three of its lenses."""
        return self.folder.split("/")[0]


CAMERAS: dict[str, Lens] = {
    "stereo_left": Lens("stereo/left", "stereo_wide_left", "GBRG"),
    "stereo_centre": Lens("stereo/centre", "stereo_narrow_left", "GBRG"),
    "stereo_right": Lens("stereo/right", "stereo_wide_right", "GBRG"),
    "mono_left": Lens("mono_left", "mono_left", "RGGB"),
    "mono_right": Lens("mono_right", "mono_right", "RGGB"),
    "mono_rear": Lens("mono_rear", "mono_rear", "RGGB"),
}


@dataclass(frozen=True)
class Calibration:
    """The folders of the dataset's SDK."""

    extrinsics: Path
    models: Path | None
    tags: Path | None

    def extrinsics_of(self, sensor: str) -> Array:
        """(4, 4) from a lidar or the INS to the vehicle, but from the vehicle to a camera."""
        return files.read_extrinsics(self.extrinsics / f"{sensor}.txt")


def read_robotcar(
    folder: Path,
    *,
    name: str | None = None,
    extrinsics: Path | None = None,
    models: Path | None = None,
    tags: Path | None = None,
    lidars: Sequence[str] | None = None,
    cameras: Sequence[str] | None = None,
    odometry: OdometrySource = "auto",
    origin: MapOrigin | None = None,
    reporter: Reporter = SILENT,
    from_lidar: FromLidar = lidar_odometry,
) -> FieldRecording:
    """Read a traversal as a recording; scans and images are opened later, on demand.

    Args:
        folder: folder of the traversal (with ``lms_front``, ``stereo``, ``vo``, ``gps``).
        name: name of the recording; default: that of the folder.
        extrinsics, models, tags: folders of the SDK; default: in the traversal's folder or the two above it.
        lidars, cameras: sensors to read (:data:`~.lidars.LIDARS`, :data:`CAMERAS`); default: those whose folders exist.
        odometry: ``vo`` chains visual odometry, ``ins`` uses GNSS/INS instead, ``lidar`` registers the scans of a
            Velodyne; ``auto`` is ``vo``, or ``lidar`` where there is a Velodyne and no ``vo/vo.csv``.
        origin: origin of the map that priors are in; all drives need that of the first (:func:`map_origin`).
            Default: this drive's own.
        from_lidar: computes odometry from scans; called after everything else has been read.

    Raises:
        DatasetError: with file and line: something needed is missing or damaged.
        ConfigError: RobotCar has no such lidar or camera.
    """
    title = name or traversal_names([folder])[0]
    calibration = _find_calibration(folder, extrinsics, models, tags)
    streams = read_lidars(folder, calibration.extrinsics_of, lidars, title, reporter)
    tagged = _tags(calibration, folder)
    prior, found_origin = _prior(folder, calibration, tagged, origin, required=odometry == "ins", reporter=reporter)
    images = _cameras(folder, calibration, cameras, title, reporter)
    spinning = next((stream for stream in streams if stream.pattern == "spinning"), None)
    source = ""
    if odometry == "ins":
        assert prior is not None
        motion = prior
    elif odometry == "lidar" or (
        odometry == "auto" and spinning is not None and not (folder / "vo" / "vo.csv").exists()
    ):
        if spinning is None:
            raise DatasetError(f"holds no scans of {' or '.join(VELODYNES)} to compute odometry from", folder)
        reporter.note(f"{title}: odometry is computed from the scans of {spinning.name}")
        motion, source = from_lidar(spinning, reporter), spinning.name
    else:
        if odometry == "auto" and not (folder / "vo" / "vo.csv").exists():
            raise DatasetError(_NO_MOTION, folder)
        steps = files.read_visual_odometry(folder / "vo" / "vo.csv", reporter)
        motion = visual_trajectory(steps, prior)
        if motion.breaks:
            many, first = len(motion.breaks), motion.times_ns[motion.breaks[0]]
            reporter.note(f"{title}: visual odometry has {many} interruptions, the first before {first} ns")
    if found_origin is not None and origin is None:
        reporter.note(f"{title}: GNSS positions are relative to {found_origin}")
    return FieldRecording(
        name=title,
        folder=folder,
        condition=_condition(folder, tagged),
        odometry=motion,
        lidars=streams,
        cameras=images,
        prior=prior,
        prior_sigma_m=_POOR_PRIOR_SIGMA_M if "poor-gps" in tagged else _PRIOR_SIGMA_M,
        odometry_lidar=source,
    )


def read_robotcar_drives(folders: Sequence[Path], **options: object) -> list[FieldRecording]:
    """Read several traversals whose priors share a map, that of the first traversal with GNSS.

    Args:
        options: options of :func:`read_robotcar` for all traversals.
    """
    origin = next((found for folder in folders if (found := map_origin(folder)) is not None), None)
    names = traversal_names(folders)
    return [
        read_robotcar(folder, name=name, origin=origin, **options)  # type: ignore[arg-type]
        for folder, name in zip(folders, names, strict=True)
    ]


def map_origin(folder: Path) -> MapOrigin | None:
    """Origin of a traversal's own map; None without GNSS/INS. Raises DatasetError with file and line."""
    path = folder / "gps" / "ins.csv"
    return MapOrigin.of(files.read_inertial(path)) if path.exists() else None


def _find_calibration(folder: Path, extrinsics: Path | None, models: Path | None, tags: Path | None) -> Calibration:
    def find(given: Path | None, name: str) -> Path | None:
        if given is not None:
            if not given.is_dir():
                raise DatasetError(f"no such folder; expected the {name} of the dataset's SDK", given)
            return given
        drive = folder.resolve()
        return next((p / name for p in (drive, drive.parent, drive.parent.parent) if (p / name).is_dir()), None)

    found = find(extrinsics, "extrinsics")
    if found is None:
        raise DatasetError("has no folder 'extrinsics' in it or above it; expected that of the dataset's SDK", folder)
    return Calibration(found, find(models, "models"), find(tags, "tags"))


def _cameras(
    folder: Path, calibration: Calibration, asked: Sequence[str] | None, title: str, reporter: Reporter
) -> dict[str, CameraStream]:
    streams: dict[str, CameraStream] = {}
    distorted: list[str] = []
    for name in chosen_of(asked, tuple(CAMERAS), tuple(CAMERAS), "RobotCar has no camera"):
        lens = CAMERAS[name]
        where = folder / lens.folder
        if not where.is_dir():
            if asked is not None:
                raise DatasetError("no such folder; expected images", where)
            continue
        what = f"images of {title}/{name}"
        found = present_files(where, folder / f"{lens.sensor}.timestamps", ".png", what, reporter)
        if not found:
            continue
        if calibration.models is None:
            raise DatasetError("has no folder 'models' in it or above it; expected that of the dataset's SDK", folder)
        model = files.read_lens_model(calibration.models / f"{lens.model}.txt")
        table = calibration.models / f"{lens.model}_distortion_lut.bin"
        if not table.exists():
            distorted.append(name)
        paths, times = tuple(found.values()), np.array(list(found), dtype=np.int64)
        camera = camera_of("pinhole", image_size(paths[0]), model.intrinsics, (), model.path)
        T_rig_cam = T_RIG_VEHICLE @ _T_vehicle_image(calibration, lens, model)
        size_from, look_up = f"the first image of {name}", table if table.exists() else None
        streams[name] = RobotCarCamera(name, camera, T_rig_cam, paths, times, size_from, lens.bayer, look_up)
    if distorted:
        reporter.note(f"{title}: no look-up table for {', '.join(distorted)}; images are not undistorted")
    return streams


def _T_vehicle_image(calibration: Calibration, lens: Lens, model: files.LensModel) -> Array:
    """(4, 4) transform from image axes to the vehicle.

    The published models of the narrow pair are relative to the centre lens, those of the wide pair to the left lens,
    which is the vehicle's origin. The right lens is in both pairs, which gives the centre lens's offset from the left.
    """
    T_camera_vehicle = calibration.extrinsics_of(lens.sensor)
    T_left_camera = np.eye(4)
    if lens.model == "stereo_narrow_left" and calibration.models is not None:
        wide, narrow = (
            files.read_lens_model(calibration.models / f"stereo_{pair}_right.txt").T_camera_image[:3, 3]
            for pair in ("wide", "narrow")
        )
        T_left_camera = make_transform(np.eye(3), wide - narrow)
    return np.asarray(invert(T_camera_vehicle) @ T_left_camera @ model.T_camera_image)


def _prior(
    folder: Path,
    calibration: Calibration,
    tags: Sequence[str],
    origin: MapOrigin | None,
    required: bool,
    reporter: Reporter,
) -> tuple[Trajectory | None, MapOrigin | None]:
    """The prior ``T_map_rig`` by GNSS/INS and the origin of its map; (None, None) without usable GNSS/INS."""
    path = folder / "gps" / "ins.csv"
    if not required:
        if "no-gps" in tags:
            reporter.note(f"{folder.name} is tagged no-gps; its GNSS/INS is not used")
            return None, None
        if not path.exists():
            reporter.note(f"{folder.name} has no gps/ins.csv; drives are registered without GNSS")
            return None, None
    track = files.read_inertial(path, reporter)
    if track.left_out:
        reporter.note(f"{path}: {track.left_out} solutions whose status is not good are left out")
    start = origin or MapOrigin.of(track)
    if start.zone != track.zone:
        raise DatasetError(f"is in UTM zone {track.zone}, but the other drives are in zone {start.zone}", path)
    T_rig_ins = T_RIG_VEHICLE @ calibration.extrinsics_of("ins")
    return map_trajectory(track, start, T_rig_ins), start


def _tags(calibration: Calibration, folder: Path) -> tuple[str, ...]:
    if calibration.tags is None:
        return ()
    path = calibration.tags / f"{folder.resolve().name}.yaml"
    return files.read_tags(path) if path.exists() else ()


def _condition(folder: Path, tags: Sequence[str]) -> Condition:
    """The condition by the tags and the date in the folder's name.

    The date of a simulated drive means nothing; its condition is named in ``drives.csv`` beside it and becomes a tag.
    """
    simulated = simulated_condition(folder)
    if simulated is not None:
        return files.condition_of([*tags, simulated] if simulated else tags)
    date = _NAME.fullmatch(folder.resolve().name)
    month = int(date[2]) if date and 1 <= int(date[2]) <= 12 else None
    return files.condition_of(tags, month)
