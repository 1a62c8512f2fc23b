"""What the images of a dataset's drives say of the clock of its poses."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from relocbench.arrays import Array
from relocbench.datasets.clock.check import ClockCheck, check_clock
from relocbench.datasets.clock.evidence import own_trajectory
from relocbench.datasets.clock.offset import Residual, difference
from relocbench.datasets.clock.tracks import features_of, homogeneous, match, motion_by_depth
from relocbench.datasets.core.build import work
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.schema import ClockEntry
from relocbench.datasets.core.traversal import Traversal
from relocbench.execution import Run, default_workers
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
    compare = partial(work, run=Run(default_workers()), reporter=reporter)
    drives = [dataset.traversal(name) for name in dataset.traversal_names]
    return [
        DriveClock(drive.name, drive.file.clock, check_clock(drive, camera, own_trajectory(drive), compare))
        for drive in drives
        for camera in drive.cameras
    ]


def pair_residual(
    reference: tuple[Traversal, str, int], query: tuple[Traversal, str, int], T_query_ref: Array
) -> Residual | None:
    """By how much a pose (4, 4) differs from that which the images of a pair and the keyframe's depth give.

    None where they have too little in common.

    Args:
        reference, query: a drive, a camera, and the time of its image.

    Raises:
        DatasetError: an image or a depth image is damaged.
    """
    models = [drive.camera(camera, time) for drive, camera, time in (reference, query)]
    features = [features_of(drive, camera, time) for drive, camera, time in (reference, query)]
    tracks = match(0, features[0], 1, features[1], models[1])
    found = (
        None if tracks is None else motion_by_depth(tracks, homogeneous(tracks.x), homogeneous(tracks.y), models[1].fx)
    )
    return None if found is None else difference([(found, T_query_ref)])
