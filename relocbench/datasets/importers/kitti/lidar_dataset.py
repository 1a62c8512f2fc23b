"""Kind ``kitti-lidar``: sequences in the layout of KITTI odometry, with ground truth across drives from their lidar."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from relocbench.datasets.core.build_options import ImportOptions
from relocbench.datasets.importers.assembly import check_folder, open_writer
from relocbench.datasets.importers.lidar_drives.options import SequenceOptions
from relocbench.execution import Run
from relocbench.files import fitting_name
from relocbench.progress import Reporter

if TYPE_CHECKING:
    from relocbench.datasets.core.dataset import Dataset


class Options(SequenceOptions):
    """Options of ``relocbench build-dataset kitti-lidar``."""

    odometry: Literal["lidar", "poses"] = Field(
        "lidar", description="motion between scans: by registering them, or from poses/NN.txt (KITTI's own have jumps)"
    )
    motion: Literal["auto", "compensated", "distorted"] = Field(
        "auto", description="whether the scans are motion-compensated, as KITTI's own are; auto: told from the scans"
    )
    elevation: float = Field(
        0.0, gt=-5, lt=5, description="degrees by which to turn the beams up; the real KITTI lidar needs 0.205"
    )
    rate_hz: float = Field(10.0, gt=0, description="frames per second if times.txt is missing")


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Build a dataset from a reference sequence and one or more query sequences. Raises as :class:`Importer`."""
    from relocbench.datasets.core.build import Build
    from relocbench.datasets.groundtruth.jobs.build import build_ground_truth
    from relocbench.datasets.groundtruth.odometry.deferred import later
    from relocbench.datasets.importers.kitti.recording import read_kitti

    assert isinstance(options, Options)
    root = options.check_source("kitti-lidar", sources, "KITTI odometry (sequences, poses)")
    for sequence in options.sequence:
        check_folder(root / "sequences" / sequence, "a sequence of KITTI odometry")
    names = [f"kitti_{sequence}" for sequence in options.sequence]
    options.check_conditions(names)
    default_name = fitting_name(f"kitti_lidar_{'_'.join(options.sequence)}")
    writer = open_writer("kitti-lidar", sources, options, out, default_name)
    recordings = [
        read_kitti(
            root,
            sequence,
            name=title,
            odometry=options.odometry,
            motion=options.motion,
            elevation_deg=options.elevation,
            rate_hz=options.rate_hz,
            reporter=reporter,
            from_lidar=later,
        )
        for sequence, title in zip(options.sequence, names, strict=True)
    ]
    return build_ground_truth(recordings, Build(writer, options, reporter, run))
