"""Kind ``robotcar``: recordings in the layout of the Oxford RobotCar data set, with ground truth from their lidar."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from relocbench.datasets.core.build_options import ImportOptions
from relocbench.datasets.core.writer import DatasetWriter
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.datasets.importers.assembly import check_conditions, check_folder, configuration
from relocbench.execution import Run
from relocbench.progress import Reporter

if TYPE_CHECKING:
    from relocbench.datasets.core.dataset import Dataset


class Options(FieldOptions):
    """Options of ``relocbench build-dataset robotcar``."""

    extrinsics: Path | None = Field(None, description="the SDK's folder of extrinsics; default: beside the recordings")
    models: Path | None = Field(None, description="the SDK's folder of camera models and undistortion tables")
    tags: Path | None = Field(None, description="the SDK's folder of condition tags")
    lidars: tuple[str, ...] = Field((), description="lidars to use, such as lms_front,lms_rear; default: all there are")
    odometry: Literal["vo", "ins"] = Field("vo", description="visual odometry (vo/vo.csv) or GNSS/INS (gps/ins.csv)")


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """A dataset of a reference traversal (the first source) and the traversals that ask about it.

    Raises:
        DatasetError: with file and line, what is missing or wrong in a recording; or that no pair can be accepted.
        ConfigError: options that do not fit the recordings.
    """
    from relocbench.datasets.groundtruth.jobs.build import build_ground_truth, check_recordings
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
        cameras=_with_partners(sources, options.cameras),
        odometry=options.odometry,
        reporter=reporter,
    )
    check_conditions(options, [r.name for r in recordings])
    check_recordings(recordings, options)
    name = options.name or "robotcar_" + recordings[0].name
    writer = DatasetWriter(out, name, configuration("robotcar", sources, options), options.licence)
    return build_ground_truth(recordings, writer, options, reporter, run)


def _with_partners(sources: Sequence[Path], cameras: tuple[str, ...]) -> tuple[str, ...] | None:
    """The cameras that are asked for, and the right one of the stereo pair, which depth is checked with; None: all."""
    if not cameras:
        return None
    right = "stereo_left" in cameras and all((source / "stereo" / "right").is_dir() for source in sources)
    return (*cameras, "stereo_right") if right else cameras
