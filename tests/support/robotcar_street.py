"""Two drives along the fenced street in the RobotCar layout, and the dataset that the builder makes of them.

Recorded and built once (fixtures ``robotcar_street`` and ``robotcar_built``) for all tests that need no other drives.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from built_once import built_once
from command_line import Outcome, relocbench
from fenced_street import record_fenced
from recording_reading import Truth
from small_street import StraightRoad

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.synthetic.conditions.condition import CONDITIONS
from relocbench.datasets.synthetic.jobs.recording import Recorded
from relocbench.geometry import invert
from relocbench.metrics.pose.errors import PoseErrors, pose_errors

FRAMES = 64
CAMERAS = ("stereo/left", "stereo/right", "mono_rear")
# The default matcher of the search takes longer than all else; test_importer_lidar_kinds.py builds with it.
SMALL = (
    *("--submap", 30, "--depth-submap", 16, "--keyframe-distance", 1.5, "--query-distance", 3),
    *("--max-distance", 3, "--correspondences", 200, "--matcher", "fgr"),
)


@dataclass(frozen=True)
class Elsewhere(StraightRoad):
    """Another part of the street, or the same the other way."""

    start_m: float = 0.0
    backwards: bool = False

    def pose(self, s: float, lateral_m: float = 0.0, yaw_rad: float = 0.0) -> Array:
        pose = super().pose(s, lateral_m, yaw_rad)
        pose[0, 3] += self.start_m
        turn = np.diag([-1.0, -1.0, 1.0, 1.0])
        return turn @ pose if self.backwards else pose


def record_robotcar(
    out: Path,
    number: int,
    condition: str,
    path: StraightRoad | None = None,
    cameras: tuple[str, ...] = CAMERAS,
    frames: int = FRAMES,
) -> Recorded:
    return record_fenced(
        out, "robotcar", CONDITIONS[condition].factors, path, frames=frames, scale=0.06, number=number, cameras=cameras
    )


@dataclass(frozen=True)
class RobotCarStreet:
    """The recordings, and their exact truth."""

    reference: Recorded
    query: Recorded
    _truths: dict[str, Truth] = field(default_factory=dict, repr=False)

    @property
    def folders(self) -> tuple[Path, Path]:
        return self.reference.folder, self.query.folder

    @property
    def pair_set(self) -> str:
        return f"{self.reference.name}__{self.query.name}__stereo_left"

    def truth(self, drive: Recorded) -> Truth:
        return self._truths.setdefault(drive.name, Truth(drive.truth))

    def exact(self, pair: Pair) -> Array:
        """``T_query_ref`` of the left stereo camera."""
        ref, query = self.truth(self.reference), self.truth(self.query)
        T_world_ref = ref.rig(pair.ref_timestamp_ns) @ ref.T_rig["stereo/left"]
        T_world_query = query.rig(pair.query_timestamp_ns) @ query.T_rig["stereo/left"]
        return np.asarray(invert(T_world_query) @ T_world_ref)

    def errors(self, dataset: Dataset) -> PoseErrors:
        """Errors of the accepted pairs."""
        pairs = [pair for pair in dataset.pair_set(self.pair_set).pairs if pair.accepted]
        found = [pair.T_query_ref for pair in pairs if pair.T_query_ref is not None]
        return pose_errors(found, [self.exact(pair) for pair in pairs])


def _opened(root: Path) -> RobotCarStreet:
    reference, query = (Recorded(path.name, path, root / "truth" / path.name) for path in sorted(root.glob("2024*")))
    return RobotCarStreet(reference, query)


@built_once(_opened)
def record_robotcar_street(out: Path) -> None:
    """Record the two drives below ``out``."""
    rows = [("name", "condition")]
    for number, condition in enumerate(("Sunny", "Overcast")):
        rows.append((record_robotcar(out, number, condition).name, condition))
    (out / "drives.csv").write_text("".join(",".join(row) + "\n" for row in rows))


def build_robotcar(out: Path, *arguments: object) -> Outcome:
    return relocbench("build-dataset", "robotcar", "--out", out, "-j", 1, *SMALL, *arguments)


@dataclass(frozen=True)
class Built:
    """A dataset, and what the command said that built it."""

    root: Path
    outcome: Outcome

    @property
    def dataset(self) -> Dataset:
        return Dataset(self.root)

    def table(self, pair_set: str) -> list[dict[str, str]]:
        """Rows of the pair set's CSV file."""
        with self.dataset.layout.pair_table(pair_set).open(newline="") as stream:
            return list(csv.DictReader(stream))


def _opened_built(root: Path) -> Built:
    return Built(root / "dataset", Outcome.kept(root / "outcome.json"))


@built_once(_opened_built)
def build_robotcar_street(root: Path, *options: object) -> None:
    """Build the dataset of the street below ``root``, by the command a user types."""
    drives = record_robotcar_street.original().folders
    outcome = relocbench("build-dataset", "robotcar", *drives, "--out", root / "dataset", "-j", 1, *options)
    assert outcome.status == 0, outcome.err
    outcome.keep(root / "outcome.json")
