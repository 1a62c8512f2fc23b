"""Scores say by which formulas they were computed: whoever changes a formula increases its version."""

from __future__ import annotations

import numpy as np
import pytest

from relocbench.evaluation.tracking.score import FORMULAS
from relocbench.geometry import Camera, make_transform, so3_exp
from relocbench.metrics import PairScores, pose_errors, reprojection_errors, summarize_scores

SCORES = {
    1: {
        "pairs": 10,
        "answered": 9,
        "t_auc@0.5m": 0.48017146357113843,
        "t_auc@1m": 0.6900857317855691,
        "r_auc@0.5deg": 0.16249012916860242,
        "r_auc@1deg": 0.27081688194767073,
        "pose_auc@(0.5m,4deg)": 0.48017146357113843,
        "recall@(0.05m,0.5deg)": 0.1,
        "recall@(0.1m,1deg)": 0.2,
        "recall@(0.25m,2deg)": 0.5,
        "recall@(0.5m,5deg)": 0.9,
        "recall@(1m,5deg)": 0.9,
        "recall@(5m,10deg)": 0.9,
        "mlad_recall@0.1m": 0.2,
        "mlad_recall@0.2m": 0.4,
        "mlad_recall@0.5m": 0.9,
        "median_translation_error_m": 0.26239283526803847,
        "median_rotation_error_deg": 1.0313240312354817,
        "median_mlad_translation_error_m": 0.24704284182491676,
        "coverage": 0.9,
        "median_vcre": 0.08982922503164512,
        "vcre_precision@10%": 0.6,
        "vcre_auc@10%": 0.5296428571428572,
        "longest_lost_queries@(0.25m,2deg)": 5.0,
        "longest_lost_seconds@(0.25m,2deg)": 4.0,
        "longest_lost_metres@(0.25m,2deg)": 6.0,
        "lost_for_2@(0.25m,2deg)": 0.5,
        "lost_for_5@(0.25m,2deg)": 0.5,
        "lost_for_10@(0.25m,2deg)": 0.0,
        "lost_stretches_of_2@(0.25m,2deg)": 1.0,
        "lost_stretches_of_5@(0.25m,2deg)": 1.0,
        "lost_stretches_of_10@(0.25m,2deg)": 0.0,
        "run_recall_3@(0.25m,2deg)": 0.5,
        "run_recall_5@(0.25m,2deg)": 0.5,
        "recall_easy@(0.25m,2deg)": 1.0,
        "recall_medium@(0.25m,2deg)": 1.0,
        "recall_hard@(0.25m,2deg)": 0.2,
        "recall_extreme@(0.25m,2deg)": 0.5,
        "recall_look_alike@(0.25m,2deg)": 1.0,
        "recall_look_changed@(0.25m,2deg)": 1.0,
        "recall_look_different@(0.25m,2deg)": 0.0,
        "recall_overlap_to_0.1@(0.25m,2deg)": 1.0,
        "recall_overlap_0.1_to_0.2@(0.25m,2deg)": 1.0,
        "recall_overlap_0.2_to_0.5@(0.25m,2deg)": 0.5,
        "recall_overlap_over_0.5@(0.25m,2deg)": 0.25,
        "recall_scale_to_1.15@(0.25m,2deg)": 1.0,
        "recall_scale_1.15_to_1.4@(0.25m,2deg)": 1.0,
        "recall_scale_1.4_to_1.8@(0.25m,2deg)": 0.0,
        "recall_scale_over_1.8@(0.25m,2deg)": 0.0,
        "confidence_auc_pr@(0.25m,2deg)": 0.2984126984126984,
        "aurc@(0.25m,2deg)": 0.4949206349206349,
        "wrong_of_answered@(0.25m,2deg)": 0.4444444444444444,
        "coverage_at_precision_95@(0.25m,2deg)": 0.1,
        "coverage_at_precision_99@(0.25m,2deg)": 0.1,
        "precision_at_confidence_50@(0.25m,2deg)": 0.5,
        "coverage_at_confidence_50": 0.4,
        "median_seconds": 0.55,
        "p95_seconds": 0.9549999999999998,
        "peak_memory_bytes": 109000000.0,
    },
}
"""version of the formulas -> scores of :func:`scores`, as that version computes them"""


def scores() -> dict[str, float | int | None]:
    """Nine pairs whose errors grow from zero, and a tenth without an answer."""
    steps = np.arange(10)
    truth = np.array([make_transform(so3_exp([0.0, 0.1 * i, 0.0]), [0.2 * i, 0.0, 1.0]) for i in steps])
    off = np.array([make_transform(so3_exp([0.004 * i, 0.0, 0.0]), [0.0, 0.05 * i, 0.03 * i]) for i in steps])
    errors = pose_errors(off @ truth, truth, answered=steps < 9)
    seconds, confidence = 0.1 + 0.1 * steps.astype(np.float64), np.cos(steps.astype(np.float64))
    vcre = reprojection_errors(off @ truth, truth, Camera("pinhole", 96, 72, 240.0, 240.0, 47.5, 35.5), steps < 9)
    all_known = PairScores(
        errors,
        seconds,
        confidence,
        vcre,
        travelled_m=1.5 * steps.astype(np.float64),
        overlap=np.where(steps == 1, 0.9, 0.08 * steps),
        overlap_query=1.0 - 0.1 * steps.astype(np.float64),
        scale_change=1 + 0.1 * steps.astype(np.float64),
        angle_deg=5.0 * steps.astype(np.float64),
        depth_error=0.005 * steps.astype(np.float64),
        similarity=0.9 - 0.1 * steps.astype(np.float64),
        peak_memory_bytes=1e8 + 1e6 * steps.astype(np.float64),
        query_ns=10**9 * steps,
    )
    return summarize_scores(all_known).to_dict()


def test_a_changed_formula_has_another_version() -> None:
    assert max(SCORES) == FORMULAS, "add what the new version computes; scores of earlier ones are refused"
    assert list(scores()) == list(SCORES[FORMULAS]), "published tables and scripts rely on names and order"
    assert scores() == pytest.approx(SCORES[FORMULAS], rel=1e-9), "increase FORMULAS: these formulas are not the same"
