"""What the images of a dataset's drives say of the clock of its poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from relocbench.datasets.clock.check import ClockCheck, check_clock, own_trajectory
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.schema import ClockEntry
from relocbench.execution import Run, default_workers, run_units
from relocbench.progress import Reporter


@dataclass(frozen=True)
class DriveClock:
    """A camera of a drive: what was found when the dataset was built, and what its images and poses say now."""

    traversal: str
    built: ClockEntry | None
    check: ClockCheck

    def to_dict(self) -> dict[str, Any]:
        """Plain values for scripts."""
        check, left = self.check, self.check.residual_at_offset
        return {
            "traversal": self.traversal,
            "camera": check.camera,
            "built": None if self.built is None else self.built.model_dump(mode="json"),
            "verdict": check.verdict,
            "offset_s": check.offset_s,
            "sigma_s": check.sigma_s,
            "readout_s": check.readout_s,
            "residual_deg": None if left is None else left.deg,
            "residual_mm": None if left is None else left.mm,
            "words": check.words,
        }


def check_clocks(dataset: Dataset, reporter: Reporter) -> list[DriveClock]:
    """Check each camera with images of each drive.

    Raises:
        DatasetError: an image, a depth image or a table of poses is damaged.
    """

    def work(title: str, step: Any, units: Any) -> list[Any]:
        results: dict[int, Any] = {}
        with reporter.stage(title, len(units)) as advance:
            for index, result in run_units(step, units, Run(default_workers() if len(units) > 2 else 1)):
                results[index] = result
                advance(1)
        return [results[index] for index in range(len(units))]

    drives = [dataset.traversal(name) for name in dataset.traversal_names]
    return [
        DriveClock(drive.name, drive.file.clock, check_clock(drive, camera, own_trajectory(drive), work))
        for drive in drives
        for camera in drive.cameras
    ]
