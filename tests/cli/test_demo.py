"""The demo on a tiny street: what it prints is what its leaderboard says, and its picture and page are there."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import Outcome, relocbench
from refusals import Notes, assert_names
from repository import ROOT

from relocbench.cli.commands import demo
from relocbench.datasets.synthetic.renderer.revision import RENDERER_REVISION

pytestmark = pytest.mark.usefixtures("towns_kept")
METHODS = ("identity", "orb-pnp")
TINY = {"conditions": ("Sunny", "Night"), "size": "96x72", "steps": 3, "extent": 190.0}


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> tuple[Outcome, Path]:
    out = tmp_path_factory.mktemp("demo") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demo, "_STREET", {**demo._STREET, **TINY})
        patch.setattr(demo, "_METHODS", METHODS)
        patch.setenv("TORCH_HOME", str(out.parent / "no-weights"))
        return relocbench("demo", "--out", out, "--workers", 1), out


def board_of(out: Path) -> list[dict[str, str]]:
    with (out / "leaderboard" / "leaderboard.csv").open(newline="") as stream:
        return [
            row for row in csv.DictReader(stream) if row["group"] == "all" and not row["pair_set"].startswith("tot")
        ]


@pytest.mark.thorough
def test_the_summary_has_the_shares_of_the_leaderboard(ran: tuple[Outcome, Path]) -> None:
    ended, out = ran
    assert ended.status == 0, ended.err
    shares = {
        (row["method"], row["pair_set"].split("__")[1]): f"{100 * float(row['recall@(0.25m,2deg)']):.1f}"
        for row in board_of(out)
    }
    assert len(shares) == 4
    lines = [[cell.strip() for cell in line.split("│")[1:-1]] for line in ended.out.splitlines() if line[:1] == "│"]
    printed = {cells[0]: cells[1:] for cells in lines}
    assert printed == {m: [shares[m, "test-Sunny-0"], shares[m, "test-Night-0"]] for m in METHODS}
    assert list(printed) == ["orb-pnp", "identity"]  # the floor last
    assert ended.out.splitlines()[0].endswith("Map: sunny, summer, morning")


@pytest.mark.thorough
def test_the_picture_is_written(ran: tuple[Outcome, Path]) -> None:
    ended, out = ran
    picture = out / "demo.png"
    assert f"picture: {picture}" in ended.out.splitlines()
    image = cv2.imread(str(picture))
    assert image is not None
    assert image.shape[1] == 1760
    assert image.std() > 20


@pytest.mark.thorough
def test_the_last_line_names_the_page(ran: tuple[Outcome, Path]) -> None:
    ended, out = ran
    word, page = ended.out.splitlines()[-1].split(": ")
    assert word == "page"
    assert Path(page) == out / "leaderboard" / "html" / "index.html"
    assert "orb-pnp" in Path(page).read_text()


@pytest.mark.thorough
def test_a_folder_that_holds_something_else_is_refused_before_any_work(
    ran: tuple[Outcome, Path], tmp_path: Path
) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    for folder in (tmp_path, ran[1] / "dataset", ran[1] / "dataset" / "inside"):
        ended = relocbench("demo", "--out", folder)
        assert ended.status == 2
        assert_names(ended.complaint, folder)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


SHOWN = ROOT / "docs" / "images" / "demo.txt"


def test_the_picture_of_the_readme_is_of_the_street_that_the_demo_renders() -> None:
    """Else run the demo with the weights of aliked-pnp, and keep its picture and what it prints beside each other."""
    _, made_of, title, *_ = SHOWN.read_text(encoding="utf-8").splitlines()
    assert made_of == f"street {json.dumps(demo._STREET)}, renderer {RENDERER_REVISION}"
    assert title.startswith("demo: pairs found within 0.25 m and 2°")


@pytest.mark.thorough
def test_weights_that_are_not_installed_are_one_note_which_says_how_to_get_them(ran: tuple[Outcome, Path]) -> None:
    notes = [line for line in ran[0].err.splitlines() if "aliked-pnp" in line]
    assert len(notes) == 1
    assert notes[0].endswith("relocbench fetch-weights aliked-pnp")


def test_methods_run_where_what_they_need_is_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from relocbench.methods import parse_method
    from relocbench.methods.fetching import published_files

    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    monkeypatch.setattr(demo, "_METHODS", ("identity", "absent"))
    for path in published_files(parse_method("aliked-pnp")):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(np.zeros(1).tobytes())
    notes = Notes()
    assert demo._able(notes) == ("identity", "aliked-pnp")
    assert len(notes.notes) == 1
    assert notes.notes[0].startswith("absent is left out: ")
