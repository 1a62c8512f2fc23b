"""Kind ``generic-lidar``: generic folders with ``lidar.yaml``, with ground truth across drives from their lidar."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from relocbench.datasets.core.build_options import ImportOptions, LinkingOptions
from relocbench.datasets.groundtruth.jobs.options import FieldOptions
from relocbench.datasets.importers.assembly import check_several, open_writer
from relocbench.datasets.sensors.trajectories import traversal_names
from relocbench.execution import Run
from relocbench.progress import Reporter

if TYPE_CHECKING:
    from relocbench.datasets.core.dataset import Dataset


class Options(FieldOptions, LinkingOptions):
    """Options of ``relocbench build-dataset generic-lidar``."""

    odometry: Literal["auto", "poses", "lidar"] = Field(
        "auto", description="motion between scans: from poses.txt, or by registering the scans of a spinning lidar"
    )
    max_pose_gap: float = Field(
        1.0,
        gt=0,
        description="longest gap in seconds between two poses to interpolate over; unless it is given, shorter gaps "
        "that are holes in a drive are not interpolated over either",
    )


def build(sources: list[Path], options: ImportOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
    """Build a dataset from a reference drive, the first source, and query drives. Raises as :class:`Importer`."""
    from relocbench.datasets.core.build import Build
    from relocbench.datasets.groundtruth.jobs.build import build_ground_truth
    from relocbench.datasets.groundtruth.odometry.deferred import later
    from relocbench.datasets.importers.generic.recording import read_generic

    assert isinstance(options, Options)
    names = traversal_names(sources)
    check_several(names)
    options.check_conditions(names)
    writer = open_writer("generic-lidar", sources, options, out, "generic_lidar_" + names[0])
    recordings = [
        read_generic(
            source,
            name=title,
            odometry=options.odometry,
            max_gap_s=options.given("max_pose_gap"),
            reporter=reporter,
            from_lidar=later,
        )
        for source, title in zip(sources, names, strict=True)
    ]
    return build_ground_truth(recordings, Build(writer, options, reporter, run))
