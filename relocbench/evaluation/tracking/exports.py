"""Exporting predicted (or true) query poses to other tools' formats: TUM, KITTI, COLMAP, kapture, hloc, MLAD zips."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.fingerprint import SHORT
from relocbench.datasets.core.named_poses import write_named_poses
from relocbench.datasets.core.pairfile import PairKey, PoseLine, pose_fields, pose_text, read_pose_lines
from relocbench.errors import DatasetError, PredictionError, available
from relocbench.evaluation.common.image_names import listed_name
from relocbench.evaluation.common.results import DatasetResults
from relocbench.evaluation.tracking.absolute_poses import answered_lines, digits, query_poses
from relocbench.evaluation.tracking.colmap_export import export_colmap
from relocbench.evaluation.tracking.kapture_export import export_kapture
from relocbench.evaluation.tracking.score import read_predictions
from relocbench.files import atomic_write, write_text
from relocbench.geometry import invert
from relocbench.progress import Reporter, Silent

ExportFormat = Literal["tum", "kitti", "colmap", "kapture", "hloc", "mlad"]
_OF_IMAGES = ("colmap", "kapture", "hloc")
_ZIP_EPOCH = (1980, 1, 1, 0, 0, 0)
_NS = 1_000_000_000


def export_poses(
    dataset: Dataset,
    pair_sets: Sequence[str],
    format: ExportFormat,
    out: Path,
    results: Path,
    method: str | None,
    relocalization_files: Sequence[Path] = (),
    reporter: Reporter | None = None,
) -> list[Path]:
    """Export pair sets of a dataset, without pairs of different places; returns the files or folders written.

    Args:
        out: folder for ``PAIRSET.txt`` (tum, kitti) or ``PAIRSET/`` (colmap, kapture, hloc); for mlad, the
            zip file itself.
        results: the results folder that holds the predictions.
        method: the label of the predictions; None for the ground truth.
        relocalization_files: for mlad, the challenge's files, whose names and line order the zip follows.
        reporter: receives the progress of files of images and depth.

    Raises:
        PredictionError: no such predictions, none with a pose, or ground truth that is withheld.
        DatasetError: the format is of images, and there are none.
    """
    if format in _OF_IMAGES:
        message = f"{format} files name images; tum, kitti and mlad hold poses alone"
        dataset.require_images([dataset.pair_set(name) for name in pair_sets], message)
    lines = {name: _lines_of(dataset, name, results, method) for name in pair_sets}
    if format == "mlad":
        export_mlad(dataset, lines, out, relocalization_files)
        return [out]
    written = []
    for name, predictions in lines.items():
        path = out / (name if format in _OF_IMAGES else f"{name}.txt")
        if format == "kapture":
            export_kapture(dataset, name, predictions, path, reporter or Silent())
        else:
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
        raise PredictionError(f"no predictions of '{method}'{available(method, known)}", folder.root)
    poses = read_predictions(folder.method(method).predictions(pair_set), dataset.pair_set(pair_set))
    return [PoseLine(*pair.key, poses[pair.key]) for pair in dataset.pair_set(pair_set).pairs if pair.key in poses]


def truth_lines(dataset: Dataset, pair_set: str) -> list[PoseLine]:
    """The ground truth of a pair set in the form of predictions, without pairs whose truth is withheld."""
    pairs = dataset.pair_set(pair_set).pairs
    return [PoseLine(*p.key, p.T_query_ref) for p in pairs if p.T_query_ref is not None]


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
    write_text(out, "".join(" ".join(map(digits, p.T_world_query[:3].ravel())) + "\n" for p in poses))
    write_text(out.with_suffix(".times.txt"), "".join(f"{_seconds(p.query_timestamp_ns)}\n" for p in poses))
    return len(poses)


def export_hloc(dataset: Dataset, pair_set: str, predictions: Sequence[PoseLine], out: Path) -> int:
    """Write ``poses.txt`` (``name qw qx qy qz tx ty tz``, camera from world) and ``pairs.txt`` (``query keyframe``).

    Poses are those of :func:`query_poses`, in metres; pairs are all of the set that are of one place, whether answered
    or not, and so the retrieval that hloc is to start from. Images are named as where they were imported from, or by
    their path below the dataset's ``traversals``. Returns the number of poses.

    Raises:
        PredictionError, DatasetError: see :func:`query_poses`; also a name with a blank or ``#``.
    """
    poses = query_poses(dataset, pair_set, predictions)
    chosen = dataset.pair_set(pair_set)
    reference, query = dataset.traversal(chosen.reference), dataset.traversal(chosen.query)
    named = {listed_name(query, chosen.query_camera, p.query_timestamp_ns): invert(p.T_world_query) for p in poses}
    write_named_poses(out / "poses.txt", named)
    lines = []
    for pair in sorted(chosen.pairs, key=lambda p: (p.query_timestamp_ns, p.ref_timestamp_ns)):
        asked = listed_name(query, chosen.query_camera, pair.query_timestamp_ns)
        lines.append(f"{asked} {listed_name(reference, chosen.reference_camera, pair.ref_timestamp_ns)}\n")
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
    answered = {name: answered_lines(dataset.pair_set(name), lines) for name, lines in sorted(predictions.items())}
    texts: dict[str, list[PoseLine]] = {}
    if relocalization_files:
        by_key: dict[PairKey, PoseLine] = {line.key: line for lines in answered.values() for line in lines}
        for file in relocalization_files:
            if file.name in texts:
                raise DatasetError("a second relocalization file of this name; a submission needs different ones", file)
            texts[file.name] = [by_key[expected.key] for expected in read_pose_lines(file) if expected.key in by_key]
            if not texts[file.name]:
                raise PredictionError("no pair of this file is answered", file)
    else:
        texts = {f"{name}.txt": lines for name, lines in answered.items()}
    with atomic_write(out, "wb") as stream, zipfile.ZipFile(stream, "w") as archive:
        for name, lines in sorted(texts.items()):
            entry = zipfile.ZipInfo(name, _ZIP_EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, pose_text(lines))
    return sum(map(len, texts.values()))


def _seconds(timestamp_ns: int) -> str:
    """Decimal seconds, exact to the nanosecond."""
    return f"{timestamp_ns // _NS}.{timestamp_ns % _NS:09d}"


_EXPORTERS: dict[str, Callable[[Dataset, str, Sequence[PoseLine], Path], int]] = {
    "tum": export_tum,
    "kitti": export_kitti,
    "colmap": export_colmap,
    "hloc": export_hloc,
}
