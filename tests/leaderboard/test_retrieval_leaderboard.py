"""Retrievers compared: ranks, means over tasks, missing results, and the page."""

from __future__ import annotations

import csv
import json
import re
import shlex
import shutil
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from command_line import relocbench
from refusals import refused
from small_dataset import make_small_dataset
from small_views import make_small_views

from relocbench.errors import ConfigError, PredictionError
from relocbench.evaluation.common.folders import sets_in
from relocbench.evaluation.retrieval.evaluate import RetrievalOptions, evaluate_retrievers
from relocbench.evaluation.retrieval.records import METRICS, SET_FILE, SetResults, TaskRecord
from relocbench.leaderboard.common.by_query import load_board
from relocbench.leaderboard.retrieval.board import (
    RETRIEVAL,
    RetrievalBoard,
    RetrievalRow,
    check_plausible,
    has_single_positives,
    mean_tables,
)
from relocbench.leaderboard.retrieval.page import evaluate_command, retrieval_page
from relocbench.progress import Silent

HERE = "retrievers_for_tests"
D2S, S2D, MEAN = "drone-satellite", "satellite-drone", "mean over all tasks"


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("board")
    views = make_small_views(root / "town", places=12, noise=20.0)
    run(views, root / "results", f"good={HERE}:Thumbnail", f"twin={HERE}:Thumbnail", f"same={HERE}:Constant")
    run(views, root / "results", f"half={HERE}:Thumbnail", pair_sets=(D2S,))
    return root / "results"


def run(dataset: Path, out: Path, *methods: str, **options: Any) -> None:
    evaluate_retrievers(RetrievalOptions(dataset=dataset, out=out, methods=methods, workers=0, **options), Silent())


@cache
def board_of(results: Path, **options: Any) -> RetrievalBoard:
    board = load_board(RETRIEVAL, results, **options)
    assert board is not None
    return board


def rows_of(results: Path, table: str) -> dict[str, RetrievalRow]:
    found = next(t for s in board_of(results).sets for t in s.tables if t.name == table)
    return {row.method.label: row for row in found.rows}


def test_methods_share_a_place_unless_they_differ(results: Path) -> None:
    rows = rows_of(results, MEAN)
    assert {label: row.rank for label, row in rows.items()} == {"good": 1, "twin": 1, "same": 2, "half": None}
    assert rows["good"].family == rows["twin"].family == ("good", "twin"), "one code with the same settings"
    assert rows["same"].family == ()
    assert list(rows)[-1] == "half"
    assert rows["half"].missing == (S2D,)
    assert set(rows["half"].values.values()) == {None}
    assert rows_of(results, D2S)["half"].rank == 1


def test_results_of_one_set_with_other_queries_are_refused(results: Path, tmp_path: Path) -> None:
    (folder,) = (each.root for each in sets_in(results, SetResults))
    first, other = tmp_path / folder.name, tmp_path / f"{folder.name.split('@')[0]}@ffffffffffff"
    shutil.copytree(folder, first)
    shutil.copytree(folder, other)
    text = (other / SET_FILE).read_text(encoding="utf-8")
    assert re.search("^question: .", text, re.MULTILINE)
    changed = re.sub("^fingerprint: .*", f"fingerprint: {'f' * 64}", text, flags=re.MULTILINE)
    (other / SET_FILE).write_text(re.sub("queries: (\\d+)", "queries: 1\\1", changed, count=1), encoding="utf-8")
    with refused(PredictionError, other / SET_FILE):
        load_board(RETRIEVAL, tmp_path)


def test_values_are_those_of_the_evaluation_and_the_mean_counts_tasks_alike(results: Path) -> None:
    scores = sets_in(results, SetResults)[0].method("good").retrieval_scores().tasks
    for metric in METRICS:
        for task in (D2S, S2D):
            assert rows_of(results, task)["good"].values[metric] == pytest.approx(scores[task][metric], abs=1e-12)
        mean = (float(scores[D2S][metric] or 0) + float(scores[S2D][metric] or 0)) / 2
        assert rows_of(results, MEAN)["good"].values[metric] == pytest.approx(mean, abs=1e-12)


def test_places_that_several_tasks_ask_for_count_once(results: Path) -> None:
    intervals = {name: rows_of(results, name)["good"].intervals["AP"] for name in (D2S, S2D, MEAN)}
    one, other, mean = (intervals[name] for name in (D2S, S2D, MEAN))
    assert one is not None
    assert other is not None
    assert mean is not None
    # Twelve places, not twenty-four: all found, as many draws as places.
    assert rows_of(results, MEAN)["good"].values["AP"] == 1.0
    for task in (one, other):
        assert (mean.low, mean.high) == pytest.approx((task.low, task.high))


def test_means_are_by_direction_and_by_conditions_and_parts_count_once() -> None:
    def record(query: str, gallery: str, asked: str, stored: str) -> TaskRecord:
        views = {"view_query": query, "view_gallery": gallery, "condition_query": asked, "condition_gallery": stored}
        return TaskRecord(queries=1, gallery=1, without_positives=0, most_positives=1, **views)

    tasks = {
        "drone-satellite": record("drone", "satellite", "rain+sun", "sun"),
        "drone-satellite__rain": record("drone", "satellite", "rain", "sun"),
        "drone-satellite__sun": record("drone", "satellite", "sun", "sun"),
        "4K_drone-satellite": record("drone", "satellite", "", ""),
        "street-satellite__rain": record("street", "satellite", "rain", "sun"),
    }
    assert mean_tables(tasks) == {
        MEAN: ("drone-satellite", "4K_drone-satellite", "street-satellite__rain"),
        "direction drone → satellite": ("drone-satellite", "4K_drone-satellite"),
        "conditions rain → sun": ("drone-satellite__rain", "street-satellite__rain"),
    }
    assert mean_tables({"a__b__c": record("street", "street", "x", "y")}) == {}


def test_the_same_results_give_the_same_bytes(results: Path, tmp_path: Path) -> None:
    for out in (tmp_path / "a", tmp_path / "b"):
        assert relocbench("leaderboard", results, "--out", out, "-q").status == 0
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == ["retrieval.csv", "retrieval.md"]
    for name in ("retrieval.csv", "retrieval.md"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_the_page_says_what_a_reader_must_know(results: Path, tmp_path: Path) -> None:
    shown = relocbench("leaderboard", results, "--out", tmp_path)
    assert shown.status == 0, shown.err
    assert "half has no result on satellite-drone" in shown.err
    assert "(chance)" in shown.out
    page = (tmp_path / "retrieval.md").read_text(encoding="utf-8")
    for words in (
        "The denominator is every query",
        "No significant gain over chance: `same`.",
        "- `half` on `satellite-drone`",
        "Each query has one right image",
        "| `drone-satellite` | drone → satellite |",
        "relocbench evaluate-retrieval --dataset DATASET --out RESULTS --method good=retrievers_for_tests:Thu",
    ):
        assert words in page
    assert str(results) not in page
    s2d = page.split("### satellite-drone")[1].split("### Methods")[0]
    assert "Each query has one right image" not in s2d  # two drone images show each place
    width = 0
    for line in page.replace("\\|", "").splitlines():
        count = line.count("|") if line.startswith("|") else 0
        assert count in (0, width) or width == 0, line
        width = count
    rows = list(csv.DictReader((tmp_path / "retrieval.csv").open(encoding="utf-8")))
    assert {r["method"] for r in rows} == {"good", "twin", "same", "half", "(chance)"}
    good = next(r for r in rows if r["method"] == "good" and r["table"] == D2S)
    assert float(good["R@1_low"]) <= float(good["R@1"]) <= float(good["R@1_high"])
    assert (good["view_query"], good["view_gallery"], good["queries"]) == ("drone", "satellite", "24")


def test_json_holds_the_rows_of_both_halves(results: Path, tmp_path: Path) -> None:
    shown = json.loads(relocbench("leaderboard", results, "--out", tmp_path, "-q", "--json").out)
    assert shown["rows"] == []
    assert {row["method"] for row in shown["retrieval"]} == {"good", "twin", "same", "half", "(chance)"}


@pytest.mark.thorough
def test_both_halves_are_written_from_one_results_folder(tmp_path: Path) -> None:
    street = make_small_dataset(tmp_path / "street", frames=8)
    out = tmp_path / "results"
    assert relocbench("evaluate", "-d", street.root, "-m", "identity", "--out", out, "-j", "1", "-q").status == 0
    run(street.root, out, f"t={HERE}:Thumbnail", radius=0.2, heading=30.0)
    board = relocbench("leaderboard", out, "--out", tmp_path / "board", "-q", "--split", "test")
    assert board.status == 0, board.err
    assert {"leaderboard.md", "retrieval.md"} <= {p.name for p in (tmp_path / "board").iterdir()}
    asked = sets_in(out, SetResults)[0]
    assert asked.record.splits == {"test": ("summer__winter__cam0",), "all": ("summer__winter__cam0",)}
    words = shlex.split(evaluate_command(asked.record, asked.method("t").run_record()))
    assert words[words.index("--radius") : words.index("--radius") + 4] == ["--radius", "0.2", "--heading", "30"]
    refused = relocbench("leaderboard", out, "--out", tmp_path / "b", "--split", "absent")
    assert (refused.status, "no split 'absent'" in refused.complaint) == (2, True)


def test_an_unknown_metric_or_split_is_refused(results: Path) -> None:
    with refused(ConfigError, "", None, "R@3", "R@5"):
        load_board(RETRIEVAL, results, metric="R@3")
    with refused(ConfigError, "", None, "test"):
        load_board(RETRIEVAL, results, split="test")
    assert board_of(results, metric="AP").metric == "AP"


def test_answers_that_changed_since_they_were_scored_are_refused(tmp_path: Path) -> None:
    views = make_small_views(tmp_path / "town", places=3)
    run(views, tmp_path / "results", f"t={HERE}:Thumbnail")
    folder = sets_in(tmp_path / "results", SetResults)[0].method("t")
    kept = folder.answers(D2S).read_text()
    folder.answers(D2S).write_text(kept.replace(",ok,1,1,", ",ok,1,2,", 1))
    with refused(PredictionError, "drone-satellite.csv"):
        load_board(RETRIEVAL, tmp_path / "results")
    folder.answers(D2S).write_text(kept)
    folder.scores_yaml.unlink()
    with refused(PredictionError, "scores.yaml"):
        load_board(RETRIEVAL, tmp_path / "results")


def test_a_metric_that_is_younger_than_the_scores_follows_from_the_table(tmp_path: Path) -> None:
    run(make_small_views(tmp_path / "town", places=3), tmp_path / "results", f"t={HERE}:Thumbnail")
    before = [dict(row.values) for table in board_of(tmp_path / "results").sets[0].tables for row in table.rows]
    path = sets_in(tmp_path / "results", SetResults)[0].method("t").scores_yaml
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(line for line in lines if " AP:" not in line))
    assert path.read_text() != "".join(lines)
    again = [dict(row.values) for table in board_of(tmp_path / "results").sets[0].tables for row in table.rows]
    assert again == before


def test_an_average_precision_that_one_positive_does_not_allow_is_refused(results: Path) -> None:
    table = next(t for t in board_of(results).sets[0].tables if t.name == D2S)
    assert has_single_positives(table)
    check_plausible(table)
    row = table.rows[0]
    wrong = RetrievalRow(row.method, {**row.values, "R@1": 0.5, "AP": 0.7}, {}, 1)
    with refused(PredictionError, "", None, "good", "drone-satellite", "70.0000"):
        check_plausible(type(table)(table.name, table.tasks, table.records, (wrong,)))


def test_a_folder_without_retrieval_has_no_board(tmp_path: Path) -> None:
    assert load_board(RETRIEVAL, tmp_path) is None


def test_a_set_on_which_no_method_has_finished_a_task_has_a_page_without_tables(tmp_path: Path) -> None:
    views = make_small_views(tmp_path / "town", places=3)
    run(views, tmp_path / "results", f"t={HERE}:Thumbnail")
    folder = sets_in(tmp_path / "results", SetResults)[0].method("t")
    for task in (D2S, S2D):
        folder.answers(task).unlink()
    board = load_board(RETRIEVAL, tmp_path / "results")
    assert board is not None
    assert board.sets[0].tables == ()
    assert f"No method has been run on `{D2S}`, `{S2D}`." in retrieval_page(board)
