"""One table over all datasets, in every format."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import relocbench
from latex_parser import check_latex
from made_results import SAME, WINTER, Made, MadeResults, made, read_csv
from small_views import make_small_views

from relocbench.evaluation.retrieval.evaluate import RetrievalOptions, evaluate_retrievers
from relocbench.leaderboard import Board, load_results, make_board
from relocbench.leaderboard.common.by_query import load_board
from relocbench.leaderboard.retrieval.board import RETRIEVAL
from relocbench.metrics.statistics.intervals import MANY_ROADS
from relocbench.progress import Silent


def town(root: Path, name: str, pairs: int, methods: dict[str, Made], **sets: int) -> None:
    results = MadeResults(root, {WINTER: pairs, **sets}, name=name)
    results.write_dataset()
    for label, answers in methods.items():
        of_sets = {other: made(99, n, 0.05) for other, n in sets.items()}
        results.add(label, {WINTER: answers, **of_sets})


def right(pairs: int, share: float, seed: int) -> Made:
    """Errors of which that share is small, on scattered pairs."""
    wrong = np.random.default_rng(seed).permutation(pairs) >= share * pairs
    errors = np.where(wrong, 5.0, 0.01) * np.random.default_rng(seed + 1).uniform(0.5, 1.5, pairs)
    return Made(errors, errors)


def shares(board: Board) -> dict[str, float | None]:
    (over,) = board.over
    return {row.method.label: row.values[over.metric] for row in over.rows}


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two datasets of unequal size, whose methods differ; one method is missing on the second."""
    root = tmp_path_factory.mktemp("over") / "results"
    town(root, "big", 200, {"good": right(200, 1.0, 1), "bad": right(200, 0.5, 2), "lone": right(200, 1.0, 3)})
    town(root, "small", 100, {"good": right(100, 0.9, 4), "bad": right(100, 0.3, 5), "identity": right(100, 0.2, 6)})
    return root


def test_each_dataset_counts_once_and_a_missing_one_leaves_no_value(results: Path) -> None:
    board = make_board(load_results(results))
    (over,) = board.over
    assert over.roads == 2
    found = shares(board)
    assert found["good"] == pytest.approx(0.95)
    assert found["bad"] == pytest.approx(0.4)
    rows = {row.method.label: row for row in over.rows}
    assert list(rows)[:2] == ["good", "bad"]
    assert {label: row.rank for label, row in rows.items()} == {"good": 1, "bad": 2, "lone": None, "identity": None}
    assert (rows["lone"].values[over.metric], len(rows["lone"].missing)) == (None, 1)
    assert rows["good"].values["least"] == pytest.approx(0.9)
    assert rows["good"].values["greatest"] == 1.0


def test_one_dataset_and_datasets_without_a_method_in_common_have_none(tmp_path: Path) -> None:
    town(tmp_path, "one", 50, {"mine": right(50, 0.9, 1)})
    assert make_board(load_results(tmp_path)).over == ()
    town(tmp_path, "other", 50, {"yours": right(50, 0.9, 1)})
    assert make_board(load_results(tmp_path)).over == ()


def test_tiers_of_a_town_count_once(tmp_path: Path) -> None:
    for number in (1, 2):
        for tier in ("easy", "extreme"):
            share = {"easy": 1.0, "extreme": 0.2}[tier] - 0.1 * number
            name = f"relocbench-2026.1-test-{tier}-{number:02d}"
            town(tmp_path, name, 50, {"mine": right(50, share, number), "yours": right(50, 0.1, number)})
    (over,) = make_board(load_results(tmp_path)).over
    assert (over.roads, len(over.parts), over.count) == (2, 4, 200)
    (mine,) = (row for row in over.rows if row.method.label == "mine")
    assert (mine.values["least"], mine.values["greatest"]) == pytest.approx((0.4, 0.5))
    assert over.notes[0].startswith("4 datasets of 2 roads")


def test_pairs_of_the_same_drive_have_a_table_of_their_own(tmp_path: Path) -> None:
    for number in range(2):
        methods = {"a": right(30, 0.9, number), "b": right(30, 0.5, number)}
        town(tmp_path, f"town-{number}", 30, methods, **{SAME: 20})
    assert [over.name for over in make_board(load_results(tmp_path)).over] == ["cross-condition", "same drive"]


@pytest.mark.thorough
def test_many_datasets_must_agree_that_a_method_is_better(tmp_path: Path) -> None:
    """What one dataset alone decides is no difference on others, if there are many that say nothing."""
    for number in range(MANY_ROADS):
        lead = 1.0 if number == 0 else 0.5
        methods = {"steady": right(60, 0.9, number), "lucky": right(60, lead, 50 + number), "low": right(60, 0.1, 99)}
        if number:
            methods["steady"] = right(60, 0.5, 100 + number)
        town(tmp_path, f"town-{number}", 60, methods)
    (over,) = make_board(load_results(tmp_path)).over
    ranks = {row.method.label: row.rank for row in over.rows}
    assert ranks["steady"] == ranks["lucky"] == 1
    assert ranks["low"] == 3


@pytest.mark.thorough
def test_every_format_has_the_table(results: Path, tmp_path: Path) -> None:
    formats = "csv,markdown,latex,html"
    shown = relocbench("leaderboard", results, "--out", tmp_path, "--format", formats, "--pairs", 0, "--quiet")
    assert shown.status == 0, shown.err
    rows = {row["method"]: row for row in read_csv(tmp_path / "datasets.csv")}
    assert (rows["good"]["rank"], rows["bad"]["rank"], rows["lone"]["rank"]) == ("1", "2", "")
    assert float(rows["good"]["recall@(0.25m,2deg)"]) == pytest.approx(0.95)
    page = (tmp_path / "leaderboard.md").read_text(encoding="utf-8").replace("\\", "")
    assert page.index("## 2 datasets, cross-condition") < page.index("## big")
    assert "| 1 | good | 95.0 [" in page
    table = check_latex((tmp_path / "leaderboard.tex").read_text(encoding="utf-8"))[0]
    assert table[1][:2] == ["good", "1"]
    start = (tmp_path / "html" / "index.html").read_text(encoding="utf-8")
    assert "Trackers, 2 datasets, cross-condition" in start
    assert "2 datasets, cross-condition" in shown.out
    told = relocbench("leaderboard", results, "--out", tmp_path, "--json", "--quiet")
    assert {row["method"]: row["rank"] for row in json.loads(told.out)["datasets"]}["bad"] == 2


@pytest.mark.thorough
def test_retrievers_are_compared_over_datasets_too(tmp_path: Path) -> None:
    for number in range(2):
        views = make_small_views(tmp_path / f"town-{number}", places=12 + number, noise=20.0)
        methods = ["good=retrievers_for_tests:Thumbnail", "same=retrievers_for_tests:Constant", "random"]
        options = RetrievalOptions(dataset=views, out=tmp_path / "results", methods=methods, workers=0)
        evaluate_retrievers(options, Silent())
    board = load_board(RETRIEVAL, tmp_path / "results")
    assert board is not None
    (over,) = board.over
    assert over.roads == 2
    assert {row.method.label: row.rank for row in over.rows} == {"good": 1, "same": 2, "random": None}
