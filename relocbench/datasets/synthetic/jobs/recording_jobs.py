"""Distribution of the images and scans of drives to workers."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from relocbench.datasets.synthetic.jobs.recording_work import (
    Composer,
    DriveContext,
    RecordableDistrict,
    RendererFactory,
    Unit,
    shared,
    town_compose,
    town_renderer,
    write_images,
    write_scans,
)
from relocbench.execution import Run, chunks, run_units
from relocbench.progress import Reporter

_IMAGES_A_UNIT = 8
_SCANS_A_UNIT = 64

Files = Sequence[tuple[str, int]]
"""(sensor, index) of each"""


@dataclass(frozen=True, eq=False)
class DriveJob:
    """The missing images and scans of a drive."""

    district: RecordableDistrict
    drive: DriveContext
    truth: Path
    scans: Files
    pictures: Files


def carry_out(
    jobs: Sequence[DriveJob],
    reporter: Reporter,
    run: Run,
    renderer_factory: RendererFactory = town_renderer,
    compose: Composer = town_compose,
) -> None:
    """Scan and render what is missing, drive by drive.

    Args:
        renderer_factory, compose: replacements for the town's own; they must be importable by workers.
    """
    jobs = [job for job in jobs if job.scans or job.pictures]
    with ExitStack() as stack:
        pickled: dict[int, Path] = {}
        for job in jobs:
            if id(job.district) not in pickled:
                pickled[id(job.district)] = stack.enter_context(shared(job.district, job.truth))
        drives = [
            replace(job.drive, district=pickled[id(job.district)], make_renderer=renderer_factory, compose=compose)
            for job in jobs
        ]
        both = list(zip(drives, jobs, strict=True))
        scans = [Unit(drive, part) for drive, job in both for part in chunks(job.scans, _SCANS_A_UNIT)]
        pictures = [Unit(drive, part) for drive, job in both for part in chunks(job.pictures, _IMAGES_A_UNIT)]
        for what, work, units in (("scanning", write_scans, scans), ("rendering", write_images, pictures)):
            if units:
                with reporter.stage(what, sum(len(unit.work) for unit in units)) as advance:
                    for _, count in run_units(work, units, run):
                        advance(count)
