"""Writing datasets: files appear whole, killed builds resume, and other folders are never overwritten."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Array, Image
from relocbench.datasets.core import fingerprint, images
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.intrinsics import write_intrinsics
from relocbench.datasets.core.layout import DatasetLayout, pair_set_name
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pair_table import write_pairs
from relocbench.datasets.core.pairfile import TRUTH_DECIMALS, Pair, pose_fields
from relocbench.datasets.core.schema import (
    CAMERAS_VERSION,
    ELSEWHERE_VERSION,
    FORMAT_VERSION,
    INTRINSICS_VERSION,
    POSES_VERSION,
    DatasetFile,
    TraversalFile,
)
from relocbench.datasets.core.traversal import POSE_COLUMNS, Traversal
from relocbench.errors import ConfigError, DatasetError
from relocbench.files import (
    YamlFault,
    atomic_write,
    check_joined_name,
    dump_yaml,
    link_file,
    load_yaml_values,
    parse_yaml,
    remove_parts,
    write_table,
    write_text,
)
from relocbench.geometry import Camera
from relocbench.tracking import KeyframePoints

_VERSIONED = ("relocbench", "numpy", "opencv-python-headless", "open3d")


class DatasetWriter:
    """Builds one dataset folder.

    The build's configuration is written first, to ``build.yaml``. A folder with the same configuration is resumed:
    files that exist and are whole are kept. ``dataset.yaml``, with the fingerprint, is written last.

    Args:
        out: the folder; it must be absent, empty, or an earlier run of the same build.
        configuration: everything that determines the result, as plain values (kind, sources, options, seed).

    Raises:
        DatasetError: ``out`` holds something else.
        ConfigError: the name cannot be that of a dataset, or an option cannot be written to YAML.
    """

    def __init__(self, out: Path, name: str, configuration: Mapping[str, Any], licence: str = "unknown") -> None:
        self.layout = DatasetLayout(out)
        self.name = name
        self.licence = licence
        try:
            check_joined_name(name, "dataset name")
            self.configuration = parse_yaml(dump_yaml(dict(configuration)))
        except YamlFault as bad:
            raise ConfigError(f"the options cannot be written to build.yaml: {bad}") from None
        except ValueError as bad:
            raise ConfigError(f"{bad}; choose another with --name") from None
        self._claim_folder()

    @property
    def complete(self) -> bool:
        """Whether an earlier run has finished this build."""
        return self.layout.dataset_yaml.exists()

    def traversal(self, file: TraversalFile, poses: Mapping[int, Array]) -> None:
        """Write ``traversal.yaml`` and ``poses.csv``; ``poses`` maps timestamp_ns to (4, 4) ``T_world_rig``."""
        layout = self.layout.traversal(file.name)
        write_text(layout.traversal_yaml, dump_yaml(file.model_dump(mode="json")))
        rows = ([time, *pose_fields(poses[time], TRUTH_DECIMALS)] for time in sorted(poses))
        write_table(layout.poses, POSE_COLUMNS, rows)

    def intrinsics(self, traversal: str, camera: str, cameras: Mapping[int, Camera]) -> None:
        """Write the pinhole cameras of images that have intrinsics of their own: timestamp_ns -> camera."""
        write_intrinsics(self.layout.traversal(traversal).intrinsics(camera), cameras)

    def link_image(self, traversal: str, camera: str, timestamp_ns: int, source: Path, *, copy: bool) -> None:
        """Add an image of a recording unchanged, as a symbolic link or, with ``copy``, as a copy.

        Raises:
            DatasetError: the image is missing or truncated.
        """
        suffix = source.suffix.lower()
        path = self.layout.traversal(traversal).image(camera, timestamp_ns, suffix)
        if not source.exists():
            raise DatasetError("missing; expected an image", source)
        if not images.is_whole(source):
            raise DatasetError("truncated or not an image; expected a whole PNG or JPEG", source)
        if not copy:
            if not (path.is_symlink() and path.resolve() == source.resolve()):
                link_file(source, path)
        elif not _kept(path):
            with atomic_write(path, "wb") as stream:
                stream.write(source.read_bytes())

    def needs_image(self, traversal: str, camera: str, timestamp_ns: int) -> bool:
        """Whether the image has to be written; a resumed build skips those that exist and are whole."""
        return not _kept(self.layout.traversal(traversal).image(camera, timestamp_ns))

    def needs_depth(self, traversal: str, camera: str, timestamp_ns: int) -> bool:
        """Whether the depth image has to be written."""
        return not _kept(self.layout.traversal(traversal).depth(camera, timestamp_ns))

    def image(self, traversal: str, camera: str, timestamp_ns: int, image: Image) -> None:
        """Write an image, (H, W) grey or (H, W, 3) RGB."""
        images.write_image(self.layout.traversal(traversal).image(camera, timestamp_ns), image)

    def depth(self, traversal: str, camera: str, timestamp_ns: int, depth: NDArray[np.floating]) -> None:
        """Write dense depth (H, W), metres along z, 0 where unknown."""
        images.write_depth(self.layout.traversal(traversal).depth(camera, timestamp_ns), depth)

    def remove_frame(self, traversal: str, camera: str, timestamp_ns: int) -> None:
        """Remove the image, depth and points of a frame that turned out to have no pose."""
        layout = self.layout.traversal(traversal)
        image = layout.find_image(camera, timestamp_ns)
        for path in (image, layout.depth(camera, timestamp_ns), layout.points(camera, timestamp_ns)):
            if path is not None:
                path.unlink(missing_ok=True)

    def points(self, traversal: str, camera: str, timestamp_ns: int, points: KeyframePoints) -> None:
        """Write sparse keyframe points."""
        images.write_points(self.layout.traversal(traversal).points(camera, timestamp_ns), points)

    def pairs(self, reference: str, query: str, camera: str, pairs: Sequence[Pair], query_camera: str = "") -> str:
        """Write a pair set, sorted by reference and query time, and return its name.

        Args:
            query_camera: that of the queries, where it is not the keyframes'.
        """
        name = pair_set_name(reference, query, camera, query_camera)
        ordered = sorted(pairs, key=lambda p: (p.ref_timestamp_ns, p.query_timestamp_ns))
        write_pairs(self.layout.pair_file(name), self.layout.pair_table(name), ordered)
        return name

    def finish(self, splits: Mapping[str, Sequence[str]] | None = None) -> Dataset:
        """Hash the content, write ``dataset.yaml`` and open the dataset.

        Args:
            splits: split name -> pair sets; default: all pair sets in the split ``test``.
        """
        remove_parts(self.layout.root)
        everything = sorted(path.stem for path in self.layout.pairs.glob("*.txt"))
        splits = splits if splits is not None else {"test": everything} if everything else {}
        plain = {split: tuple(names) for split, names in splits.items()}
        fingerprint.write_manifest(self.layout)
        sets = [PairSet(self.layout, name) for name in everything]
        elsewhere = any(one.negative_pairs for one in sets)
        version = ELSEWHERE_VERSION if elsewhere else FORMAT_VERSION
        if any(self.layout.traversals.glob("*/intrinsics/*.csv")):
            version = INTRINSICS_VERSION
        names = sorted(path.parent.name for path in self.layout.traversals.glob("*/traversal.yaml"))
        if any(Traversal(self.layout.traversal(name)).frames for name in names):
            version = POSES_VERSION
        if any(one.reference_camera != one.query_camera for one in sets):
            version = CAMERAS_VERSION
        file = DatasetFile(
            format_version=version,
            name=self.name,
            licence=self.licence,
            made_by={**self.configuration, "versions": versions()},
            splits=plain,
            fingerprint=fingerprint.compute(self.layout, version, plain),
        )
        write_text(self.layout.dataset_yaml, dump_yaml(file.model_dump(mode="json")))
        return Dataset(self.layout.root)

    def _claim_folder(self) -> None:
        root, mark = self.layout.root, self.layout.build_yaml
        for source in map(Path, self.configuration.get("sources") or ()):
            if root.resolve().is_relative_to(source):
                raise DatasetError(f"lies inside the recording {source}; recordings are never written to", root)
        if root.exists() and not root.is_dir():
            raise DatasetError("is a file; expected a folder to write the dataset to", root)
        if root.is_dir() and any(root.iterdir()) and not mark.exists():
            raise DatasetError("holds something else; --out must be new, empty, or an unfinished build", root)
        # An earlier run that failed before it wrote anything may be repeated with other options.
        if mark.exists() and any(p != mark for p in root.iterdir()):
            check_same_options(mark, self.configuration, "a build", "a dataset made")
            remove_parts(root)
            return
        write_text(mark, dump_yaml(self.configuration))


def check_same_options(mark: Path, configuration: Mapping[str, Any], of: str, made: str) -> None:
    """Raise DatasetError, naming what differs, unless a folder's file of options holds this configuration."""
    before, _ = load_yaml_values(mark, f"the configuration of {of}", DatasetError)
    if before != configuration:
        keys = sorted(str(k) for k in before.keys() | configuration.keys() if before.get(k) != configuration.get(k))
        raise DatasetError(
            f"holds {made} with other options ({', '.join(keys)} differ); choose another --out", mark.parent
        )


def versions() -> dict[str, str]:
    """Versions of Python and of the installed packages that can change a result."""
    installed = {"python": platform.python_version()}
    for name in _VERSIONED:
        with suppress(metadata.PackageNotFoundError):
            installed[name] = metadata.version(name)
    return installed


def _kept(path: Path) -> bool:
    return not path.is_symlink() and path.is_file() and images.is_whole(path)
