"""The page of editions shows the recipe that is built."""

from __future__ import annotations

import re

import editions
from repository import ROOT

from relocbench.datasets.importers.edition.dataset import recipe


def test_the_page_has_what_is_printed_from_the_recipe() -> None:
    page = (ROOT / "docs" / "editions.md").read_text().splitlines()
    printed = list(editions.lines(recipe("2026.1")))
    assert [line for line in printed if line not in page] == []


def test_the_recipe_expects_the_questions_that_published_results_were_asked() -> None:
    page = (ROOT / "leaderboard" / "edition" / "2026.1-test.md").read_text()
    published = re.findall(r"^\| (\w+) \| 12 \| \d+ \| `([0-9a-f]{64})` \|$", page, re.MULTILINE)
    assert recipe("2026.1").questions["test"] == dict(published)
