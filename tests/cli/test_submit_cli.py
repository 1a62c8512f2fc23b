"""``submit-check`` and ``leaderboard add`` as a user meets them: statuses, JSON, mistakes in one line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import relocbench
from small_dataset import ACROSS, make_small_dataset
from submissions import submit

from relocbench.datasets.core.dataset import Dataset


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("town") / "ds", frames=3, size=(24, 18))


def test_status_0_1_and_2(town: Dataset, tmp_path: Path) -> None:
    root = submit(tmp_path / "s", town)
    assert relocbench("submit-check", root, "-d", town.root).status == 0
    (root / town.name / f"{ACROSS}.txt").write_text("1 2\n")
    outcome = relocbench("submit-check", root, "-d", town.root, "-q")
    assert outcome.status == 1
    assert outcome.err == ""
    assert f"{ACROSS}.txt:1: unknown pair 1 2" in outcome.out
    for words, told in (
        ((root,), "give --dataset FOLDER"),
        ((), "nothing to check"),
        ((tmp_path / "none", "-d", town.root), "no such folder"),
        ((root, "-d", tmp_path), "dataset"),
        ((root, "-d", root), "is the submission itself"),
        ((root, "-d", town.root, "--new", tmp_path / "n"), "give it alone"),
        ((root, "-d", town.root, "--radius", 0), "--radius is 0"),
    ):
        outcome = relocbench("submit-check", *words)
        assert outcome.status == 2
        assert told in outcome.complaint


def test_json_has_what_is_printed(town: Dataset, tmp_path: Path) -> None:
    root = submit(tmp_path / "s", town)
    found = json.loads(relocbench("submit-check", root, "-d", town.root, "--json", "-q").out)
    assert (found["valid"], found["faults"], found["suspicions"]) == (True, [], [])
    assert {row["missing"] for row in found["answers"]} == {0}
    added = json.loads(relocbench("leaderboard", "add", root, "--to", tmp_path / "r", "-d", town.root, "--json").out)
    assert [row["state"] for row in added["rows"]] == ["added"]
    (root / "card.yaml").write_text("label: x\n")
    outcome = relocbench("leaderboard", "add", root, "--to", tmp_path / "r", "-d", town.root, "--json", "-q")
    assert (outcome.status, json.loads(outcome.out)["rows"]) == (1, [])


def test_many_faults_of_a_file_are_counted(town: Dataset, tmp_path: Path) -> None:
    root = submit(tmp_path / "s", town)
    (root / town.name / f"{ACROSS}.txt").write_text("".join(f"{n} 2\n" for n in range(1, 1001)))
    outcome = relocbench("submit-check", root, "-d", town.root)
    assert f"{ACROSS}.txt: 900 more faults (--json has all)" in outcome.out
    assert len(json.loads(relocbench("submit-check", root, "-d", town.root, "--json").out)["faults"]) >= 1000


def test_a_template_is_not_written_over_a_card(tmp_path: Path) -> None:
    assert relocbench("submit-check", "--new", tmp_path / "s").status == 0
    (tmp_path / "s" / "card.yaml").write_text("mine")
    outcome = relocbench("submit-check", "--new", tmp_path / "s")
    assert (outcome.status, "exists already" in outcome.complaint) == (2, True)
    assert (tmp_path / "s" / "card.yaml").read_text() == "mine"


def test_leaderboard_keeps_its_form_and_add_is_a_command_of_its_own(
    town: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert relocbench("leaderboard", "add", submit(tmp_path / "s", town), "--to", "add", "-d", town.root).status == 0
    assert relocbench("leaderboard", "./add", "--out", "board", "-q").status == 0
    assert (tmp_path / "board" / "leaderboard.md").exists()
    assert "leaderboard add" in relocbench("--help").out
    assert "--replace" in relocbench("leaderboard", "add", "--help").out
    assert "--replace" not in relocbench("leaderboard", "--help").out
    outcome = relocbench("leaderboard", "add", "--out", "board")
    assert (outcome.status, "leaderboard add --help" in outcome.complaint) == (2, True)
