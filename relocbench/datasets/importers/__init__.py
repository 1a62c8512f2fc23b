"""Importers: one folder per outside format, each of which turns recordings into a dataset.

``photos`` is what importers of collections of named images share, ``lidar_drives`` what those of published lidar
datasets share, ``assembly`` what all do.

An importer module has ``Options``, a subclass of :class:`DatasetOptions` whose fields are command-line options and keys
of a configuration file, and ``build(sources, options, out, reporter, run) -> Dataset``. Recordings are never changed,
and their images are linked rather than copied unless the user asks for copies.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

if TYPE_CHECKING:
    from relocbench.datasets.core.build_options import DatasetOptions
    from relocbench.datasets.core.dataset import Dataset
    from relocbench.datasets.core.recording_folder import RecordingFolder
    from relocbench.datasets.core.schema import Strict
    from relocbench.datasets.cross_view import CrossViewSet
    from relocbench.execution import Run
    from relocbench.progress import Reporter

KINDS: dict[str, str] = {
    "kitti": "KITTI odometry layout (stereo or velodyne depth)",
    "tum-rgbd": "TUM RGB-D layout (depth images)",
    "four-seasons": "4Seasons / MLAD recordings (sparse keyframe points)",
    "robotcar": "Oxford RobotCar layout: ground truth across drives from lidar",
    "kitti-lidar": "KITTI odometry layout: ground truth across sequences from the velodyne",
    "generic-lidar": "the minimal folder with lidar: ground truth across drives from it",
    "rosbag": "bags of ROS 1 and 2 and MCAP files: ground truth across drives from their lidar",
    "boreas": "Boreas layout: ground truth across drives from the Velodyne",
    "mulran": "MulRan layout: ground truth across drives from the Ouster (no images)",
    "helipr": "HeLiPR layout: ground truth across drives from four kinds of lidar (no images)",
    "clouds": "folders of point clouds with times in their names or a file: ground truth across drives",
    "nclt": "NCLT layout: ground truth across drives from the Velodyne",
    "kitti-360": "KITTI-360 layout: ground truth across sequences from the Velodyne",
    "complex-urban": "Complex Urban (KAIST) layout: ground truth across drives from its lidars",
    "ford-av": "Ford Multi-AV Seasonal layout (bags): ground truth across drives from its Velodynes",
    "generic": "a minimal documented folder: images, intrinsics, TUM poses, optional depth",
    "colmap": "a sparse model of COLMAP: photo collections with a camera for each image",
    "kapture": "folders in the kapture format: map and queries, with rigs, depth maps or points",
    "poses": "trajectories alone, without images: to score predictions that were made elsewhere",
    "pair-files": "relocalization files of nine columns alone, as the truth, without images",
    "photographs": "single photographs, each seen again by a camera that moved: made-up depth, exact truth",
    "synthetic": "a procedural town in any weather, ray-cast: districts, drives and exact truth from a seed",
    "edition": "a named benchmark: the districts of an edition by tiers of difficulty, rendered from its recipe",
    "cross-view": "buildings of procedural towns by drone, satellite and from the street, in University-1652's layout",
}
"""kinds of ``relocbench build-dataset`` with one line of help each"""

_MODULES = {
    "kitti-lidar": "kitti.lidar_dataset",
    "generic-lidar": "generic.lidar_dataset",
    "kitti-360": "kitti360.dataset",
    "poses": "poses.trajectories",
    "pair-files": "poses.pair_files",
    "photographs": "single_photographs.dataset",
    "synthetic": "rendered.dataset",
    "cross-view": "rendered.cross_view",
}
"""kind -> importer module, where it is not ``dataset`` in the folder of the kind's name"""


class Importer(Protocol):
    """What an importer module offers."""

    Options: type[DatasetOptions]

    def build(self, sources: list[Path], options: DatasetOptions, out: Path, reporter: Reporter, run: Run) -> Dataset:
        """Build a dataset.

        Raises:
            DatasetError: with file and line, or topic and time: something in a recording is missing or wrong, or no
                pair can be accepted.
            ConfigError: the options do not fit the recordings, or a package that reads them is not installed.
        """
        ...


class Recorder(Protocol):
    """What an importer module offers in addition if it can make recordings."""

    def record(
        self, sources: list[Path], options: DatasetOptions, out: Path, reporter: Reporter, run: Run
    ) -> RecordingFolder | None:
        """Make recordings, or return None if the options ask for a dataset."""
        ...


class PlaceImporter(Protocol):
    """What an importer module offers that makes a retrieval set instead of a tracking dataset."""

    Options: type[Strict]

    def build_places(
        self, sources: list[Path], options: Strict, out: Path, reporter: Reporter, run: Run
    ) -> CrossViewSet: ...


def options_of(kind: str) -> type[Strict]:
    """The options of one of :data:`KINDS`."""
    return importer(kind).Options


def place_importer(kind: str) -> PlaceImporter | None:
    """The importer module of a kind if it makes retrieval sets, else None."""
    module = importer(kind)
    return cast(PlaceImporter, module) if hasattr(module, "build_places") else None


def recorder(kind: str) -> Recorder | None:
    """The importer module of a kind if it can make recordings, else None."""
    module = importer(kind)
    return cast(Recorder, module) if hasattr(module, "record") else None


def importer(kind: str) -> Importer:
    """Import the importer module of one of :data:`KINDS`."""
    path = _MODULES.get(kind, f"{kind.replace('-', '_')}.dataset")
    module: Importer = import_module(f"{__name__}.{path}")
    return module
