"""Kind ``robotcar``: recordings in the layout of Oxford RobotCar, with ground truth across drives from their lidar."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from relocbench.datasets.core.build_options import ImportOptions
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.datasets.importers.assembly import check_folder, open_writer
from relocbench.execution import Run
from relocbench.progress import Reporter

if TYPE_CHECKING:
    from relocbench.datasets.core.dataset import Dataset


class Options(FieldOptions):
    """Options of ``relocbench build-dataset robotcar``."""

    extrinsics: Path | None = Field(None, description="the SDK's folder of extrinsics; default: beside the recordings")
    models: Path | None = Field(None, description="the SDK's folder of camera models and undistortion tables")
    tags: Path | None = Field(None, description="the SDK's folder of condition tags")
    lidars: tuple[str, ...] = Field(
        (), description="lidars to use: lms_front, lms_rear, velodyne_left, velodyne_right; default: all recorded"
    )
    odometry: Literal["auto", "vo", "ins", "lidar"] = Field(
        "auto",
        description="visual odometry (vo/vo.csv), GNSS/INS (gps/ins.csv), or computed from the scans of a Velodyne; "
        "default: vo, or lidar without vo/vo.csv",
    )


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Build a dataset from a reference traversal, the first source, and query ones. Raises as :class:`Importer`."""
    from relocbench.datasets.core.build import Build
    from relocbench.datasets.groundtruth.jobs.build import build_ground_truth, check_recordings
    from relocbench.datasets.groundtruth.odometry.deferred import later
    from relocbench.datasets.importers.robotcar.recording import read_robotcar_drives

    assert isinstance(options, Options)
    for source in sources:
        check_folder(source, "a traversal")
    recordings = read_robotcar_drives(
        sources,
        extrinsics=options.extrinsics,
        models=options.models,
        tags=options.tags,
        lidars=options.lidars or None,
        cameras=() if options.without_images else _with_right_camera(sources, options.cameras),
        odometry=options.odometry,
        reporter=reporter,
        from_lidar=later,
    )
    options.check_conditions([r.name for r in recordings])
    check_recordings(recordings, options)
    writer = open_writer("robotcar", sources, options, out, "robotcar_" + recordings[0].name)
    return build_ground_truth(recordings, Build(writer, options, reporter, run))


def _with_right_camera(sources: Sequence[Path], cameras: tuple[str, ...]) -> tuple[str, ...] | None:
    """The chosen cameras and, for the check of depth against stereo, the right partner of the left one; None: all."""
    if not cameras:
        return None
    right = "stereo_left" in cameras and all((source / "stereo" / "right").is_dir() for source in sources)
    return (*cameras, "stereo_right") if right else cameras
