"""``tools/recompute.py`` says of a published page whether it follows from predictions and truth."""

from __future__ import annotations

import shutil
from pathlib import Path

import archives
import pytest
import recompute
from command_line import relocbench
from repository import ROOT
from small_dataset import make_small_dataset

SMALL_DISTRICT = ("--steps", 3, "--size", "64x64", "--split", "validation", "-j", 1)


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset in ``data``, results on it, and a leaderboard with its predictions."""
    root = tmp_path_factory.mktemp("published")
    make_small_dataset(root / "data" / "small")
    asked = relocbench("evaluate", "-d", root / "data" / "small", "-m", "identity", "-o", root / "results", "-q")
    assert asked.status == 0, asked.err
    printed = relocbench("leaderboard", root / "results", "-d", root / "data", "--out", root / "board", "-q")
    assert printed.status == 0, printed.err
    archives.pack(root / "results", "small", "identity", root / "board" / "predictions" / "small" / "identity.tar.xz")
    return root


@pytest.mark.thorough
def test_pages_that_follow_from_predictions_are_equal_and_a_page_that_was_edited_is_not(
    published: Path, tmp_path: Path
) -> None:
    board = published / "board"
    found = list(recompute.from_predictions(board, published / "data", tmp_path / "a"))
    assert [(one.page, one.outcome) for one in found if one.outcome != "byte-equal"] == []
    (page,) = (board / "sets").glob("*.md")
    assert {"leaderboard.md", "leaderboard.csv", "errors.csv", f"sets/{page.name}"} <= {one.page for one in found}
    text = page.read_text()
    page.write_text(text.replace("identity", "idle", 1))
    line = text[: text.index("identity")].count("\n") + 1
    differing = [one for one in recompute.from_predictions(board, published / "data", tmp_path / "b") if one.differs]
    assert [(one.page, one.outcome) for one in differing] == [(f"sets/{page.name}", f"differs from line {line} on")]
    page.write_text(text)


@pytest.mark.thorough
def test_predictions_that_do_not_give_the_published_errors_are_told(published: Path, tmp_path: Path) -> None:
    forged = archives.unpack(published / "board" / "predictions", tmp_path / "forged")
    path = next(forged.rglob("*.txt"))
    lines = path.read_text().splitlines()
    columns = lines[-1].split()
    path.write_text("\n".join([*lines[:-1], " ".join([*columns[:2], "9.5", *columns[3:]])]) + "\n")
    board = tmp_path / "board"
    archives.pack(forged, "small", "identity", board / "predictions" / "small" / "identity.tar.xz")
    (finding,) = recompute.from_predictions(board, published / "data", tmp_path / "scratch")
    assert finding.differs
    assert path.name.removesuffix(".txt") in finding.outcome


def test_every_published_page_is_told_of_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    board = ROOT / "leaderboard"
    monkeypatch.setattr(recompute, "_run", lambda *_: None)
    monkeypatch.setattr(shutil, "copytree", lambda *_, **__: None)
    monkeypatch.setattr(recompute, "compared", lambda page, source, *_: recompute.Finding(page, source, ""))
    monkeypatch.setattr(
        recompute, "edition_again", lambda page, *_: recompute.Finding(str(page.relative_to(board)), "", "")
    )
    found = list(recompute.findings(board, tmp_path, None, False))
    pages = {str(path.relative_to(board)) for path in board.rglob("*.md")} - {"README.md", "LEDGER.md"}
    pages -= {"relocalization/retrieval.md"}  # told of with the page beside it, where there are predictions
    told = {one.page for one in found if one.page.endswith(".md")} - {"relocalization/retrieval.md"}
    assert told == pages
    unknown = "cannot be recomputed: neither predictions nor errors are published"
    assert [one.page for one in found if one.outcome.startswith(unknown)] == ["real/webcams_probe/probe.md"]


@pytest.mark.thorough
def test_the_pages_of_the_full_pipeline_follow_from_its_predictions(tmp_path: Path) -> None:
    words = ("-r", "oracle", "-r", "random", "-m", "identity", "--scratch", tmp_path / "a")
    recompute._run(
        "benchmarks/publish/relocalization.py", *SMALL_DISTRICT, *words, "--out", tmp_path / "relocalization"
    )
    found = list(recompute.relocalization(tmp_path, tmp_path / "b", True, *SMALL_DISTRICT))
    assert {one.page: one.outcome for one in found} == {
        f"relocalization/{name}": "byte-equal"
        for name in ("relocalization.csv", "relocalization.md", "retrieval.csv", "retrieval.md")
    }


def test_the_full_pipeline_is_not_recomputed_without_predictions_or_rendering(tmp_path: Path) -> None:
    (lacking,) = recompute.relocalization(tmp_path, tmp_path, True)
    assert lacking.outcome.startswith("cannot be recomputed")
    archive = tmp_path / "relocalization" / "predictions.tar.xz"
    archive.parent.mkdir()
    archive.touch()
    (untried,) = recompute.relocalization(tmp_path, tmp_path, False)
    assert untried.outcome.startswith("not recomputed")


def test_pages_of_retrieval_are_not_recomputed_without_ranks_or_rendering(tmp_path: Path) -> None:
    folder = tmp_path / "retrieval" / "real"
    folder.mkdir(parents=True)
    (folder / "retrieval.md").touch()
    (lacking,) = recompute.retrieval(tmp_path, tmp_path, None, True)
    assert (lacking.page, lacking.outcome[:20]) == ("retrieval/real/retrieval.md", "cannot be recomputed")
    (folder / "retrievers.tar.xz").touch()
    (untried,) = recompute.retrieval(tmp_path, tmp_path, None, False)
    assert untried.outcome.startswith("not recomputed: no --render")
