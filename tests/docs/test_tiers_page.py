"""The page of tiers counts the pairs of recordings as their published errors do."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import archives
import pandas as pd
from repository import ROOT

from relocbench.metrics.pose.tiers import MEASURES, TIERS, tiers

BOARD = ROOT / "leaderboard"


def counted(errors: pd.DataFrame) -> list[int]:
    found = tiers(*errors[list(MEASURES)].to_numpy(float).T)
    return [int((found == tier).sum()) for tier in range(len(TIERS))]


def test_pairs_of_recordings_are_of_the_tiers_that_the_page_says(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "tiers.md").read_text()
    shown: dict[str, Counter[int]] = {}
    for name, cells in re.findall(r"^\| `(\w+)`:? [^|]*((?:\| \d+ ){4})", page, re.MULTILINE):
        shown.setdefault(name, Counter()).update(dict(enumerate(map(int, re.findall(r"\d+", cells)))))
    published = pd.read_csv(BOARD / "errors.csv")
    sets = published[published["method"] == "identity"].groupby("dataset")
    expected = {str(name): counted(rows) for name, rows in sets if name != "town_demo"}
    apart = archives.unpack(BOARD / "real" / "predictions", tmp_path, "identity")
    expected["michigan"] = counted(pd.read_csv(next(apart.rglob("*.errors.csv"))))
    assert {name: list(count.values()) for name, count in shown.items()} == expected
