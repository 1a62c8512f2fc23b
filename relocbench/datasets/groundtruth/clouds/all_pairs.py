"""Each pair of a folder's clouds registered on its own, and compared with poses that are known."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.clouds.folders import Reading, cloud_files, read_clouds
from relocbench.datasets.groundtruth.clouds.register import CloudRegistration, CloudRegistrationOptions, register_clouds
from relocbench.datasets.groundtruth.registration.global_registration import pose_difference
from relocbench.datasets.sensors.cloud_poses import read_cloud_poses
from relocbench.errors import DatasetError
from relocbench.geometry import invert
from relocbench.progress import Reporter, Silent

_MOST = 30
"""clouds whose pairs are registered at most"""


@dataclass(frozen=True, eq=False)
class PairRegistration:
    """A pair of clouds of a folder."""

    a: Path
    b: Path
    found: CloudRegistration
    expected: Array | None
    """(4, 4) ``T_a_b`` by the poses, if they are known"""

    @property
    def difference(self) -> tuple[float, float]:
        """Metres and degrees between the pose found and the expected one; nan if there is none."""
        if self.expected is None or not np.isfinite(self.found.T_a_b).all():
            return float("nan"), float("nan")
        return pose_difference(self.expected, self.found.T_a_b)


def register_all_pairs(
    folder: Path, poses: Path | None, reading: Reading, options: CloudRegistrationOptions, reporter: Reporter
) -> list[PairRegistration]:
    """Register all pairs of the clouds of a folder, in the order of their names.

    Raises:
        DatasetError: there are fewer than two clouds or too many, one is damaged, or poses are wrong.
    """
    files = cloud_files(folder, reading.files)
    if not 2 <= len(files) <= _MOST:
        raise DatasetError(f"holds {len(files)} clouds; expected 2 to {_MOST} to register all pairs", folder)
    T = None if poses is None else read_cloud_poses(poses, len(files))
    clouds = [side.cloud for side in read_clouds(files, reading, reporter)]
    pairs = list(combinations(range(len(files)), 2))
    out = []
    with reporter.stage("registering pairs", len(pairs)) as advance:
        for i, j in pairs:
            registration = register_clouds(clouds[i], clouds[j], options, Silent())
            ends = (None, None) if T is None else (T[i], T[j])
            expected = None if ends[0] is None or ends[1] is None else np.asarray(invert(ends[0]) @ ends[1])
            out.append(PairRegistration(files[i], files[j], registration, expected))
            advance(1)
    return out
