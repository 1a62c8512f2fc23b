"""One recorded drive of a dataset, read from disk on demand."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

import numpy as np

from relocbench.arrays import Array, Floats, Image
from relocbench.datasets.core import images, pairfile
from relocbench.datasets.core.intrinsics import read_intrinsics
from relocbench.datasets.core.layout import TraversalLayout
from relocbench.datasets.core.names import read_names
from relocbench.datasets.core.schema import CameraEntry, Condition, TraversalFile
from relocbench.errors import DatasetError, available
from relocbench.files import load_yaml, read_table, values_by_time
from relocbench.geometry import Camera, invert, path_lengths
from relocbench.tracking import KeyframePoints, Neighbour, Query, Reference

POSE_COLUMNS = ("timestamp_ns", "tx", "ty", "tz", "qx", "qy", "qz", "qw")


class Traversal:
    """One recorded drive of a dataset, read on demand."""

    def __init__(self, layout: TraversalLayout) -> None:
        self.layout = layout
        self.file = load_yaml(layout.traversal_yaml, TraversalFile, "a traversal description", DatasetError)
        if self.file.name != layout.root.name:
            raise DatasetError(f"key 'name' is '{self.file.name}', expected the folder's name", layout.traversal_yaml)
        self._intrinsics: dict[str, dict[int, Camera]] = {}

    @property
    def name(self) -> str:
        return self.file.name

    @property
    def condition(self) -> Condition:
        return self.file.condition

    @property
    def cameras(self) -> list[str]:
        return list(self.file.cameras)

    @property
    def frames(self) -> list[str]:
        """The frames of which there are poses and no images."""
        return list(self.file.frames)

    def camera(self, camera: str, timestamp_ns: int | None = None) -> Camera:
        """Model, intrinsics and size of a camera, or those of its image at a time.

        They differ only where images have intrinsics of their own.

        Raises:
            DatasetError: no such camera, or a frame without images; or its table of intrinsics is bad.
        """
        usual = self._entry(camera).camera
        return usual if timestamp_ns is None else self.intrinsics(camera).get(timestamp_ns, usual)

    def intrinsics(self, camera: str) -> dict[int, Camera]:
        """The cameras of images with intrinsics of their own: timestamp_ns -> camera. Raises as :meth:`camera`."""
        if camera not in self._intrinsics:
            self._intrinsics[camera] = read_intrinsics(self.layout.intrinsics(camera))
        return self._intrinsics[camera]

    def T_rig_cam(self, camera: str) -> Array:
        """Pose of a camera, or of a frame without images, in the rig's frame, (4, 4)."""
        frame = self.file.frames.get(camera)
        return self._entry(camera).T_rig_cam.matrix if frame is None else frame.matrix

    def timestamps(self, camera: str) -> list[int]:
        """Sorted times of the camera's images, nanoseconds; of a frame without images, those of its poses."""
        return list(self.poses) if camera in self.file.frames else self.layout.timestamps("images", camera)

    def keyframe_timestamps(self, camera: str) -> list[int]:
        """Sorted times of the camera's images with depth or sparse points, or of a frame's poses, nanoseconds."""
        if camera in self.file.frames:
            return self.timestamps(camera)
        known = {*self.layout.timestamps("depth", camera), *self.layout.timestamps("points", camera)}
        return [t for t in self.timestamps(camera) if t in known]

    @cached_property
    def poses(self) -> dict[int, Array]:
        """Poses of the rig: timestamp_ns -> (4, 4) ``T_world_rig``."""
        return read_poses(self.layout.poses)

    @cached_property
    def travelled_m(self) -> dict[int, float]:
        """timestamp_ns -> metres that the rig had travelled by then: the sum of the distances between its poses."""
        positions = np.array([T_world_rig[:3, 3] for T_world_rig in self.poses.values()]).reshape(-1, 3)
        return dict(zip(self.poses, path_lengths(positions).tolist(), strict=True))

    @cached_property
    def names(self) -> dict[int, str]:
        """Names of images where they were imported from: timestamp_ns -> name; empty if they had none but times."""
        return read_names(self.layout.names)

    def T_world_cam(self, camera: str, timestamp_ns: int) -> Array:
        """Pose of a camera in the world, (4, 4). Raises DatasetError if the traversal has no pose at that time."""
        try:
            return self.poses[timestamp_ns] @ self.T_rig_cam(camera)
        except KeyError:
            raise DatasetError(f"no pose at {timestamp_ns}", self.layout.poses) from None

    def image(self, camera: str, timestamp_ns: int) -> Image:
        """An image, (H, W) grey or (H, W, 3) RGB.

        Raises:
            DatasetError: the image is missing, damaged or not of its camera's size, or the frame has no images.
        """
        path = self.layout.find_image(camera, timestamp_ns) or self.layout.image(camera, timestamp_ns)
        return images.read_image(path, self._expected_size(camera, timestamp_ns))

    def depth(self, camera: str, timestamp_ns: int) -> Floats | None:
        """Dense depth (H, W) in metres, 0 where unknown; None if the frame has none."""
        path = self.layout.depth(camera, timestamp_ns)
        if not path.exists() and not path.is_symlink():
            return None
        return images.read_depth(path, self._expected_size(camera, timestamp_ns))

    def points(self, camera: str, timestamp_ns: int) -> KeyframePoints | None:
        """Sparse keyframe points, or None if the frame has none."""
        path = self.layout.points(camera, timestamp_ns)
        return images.read_points(path) if path.exists() else None

    def reference(self, camera: str, timestamp_ns: int, neighbours: int = 0) -> Reference:
        """A keyframe, with up to ``neighbours`` posed frames on each side."""
        return Reference(
            key=f"{self.name}/{camera}/{timestamp_ns}",
            timestamp_ns=timestamp_ns,
            image=self.image(camera, timestamp_ns),
            camera=self.camera(camera, timestamp_ns),
            sparse_points=self.points(camera, timestamp_ns),
            depth=self.depth(camera, timestamp_ns),
            depth_sigma=self._entry(camera).depth_sigma,
            neighbours=tuple(self._neighbours(camera, timestamp_ns, neighbours)) if neighbours else (),
        )

    def query(self, camera: str, timestamp_ns: int) -> Query:
        """A query."""
        return Query(
            key=f"{self.name}/{camera}/{timestamp_ns}",
            timestamp_ns=timestamp_ns,
            image=self.image(camera, timestamp_ns),
            camera=self.camera(camera, timestamp_ns),
        )

    def _entry(self, camera: str) -> CameraEntry:
        try:
            return self.file.cameras[camera]
        except KeyError:
            if camera in self.file.frames:
                message = f"there are poses of '{camera}' and no images"
                raise DatasetError(message, self.layout.traversal_yaml) from None
            known = [*self.file.cameras, *self.file.frames]
            raise DatasetError(f"no camera '{camera}'{available(camera, known)}", self.layout.traversal_yaml) from None

    def _neighbours(self, camera: str, timestamp_ns: int, count: int) -> Iterator[Neighbour]:
        times = [t for t in self.timestamps(camera) if t in self.poses]
        if timestamp_ns not in times:
            return
        at = times.index(timestamp_ns)
        T_world_ref = self.T_world_cam(camera, timestamp_ns)
        for t in times[max(0, at - count) : at] + times[at + 1 : at + 1 + count]:
            T_neighbour_ref = invert(self.T_world_cam(camera, t)) @ T_world_ref
            seconds = (t - timestamp_ns) / 1e9
            yield Neighbour(seconds, self.image(camera, t), self.camera(camera, t), T_neighbour_ref)

    def _expected_size(self, camera: str, timestamp_ns: int) -> images.ExpectedSize:
        return images.ExpectedSize(self.camera(camera, timestamp_ns).size, f"camera '{camera}'")


def read_poses(path: Path) -> dict[int, Array]:
    """Read ``poses.csv``: timestamp_ns -> (4, 4) ``T_world_rig``, in time order.

    Raises:
        DatasetError: with file and line: a wrong header, a value that is not finite, a quaternion whose norm is not 1,
            or times that do not increase.
    """
    rows = read_table(path, POSE_COLUMNS, "poses", DatasetError)
    return values_by_time(rows, path, lambda row, line: pairfile.parse_pose(row, path, line), DatasetError)
