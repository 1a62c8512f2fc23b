"""The whole line on a desk seen in two sessions: within one all is found, across them failures count.

A file of its own beside ``test_end_to_end``, so that two processes can share the longest tests.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from test_end_to_end import METHODS, errors_by_method, medians, run

pytestmark = pytest.mark.slow


def test_a_desk_is_tracked_within_a_session_and_failures_across_sessions_count(
    tmp_path: Path, real_data: Callable[[str], Path]
) -> None:
    source = real_data("tum_rgbd")
    xyz, desk = source / "rgbd_dataset_freiburg1_xyz", source / "rgbd_dataset_freiburg1_desk"
    bare = ("--correspondences", 0)
    run("build-dataset", "tum-rgbd", xyz, "--pair-step", "1,2,4", *bare, "--out", tmp_path / "d", "-q")
    run("evaluate", "-d", tmp_path / "d", *METHODS, "--out", tmp_path / "r", "-j", 0, "-q")
    for method, rows in errors_by_method(tmp_path / "r").items():
        metres, degrees = medians(rows, "step_1", "step_2", "step_4")
        if method != "identity":
            assert metres <= 0.015, method
            assert degrees <= 0.6, method
    run("build-dataset", "tum-rgbd", xyz, desk, *bare, "--out", tmp_path / "d2", "-q")
    report: dict[str, Any] = json.loads(
        run("evaluate", "-d", tmp_path / "d2", *METHODS, "--out", tmp_path / "r2", "-j", 0, "--json")
    )
    for method, rows in errors_by_method(tmp_path / "r2").items():
        assert len(rows) == 9, "every frame of the second session is a query"
        failed = sum(r.status != "ok" for r in rows)
        assert sum(math.isinf(r.translation_error_m) for r in rows) == failed
        (summary,) = (groups["all"] for groups in report["methods"][method].values())
        assert summary["coverage"] == pytest.approx(1 - failed / 9)
    assert any(r.status != "ok" for r in errors_by_method(tmp_path / "r2")["dso"])
