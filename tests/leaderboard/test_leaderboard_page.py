"""What the leaderboard's page and command tell a person."""

from __future__ import annotations

import json
import re
import shlex
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
import typer
from board_pages import board_pages
from made_results import NIGHT, SAME, TITLE, WINTER, Made, MadeResults, cells, made, read_csv, row, table
from typer.testing import CliRunner

from relocbench.cli.commands.leaderboard import leaderboard
from relocbench.errors import PredictionError
from relocbench.evaluation.common.results import RunRecord
from relocbench.files import dump_yaml, load_yaml_values, write_text
from relocbench.leaderboard import write_leaderboard
from relocbench.leaderboard.tracking.front_page import front_page
from relocbench.leaderboard.tracking.marks import level_with_identity
from relocbench.leaderboard.tracking.method import evaluate_command
from relocbench.metrics import Difference, Interval
from relocbench.pages.markdown import escaped


def page_of(results: MadeResults, out: Path) -> str:
    write_leaderboard(results.root, out)
    return board_pages(out)


@pytest.fixture
def one_set(tmp_path: Path) -> MadeResults:
    results = MadeResults(tmp_path / "results", {WINTER: 100})
    results.write_dataset()
    results.add("good", {WINTER: made(1, 100, 0.05)})
    return results


def test_without_the_identity_the_page_says_that_it_is_missing(one_set: MadeResults, tmp_path: Path) -> None:
    assert "**The identity baseline is missing:**" in page_of(one_set, tmp_path / "out")
    one_set.add("identity", {WINTER: made(2, 100, 0.8)})
    page = page_of(one_set, tmp_path / "out")
    assert "**The identity baseline is missing:**" not in page
    assert cells(page, f"## {WINTER}".replace("_", "\\_"), "*identity* (trivial baseline)")[0] == ""


def test_the_floor_is_known_by_what_ran_not_by_its_label(one_set: MadeResults, tmp_path: Path) -> None:
    one_set.add("identity", {WINTER: made(2, 100, 0.8)}, target="dso")
    assert "**The identity baseline is missing:**" in page_of(one_set, tmp_path / "out")
    one_set.add("nothing", {WINTER: made(2, 100, 0.8)}, target="baselines.identity:Identity")
    assert "*nothing* (trivial baseline)" in page_of(one_set, tmp_path / "out")


@pytest.mark.parametrize(
    ("target", "ranked"),
    [("identity", False), ("floor:clock", False), ("baselines.identity:Identity", False), ("dso", True)],
)
def test_floors_have_no_rank_and_move_nobody(one_set: MadeResults, target: str, ranked: bool) -> None:
    one_set.add("other", {WINTER: made(2, 100, 0.001)}, target=target)
    board = one_set.board(metric="t_auc@0.5m")
    assert row(board, WINTER, "other").rank == (1 if ranked else None)
    assert row(board, WINTER, "good").rank == (2 if ranked else 1)


def test_a_right_position_with_a_wrong_rotation_gains_nothing(one_set: MadeResults) -> None:
    one_set.add("position", {WINTER: Made([0.0] * 100, [5.0] * 100)})
    board = one_set.board()
    assert board.metric.name == "recall@(0.25m,2deg)"
    assert (row(board, WINTER, "good").rank, row(board, WINTER, "position").rank) == (1, 2)
    for metric in ("recall@(0.25m,2deg)", "pose_auc@(0.5m,4deg)"):
        assert row(board, WINTER, "position").values[metric] == 0.0


def test_medians_of_one_pair_set_have_intervals(one_set: MadeResults, tmp_path: Path) -> None:
    found = row(one_set.board(), WINTER, "good")
    interval, value = found.intervals["median_translation_error_m"], found.values["median_translation_error_m"]
    assert interval is not None
    assert value is not None
    assert interval.low <= value <= interval.high


def test_what_a_method_assumes_stands_behind_its_name(one_set: MadeResults, tmp_path: Path) -> None:
    one_set.add("sails", {WINTER: made(2, 100, 0.3)}, assumes="a *calm* sea")
    page = page_of(one_set, tmp_path / "out")
    assert page.count(f"sails ({escaped('a *calm* sea')})") >= 2


def test_a_method_no_better_than_the_identity_is_named(one_set: MadeResults, tmp_path: Path) -> None:
    floor = made(2, 100, 0.3)
    one_set.add("identity", {WINTER: floor})
    one_set.add("idle", {WINTER: Made(list(reversed(floor.translation_m)), floor.rotation_deg)})
    page = page_of(one_set, tmp_path / "out")
    assert re.findall(r"^No significant gain over .*: (.*)\.$", page, re.MULTILINE) == ["`idle`"] * 2
    found = row(write_leaderboard(one_set.root, tmp_path / "out"), WINTER, "good")
    assert found.above_identity is not None
    assert found.above_identity.significant


@pytest.mark.parametrize(("interval", "named"), [(None, []), (Interval(-0.1, 0.1, 0.95), ["good"])])
def test_a_gain_that_cannot_be_tested_is_not_called_insignificant(
    one_set: MadeResults, interval: Interval | None, named: list[str]
) -> None:
    one_set.add("identity", {WINTER: made(2, 100, 0.3)})
    board = one_set.board()
    (dataset,), of_all = board.datasets, table(board, WINTER)
    gains = {"good": Difference(1.0, interval), "identity": None}
    rows = tuple(
        replace(row, above_identity=gains[row.method.label]) for row in of_all.rows if row.method.label in gains
    )
    assert level_with_identity(dataset, replace(of_all, rows=rows)) == named


@pytest.mark.parametrize(("sigma", "marked"), [(0.02, False), (0.06, True), (None, False)])
def test_thresholds_finer_than_two_sigma_have_a_dagger(tmp_path: Path, sigma: float | None, marked: bool) -> None:
    results = MadeResults(tmp_path / "results", {WINTER: 50}, sigma_m=sigma)
    results.write_dataset()
    results.add("mine", {WINTER: made(1, 50, 0.1)})
    page = page_of(results, tmp_path / "out")
    assert ("| recall@(0.1m,1deg), % † |" in page) == marked
    assert ("<sub>" in page.split("# How to read")[0]) == marked
    assert ("`recall@(0.1m,1deg)`." in page) == marked
    finer = read_csv(tmp_path / "out" / "leaderboard.csv")[0]["finer_than_truth"]
    assert ("recall@(0.1m,1deg)" in finer.split()) == marked
    assert "recall@(0.5m,5deg)" not in finer.split()
    assert "<sub>Small</sub> numbers with a dagger (†)" in page
    assert ("</sub>† |" in page) == marked


@pytest.mark.thorough
def test_the_first_page_is_short_and_begins_with_all_methods_on_all_datasets(tmp_path: Path) -> None:
    groups = ("over_5m", "2_to_5m", "under_1m", "1_to_2m")
    results = MadeResults(tmp_path / "results", {WINTER: 100, NIGHT: 100}, groups=groups)
    results.write_dataset()
    results.add("identity", {WINTER: made(2, 100, 0.8), NIGHT: made(3, 100, 0.8)})
    for number in range(9):
        spread = 0.05 if number < 2 else 0.4
        results.add(f"net-{number}", {name: made(number, 100, spread) for name in (WINTER, NIGHT)})
    board = results.board()
    page = front_page(replace(board, datasets=board.datasets * 5))
    assert len(page.encode()) < 15_000
    page = page.replace("\\", "")
    assert page.count("under_1m") == page.count("\n| rank | method |") == 5
    for line in page.splitlines():
        named = [name for name in re.findall(r"\w+(?=<br>\d+ pairs)", line) if name in groups]
        assert named in ([], ["under_1m", "1_to_2m", "2_to_5m", "over_5m"])
    head, *rows = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("|")][:12]
    assert head[0] == "method"
    assert [cells[0] for cells in rows[1:]][:2] == ["net-0 ³", "net-1 ³"]
    assert rows[-1][0] == "*identity* ³"
    assert rows[1][1] == f"{100 * (row(board, NIGHT, 'net-0').values[board.metric.name] or 0):.1f}"


def test_the_summary_of_many_datasets_has_a_row_for_each(one_set: MadeResults) -> None:
    board = one_set.board()
    page = front_page(replace(board, datasets=board.datasets * 3))
    link = f"[town@{TITLE.split('@')[1]}](sets/{TITLE.replace('@', '%40')}.md)"
    assert page.count(f"\n| {link}<br>winter<br>100 pairs |") == 3


def test_the_pages_link_each_other_and_their_pictures(one_set: MadeResults, tmp_path: Path) -> None:
    out = tmp_path / "out"
    (out / "sets").mkdir(parents=True)
    for name in ("gone@0123456789ab.md", "notes.md"):
        (out / "sets" / name).touch()
    write_leaderboard(one_set.root, out)
    pages = [out / "leaderboard.md", out / "reading.md", *(out / "sets").iterdir()]
    assert {page.name for page in pages} == {"leaderboard.md", "reading.md", f"{TITLE}.md", "notes.md"}
    links = [(page, link) for page in pages for link in re.findall(r"\]\(([^)]+)\)", page.read_text(encoding="utf-8"))]
    assert len(links) > 5
    assert all((page.parent / unquote(link)).exists() for page, link in links)


def test_the_first_page_says_what_it_shows(tmp_path: Path) -> None:
    results = MadeResults(tmp_path / "results", {SAME: 40}, sigma_m=0.3)
    results.write_dataset()
    results.add("mine", {SAME: made(1, 40, 0.1)})
    page = front_page(results.board())
    assert page.count("same drive") == 2
    assert "the ranks here are not to be relied on" in page
    assert "†: the threshold is finer than twice the standard deviation of the ground truth." in page
    exact = MadeResults(tmp_path / "exact", {SAME: 40}, sigma_m=0.06)
    exact.write_dataset()
    exact.add("mine", {SAME: made(1, 40, 0.1)})
    assert "†" not in front_page(exact.board()), "recall@(0.1m,1deg) is not shown"


def test_ranks_by_a_metric_with_a_dagger_come_with_a_warning(tmp_path: Path) -> None:
    results = MadeResults(tmp_path / "results", {WINTER: 50}, sigma_m=0.3)
    results.write_dataset()
    results.add("mine", {WINTER: made(1, 50, 0.1)})
    assert "the ranks here are not to be relied on" in page_of(results, tmp_path / "out")


def test_a_median_over_mostly_failed_pairs_is_inf(one_set: MadeResults, tmp_path: Path) -> None:
    errors = [0.01] * 40 + [np.inf] * 60
    one_set.add("shy", {WINTER: Made(errors, errors, broke=frozenset(range(90, 100)))})
    page = page_of(one_set, tmp_path / "out")
    found = dict(zip(cells(page, "## summer", "method"), cells(page, "## summer", "shy"), strict=True))
    assert [found[f"median_{error}"] for error in ("translation_error_m", "rotation_error_deg")] == ["inf", "inf"]
    assert (found["recall@(0.25m,2deg), %"], list(found.values())[-1]) == ("40.0", "50 / 10")
    line = next(r for r in read_csv(tmp_path / "out" / "leaderboard.csv") if r["method"] == "shy")
    assert line["median_translation_error_m"] == "inf"


def test_the_page_names_fingerprint_licence_rejected_pairs_and_machine(one_set: MadeResults, tmp_path: Path) -> None:
    page = page_of(one_set, tmp_path / "out")
    for fact in ("CC-BY-4.0", "100 pairs in 1 pair set; 3 more were rejected", "Test CPU, 2 cores", "0.840"):
        assert fact in page
    assert f"Fingerprint `{TITLE.split('@')[1]}" in page
    assert str(tmp_path) not in page


def test_every_table_of_the_page_has_as_many_cells_as_columns(tmp_path: Path) -> None:
    results = MadeResults(tmp_path / "results", {WINTER: 40, NIGHT: 40}, groups=("a|b", "step_2"))
    results.write_dataset()
    for seed in (0, 1):
        results.add(f"net-{seed}", {WINTER: made(seed, 40, 0.1)}, target="net", seed=seed, parameters={"x": "a|b"})
    width = 0
    for line in page_of(results, tmp_path / "out").replace("\\|", "").splitlines():
        count = line.count("|") if line.startswith("|") else 0
        assert count in (0, width) or width == 0, line
        width = count


def test_nothing_on_the_page_of_what_others_wrote_is_markup(tmp_path: Path) -> None:
    evil = "<script>x</script> [y](http://z) a|b\n# h"
    results = MadeResults(tmp_path / "results", {WINTER: 40}, groups=(evil, "plain"))
    results.write_dataset()
    path = results.folder / "dataset.yaml"
    values, _ = load_yaml_values(path, "a record")
    values["licence"] = values["pair_sets"][WINTER]["query_condition"] = evil
    write_text(path, dump_yaml(values))
    for seed in (0, 1):
        results.add(f"m{seed}", {WINTER: made(seed, 40, 0.1)}, target=evil, parameters={evil: evil, "seed": seed})
    outside = re.sub(r"```sh\n.*?\n```|(`+) ?.*?\1", "", page_of(results, tmp_path / "out"), flags=re.DOTALL)
    assert "\\<script\\>x" in outside
    assert not re.search(r"(?<!\\)<script|(?<!\\)\]\(http|^# h", outside, flags=re.MULTILINE)


def test_the_command_of_a_method_can_be_pasted_into_a_shell() -> None:
    run = RunRecord(
        method="mine",
        target="subprocess:./track --fast",
        parameters={"points": 5, "name": "a b", "off": None, "seed": 4},
        seed=4,
        dataset="town",
        fingerprint="0",
    )
    words = shlex.split(evaluate_command(run))
    assert words[words.index("--method") + 1] == "mine=subprocess:./track --fast"
    assert [w for w in words if w.startswith("mine.")] == ["mine.points=5", "mine.name=a b", "mine.off=null"]
    assert words[-2:] == ["--seed", "4"]
    outside = RunRecord(method="theirs", target="predictions:folder", dataset="town", fingerprint="0")
    assert evaluate_command(outside).endswith("--method theirs --predictions folder")


def run_command(*arguments: str) -> tuple[int, str, BaseException | None]:
    app = typer.Typer()
    app.command()(leaderboard)
    result = CliRunner().invoke(app, list(arguments))
    return result.exit_code, result.stdout, result.exception


def test_the_command_prints_a_table_or_json(one_set: MadeResults, tmp_path: Path) -> None:
    out = str(tmp_path / "out")
    code, text, _ = run_command(str(one_set.root), "--out", out)
    assert code == 0
    assert "good" in text
    assert "winter" in text
    code, text, _ = run_command(str(one_set.root), "--out", out, "--json", "--quiet")
    rows = json.loads(text)["rows"]
    assert code == 0
    assert {r["pair_set"] for r in rows} == {WINTER, "total"}
    assert rows[0]["rank"] == 1


def test_a_folder_without_results_is_a_users_mistake(tmp_path: Path) -> None:
    _, _, bad = run_command(str(tmp_path), "--out", str(tmp_path / "out"))
    assert isinstance(bad, PredictionError)
    assert not (tmp_path / "out").exists()


def test_one_datasets_folder_can_be_given_alone(one_set: MadeResults, tmp_path: Path) -> None:
    board = write_leaderboard(one_set.folder, tmp_path / "out")
    assert table(board, WINTER).pairs == 100
