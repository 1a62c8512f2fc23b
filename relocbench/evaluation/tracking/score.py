"""Phase two: scoring predictions against the ground truth, without the method."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from relocbench import version
from relocbench.arrays import Array, Mask
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pair_table import MEASURES
from relocbench.datasets.core.pairfile import PairKey, distances_and_angles, read_pose_lines
from relocbench.errors import PredictionError
from relocbench.evaluation.common.results import MethodResults, ScoreRecord, check_made_for, write_record
from relocbench.evaluation.tables.answers import Answer, read_answers
from relocbench.evaluation.tables.errors import ErrorTable, PairErrors, groups_in, write_errors
from relocbench.evaluation.tables.matching import MATCHING, MatchingRow, Summary, check_complete, summarize_matching
from relocbench.evaluation.tables.schema import ALL
from relocbench.files import plain_file, remove_parts, sha256_file
from relocbench.geometry import Camera
from relocbench.metrics import PairSetSummary, align_predictions, pose_array, pose_errors, reprojection_errors

FORMULAS = 1
"""Version of the formulas: a change by which the same predictions and truth get other scores increases it."""


def read_predictions(path: Path, pair_set: PairSet) -> dict[PairKey, Array]:
    """Read the poses of a prediction file, by pair; a pose that is not finite counts as no pose.

    Raises:
        PredictionError: with file and line: a line that cannot be read, an unknown pair, or a pair that occurs twice.
    """
    lines = read_pose_lines(path, PredictionError, allow_non_finite=True)
    align_predictions(
        [p.key for p in pair_set.evaluated],
        [line.key for line in lines],
        path=path,
        lines=[line.line for line in lines],
    )
    return {line.key: line.T_query_ref for line in lines if line.T_query_ref is not None}


def score_method(dataset: Dataset, pair_sets: Sequence[PairSet], folder: MethodResults) -> ScoreRecord:
    """Score every complete pair set of a method, and write ``PAIRSET.errors.csv`` and ``scores.yaml``.

    ``scores.yaml`` also summarizes matching quality where there is a ``PAIRSET.matching.csv``. Pair sets without
    ground truth are skipped: their predictions can be exported but not scored. Pair sets that earlier formulas scored
    are scored again, whether they are among ``pair_sets`` or not.

    Raises:
        PredictionError: the predictions are for another dataset, or a file is bad.
    """
    check_made_for(folder.run_record(), dataset.name, dataset.fingerprint, folder.run_yaml)
    remove_parts(folder.root)
    before = folder.score_record() if folder.scores_yaml.exists() else None
    if before is not None and (before.formulas, before.fingerprint) != (FORMULAS, dataset.fingerprint):
        before, pair_sets = None, dataset.pair_sets()
    hashes = dict(before.predictions) if before else {}
    errors = dict(before.errors) if before else {}
    truth = dict(before.truth) if before else {}
    scores = dict(before.pair_sets) if before else {}
    elsewhere = dict(before.elsewhere) if before else {}
    matching = dict(before.matching) if before else {}
    tables = dict(before.matching_tables) if before else {}
    for pair_set in pair_sets:
        if not pair_set.has_truth or not folder.predictions(pair_set.name).exists():
            continue
        rows = score_pair_set(pair_set, folder)
        write_errors(folder.errors(pair_set.name), rows)
        hashes[pair_set.name] = predictions_hash(folder, pair_set.name)
        errors[pair_set.name] = sha256_file(folder.errors(pair_set.name))
        truth[pair_set.name] = truth_hash(pair_set)
        scores[pair_set.name] = {g: summarize_rows(rows, g).to_dict() for g in groups_of(rows)}
        if pair_set.negative_pairs:
            elsewhere[pair_set.name] = rows.different_places.to_dict()
        if folder.matching(pair_set.name).exists():
            matching[pair_set.name] = matching_scores(pair_set, folder)
            tables[pair_set.name] = sha256_file(folder.matching(pair_set.name))
    known = {s for s in dataset.pair_set_names if folder.predictions(s).exists()}
    matched = {s for s in known if folder.matching(s).exists()}
    score_record = ScoreRecord(
        relocbench=version.__version__,
        formulas=FORMULAS,
        fingerprint=dataset.fingerprint,
        question=dataset.content_id,
        run=sha256_file(folder.run_yaml),
        predictions={k: v for k, v in sorted(hashes.items()) if k in known},
        errors={k: v for k, v in sorted(errors.items()) if k in known},
        truth={k: v for k, v in sorted(truth.items()) if k in known},
        pair_sets={k: v for k, v in sorted(scores.items()) if k in known},
        elsewhere={k: v for k, v in sorted(elsewhere.items()) if k in known},
        matching={k: v for k, v in sorted(matching.items()) if k in matched},
        matching_tables={k: v for k, v in sorted(tables.items()) if k in matched},
    )
    write_record(folder.scores_yaml, score_record)
    return score_record


def score_pair_set(pair_set: PairSet, folder: MethodResults) -> ErrorTable:
    """The errors of every evaluated pair, in the pair set's order. Raises PredictionError."""
    poses = read_predictions(folder.predictions(pair_set.name), pair_set)
    path = folder.answers(pair_set.name)
    answers = read_answers(path) if path.exists() else {}
    pairs = pair_set.evaluated
    align_predictions([p.key for p in pairs], list(answers), path=path)
    T_pred, T_gt = pose_array(poses.get(p.key) for p in pairs), pose_array(p.T_query_ref for p in pairs)
    errors = pose_errors(T_pred, T_gt, answered=[p.key in poses for p in pairs])
    values = zip(
        errors.rotation_error_deg,
        errors.translation_error_m,
        errors.mlad_translation_error_m,
        _reprojection_errors(pair_set, T_pred, T_gt, errors.answered),
        strict=True,
    )
    rows = []
    for pair, (distance, angle), (rotation, translation, mlad, vcre) in zip(
        pairs, distances_and_angles(pairs), values, strict=True
    ):
        # Predictions made elsewhere may come without a table.
        answer = answers.get(pair.key) or Answer(*pair.key, "failed")
        status = "ok" if math.isfinite(translation) else "failed" if answer.status == "ok" else answer.status
        rows.append(
            PairErrors(
                *pair.key,
                group=pair.group,
                status=status,
                rotation_error_deg=rotation,
                translation_error_m=translation,
                mlad_translation_error_m=mlad,
                confidence=answer.confidence,
                seconds=answer.seconds,
                distance_m=distance,
                angle_deg=angle,
                sigma_translation_m=pair.calibrated_sigmas[0],
                sigma_rotation_deg=pair.calibrated_sigmas[1],
                vcre=vcre,
                travelled_m=pair_set.query_traversal.travelled_m.get(pair.query_timestamp_ns),
                peak_memory_bytes=answer.peak_memory_bytes,
                **{name: getattr(pair, name) for name in MEASURES},
            )
        )
    return ErrorTable.of(rows)


def _reprojection_errors(pair_set: PairSet, T_pred: Array, T_gt: Array, answered: Mask) -> Array:
    """The virtual correspondence reprojection errors (N,) as shares of the diagonal; NaN for frames without images."""
    drive = pair_set.query_traversal
    out = np.full(len(T_gt), np.nan)
    if pair_set.query_camera in drive.frames:
        return out
    rows_of: dict[Camera, list[int]] = {}
    for row, pair in enumerate(pair_set.evaluated):
        rows_of.setdefault(drive.camera(pair_set.query_camera, pair.query_timestamp_ns), []).append(row)
    for camera, rows in rows_of.items():
        out[rows] = reprojection_errors(T_pred[rows], T_gt[rows], camera, answered[rows])
    return out


def matching_scores(pair_set: PairSet, folder: MethodResults) -> dict[str, Summary]:
    """The matching quality of each group of a pair set. Raises PredictionError."""
    path = folder.matching(pair_set.name)
    rows = MATCHING.read(path)
    check_complete(rows, [p.key for p in pair_set.pairs], path)
    return {group: summarize_matching(rows, group) for group in groups_of(rows)}


def summarize_rows(rows: Sequence[PairErrors], group: str = ALL) -> PairSetSummary:
    """Every metric over the rows of one group. Raises DatasetError where there is none."""
    return ErrorTable.of(rows).of_group(group).summary


def groups_of(rows: Sequence[PairErrors] | Sequence[MatchingRow]) -> list[str]:
    """The groups of rows that are scored: ``all``, and the named groups in order of appearance if there are several."""
    return groups_in(rows.group_names if isinstance(rows, ErrorTable) else list(dict.fromkeys(r.group for r in rows)))


def predictions_hash(folder: MethodResults, pair_set: str) -> str:
    """The SHA-256 of predictions and table, by which stale scores are recognized."""
    return _hash_of(folder.predictions(pair_set), folder.answers(pair_set))


def truth_hash(pair_set: PairSet) -> str:
    """The SHA-256 of the pair file and its table, which hold the truth that predictions are compared with."""
    return _hash_of(pair_set.layout.pair_file(pair_set.name), pair_set.layout.pair_table(pair_set.name))


def _hash_of(path: Path, other: Path) -> str:
    """The SHA-256 of two files with a line end between them; the second is empty if it does not exist.

    Raises:
        PredictionError: no such file, or none that can be read.
    """
    digest = hashlib.sha256()
    _add_file(digest, path)
    digest.update(b"\n")
    if other.exists():
        _add_file(digest, other)
    return digest.hexdigest()


def _add_file(digest: hashlib._Hash, path: Path) -> None:
    """Add a file in blocks, since it may be large."""
    with plain_file(path, "a file", PredictionError).open("rb") as stream:
        while block := stream.read(2**20):
            digest.update(block)
