"""What others wrote is shown in tables and pictures, and nothing of it acts."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from made_results import WINTER, MadeResults, made
from matplotlib.figure import Figure

from relocbench.files import dump_yaml, json_text, load_yaml_values, write_text
from relocbench.leaderboard import load_results, write_leaderboard
from relocbench.leaderboard.common.text import cell
from relocbench.pages.figures import png_of

FORMULAS = ["=1+1", "+1+1", "-1+1", "@SUM(A1)", "\t=1", "\r=1", "\n=1", " =1", "'=1", '"=1', "＝1", "-", "=HYPERLINK()"]


@pytest.mark.parametrize("text", FORMULAS)
def test_a_cell_that_a_spreadsheet_would_compute_is_text(text: str) -> None:
    assert cell(text) == f"'{text}"


@pytest.mark.parametrize("text", ["-0.5", "+3", "1e-5", "-.5e3", "plain", "a=b", "x@y", "", "2-1"])
def test_numbers_and_plain_text_stay_as_they_are(text: str) -> None:
    assert cell(text) == text
    assert [cell(-0.5), cell(-3), cell(None)] == ["-0.5", -3, ""]


def test_no_table_of_a_board_holds_a_formula_of_somebody_else(tmp_path: Path) -> None:
    results = MadeResults(tmp_path / "results", {WINTER: 12}, groups=("=1+1", "@x"))
    results.write_dataset()
    path = results.folder / "dataset.yaml"
    values, _ = load_yaml_values(path, "a record")
    values["pair_sets"][WINTER]["query_condition"] = '=HYPERLINK("http://x")'
    write_text(path, dump_yaml(values))
    for seed in (0, 1):
        results.add(f"+cmd{seed}", {WINTER: made(seed, 12, 0.2)}, target="@evil", seed=seed, parameters={"seed": seed})
    write_leaderboard(tmp_path / "results", tmp_path / "board")
    for name in ("leaderboard.csv", "errors.csv", "seeds.csv"):
        with (tmp_path / "board" / name).open(newline="", encoding="utf-8") as stream:
            cells = {text for line in csv.reader(stream) for text in line}
        assert not [text for text in cells if text[:1] in "=+@\t" and text], name
        assert "'=1+1" in cells
    # The results themselves hold what was said, to the letter.
    assert load_results(tmp_path / "results")[0].methods[0].errors[WINTER].group_names == ("=1+1", "@x")


def test_what_json_does_not_know_stands_as_text() -> None:
    import datetime

    circle: list[object] = []
    circle.append(circle)
    shown = json_text({1: datetime.date(2024, 1, 2), "huge": 16**5000, None: float("nan"), "deep": circle})
    assert '"1": "2024-01-02"' in shown
    assert "..." in shown


def test_a_picture_shows_names_that_would_be_formulas() -> None:
    def draw(figure: Figure) -> None:
        figure.suptitle("_$\\frac{$")

    assert png_of((2, 1), draw, dpi=50).startswith(b"\x89PNG")
