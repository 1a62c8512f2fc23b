"""Every published page has a command that makes it again, and what decides it exists."""

from __future__ import annotations

import re
import subprocess

import published
import pytest
from repository import ROOT


def test_every_published_page_is_listed_with_what_decides_it() -> None:
    listed = {page.path for page in published.PAGES}
    here = {str(path.relative_to(ROOT)) for path in (ROOT / "leaderboard").rglob("*.md")}
    beside = {"leaderboard/README.md", "leaderboard/LEDGER.md", "leaderboard/relocalization/retrieval.md"}
    beside |= {"leaderboard/retrieval/real/lpn_configurations.md", "leaderboard/reading.md"}
    beside |= {"leaderboard/retrieval/frozen/real/lpn_configurations.md"}
    with_the_board = {path for path in here if path.startswith("leaderboard/sets/")}
    assert with_the_board
    assert here - beside - with_the_board == listed
    for page in published.PAGES:
        assert all((ROOT / path).exists() for path in page.decided_by)
        target = page.command.split()[1]
        assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.MULTILINE)


def test_the_table_says_what_changed_since() -> None:
    try:
        text = published.table()
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("no repository with its history")
    assert text.count("\n") == 1 + len(published.PAGES)
    assert published.on_page_markdown(f"before {published.PLACE} after") == f"before {text} after"
    assert published.on_page_markdown("nothing") == "nothing"
