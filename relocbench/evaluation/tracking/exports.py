"""Exporting predicted (or true) query poses to other tools' formats: TUM, KITTI, COLMAP, hloc, MLAD zips.

A relative pose becomes an absolute one by the map's pose of its keyframe:
``T_world_query = T_world_ref @ inv(T_query_ref)``.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.fingerprint import SHORT
from relocbench.datasets.core.named_poses import write_named_poses
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey, PoseLine, pose_fields, pose_line_fields, read_pose_lines
from relocbench.datasets.core.traversal import Traversal
from relocbench.errors import DatasetError, PredictionError
from relocbench.evaluation.common.results import DatasetResults
from relocbench.evaluation.tracking.score import read_predictions
from relocbench.files import atomic_write, write_text
from relocbench.geometry import Camera, apply, invert, transform_to_tq

Array = NDArray[np.float64]
ExportFormat = Literal["tum", "kitti", "colmap", "hloc", "mlad"]
_ZIP_EPOCH = (1980, 1, 1, 0, 0, 0)
_NS = 1_000_000_000


@dataclass(frozen=True, eq=False)
class QueryPose:
    """The absolute pose of a query camera, in the world frame of the reference traversal."""

    query_timestamp_ns: int
    ref_timestamp_ns: int
    """the keyframe of the relative pose"""
    T_world_query: Array
    """(4, 4)"""


def export_poses(
    dataset: Dataset,
    pair_sets: Sequence[str],
    format: ExportFormat,
    out: Path,
    results: Path,
    method: str | None,
    relocalization_files: Sequence[Path] = (),
) -> list[Path]:
    """Export pair sets of a dataset, without pairs of different places; returns the files or folders written.

    Args:
        out: folder for ``PAIRSET.txt`` (tum, kitti) or ``PAIRSET/`` (colmap, hloc); for mlad, the zip file itself.
        results: the results folder that holds the predictions.
        method: the label of the predictions; None for the ground truth.
        relocalization_files: for mlad, the challenge's files, whose names and line order the zip follows.

    Raises:
        PredictionError: no such predictions, none with a pose, or ground truth that is withheld.
    """
    lines = {name: _lines_of(dataset, name, results, method) for name in pair_sets}
    if format == "mlad":
        export_mlad(dataset, lines, out, relocalization_files)
        return [out]
    written = []
    for name, predictions in lines.items():
        path = out / (name if format in ("colmap", "hloc") else f"{name}.txt")
        _EXPORTERS[format](dataset, name, predictions, path)
        written.append(path)
    return written


def _lines_of(dataset: Dataset, pair_set: str, results: Path, method: str | None) -> list[PoseLine]:
    if method is None:
        lines = truth_lines(dataset, pair_set)
        if not lines:
            raise PredictionError(f"the ground truth of '{pair_set}' is withheld; name a method", dataset.root)
        return lines
    folder = DatasetResults(results / f"{dataset.name}@{dataset.fingerprint[:SHORT]}")
    known = [m.label for m in folder.methods()]
    if method not in known:
        raise PredictionError(f"no predictions of '{method}'; there are {', '.join(known) or 'none'}", folder.root)
    poses = read_predictions(folder.method(method).predictions(pair_set), dataset.pair_set(pair_set))
    return [PoseLine(*pair.key, poses[pair.key]) for pair in dataset.pair_set(pair_set).pairs if pair.key in poses]


def truth_lines(dataset: Dataset, pair_set: str) -> list[PoseLine]:
    """The ground truth of a pair set in the form of predictions, without pairs whose truth is withheld."""
    pairs = dataset.pair_set(pair_set).pairs
    return [PoseLine(*p.key, p.T_query_ref) for p in pairs if p.T_query_ref is not None]


def query_poses(dataset: Dataset, pair_set: str, predictions: Sequence[PoseLine]) -> list[QueryPose]:
    """The absolute poses of a pair set's queries, in time order.

    Of several answers for one query, the one that is nearest to its own keyframe is taken.

    Raises:
        PredictionError: a pair that is not in the set, or none with a pose.
        DatasetError: the map has no pose of a keyframe.
    """
    chosen = dataset.pair_set(pair_set)
    best: dict[int, PoseLine] = {}
    for line in _answered(chosen, predictions):
        known = best.get(line.query_timestamp_ns)
        if known is None or _reach(line) < _reach(known):
            best[line.query_timestamp_ns] = line
    if not best:
        raise PredictionError(f"no pair of '{pair_set}' has a pose: there is nothing to export")
    reference = dataset.traversal(chosen.reference)
    return [
        QueryPose(
            time,
            line.ref_timestamp_ns,
            reference.T_world_cam(chosen.camera, line.ref_timestamp_ns) @ invert(_pose(line)),
        )
        for time, line in sorted(best.items())
    ]


def export_tum(dataset: Dataset, pair_set: str, predictions: Sequence[PoseLine], out: Path) -> int:
    """Write a TUM trajectory, ``t tx ty tz qx qy qz qw``, world from camera, with times in seconds to nine decimals.

    Returns the number of poses.

    Raises:
        PredictionError, DatasetError: see :func:`query_poses`.
    """
    poses = query_poses(dataset, pair_set, predictions)
    lines = [f"{_seconds(p.query_timestamp_ns)} {' '.join(pose_fields(p.T_world_query))}\n" for p in poses]
    write_text(out, "".join(lines))
    return len(poses)


def export_kitti(dataset: Dataset, pair_set: str, predictions: Sequence[PoseLine], out: Path) -> int:
    """Write KITTI poses, the upper three rows of ``T_world_query`` on a line each; returns their number.

    Since the format has no times, a file ``NAME.times.txt`` beside it holds them in seconds.

    Raises:
        PredictionError, DatasetError: see :func:`query_poses`.
    """
    poses = query_poses(dataset, pair_set, predictions)
    write_text(out, "".join(" ".join(map(_digits, p.T_world_query[:3].ravel())) + "\n" for p in poses))
    write_text(out.with_suffix(".times.txt"), "".join(f"{_seconds(p.query_timestamp_ns)}\n" for p in poses))
    return len(poses)


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
    model = _ColmapModel(chosen.camera)
    keyframes = sorted({p.ref_timestamp_ns for p in poses})
    for time in keyframes:
        model.add_image(reference, time, reference.T_world_cam(chosen.camera, time), with_points=True)
    for pose in poses:
        if query.name != reference.name or pose.query_timestamp_ns not in keyframes:
            model.add_image(query, pose.query_timestamp_ns, pose.T_world_query, with_points=False)
    write_text(out / "cameras.txt", "".join(line + "\n" for line in model.cameras.values()))
    write_text(out / "images.txt", "".join(line + "\n" for line in model.images))
    write_text(out / "points3D.txt", "".join(line + "\n" for line in model.points))
    return len(poses)


def export_hloc(dataset: Dataset, pair_set: str, predictions: Sequence[PoseLine], out: Path) -> int:
    """Write ``poses.txt`` (``name qw qx qy qz tx ty tz``, camera from world) and ``pairs.txt`` (``query keyframe``).

    Poses are those of :func:`query_poses`, in metres; pairs are all of the set that are of one place, whether answered
    or not, and so the retrieval that hloc is to start from. Images are named as where they were imported from, or by
    their path below the dataset's ``traversals``. Returns the number of poses.

    Raises:
        PredictionError, DatasetError: see :func:`query_poses`.
    """
    poses = query_poses(dataset, pair_set, predictions)
    chosen = dataset.pair_set(pair_set)
    reference, query = dataset.traversal(chosen.reference), dataset.traversal(chosen.query)
    named = {_name_of(query, chosen.camera, p.query_timestamp_ns): invert(p.T_world_query) for p in poses}
    write_named_poses(out / "poses.txt", named)
    lines = []
    for pair in sorted(chosen.pairs, key=lambda p: (p.query_timestamp_ns, p.ref_timestamp_ns)):
        asked = _name_of(query, chosen.camera, pair.query_timestamp_ns)
        lines.append(f"{asked} {_name_of(reference, chosen.camera, pair.ref_timestamp_ns)}\n")
    write_text(out / "pairs.txt", "".join(lines))
    return len(poses)


def export_mlad(
    dataset: Dataset,
    predictions: Mapping[str, Sequence[PoseLine]],
    out: Path,
    relocalization_files: Sequence[Path] = (),
) -> int:
    """Write a submission to the MLAD challenges: a zip with one text file for each pair file, at the top level.

    The same predictions give the same bytes. Returns the number of poses written.

    Args:
        predictions: pair set -> its predictions.
        relocalization_files: the challenge's own files. Where given, the zip holds files of the same names with their
            answered lines in the same order; otherwise it holds one file for each pair set.

    Raises:
        PredictionError: a pair that is not in its set, or a file none of whose pairs is answered.
        DatasetError: two relocalization files have the same name.
    """
    answered = {name: _answered(dataset.pair_set(name), lines) for name, lines in sorted(predictions.items())}
    texts: dict[str, list[PoseLine]] = {}
    if relocalization_files:
        by_key: dict[PairKey, PoseLine] = {line.key: line for lines in answered.values() for line in lines}
        for file in relocalization_files:
            if file.name in texts:
                raise DatasetError("a second relocalization file of this name; a submission needs different ones", file)
            texts[file.name] = [by_key[asked.key] for asked in read_pose_lines(file) if asked.key in by_key]
            if not texts[file.name]:
                raise PredictionError("no pair of this file is answered", file)
    else:
        texts = {f"{name}.txt": lines for name, lines in answered.items()}
    with atomic_write(out, "wb") as stream, zipfile.ZipFile(stream, "w") as archive:
        for name, lines in sorted(texts.items()):
            entry = zipfile.ZipInfo(name, _ZIP_EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, "".join(" ".join(pose_line_fields(line)) + "\n" for line in lines))
    return sum(map(len, texts.values()))


class _ColmapModel:
    """The lines of the three text files of a model."""

    def __init__(self, camera: str) -> None:
        self.camera = camera
        self.cameras: dict[Camera, str] = {}
        self.images: list[str] = []
        self.points: list[str] = []

    def add_image(self, traversal: Traversal, time: int, T_world_cam: Array, *, with_points: bool) -> None:
        """Add an image: its pose on one line, its points on the next."""
        image_id = len(self.images) // 2 + 1
        name = _stored_name(traversal, self.camera, time)
        translation, (qx, qy, qz, qw) = transform_to_tq(invert(T_world_cam))
        pose = " ".join(map(_digits, (qw, qx, qy, qz, *translation)))
        camera = traversal.camera(self.camera, time)
        self.images.append(f"{image_id} {pose} {self._camera_id(camera)} {name}")
        seen = self._add_points(traversal, time, T_world_cam, image_id) if with_points else []
        self.images.append(" ".join(seen))

    def _add_points(self, traversal: Traversal, time: int, T_world_cam: Array, image_id: int) -> list[str]:
        """Add the sparse points of a keyframe, each observed by it alone; returns their entries on the image's line."""
        points = traversal.points(self.camera, time)
        if points is None or not len(points):
            return []
        rays, valid = traversal.camera(self.camera, time).unproject(points.uv)
        valid = valid & (rays[:, 2] > 0)
        rays = rays[valid] / rays[valid][:, 2:]
        in_world = apply(T_world_cam, rays / points.inverse_depth[valid, None])
        entries = []
        for index, (point, (u, v)) in enumerate(zip(in_world, points.uv[valid], strict=True)):
            point_id = len(self.points) + 1
            xyz = " ".join(map(_digits, point))
            self.points.append(f"{point_id} {xyz} 128 128 128 0 {image_id} {index}")
            entries.append(f"{_digits(u + 0.5)} {_digits(v + 0.5)} {point_id}")
        return entries

    def _camera_id(self, camera: Camera) -> int:
        if camera not in self.cameras:
            self.cameras[camera] = f"{len(self.cameras) + 1} {colmap_camera(camera)}"
        return list(self.cameras).index(camera) + 1


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
    return f"{model} {camera.width} {camera.height} {' '.join(map(_digits, [*k, *distortion]))}"


def _stored_name(traversal: Traversal, camera: str, time: int) -> str:
    """The path of an image below the dataset's ``traversals``."""
    path = traversal.layout.find_image(camera, time) or traversal.layout.image(camera, time)
    return path.relative_to(traversal.layout.root.parent).as_posix()


def _name_of(traversal: Traversal, camera: str, time: int) -> str:
    """The name of an image where it was imported from, or else :func:`_stored_name`."""
    return traversal.names.get(time) or _stored_name(traversal, camera, time)


def _answered(pair_set: PairSet, predictions: Sequence[PoseLine]) -> list[PoseLine]:
    for line in predictions:
        if line.key not in pair_set.by_key:
            raise PredictionError(f"pair {line.key[0]} {line.key[1]} is not in the pair set '{pair_set.name}'")
    return [line for line in predictions if line.T_query_ref is not None and not pair_set.by_key[line.key].is_elsewhere]


def _pose(line: PoseLine) -> Array:
    assert line.T_query_ref is not None
    return line.T_query_ref


def _reach(line: PoseLine) -> float:
    """The predicted distance in metres from the keyframe to the query."""
    return float(np.linalg.norm(_pose(line)[:3, 3]))


def _seconds(timestamp_ns: int) -> str:
    """Decimal seconds, exact to the nanosecond."""
    return f"{timestamp_ns // _NS}.{timestamp_ns % _NS:09d}"


def _digits(value: float) -> str:
    """A float in the fewest digits that read back as the same number."""
    return repr(float(value) + 0.0)


_EXPORTERS: dict[str, Callable[[Dataset, str, Sequence[PoseLine], Path], int]] = {
    "tum": export_tum,
    "kitti": export_kitti,
    "colmap": export_colmap,
    "hloc": export_hloc,
}
