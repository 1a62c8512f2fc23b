"""Chains by the commands a user types: the whole way to a page, and mistakes in one line."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
from command_line import relocbench
from latex_parser import check_latex
from pipelines_for_tests import lists
from refusals import refused
from small_dataset import ACROSS, make_small_dataset

from relocbench.datasets.core.dataset import Dataset
from relocbench.errors import ConfigError, PredictionError
from relocbench.leaderboard.common.by_query import load_board
from relocbench.leaderboard.relocalization.board import RELOCALIZATION

KNOWS = "pipelines_for_tests:Knows"
THUMBNAIL = "thumb=retrievers_for_tests:Thumbnail"
CHAIN = ("evaluate-relocalization",)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("data") / "small", frames=12, size=(32, 24))


@pytest.fixture(scope="module")
def results(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A good and a bad tracker behind a good and a bad retriever, and the oracle."""
    root = tmp_path_factory.mktemp("chains")
    far = lists(dataset, root / "far", [[(q + 6) % 12, (q + 5) % 12] for q in range(12)])
    near = lists(dataset, root / "near", [[q, (q + 5) % 12] for q in range(12)])
    done = relocbench(
        *CHAIN, "-d", dataset.root, "-o", root / "r", "-r", f"far=predictions:{far}", "-r", f"near=predictions:{near}",
        "-r", "oracle", "-m", f"good={KNOWS}", "-m", f"bad={KNOWS}", "--set", "bad.reach=-1", "--top", 2, "-j", 1,
    )  # fmt: skip
    assert done.status == 0, done.err
    assert "\x1b" not in done.out + done.err
    assert "12 queries, 12 keyframes, pairs reach 0.192 m, 2°" in done.out
    first = {tuple(line.strip("│ ").split("│")[:2]) for line in done.out.splitlines() if line.startswith("│")}
    pipelines = {(retriever.strip(), tracker.strip()) for retriever, tracker in first}
    assert pipelines == {(r, t) for r in ("far", "near", "oracle") for t in ("good", "bad", "keyframe-pose")}
    assert "good on small: 48/48" in done.err  # near, far and what the oracle asks beyond them
    return root / "r"


@pytest.mark.thorough
def test_a_page_says_who_is_ahead_and_where_it_is_lost(results: Path, tmp_path: Path) -> None:
    shown = relocbench("leaderboard", results, "--out", tmp_path / "b", "--relocalization-metric", "recall@(0.5m,5deg)")
    assert shown.status == 0, shown.err
    assert sorted(p.name for p in (tmp_path / "b").iterdir()) == [
        "relocalization.csv",
        "relocalization.md",
        "retrieval.csv",
        "retrieval.md",
    ]
    with (tmp_path / "b" / "relocalization.csv").open() as stream:
        rows = {(r["retriever"], r["tracker"]): r for r in csv.DictReader(stream)}
    assert len(rows) == 9
    assert rows["near", "keyframe-pose"]["rank"] == "", "a trivial baseline"
    assert rows["near", "good"]["rank"] == "", "the tracker uses times"
    assert rows["oracle", "keyframe-pose"]["rank"] == ""
    assert float(rows["near", "good"]["recall@(0.25m,2deg)"]) == 1.0
    assert float(rows["far", "good"]["failed_retrieval"]) == 1.0
    assert float(rows["near", "bad"]["failed_tracking"]) == 1.0
    assert rows["near", "good"]["hit_low"] == ""  # eight queries are too few for an interval
    page = (tmp_path / "b" / "relocalization.md").read_text()
    best = "|  | near | good (uses times) ² ³ | 2 | 100.0 |"
    for words in (best, "*oracle*", "*keyframe-pose*", "failed_retrieval, %", "--retriever"):
        assert words in page, words
    again = relocbench("leaderboard", results, "--out", tmp_path / "c", "--relocalization-metric", "recall@(0.5m,5deg)")
    assert again.status == 0
    assert all((tmp_path / "c" / p.name).read_bytes() == p.read_bytes() for p in (tmp_path / "b").iterdir())


def test_both_tasks_are_tables_for_papers_too(results: Path, tmp_path: Path) -> None:
    shown = relocbench("leaderboard", results, "--out", tmp_path / "t", "--format", "latex", "--json", "-q")
    assert shown.status == 0, shown.err
    assert sorted(p.name for p in (tmp_path / "t").iterdir()) == ["relocalization.tex", "retrieval.tex"]
    assert json.loads(shown.out)["counts"]["files_written"] == 2
    pipelines = check_latex((tmp_path / "t" / "relocalization.tex").read_text())
    assert [len(table) for table in pipelines] == [10]
    assert pipelines[0][0][:5] == ["retriever", "tracker", "top", "rank", r"recall@(0.25m,2deg), \% $\uparrow$"]
    rankings = check_latex((tmp_path / "t" / "retrieval.tex").read_text())
    assert [row[0] for row in rankings[0]][-1] == r"\textit{(chance)}"


def test_a_metric_of_a_task_without_results_is_refused(results: Path, tmp_path: Path) -> None:
    told = relocbench("leaderboard", results, "--out", tmp_path / "b", "--metric", "t_auc@0.5m")
    assert told.status == 2
    assert (
        "--metric ranks results of evaluate, of which there are none here, only of evaluate-retrieval" in told.complaint
    )
    assert not (tmp_path / "b").exists()


@pytest.mark.thorough
def test_one_json_object(results: Path, dataset: Dataset) -> None:
    out = relocbench(
        *CHAIN, "-d", dataset.root, "-o", results, "-r", "oracle", "-m", f"good={KNOWS}", "--top", 2, "--json", "-q",
        "-j", 1,
    )  # fmt: skip
    told = json.loads(out.out, parse_constant=pytest.fail)
    assert [c["pipeline"] for c in told["pipelines"]] == ["oracle+keyframe-pose.top1", "oracle+good.top2"]
    assert told["pipelines"][1]["tasks"][ACROSS]["hit"] == 1.0
    assert told["tasks"][ACROSS]["queries"] == 12
    page = json.loads(relocbench("leaderboard", results, "--out", results.parent / "j", "--json", "-q").out)
    assert len(page["relocalization"]) == 9
    assert page["rows"] == []


@pytest.mark.thorough
def test_a_configuration_file_can_ask_for_pipelines(dataset: Dataset, tmp_path: Path) -> None:
    config = tmp_path / "run.yaml"
    config.write_text(
        f"dataset: {dataset.root}\nretriever: ['{THUMBNAIL}']\nmethods: ['g={KNOWS}']\n"
        f"set: [thumb.side=4, g.reach=2]\ntop: 1\nworkers: 1\nout: {tmp_path / 'r'}\n"
    )
    assert relocbench(*CHAIN, "--config", config, "-q").status == 0
    run = next((tmp_path / "r").glob("*/thumb+g.top1/run.yaml")).read_text()
    assert "parameters: {side: 4" in run
    assert "reach: 2" in run


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("-m", "dso"), "nothing to evaluate: give --retriever"),
        (("-r", "orb-pnp"), "'orb-pnp' is a tracker, not a retriever"),
        (("-r", "oracle", "-m", "lpn"), "'lpn' is a retriever, not a tracker"),
        (("-r", "nowhere"), "no retriever 'nowhere'"),
        (("-r", "predictions:somewhere"), "rankings made elsewhere need a label"),
        (("-r", "n=predictions:nowhere"), "no such file or folder"),
        (("-r", "oracle", "-r", "oracle"), "two methods are called 'oracle'"),
        (("-r", THUMBNAIL, "-m", f"thumb={KNOWS}"), "two methods are called 'thumb'"),
        (("-r", "oracle", "-m", f"keyframe-pose={KNOWS}"), "'keyframe-pose' is the name of a trivial baseline"),
        (("-r", "oracle", "-m", f"a+b={KNOWS}"), "'+' joins the two halves"),
        (("-r", "oracle", "-m", f"t={KNOWS}", "--set", "reach=2"), "say for which method, as LABEL.key=value"),
        (("-r", "oracle", "-m", f"t={KNOWS}", "--set", "u.reach=2"), "no method 'u' in this run; available: oracle, t"),
        (("-r", "oracle", "-m", f"t={KNOWS}", "--set", "t.each=2"), "has no parameter 'each'"),
        (("-r", "oracle", "--top", 0), "--top"),
        (("-r", "oracle", "--keep", 5), "No such option: --keep; it is an option of relocbench evaluate-retrieval"),
        (("-r", "oracle", "--probe", "p", "--radius", 2), "give one or the other"),
        (("-r", "oracle", "--probe", "nowhere"), "radii"),
        (("-r", "oracle", "--pair-set", "summer__summer__cam0"), "is of one traversal"),
    ],
)
def test_mistakes_in_one_line(dataset: Dataset, tmp_path: Path, words: tuple[object, ...], complaint: str) -> None:
    done = relocbench(*CHAIN, "-d", dataset.root, "-o", tmp_path / "r", "-q", "-j", 1, *words)
    assert done.status == 2
    assert complaint in done.complaint
    assert not (tmp_path / "r").exists()


def test_options_of_pipelines_mean_nothing_elsewhere(dataset: Dataset, tmp_path: Path) -> None:
    done = relocbench("evaluate", "-d", dataset.root, "-m", "identity", "-r", "oracle", "-o", tmp_path / "r")
    assert done.status == 2
    assert "No such option: -r; it is an option of relocbench evaluate-relocalization" in done.complaint


def test_boards_refuse_what_they_cannot_show(results: Path) -> None:
    with refused(ConfigError, "", None, "R@1"):
        load_board(RELOCALIZATION, results, metric="R@1")
    with refused(ConfigError, "", None, "nowhere", "all", "test"):
        load_board(RELOCALIZATION, results, split="nowhere")
    board = load_board(RELOCALIZATION, results, split="test")
    assert board is not None
    assert [t.tasks for t in board.sets[0].tables] == [(ACROSS,)]
    table = next(results.glob("*/near+good.top2")) / f"{ACROSS}.csv"
    before = table.read_text()
    try:
        table.write_text(before.replace("right", "choice", 1))
        with refused(PredictionError, table, None, "changed", "scored"):
            load_board(RELOCALIZATION, results)
    finally:
        table.write_text(before)
