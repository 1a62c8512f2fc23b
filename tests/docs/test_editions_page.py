"""The page of editions shows the recipe that is built."""

from __future__ import annotations

import editions
from repository import ROOT

from relocbench.datasets.importers.edition.dataset import recipe


def test_the_page_has_what_is_printed_from_the_recipe() -> None:
    page = (ROOT / "docs" / "editions.md").read_text().splitlines()
    printed = list(editions.lines(recipe("2026.1")))
    assert [line for line in printed if line not in page] == []
