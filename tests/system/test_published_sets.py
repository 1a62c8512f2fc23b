"""The commands of the published results give the datasets that were published, and methods find their way there."""

from __future__ import annotations

import csv
import json
import math
import os
import shlex
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from repository import ROOT
from test_end_to_end import METHODS, board_rows, errors_by_method, medians, run

from relocbench.datasets.core.dataset import Dataset

RECORDINGS = Path(os.environ.get("RELOCBENCH_REAL_DATA", ROOT.parent / "shared" / "data"))
SCRIPT = ROOT / "tools" / "build_small_sets.sh"
TABLE = ROOT / "leaderboard" / "leaderboard.csv"
Built = Callable[[str], Dataset]

pytestmark = pytest.mark.thorough


def published() -> dict[str, str]:
    """Dataset -> question, the digest of recipe, rigs, poses and pairs.

    A fingerprint covers the tables' columns as well, which grow from version to version.
    """
    with TABLE.open(encoding="utf-8") as stream:
        return {row["dataset"]: row["question"] for row in csv.DictReader(stream)}


def published_command(name: str, out: Path) -> list[str]:
    """The words of the script's line that builds a dataset, its variables filled in."""
    assignments = {
        "kitti": RECORDINGS / "kitti_odometry",
        "xyz": RECORDINGS / "tum_rgbd" / "rgbd_dataset_freiburg1_xyz",
        "desk": RECORDINGS / "tum_rgbd" / "rgbd_dataset_freiburg1_desk",
        "by_nc": "CC BY-NC-SA 3.0 (KITTI)",
        "by": "CC BY 4.0 (TUM RGB-D)",
        "scratch": out,
    }
    (line,) = [
        text
        for text in SCRIPT.read_text(encoding="utf-8").splitlines()
        if text.startswith("relocbench build-dataset") and f'"$scratch/{name}"' in text
    ]
    words = shlex.split(line)
    for variable, value in sorted(assignments.items(), key=lambda item: -len(item[0])):
        words = [word.replace(f"${variable}", str(value)) for word in words]
    return words[1:]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Built:
    """``built("kitti_06")`` is that dataset, made by the published command."""
    if not (RECORDINGS / "kitti_odometry").is_dir() or not (RECORDINGS / "tum_rgbd").is_dir():
        pytest.skip(f"no recordings in {RECORDINGS}")
    folder = tmp_path_factory.mktemp("published")

    @cache
    def build(name: str) -> Dataset:
        run(*published_command(name, folder), "--workers", 1)
        return Dataset(folder / name)

    return build


@pytest.mark.parametrize("name", ["kitti_06", "fr1_xyz", "fr1_xyz_to_desk"])
def test_a_published_dataset_is_what_its_command_gives_on_this_machine(name: str, built: Built) -> None:
    assert built(name).content_id == published()[name]


def test_kitti_is_tracked_to_centimetres_and_what_fails_farther_off_is_in_the_table(
    tmp_path: Path, built: Built
) -> None:
    results, board = tmp_path / "r", tmp_path / "b"
    run("evaluate", "-d", built("kitti_06").root, *METHODS, "-m", "gn-net", "--out", results, "-j", 0, "-q")
    run("leaderboard", results, "--out", board, "-q")
    errors = errors_by_method(results)
    for method in ("orb-pnp", "dso", "gn-net"):
        metres, degrees = medians(errors[method], "step_1", "step_2")
        assert metres <= 0.05, method
        assert degrees <= 0.1, method
    assert medians(errors["identity"], "step_1", "step_2")[0] > 1.0
    # The basin of raw intensities ends between 2.4 m and 4.8 m (reference/direct alignment on these frames).
    assert medians(errors["dso"], "step_4", "step_8")[0] > 1.0
    # Features that were learnt on a rendered town alone reach farther, on these real images.
    assert medians(errors["gn-net"], "step_4")[0] < 0.3
    shown = {(r["method"], r["group"]) for r in board_rows(board)}
    assert {(m, f"step_{k}") for m in errors for k in (1, 2, 4, 8)} <= shown


def test_a_desk_is_tracked_within_a_session_and_failures_across_sessions_count(tmp_path: Path, built: Built) -> None:
    within, across = tmp_path / "within", tmp_path / "across"
    run("evaluate", "-d", built("fr1_xyz").root, *METHODS, "--out", within, "-j", 0, "-q")
    for method, rows in errors_by_method(within).items():
        metres, degrees = medians(rows, "step_1", "step_2", "step_4")
        if method != "identity":
            assert metres <= 0.015, method
            assert degrees <= 0.6, method
    report: dict[str, Any] = json.loads(
        run("evaluate", "-d", built("fr1_xyz_to_desk").root, *METHODS, "--out", across, "-j", 0, "--json")
    )
    for method, rows in errors_by_method(across).items():
        assert len(rows) == 9, "every frame of the second session is a query"
        failed = sum(r.status != "ok" for r in rows)
        assert sum(math.isinf(r.translation_error_m) for r in rows) == failed
        (summary,) = (groups["all"] for groups in report["methods"][method].values())
        assert summary["coverage"] == pytest.approx(1 - failed / 9)
    assert any(r.status != "ok" for r in errors_by_method(across)["dso"])
