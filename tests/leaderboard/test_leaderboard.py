"""The leaderboard's tables and files, from results folders written here without running any method."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from board_pages import board_pages
from forgery import reseal
from made_results import FINGERPRINT, NIGHT, SAME, WINTER, Made, MadeResults, cells, made, read_csv, row, table
from refusals import refused

from relocbench.errors import ConfigError, PredictionError
from relocbench.evaluation.common.results import MethodResults
from relocbench.leaderboard import load_results, make_board, write_leaderboard

STEPS = ("step_1", "step_2", "step_8", "step_10")


@pytest.fixture
def two_sets(tmp_path: Path) -> MadeResults:
    """Two pair sets; `good` is far better than `identity`, `partial` misses the second set."""
    results = MadeResults(tmp_path / "results", {WINTER: 120, NIGHT: 80}, groups=STEPS)
    results.write_dataset()
    results.add("identity", {WINTER: made(1, 120, 0.8), NIGHT: made(2, 80, 0.8)})
    results.add("good", {WINTER: made(3, 120, 0.05, failing=0.1), NIGHT: made(4, 80, 0.06)}, parameters={"points": 7})
    results.add("partial", {WINTER: made(5, 120, 0.01)})
    return results


def test_the_csv_holds_the_formulas_of_the_metrics_in_full(tmp_path: Path) -> None:
    results = MadeResults(tmp_path / "results", {WINTER: 4})
    results.write_dataset()
    answers = Made([0.05, 0.2, np.inf, 0.6], [0.5, 1.5, np.inf, 0.25], broke=frozenset([2]), seconds=0.5)
    results.add("mine", {WINTER: answers})
    write_leaderboard(results.root, tmp_path / "out")
    found = next(r for r in read_csv(tmp_path / "out" / "leaderboard.csv") if r["pair_set"] == WINTER)
    # By hand: 1/4 (0.9 + 0.6 + 0 + 0); 1/4 (0 + 0 + 0 + 0.5); two of four within 0.25 m and 2 deg.
    assert float(found["t_auc@0.5m"]) == pytest.approx(0.375, abs=1e-15)
    assert float(found["r_auc@0.5deg"]) == pytest.approx(0.125, abs=1e-15)
    assert float(found["recall@(0.25m,2deg)"]) == 0.5
    assert float(found["median_translation_error_m"]) == pytest.approx(0.4, abs=1e-15)
    assert float(found["coverage"]) == 0.75
    assert float(found["median_seconds"]) == 0.5
    assert [found[c] for c in ("pairs", "rejected", "answered", "failed", "broke")] == ["4", "3", "3", "0", "1"]
    assert found["machine"] == "Test CPU"


def test_a_total_is_the_mean_over_pair_sets_each_counting_the_same(two_sets: MadeResults) -> None:
    board = two_sets.board()
    for name in ("t_auc@0.5m", "recall@(0.25m,2deg)", "coverage"):
        one, two = (row(board, s, "good").values[name] for s in (WINTER, NIGHT))
        assert one is not None
        assert two is not None
        assert row(board, "total", "good").values[name] == pytest.approx((one + two) / 2, rel=1e-12)


def test_what_pair_sets_of_a_dataset_have_in_common_does_not_average_out_in_a_total(tmp_path: Path) -> None:
    results = MadeResults(tmp_path / "results", {WINTER: 300, NIGHT: 300})
    results.write_dataset()
    same = made(1, 300, 0.2)
    results.add("alike", {WINTER: same, NIGHT: same})
    results.add("apart", {WINTER: made(2, 300, 0.2), NIGHT: made(3, 300, 0.2)})
    board, name = results.board(), "recall@(0.25m,2deg)"
    widths = {}
    for label in ("alike", "apart"):
        for pair_set in (WINTER, "total"):
            interval = row(board, pair_set, label).intervals[name]
            assert interval is not None
            widths[label, pair_set] = interval.high - interval.low
    assert widths["alike", "total"] == pytest.approx(widths["alike", WINTER])
    assert widths["apart", "total"] < 0.85 * widths["apart", WINTER]


def test_medians_of_a_total_are_those_of_all_pairs_together(tmp_path: Path) -> None:
    results = MadeResults(tmp_path / "results", {WINTER: 5, NIGHT: 2})
    results.write_dataset()
    fails = Made([0.9, np.inf], [0.9, np.inf], seconds=4.0)
    results.add("mine", {WINTER: Made([0.1, 0.2, 0.3, 0.4, 0.5], [1.0] * 5, seconds=1.0), NIGHT: fails})
    board = results.board()
    assert row(board, NIGHT, "mine").values["median_translation_error_m"] == np.inf
    values = row(board, "total", "mine").values
    # Of 0.1 0.2 0.3 0.4 0.5 0.9 inf the fourth; of five times 1 s and two times 4 s the fourth.
    assert (values["median_translation_error_m"], values["median_seconds"]) == (0.4, 1.0)
    assert values["coverage"] == 0.75


def test_what_confidences_are_worth_in_total_is_that_of_all_pairs_together(tmp_path: Path) -> None:
    results = MadeResults(tmp_path / "results", {WINTER: 9, NIGHT: 3})
    results.write_dataset()
    one_wrong = Made([0.9, np.inf, np.inf], [0.9, np.inf, np.inf])
    results.add("mine", {WINTER: Made([0.1] * 9, [1.0] * 9), NIGHT: one_wrong})
    values = row(results.board(), "total", "mine").values
    assert row(results.board(), NIGHT, "mine").values["wrong_of_answered@(0.25m,2deg)"] == 1.0
    assert values["wrong_of_answered@(0.25m,2deg)"] == pytest.approx(1 / 10)


def test_pair_sets_of_one_drive_have_totals_of_their_own(tmp_path: Path) -> None:
    splits: dict[str, tuple[str, ...]] = {"test": (SAME, WINTER, NIGHT)}
    results = MadeResults(tmp_path / "results", {SAME: 30, WINTER: 20, NIGHT: 10}, splits=splits)
    results.write_dataset()
    results.add("mine", {SAME: made(1, 30, 0.01), WINTER: made(2, 20, 0.4)})
    board = write_leaderboard(results.root, tmp_path / "out")
    totals = {t.pair_set: t.pair_sets for t in board.datasets[0].totals}
    assert totals == {"total": (WINTER, NIGHT), "total_same_drive": (SAME,)}
    assert row(board, "total", "mine").missing == (NIGHT,)
    assert row(board, "total_same_drive", "mine").values == row(board, SAME, "mine").values
    rows = read_csv(tmp_path / "out" / "leaderboard.csv")
    assert [r["pair_set"] for r in rows if r["pair_set"].startswith("total")] == ["total", "total_same_drive"]


def test_a_method_that_misses_a_pair_set_has_blank_totals_and_no_rank(two_sets: MadeResults, tmp_path: Path) -> None:
    board = write_leaderboard(two_sets.root, tmp_path / "out")
    assert row(board, WINTER, "partial").rank == 1
    total = row(board, "total", "partial")
    assert total.rank is None
    assert total.missing == (NIGHT,)
    assert all(value is None for value in total.values.values())
    found = [r for r in read_csv(tmp_path / "out" / "leaderboard.csv") if r["method"] == "partial"]
    last = next(r for r in found if r["pair_set"] == "total" and r["group"] == "all")
    assert (last["rank"], last["t_auc@0.5m"], last["coverage"], last["missing"]) == ("", "", "", NIGHT)
    page = board_pages(tmp_path / "out")
    assert set(cells(page, "## Total", "partial (missing)")) == {"", "partial (missing) ³"}
    assert f"`partial` on `{NIGHT}`: not run" in page


def test_a_run_that_was_killed_is_missing_and_its_command_is_named(two_sets: MadeResults, tmp_path: Path) -> None:
    folder = MethodResults(two_sets.folder / "good")
    folder.answers(NIGHT).unlink()  # killed between the two files
    folder.journal(NIGHT).mkdir(parents=True)
    lines = [json.dumps({"key": [1, k]}) for k in (1, 2, 2)]
    (folder.journal(NIGHT) / "1-1.jsonl").write_text("\n".join(lines) + '\n{"key": [1, 3')
    board = write_leaderboard(two_sets.root, tmp_path / "out")
    assert row(board, "total", "good").rank is None
    page = board_pages(tmp_path / "out")
    assert f"`good` on `{NIGHT}`: the run was stopped after 2 of 80 pairs" in page
    assert "relocbench evaluate --dataset DATASET --out RESULTS --method good --set good.points=7" in page


def test_a_pair_set_that_every_method_left_unfinished_is_still_shown(tmp_path: Path) -> None:
    results = MadeResults(tmp_path / "results", {WINTER: 10})
    results.write_dataset()
    results.add("mine", {}).journal(WINTER).mkdir(parents=True)
    board = write_leaderboard(results.root, tmp_path / "out")
    assert row(board, WINTER, "mine").missing == (WINTER,)
    assert "the run was stopped after 0 of 10 pairs" in board_pages(tmp_path / "out")


@pytest.mark.parametrize(("suffix", "old", "new"), [("txt", "\n", "\n\n"), ("csv", "0.25", "0.01")])
def test_predictions_and_answers_that_changed_since_they_were_scored_are_refused(
    two_sets: MadeResults, suffix: str, old: str, new: str
) -> None:
    path = two_sets.folder / "good" / f"{NIGHT}.{suffix}"
    path.write_text(path.read_text().replace(old, new))
    with refused(PredictionError, path.with_suffix(".txt"), None, "relocbench evaluate"):
        load_results(two_sets.root)


def test_errors_that_disagree_with_the_scores_are_refused(two_sets: MadeResults) -> None:
    path = two_sets.folder / "good" / f"{NIGHT}.errors.csv"
    lines = path.read_text().splitlines(keepends=True)
    fields = lines[1].split(",")
    lines[1] = ",".join([*fields[:5], "0.000001", *fields[6:]])
    path.write_text("".join(lines))
    with refused(PredictionError, path, None, "relocbench evaluate"):
        load_results(two_sets.root)
    reseal(MethodResults(path.parent))
    with refused(PredictionError, path, None, "scores.yaml"):
        load_results(two_sets.root)


def test_errors_that_lost_a_pair_are_refused(two_sets: MadeResults) -> None:
    path = two_sets.folder / "good" / f"{NIGHT}.errors.csv"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))
    reseal(MethodResults(path.parent))
    with refused(PredictionError, path, None, 79, 80):
        load_results(two_sets.root)


def test_predictions_without_scores_are_refused_with_the_command_that_scores_them(two_sets: MadeResults) -> None:
    path = two_sets.folder / "good" / "scores.yaml"
    path.unlink()
    with refused(PredictionError, path, None, "relocbench evaluate", "--method good"):
        load_results(two_sets.root)


@pytest.mark.thorough
def test_a_metric_that_is_younger_than_the_scores_follows_from_the_errors(
    two_sets: MadeResults, tmp_path: Path
) -> None:
    path = two_sets.folder / "good" / "scores.yaml"
    before = board_csv(two_sets, tmp_path / "before")
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(line for line in lines if "recall@(0.05m,0.5deg)" not in line))
    assert path.read_text() != "".join(lines)
    assert board_csv(two_sets, tmp_path / "after") == before


def board_csv(results: MadeResults, out: Path) -> bytes:
    write_leaderboard(results.root, out)
    return (out / "leaderboard.csv").read_bytes()


def test_results_of_another_dataset_are_refused(two_sets: MadeResults) -> None:
    run = two_sets.folder / "good" / "run.yaml"
    run.write_text(run.read_text().replace(FINGERPRINT, "f" * 64))
    with refused(PredictionError, run, None, "town@ffffffffffff"):
        load_results(two_sets.root)


def test_methods_that_do_not_differ_significantly_share_a_place(tmp_path: Path) -> None:
    results = MadeResults(tmp_path / "results", {WINTER: 300})
    results.write_dataset()
    first = made(1, 300, 0.1)
    results.add("a", {WINTER: first})
    results.add("b", {WINTER: Made(list(reversed(first.translation_m)), first.rotation_deg)})
    results.add("c", {WINTER: made(2, 300, 0.4)})
    board = results.board()
    assert {r.method.label: r.rank for r in table(board, WINTER).rows} == {"a": 1, "b": 1, "c": 3}


def test_with_too_few_pairs_nothing_is_significant_and_the_page_says_so(tmp_path: Path) -> None:
    results = MadeResults(tmp_path / "results", {WINTER: 4})
    results.write_dataset()
    results.add("a", {WINTER: made(1, 4, 0.01)})
    results.add("b", {WINTER: made(2, 4, 5.0)})
    board = write_leaderboard(results.root, tmp_path / "out")
    assert [r.rank for r in table(board, WINTER).rows] == [1, 1]
    assert "No ranks: too few of the 4 pairs are independent" in board_pages(tmp_path / "out")


def test_the_interval_contains_the_value(two_sets: MadeResults) -> None:
    found = row(two_sets.board(), WINTER, "good")
    interval, value = found.intervals["t_auc@0.5m"], found.values["t_auc@0.5m"]
    assert interval is not None
    assert value is not None
    assert interval.low < value < interval.high


@pytest.mark.thorough
def test_what_else_is_in_the_folder_does_not_change_a_methods_numbers(two_sets: MadeResults) -> None:
    before = row(two_sets.board(), WINTER, "good")
    two_sets.add("another", {WINTER: made(9, 120, 0.2), NIGHT: made(9, 80, 0.2)})
    after = row(two_sets.board(), WINTER, "good")
    assert after.values == before.values
    assert after.intervals == before.intervals


def test_groups_have_rows_of_their_own_in_natural_order(two_sets: MadeResults) -> None:
    board = two_sets.board()
    assert [t.group for t in board.datasets[0].groups_of(table(board, WINTER))] == [
        "step_1",
        "step_2",
        "step_8",
        "step_10",
    ]
    errors = np.asarray(made(3, 120, 0.05, failing=0.1).translation_m)[STEPS.index("step_8") :: len(STEPS)]
    found = row(board, WINTER, "good", "step_8")
    assert found.values["t_auc@0.5m"] == pytest.approx(np.mean(np.maximum(0, 1 - errors / 0.5)), abs=1e-12)
    assert found.pairs == 30
    assert found.rank is None


def test_another_metric_can_rank_and_one_that_is_no_mean_cannot(two_sets: MadeResults) -> None:
    assert two_sets.board(metric="recall@(1m,5deg)").metric.name == "recall@(1m,5deg)"
    with refused(ConfigError, "", None, "median_translation_error_m"):
        two_sets.board(metric="median_translation_error_m")
    with refused(ConfigError, "", None, "best"):
        two_sets.board(metric="best")


def test_a_split_limits_tables_and_totals(tmp_path: Path) -> None:
    splits: dict[str, tuple[str, ...]] = {"train": (NIGHT,), "test": (WINTER,)}
    results = MadeResults(tmp_path / "results", {WINTER: 30, NIGHT: 20}, splits=splits)
    results.write_dataset()
    results.add("mine", {WINTER: made(1, 30, 0.1)})
    board = make_board(load_results(results.root, "test"), split="test")
    assert [(t.pair_set, t.split) for t in board.datasets[0].tables] == [(WINTER, "test"), ("total", "test")]
    assert row(board, "total", "mine").rank == 1
    with refused(ConfigError, "", None, "val", "test", "train"):
        load_results(results.root, "val")


@pytest.mark.thorough
def test_runs_that_differ_by_their_seed_alone_get_a_mean_and_a_deviation(two_sets: MadeResults, tmp_path: Path) -> None:
    values = []
    for seed in (0, 1, 2):
        answers = {WINTER: made(20 + seed, 120, 0.1), NIGHT: made(30 + seed, 80, 0.1)}
        two_sets.add(f"net-{seed}", answers, target="net", seed=seed, parameters={"points": 5, "seed": seed})
    two_sets.add("net-wide", {WINTER: made(40, 120, 0.1)}, target="net", seed=3, parameters={"points": 9, "seed": 3})
    board = write_leaderboard(two_sets.root, tmp_path / "out")
    values = [row(board, WINTER, f"net-{seed}").values["t_auc@0.5m"] for seed in (0, 1, 2)]
    (found,) = table(board, WINTER).seeds
    spread = found.spread["t_auc@0.5m"]
    assert found.labels == ("net-0", "net-1", "net-2")
    assert spread is not None
    assert spread.mean == pytest.approx(np.mean(np.array(values, dtype=float)), rel=1e-12)
    assert spread.standard_deviation == pytest.approx(np.std(np.array(values, dtype=float), ddof=1), rel=1e-12)
    rows = read_csv(tmp_path / "out" / "seeds.csv")
    assert {r["methods"] for r in rows} == {"net-0 net-1 net-2"}
    page = board_pages(tmp_path / "out")
    assert "*net, 3 seeds, mean ± sd*" in page
    assert "Runs of `net` differ in:" in page


def test_the_table_of_all_pairs_holds_every_method_and_pair(two_sets: MadeResults, tmp_path: Path) -> None:
    write_leaderboard(two_sets.root, tmp_path / "out")
    rows = read_csv(tmp_path / "out" / "errors.csv")
    assert len(rows) == 120 * 3 + 80 * 2
    mine = [r for r in rows if r["method"] == "good" and r["pair_set"] == WINTER]
    given = made(3, 120, 0.05, failing=0.1)
    assert [float(r["translation_error_m"]) for r in mine] == list(given.translation_m)


@pytest.mark.thorough
def test_the_same_results_give_the_same_bytes(two_sets: MadeResults, tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_leaderboard(two_sets.root, tmp_path / name)
    files = sorted(p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*") if p.is_file())
    assert {f.suffix for f in files} == {".csv", ".md"}
    for file in files:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes(), file
    assert sorted(p.relative_to(tmp_path / "b") for p in (tmp_path / "b").rglob("*") if p.is_file()) == files
    assert "2024-01-01" not in board_pages(tmp_path / "a")


def test_the_seed_changes_no_value_and_no_interval(two_sets: MadeResults) -> None:
    one, two = (row(two_sets.board(seed=seed), WINTER, "good") for seed in (0, 1))
    assert one.values == two.values
    assert one.intervals == two.intervals
