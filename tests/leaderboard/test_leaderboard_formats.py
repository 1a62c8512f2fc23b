"""The formats of a leaderboard: which files each writes, tables for papers, and one name for a number in all."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import relocbench
from hypothesis import given
from hypothesis import strategies as st
from latex_parser import check_latex
from made_results import NIGHT, WINTER, MadeResults, made, read_csv
from refusals import assert_names

from relocbench.leaderboard.common.columns import Column
from relocbench.leaderboard.common.latex import LatexTable, document, escaped
from relocbench.leaderboard.tracking.latex import latex_page
from relocbench.metrics import Interval

NASTY = r"a_b%c#d&e$f{g}h\i^j~k--l[m]n*o" + "'`" + '"<>|° → †'


@pytest.fixture
def results(tmp_path: Path) -> Path:
    made_results = MadeResults(tmp_path / "results", {WINTER: 60, NIGHT: 60})
    made_results.write_dataset()
    made_results.add("good", {WINTER: made(1, 60, 0.05), NIGHT: made(2, 60, 0.05)})
    made_results.add("under_score", {WINTER: made(3, 60, 2.0), NIGHT: made(4, 60, 2.0)})
    return made_results.root


def written(results: Path, out: Path, *options: str) -> list[str]:
    done = relocbench("leaderboard", results, "--out", out, "-q", *options)
    assert done.status == 0, done.err
    return sorted(str(path.relative_to(out)) for path in out.rglob("*") if path.is_file())


def test_each_format_writes_its_files_and_no_others(results: Path, tmp_path: Path) -> None:
    csv, markdown = ["errors.csv", "leaderboard.csv"], ["leaderboard.md", "reading.md"]
    usual = written(results, tmp_path / "usual")
    page = next(name for name in usual if name.startswith("sets/"))
    assert usual == sorted([*csv, *markdown, page])
    assert written(results, tmp_path / "csv", "--format", "csv") == csv
    assert written(results, tmp_path / "md", "--format", "markdown") == sorted([*markdown, page])
    assert written(results, tmp_path / "tex", "--format", "latex") == ["leaderboard.tex"]
    both = written(results, tmp_path / "both", "--format", "latex", "--format", "csv", "--format", "csv")
    assert both == sorted([*csv, "leaderboard.tex"])
    for name in csv:
        assert (tmp_path / "usual" / name).read_bytes() == (tmp_path / "csv" / name).read_bytes()


def test_an_unknown_format_is_refused_before_anything_is_written(results: Path, tmp_path: Path) -> None:
    done = relocbench("leaderboard", results, "--out", tmp_path / "b", "--format", "docx")
    assert done.status == 2
    assert_names(done.complaint, "", None, "--format", "docx", "csv", "markdown", "latex", "html")
    assert not (tmp_path / "b").exists()


def test_json_counts_rows_sets_and_files(results: Path, tmp_path: Path) -> None:
    done = relocbench("leaderboard", results, "--out", tmp_path / "b", "--format", "csv", "--json", "-q")
    told = json.loads(done.out)
    assert told["counts"] == {"files_written": 2, "pair_sets": 2, "rows": len(told["rows"])}
    assert [Path(name).name for name in told["files"]] == ["leaderboard.csv", "errors.csv"]
    assert told["formats"] == ["csv"]


def test_json_counts_all_files_of_the_pages_in_html(results: Path, tmp_path: Path) -> None:
    done = relocbench("leaderboard", results, "--out", tmp_path / "b", "--format", "html", "--json", "-q")
    told = json.loads(done.out)
    there = {str(path) for path in (tmp_path / "b").rglob("*") if path.is_file() and path.name[0] != "."}
    there.remove(str(tmp_path / "b" / "html" / "files.txt"))  # the list of these files
    assert set(told["files"]) == there
    assert told["counts"]["files_written"] == len(there) == len(told["files"])
    assert Path(told["files"][0]).name == "index.html"


def test_nothing_is_written_into_a_dataset(results: Path, tmp_path: Path) -> None:
    for name in ("dataset.yaml", "manifest.csv"):
        (tmp_path / name).touch()
    for out in (tmp_path, tmp_path / "new" / "board"):
        done = relocbench("leaderboard", results, "--out", out)
        assert (done.status, "--out lies inside the dataset" in done.complaint) == (2, True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dataset.yaml", "manifest.csv", "results"]


def test_a_number_has_one_name_in_markdown_latex_and_csv_and_the_terminal_begins_with_the_matrix(
    results: Path, tmp_path: Path
) -> None:
    done = relocbench(
        "leaderboard", results, "--out", tmp_path, "--format", "csv", "--format", "markdown",
        "--format", "latex",
    )  # fmt: skip
    names = set(read_csv(tmp_path / "leaderboard.csv")[0])
    page = next((tmp_path / "sets").iterdir()).read_text(encoding="utf-8")
    rows = re.findall(r"^\| rank \| method \|(.*)\|$", page + (tmp_path / "leaderboard.md").read_text(), re.MULTILINE)
    in_markdown = {cell.strip(" †") for row in rows for cell in row.split("|")}
    (first, *_) = check_latex((tmp_path / "leaderboard.tex").read_text())
    in_latex = {re.sub(r" \$.*", "", cell).replace("\\", "") for cell in first[0]}
    for shown in (in_markdown, in_latex):
        assert {"recall@(0.25m,2deg), %", "coverage, %", "median_translation_error_m"} <= shown
        for text in shown:
            assert set(text.removesuffix(", %").split(" / ")) <= names | {"declined", "crashed"}, text
    title, matrix, *totals = re.findall(r"^[^┏┃┡│└]+$|^┃ method.*$", done.out, re.MULTILINE)
    assert "0.25 m and 2°" in title
    assert "median" not in matrix
    assert any("median m" in heading for heading in totals)


def test_latex_has_the_best_in_bold_ranks_and_intervals_in_small_print(results: Path, tmp_path: Path) -> None:
    written(results, tmp_path / "tex", "--format", "latex")
    text = (tmp_path / "tex" / "leaderboard.tex").read_text()
    tables = check_latex(text)
    assert len(tables) == 3
    for table in tables:
        heads, good, other = table
        assert heads[:2] == ["method", "rank"]
        assert (good[0], good[1], other[0], other[1]) == ("good", "1", r"under\_score", "2")
        assert good[2].startswith(r"\textbf{100.0}")
        assert r"\scriptsize" in other[2]
        assert "textbf" not in other[2]
    assert r"recall@(0.25m,2deg), \%: share of all pairs" in text
    assert "Shares are in percent." in text


def table_of(*lines: dict[str, Any], of: str = "t", head: str = "method", column: str = "a", words: str = "") -> str:
    """The LaTeX of a table with a share and a length; a line says also whether it is ``out`` of competition."""
    return document(
        [
            LatexTable(
                of=of,
                place=of,
                names=[Column(head, lambda line: line["name"])],
                rank=Column("rank", lambda line: line.get("rank")),
                columns=[
                    Column(
                        column,
                        lambda line: line.get("share"),
                        "share",
                        bounds=lambda line: line.get("interval"),
                        definition=words,
                        higher_is_better=True,
                    ),
                    Column("b_m", lambda line: line.get("length"), "m", higher_is_better=False),
                ],
                lines=lines,
                competes=lambda line: not line.get("out"),
                metric=column,
                note=words,
            )
        ]
    )


def test_equal_numbers_are_bold_alike_and_floors_infinities_and_gaps_never() -> None:
    lines: list[dict[str, Any]] = [
        {"name": "one", "rank": 1, "share": 0.5001, "length": np.inf, "interval": Interval(0.4, 0.6, 0.95)},
        {"name": "two", "rank": 1, "share": 0.5002, "length": np.inf},
        {"name": "none"},
        {"name": "floor", "share": 0.9, "length": 0.1, "out": True},
    ]
    ((_, one, two, none, floor),) = check_latex(table_of(*lines))
    assert one[2:] == [r"\textbf{50.0} {\scriptsize {[}40.0, 60.0{]}}", r"$\infty$"]
    assert two[2:] == [r"\textbf{50.0}", r"$\infty$"]
    assert none[1:] == ["", "", ""]
    assert "In italics, what is not ranked." in table_of(*lines)
    assert "italics" not in table_of(*lines[:3])
    assert floor == [r"\textit{floor}", "", "90.0", "0.100"]


@given(st.text(max_size=40))
def test_any_text_is_shown_and_never_acts(text: str) -> None:
    ((heads, row),) = check_latex(table_of({"name": text, "rank": 1, "share": 1.0}, of=text, head=text, words=text))
    assert row[0] == escaped(text)
    assert len(heads) == 4


def test_what_the_fonts_lack_and_what_they_would_join_is_written_otherwise() -> None:
    assert escaped("Ħ ł ß 東 ſ") == "? ł ß ? ?"
    assert escaped("a,,b ,,, --- 'x'") == "a,{},b ,{},{}, -{}-{}- {'}x{'}"


def test_labels_of_names_that_differ_in_signs_alone_are_told_apart(tmp_path: Path) -> None:
    names = [f"{name}__{name}__cam" for name in ("a", "a-b", "a+b")]
    made_results = MadeResults(tmp_path / "results", dict.fromkeys(names, 20))
    made_results.write_dataset()
    made_results.add("good", {name: made(1, 20, 0.05) for name in names})
    text = latex_page(made_results.board())
    check_latex(text)
    labels = re.findall(r"label{(.*)}", text)
    assert labels[-1] == f"{labels[-2]}:2"


def test_names_with_special_characters_compile(tmp_path: Path) -> None:
    line = {"name": NASTY, "rank": 1, "share": 1.0, "interval": Interval(0.9, 1.0, 0.95)}
    text = table_of(line, of=NASTY, head=NASTY, column=NASTY, words=NASTY)
    check_latex(text)
    compiler = shutil.which("pdflatex") or shutil.which("tectonic")
    if compiler is None:
        pytest.skip("no LaTeX is installed: the strict reader has read it")
    (tmp_path / "t.tex").write_text(
        "\\documentclass{article}\\usepackage{booktabs,graphicx,textcomp}\\usepackage[T1]{fontenc}\n"
        f"\\begin{{document}}\n{text}\n\\end{{document}}\n"
    )
    options = ["-interaction=nonstopmode", "-halt-on-error"] if "pdflatex" in compiler else []
    done = subprocess.run([compiler, *options, "t.tex"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
