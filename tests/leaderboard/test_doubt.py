"""Doubt about a set's truth: found where images are apart at the true pose, and carried to every board."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_results import WINTER, MadeResults, made
from small_dataset import ACROSS, WITHIN, make_small_dataset

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.inspect.agreement import ImageAgreement, Verdict
from relocbench.leaderboard import make_board
from relocbench.leaderboard.boards import Boards
from relocbench.leaderboard.html.site import write_site
from relocbench.leaderboard.tracking import doubt
from relocbench.leaderboard.tracking.doubt import TruthCheck, check_truth
from relocbench.leaderboard.tracking.front_page import front_page
from relocbench.leaderboard.tracking.set_page import set_page
from relocbench.progress import Silent

APART = TruthCheck(compared=6, agree=1, apart=5, apart_px=2.013, width_px=640)


def found_in(verdicts: dict[Verdict, float]) -> Callable[..., ImageAgreement]:
    """Measures the verdicts in turn, again and again."""
    turn = iter([*verdicts.items()] * 100)

    def measure(*_: object) -> ImageAgreement:
        verdict, px = next(turn)
        return ImageAgreement(verdict, 9, 5, px, (px, 0.0), "")

    return measure


def test_a_set_is_in_doubt_where_most_pairs_that_can_be_told_are_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_small_dataset(tmp_path / "d")
    dataset = Dataset(tmp_path / "d")
    monkeypatch.setattr(doubt, "measure_agreement", found_in({"apart": 4.0, "cannot tell": np.nan}))
    check = check_truth(dataset, [ACROSS], Silent())[ACROSS]
    assert (check.agree, check.apart > 1, check.apart_px, check.width_px) == (0, True, 4.0, 96)
    assert check.in_doubt
    monkeypatch.setattr(doubt, "measure_agreement", found_in({"agree": 0.1, "apart": 4.0}))
    assert not check_truth(dataset, [WITHIN], Silent())[WITHIN].in_doubt
    image = next((tmp_path / "d").glob("traversals/*/images/*/*.png"))
    image.write_bytes(b"")
    told: list[str] = []
    reporter = Silent()
    monkeypatch.setattr(reporter, "note", told.append, raising=False)
    monkeypatch.setattr(doubt, "measure_agreement", found_in({"agree": 0.1}))
    check_truth(Dataset(tmp_path / "d"), [WITHIN, ACROSS], reporter)
    assert any(image.name in line for line in told)


def test_one_pair_apart_is_no_doubt_and_an_exact_truth_is_not_compared(tmp_path: Path) -> None:
    assert not replace(APART, agree=0, apart=1).in_doubt
    make_small_dataset(tmp_path, sigma_translation_m=0.0)
    assert check_truth(Dataset(tmp_path), [ACROSS], Silent()) == {}


def test_every_board_marks_a_set_in_doubt_and_says_by_how_much(tmp_path: Path) -> None:
    results = MadeResults(tmp_path / "results", {WINTER: 20})
    results.write_dataset()
    results.add("good", {WINTER: made(1, 20, 0.05)})
    entry = results.board().datasets[0].entry
    board = make_board([replace(entry, truth_checks={WINTER: APART})])
    site = write_site(Boards(board), tmp_path / "html").parent
    pages = [(site / "index.html").read_text(), next(site.glob("set-*.html")).read_text()]
    for page in (front_page(board), set_page(board, board.datasets[0]), *pages):
        assert "truth in doubt" in page
        assert "5 of 6" in page
        assert "2.0 px" in page
