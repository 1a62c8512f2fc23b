"""Poses as a text model of COLMAP."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import PoseLine
from relocbench.datasets.core.traversal import Traversal
from relocbench.evaluation.common.image_names import stored_name
from relocbench.evaluation.tracking.absolute_poses import digits, points_in_world, query_poses
from relocbench.files import write_text
from relocbench.geometry import Camera, invert, transform_to_tq


def export_colmap(dataset: Dataset, pair_set: str, predictions: Sequence[PoseLine], out: Path) -> int:
    """Write a COLMAP text model to the folder ``out``: keyframes as in the map, queries as predicted.

    ``images.txt`` holds cam-from-world poses with ``QW QX QY QZ``; pixels and principal points are shifted by half a
    pixel to COLMAP's convention. Sparse keyframe points become ``points3D.txt``, which is empty for dense depth. Image
    names are paths below the dataset's ``traversals``. A frame that is both keyframe and query (pairs within one
    traversal) is written as in the map. Returns the number of queries.

    Raises:
        PredictionError, DatasetError: see :func:`query_poses`.
    """
    poses = query_poses(dataset, pair_set, predictions)
    chosen = dataset.pair_set(pair_set)
    reference, query = dataset.traversal(chosen.reference), dataset.traversal(chosen.query)
    model = _ColmapModel()
    keyframes = sorted({p.ref_timestamp_ns for p in poses})
    for time in keyframes:
        camera = chosen.reference_camera
        model.add_image(reference, camera, time, reference.T_world_cam(camera, time), with_points=True)
    as_in_map = query.name == reference.name and chosen.query_camera == chosen.reference_camera
    for pose in poses:
        if not as_in_map or pose.query_timestamp_ns not in keyframes:
            model.add_image(query, chosen.query_camera, pose.query_timestamp_ns, pose.T_world_query, with_points=False)
    write_text(out / "cameras.txt", "".join(line + "\n" for line in model.cameras.values()))
    write_text(out / "images.txt", "".join(line + "\n" for line in model.images))
    write_text(out / "points3D.txt", "".join(line + "\n" for line in model.points))
    return len(poses)


def colmap_camera(camera: Camera) -> str:
    """``MODEL WIDTH HEIGHT PARAMS...``, as on a line of ``cameras.txt``."""
    k = [camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5]
    distortion = list(camera.distortion)
    if camera.model == "pinhole":
        model = "PINHOLE"
    elif camera.model == "equidistant":
        model = "OPENCV_FISHEYE"
    elif len(distortion) == 4:
        model = "OPENCV"
    else:
        model, distortion = "FULL_OPENCV", [*distortion, *[0.0] * (8 - len(distortion))]
    return f"{model} {camera.width} {camera.height} {' '.join(map(digits, [*k, *distortion]))}"


class _ColmapModel:
    """The lines of the three text files of a model."""

    def __init__(self) -> None:
        self.cameras: dict[Camera, str] = {}
        self.images: list[str] = []
        self.points: list[str] = []

    def add_image(self, traversal: Traversal, camera: str, time: int, T_world_cam: Array, *, with_points: bool) -> None:
        """Add an image: its pose on one line, its points on the next."""
        image_id = len(self.images) // 2 + 1
        name = stored_name(traversal, camera, time)
        translation, (qx, qy, qz, qw) = transform_to_tq(invert(T_world_cam))
        pose = " ".join(map(digits, (qw, qx, qy, qz, *translation)))
        self.images.append(f"{image_id} {pose} {self._camera_id(traversal.camera(camera, time))} {name}")
        seen = self._add_points(traversal, camera, time, T_world_cam, image_id) if with_points else []
        self.images.append(" ".join(seen))

    def _add_points(self, traversal: Traversal, camera: str, time: int, T_world_cam: Array, image_id: int) -> list[str]:
        """Add the sparse points of a keyframe, each observed by it alone; returns their entries on the image's line."""
        in_world, pixels = points_in_world(traversal, camera, time, T_world_cam)
        entries = []
        for index, (point, (u, v)) in enumerate(zip(in_world, pixels, strict=True)):
            point_id = len(self.points) + 1
            xyz = " ".join(map(digits, point))
            self.points.append(f"{point_id} {xyz} 128 128 128 0 {image_id} {index}")
            entries.append(f"{digits(u + 0.5)} {digits(v + 0.5)} {point_id}")
        return entries

    def _camera_id(self, camera: Camera) -> int:
        if camera not in self.cameras:
            self.cameras[camera] = f"{len(self.cameras) + 1} {colmap_camera(camera)}"
        return list(self.cameras).index(camera) + 1
