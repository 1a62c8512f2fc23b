"""Kind ``rosbag``: bags of ROS 1 and 2 and MCAP files, with ground truth across drives from their lidar."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import Field, field_validator

from relocbench.datasets.core.build_options import ImportOptions
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.datasets.importers.assembly import check_several, open_writer
from relocbench.datasets.importers.rosbag.bag import SUFFIXES
from relocbench.datasets.sensors.point_times import parse_point_times
from relocbench.datasets.sensors.trajectories import traversal_names
from relocbench.errors import ConfigError, DatasetError, raise_all
from relocbench.execution import Run
from relocbench.progress import Reporter

if TYPE_CHECKING:
    from relocbench.datasets.core.dataset import Dataset
    from relocbench.datasets.importers.rosbag.reading import BagSettings


class Options(FieldOptions):
    """Options of ``relocbench build-dataset rosbag``."""

    cameras: tuple[str, ...] = Field(
        (), description="cameras whose images are paired, by name or topic; default: the first one"
    )
    lidars: tuple[str, ...] = Field(
        (), description="topics of lidars, such as /velodyne_points,/rear; default: guessed"
    )
    odometry: str = Field(
        "", description="topic of the odometry, 'tf', or 'lidar' to compute it from a spinning lidar; default: guessed"
    )
    gnss: str = Field(
        "",
        description="topic of NavSatFix, or of poses in a map that all drives share, or 'none'; default: the fixes",
    )
    base_frame: str = Field("", description="frame that is the rig (x forward, y left, z up); default: guessed")
    extrinsics: Path | None = Field(
        None, description="YAML file with poses of sensors and cameras, for bags without tf"
    )
    point_time: str = Field(
        "auto", description="times of points: auto, none, or FIELD:UNIT:BASE with s|ms|us|ns and scan|epoch|first"
    )
    motion: Literal["auto", "compensated", "distorted"] = Field(
        "auto",
        description="'compensated' ignores times of points, 'distorted' takes them from the azimuth if need be; "
        "auto: without times, told from the scans",
    )
    pattern: Literal["auto", "spinning", "push-broom"] = Field(
        "auto", description="push-broom if the points of a scan lie in one plane; default: by the scans"
    )
    min_range: float = Field(0.5, ge=0, description="metres; nearer points are left out")
    max_range: float = Field(100.0, gt=0, description="metres; farther points are left out")
    lidar_sigma: float = Field(0.03, gt=0, description="standard deviation of a range, metres")
    stamps: Literal["header", "receive"] = Field(
        "header", description="times by the headers of messages, or by when they were received"
    )
    max_pose_gap: float = Field(
        1.0,
        gt=0,
        description="longest gap in seconds between two poses to interpolate over; unless it is given, shorter gaps "
        "that are holes in a drive are not interpolated over either",
    )

    @field_validator("point_time")
    @classmethod
    def _known_times(cls, text: str) -> str:
        parse_point_times(text)
        return text


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Build a dataset from a reference drive, the first source, and query drives. Raises as :class:`Importer`."""
    from relocbench.datasets.core.build import Build
    from relocbench.datasets.groundtruth.jobs.build import build_ground_truth, check_recordings
    from relocbench.datasets.groundtruth.odometry.deferred import later
    from relocbench.datasets.importers.rosbag.recording import camera_names, open_bag, read_bag

    assert isinstance(options, Options)
    names = traversal_names(sources, SUFFIXES)
    check_several(names)
    options.check_conditions(names)
    settings = settings_of(options)
    opened = [open_bag(source, settings.wanted, reporter) for source in sources]
    writer = open_writer("rosbag", sources, options, out, "rosbag_" + names[0])
    recordings, faults, origin = [], [], None
    for one, name in zip(opened, names, strict=True):
        kept = out / "groundtruth" / "index" / f"{name}.npz"
        try:
            # Odometry that is missing is computed by the build, after it has checked all drives.
            recording, origin = read_bag(
                one, name, settings, origin=origin, kept=kept, reporter=reporter, from_lidar=later
            )
        except DatasetError as bad:
            faults.append(bad)
            continue
        recordings.append(recording)
    raise_all(faults)
    chosen = options.model_copy(update={"cameras": camera_names(opened[0], options.cameras)})
    check_recordings(recordings, chosen)
    return build_ground_truth(recordings, Build(writer, chosen, reporter, run))


def settings_of(options: Options) -> BagSettings:
    """How the options say that bags are read. Raises DatasetError with file and line of the extrinsics."""
    from relocbench.datasets.importers.rosbag.extrinsics import read_extrinsics
    from relocbench.datasets.importers.rosbag.reading import BagSettings
    from relocbench.datasets.importers.rosbag.roles import Wanted

    if options.min_range >= options.max_range:
        raise ConfigError(f"--min-range {options.min_range:g} is not below --max-range {options.max_range:g}")
    return BagSettings(
        wanted=Wanted(
            options.lidars, () if options.without_images else options.cameras, options.odometry, options.gnss
        ),
        base_frame=options.base_frame,
        extrinsics=read_extrinsics(options.extrinsics),
        extrinsics_file=options.extrinsics,
        point_times=parse_point_times(options.point_time),
        motion=options.motion,
        pattern=options.pattern,
        min_range_m=options.min_range,
        max_range_m=options.max_range,
        sigma_m=options.lidar_sigma,
        stamps=options.stamps,
        max_gap_ns=None if options.given("max_pose_gap") is None else round(options.max_pose_gap * 1e9),
    )
