"""Kind ``ford-av``: logs of the Ford Multi-AV Seasonal dataset, with ground truth across drives from their lidars."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from relocbench.datasets.core.build_options import ImportOptions, LinkingOptions
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.datasets.importers.assembly import check_several, open_writer
from relocbench.errors import DatasetError, raise_all
from relocbench.execution import Run
from relocbench.files import fitting_name
from relocbench.progress import Reporter

if TYPE_CHECKING:
    from relocbench.datasets.core.dataset import Dataset


class Options(FieldOptions, LinkingOptions):
    """Options of ``relocbench build-dataset ford-av``."""

    calibration_folder: Path | None = Field(
        None,
        description="folder with lidarRed_body.yaml and the like, or that of Calibration-V2; default: searched for",
    )
    lidars: tuple[str, ...] = Field((), description="of red, green, blue, yellow; default: all that the bags have")
    odometry: Literal["auto", "ground-truth", "localized", "raw", "lidar"] = Field(
        "auto",
        description="motion of the car: pose_ground_truth, pose_localized or pose_raw, or computed from the scans of "
        "the first lidar; default: pose_ground_truth, or else pose_raw, or else from scans",
    )
    lidar_axes: Literal["auto", "ros", "velodyne"] = Field(
        "auto",
        description="axes of the lidars in the calibration: azimuth 0 along x, or along y; default: by the scans",
    )
    lidar_intrinsics: Path | None = Field(
        None, description="angles of the beams, lidarIntrinsics.yaml; default: those of an HDL-32E"
    )


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Build a dataset from a reference log, the first source, and query logs. Raises as :class:`Importer`."""
    from relocbench.datasets.importers.ford_av.files import find_logs
    from relocbench.datasets.importers.ford_av.recording import ReadingOptions, read_ford
    from relocbench.datasets.importers.lidar_drives.building import build_from
    from relocbench.datasets.importers.rosbag.packets import check_calibration

    assert isinstance(options, Options)
    check_several(sources)
    logs = find_logs(sources, options.calibration_folder)
    options.check_conditions([log.name for log in logs])
    if options.lidar_intrinsics is not None:
        check_calibration(options.lidar_intrinsics)
    how = ReadingOptions(options.lidars, options.odometry, options.lidar_axes, options.lidar_intrinsics)
    writer = open_writer("ford-av", sources, options, out, fitting_name(f"ford_av_{logs[0].name}"))
    index = out / "groundtruth" / "index"
    drives, faults = [], []
    for log in logs:
        try:
            drives.append(read_ford(log, how, reporter, kept=index / f"{log.name}.npz"))
        except DatasetError as bad:
            faults.append(bad)
    raise_all(list({str(fault): fault for fault in faults}.values()))
    return build_from(drives, "ford-av", sources, options, out, reporter, run, writer)
