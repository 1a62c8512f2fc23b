"""Recording -> dataset -> predictions -> scores -> leaderboard, by the commands a user types."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from statistics import median

import pytest
from command_line import relocbench

from relocbench.evaluation.common.results import all_results
from relocbench.evaluation.tables.errors import ErrorTable, read_errors

pytestmark = pytest.mark.usefixtures("towns_kept")
METHODS = ("-m", "identity", "-m", "orb-pnp", "-m", "dso")


def run(*arguments: object) -> str:
    outcome = relocbench(*arguments)
    assert outcome.status == 0, outcome.err
    return outcome.out


def errors_by_method(results: Path) -> dict[str, ErrorTable]:
    (folder,) = all_results(results)
    (pair_set,) = folder.record.pair_sets
    return {m.label: read_errors(m.errors(pair_set)) for m in folder.methods()}


def medians(rows: ErrorTable, *groups: str) -> tuple[float, float]:
    """(metres, degrees) over all pairs of the groups, failed ones included."""
    chosen = [r for r in rows if r.group in groups]
    assert chosen
    return median(r.translation_error_m for r in chosen), median(r.rotation_error_deg for r in chosen)


def board_rows(board: Path) -> list[dict[str, str]]:
    with (board / "leaderboard.csv").open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.thorough
def test_the_whole_line_on_a_small_rendered_town(tmp_path: Path) -> None:
    dataset, results, board = tmp_path / "d", tmp_path / "r", tmp_path / "b"
    built = json.loads(run("build-dataset", "synthetic", "--preset", "smoke", "--out", dataset, "--json"))
    assert "no fault" in run("validate", dataset)
    run("evaluate", "-d", dataset, *METHODS, "--out", results, "-q")
    run("leaderboard", results, "--out", board, "-q")
    rows = board_rows(board)
    assert {r["method"] for r in rows} == {"identity", "orb-pnp", "dso"}
    assert {r["fingerprint"] for r in rows} == {built["fingerprint"]}
    page = (board / "leaderboard.md").read_text()
    assert built["fingerprint"][:12] in page
    again = tmp_path / "b2"
    run("evaluate", "-d", dataset, *METHODS, "--out", results, "-q")
    run("leaderboard", results, "--out", again, "-q")
    for path in sorted(p for p in board.rglob("*") if p.is_file()):
        assert (again / path.relative_to(board)).read_bytes() == path.read_bytes(), path.name
