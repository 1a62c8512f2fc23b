"""Retrievers on walks: an image of the same number, or nearly, is right."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import walks
from made_places import picture
from refusals import assert_names, refused

from relocbench.errors import DatasetError

COUNT = 8


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two walks along places of other colours; the second one begins a place later."""
    for name, first in (("noon", 0), ("dusk", 1)):
        (tmp_path / name).mkdir()
        for number in range(COUNT):
            cv2.imwrite(str(tmp_path / name / f"{number:03d}.png"), picture(first + number, "satellite", 0))
    return tmp_path


def test_images_within_the_tolerance_are_right(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(walks, "FLOORS", ("colour-histogram",))
    found = {}
    for tolerance in (0, 1):
        monkeypatch.setattr(sys, "argv", ["walks.py", str(folder), "--tolerance", str(tolerance)])
        assert walks.main() == 0
        found[tolerance] = json.loads(capsys.readouterr().out.splitlines()[-1])["tasks"]
    assert set(found[0]) == {"noon-dusk", "dusk-noon"}
    assert found[0]["noon-dusk"]["colour-histogram"]["R@1"] <= 1 / COUNT  # the first place is not on the other walk
    assert found[1]["noon-dusk"]["colour-histogram"]["R@1"] >= 1 - 1 / COUNT
    assert found[1]["noon-dusk"]["chance"]["R@1"] == pytest.approx((6 * 3 + 2 * 2) / COUNT**2)


def test_walks_of_other_lengths_are_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "dusk" / "000.png").unlink()
    with refused(DatasetError, "", None, "dusk 7", "noon 8"):
        walks.walks(folder)
    monkeypatch.setattr(sys, "argv", ["walks.py", str(folder)])
    assert walks.main() == 2
    assert_names(capsys.readouterr().err, "", None, "dusk 7", "noon 8")


def test_numbers_beyond_the_walk_are_no_place() -> None:
    files = [Path(f"{number}.png") for number in range(4)]
    relevance = walks.task("a-b", files, files, tolerance=2).relevance
    assert [relevance.of(query).tolist() for query in (0, 3)] == [[0, 1, 2], [1, 2, 3]]
    assert np.all(relevance.positives == [3, 4, 4, 3])
