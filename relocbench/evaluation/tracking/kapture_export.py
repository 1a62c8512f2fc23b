"""Poses as kapture folders: keyframes as in the map, queries as predicted, images linked.

Format and conventions: "kapture: data format v1.1", Naver Labs Europe. Poses map world to device, quaternions have
``qw`` first, and the centre of the top-left pixel is at (0.5, 0.5), as in COLMAP.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.named_poses import numbers_of_pose
from relocbench.datasets.core.pairfile import PoseLine
from relocbench.datasets.core.traversal import Traversal
from relocbench.evaluation.tracking.absolute_poses import digits, points_in_world, query_poses
from relocbench.evaluation.tracking.colmap_export import colmap_camera
from relocbench.files import link_file, write_bytes, write_text
from relocbench.geometry import Camera, invert
from relocbench.progress import Reporter

_VERSION = "# kapture format: 1.1"
_KEYPOINTS = "relocbench"
"""the type of keypoints, which names their folder"""


def export_kapture(
    dataset: Dataset, pair_set: str, predictions: Sequence[PoseLine], out: Path, reporter: Reporter
) -> int:
    """Write the kapture folders ``mapping`` and ``query`` and the list ``pairs.txt`` to the folder ``out``.

    ``mapping`` holds the keyframes of the set with their poses, and depth maps or, for sparse keyframe points,
    ``points3d.txt`` with an observation of each; ``query`` holds the queries of the set, with poses where predicted.
    Images are links into the dataset, named ``TRAVERSAL/CAMERA/TIME.png``. Pairs are all of the set that are of one
    place, with score 1. Returns the number of query poses.

    Raises:
        PredictionError: a pair that is not in the set, or none with a pose.
        DatasetError: the map has no pose of a keyframe, or a keyframe's depth is damaged.
    """
    poses = {p.query_timestamp_ns: p.T_world_query for p in query_poses(dataset, pair_set, predictions)}
    chosen = dataset.pair_set(pair_set)
    reference, query = dataset.traversal(chosen.reference), dataset.traversal(chosen.query)
    keyframes = sorted({pair.ref_timestamp_ns for pair in chosen.pairs})
    queries = sorted({pair.query_timestamp_ns for pair in chosen.pairs})
    mapping, asked = _Folder(out / "mapping", chosen.reference_camera), _Folder(out / "query", chosen.query_camera)
    with reporter.stage(f"images of {pair_set}", len(keyframes) + len(queries)) as advance:
        for time in keyframes:
            T_world_cam = reference.T_world_cam(chosen.reference_camera, time)
            mapping.add_image(reference, time, T_world_cam)
            mapping.add_depth(reference, time, T_world_cam)
            advance(1)
        for time in queries:
            asked.add_image(query, time, poses.get(time))
            advance(1)
    mapping.write()
    asked.write()
    pairs = sorted(chosen.pairs, key=lambda p: (p.query_timestamp_ns, p.ref_timestamp_ns))
    _write_table(
        out / "pairs.txt",
        "query_image, mapping_image, score",
        (
            (asked.name(query, pair.query_timestamp_ns), mapping.name(reference, pair.ref_timestamp_ns), "1")
            for pair in pairs
        ),
    )
    return len(poses)


class _Folder:
    """A kapture folder: files of images, depth and keypoints at once, its tables at the end."""

    def __init__(self, root: Path, camera: str) -> None:
        self.root = root
        self.camera = camera
        self.sensors: dict[Camera, str] = {}
        self.with_depth: dict[Camera, str] = {}
        self.poses: list[list[str]] = []
        self.images: list[tuple[str, str, str]] = []
        self.depths: list[tuple[str, str, str]] = []
        self.points: list[str] = []
        self.observations: list[tuple[str, str, str, str]] = []

    def name(self, traversal: Traversal, time: int) -> str:
        """The name of an image."""
        path = traversal.layout.find_image(self.camera, time)
        return f"{traversal.name}/{self.camera}/{time}{'.png' if path is None else path.suffix}"

    def add_image(self, traversal: Traversal, time: int, T_world_cam: Array | None) -> None:
        """Link an image and note its camera and its pose (4, 4), if that is known."""
        name, sensor = self.name(traversal, time), self._sensor(traversal.camera(self.camera, time))
        path = traversal.layout.find_image(self.camera, time)
        if path is not None:
            link_file(path, self._record(name))
        self.images.append((str(time), sensor, name))
        self._add_pose(time, sensor, T_world_cam)

    def add_depth(self, traversal: Traversal, time: int, T_world_cam: Array) -> None:
        """Write the depth map of a keyframe, or its sparse points with the keypoints that observe them."""
        depth = traversal.depth(self.camera, time)
        image = self.name(traversal, time)
        if depth is not None:
            camera = traversal.camera(self.camera, time)
            sensor = self.with_depth.setdefault(camera, f"{self._sensor(camera)}_depth")
            name = f"{traversal.name}/{self.camera}/{time}.depth"
            write_bytes(self._record(name), depth.astype("<f4").tobytes())
            self.depths.append((str(time), sensor, name))
            self._add_pose(time, sensor, T_world_cam)
            return
        in_world, pixels = points_in_world(traversal, self.camera, time, T_world_cam)
        if not len(in_world):
            return
        keypoints = self.root / "reconstruction" / "keypoints" / _KEYPOINTS
        write_bytes(keypoints / f"{image}.kpt", np.ascontiguousarray(pixels + 0.5, dtype="<f8").tobytes())
        for index, point in enumerate(in_world):
            self.observations.append((str(len(self.points)), _KEYPOINTS, image, str(index)))
            self.points.append(", ".join(map(digits, point)))

    def write(self) -> None:
        """Write the tables."""
        tables, reconstruction = self.root / "sensors", self.root / "reconstruction"
        sensors = [(sensor, "", "camera", *colmap_camera(camera).split()) for camera, sensor in self.sensors.items()]
        sensors += [(sensor, "", "depth", *colmap_camera(camera).split()) for camera, sensor in self.with_depth.items()]
        _write_table(tables / "sensors.txt", "sensor_id, name, sensor_type, [sensor_params]+", sensors)
        _write_table(tables / "trajectories.txt", "timestamp, device_id, qw, qx, qy, qz, tx, ty, tz", self.poses)
        _write_table(tables / "records_camera.txt", "timestamp, device_id, image_path", self.images)
        if self.depths:
            _write_table(tables / "records_depth.txt", "timestamp, device_id, depth_map_path", self.depths)
        if self.points:
            keypoints = reconstruction / "keypoints" / _KEYPOINTS / "keypoints.txt"
            _write_table(keypoints, "name, dtype, dsize", [(_KEYPOINTS, "float64", "2")])
            _write_table(reconstruction / "points3d.txt", "X, Y, Z", [(point,) for point in self.points])
            _write_table(
                reconstruction / "observations.txt",
                "point3d_id, keypoints_type, [image_path, feature_id]*",
                self.observations,
            )

    def _add_pose(self, time: int, sensor: str, T_world_cam: Array | None) -> None:
        if T_world_cam is not None:
            self.poses.append([str(time), sensor, *map(digits, numbers_of_pose(invert(T_world_cam)))])

    def _sensor(self, camera: Camera) -> str:
        """The sensor of a camera: the first is called as in the dataset, further ones have a number."""
        known = len(self.sensors)
        return self.sensors.setdefault(camera, f"{self.camera}_{known + 1}" if known else self.camera)

    def _record(self, name: str) -> Path:
        return self.root / "sensors" / "records_data" / name


def _write_table(path: Path, form: str, rows: Iterable[Sequence[str]]) -> None:
    write_text(path, "".join(f"{line}\n" for line in (_VERSION, f"# {form}", *(", ".join(row) for row in rows))))
