"""``tools/check_docs.py`` finds links to files and headings that do not exist."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import pytest
from repository import ROOT


def load_tool() -> Any:
    spec = importlib.util.spec_from_file_location("check_docs", ROOT / "tools" / "check_docs.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


tool = load_tool()


@pytest.mark.parametrize(
    ("heading", "on_github", "on_site"),
    [
        ("The generic folder", "the-generic-folder", "the-generic-folder"),
        ("`pairs.csv`, and more", "pairscsv-and-more", "pairscsv-and-more"),
        ("rain → sun", "rain--sun", "rain-sun"),
        ("Größe", "größe", "groe"),
        ("18. A *place* is [verified](x.md)", "18-a-place-is-verified", "18-a-place-is-verified"),
        ("T_query_ref", "t_query_ref", "t_query_ref"),
    ],
)
def test_a_heading_has_the_anchors_of_github_and_of_the_site(heading: str, on_github: str, on_site: str) -> None:
    text = tool._plain(heading)
    assert (tool.github_slug(text), tool.site_slug(text)) == (on_github, on_site)


def test_a_link_needs_its_file_and_its_heading(tmp_path: Path) -> None:
    (tmp_path / "a b.md").write_text('# Title\n\n## Twice\n\n## Twice\n\n```\n# no heading\n```\n\n<a id="mark"></a>\n')
    page = tmp_path / "page.md"
    right = "[x](a%20b.md#title) [x](a%20b.md#twice-1) [x](a%20b.md#mark) [x](#here) [two\nlines](a%20b.md#twice)"
    page.write_text(
        f"# Here\n\n{right}\n\n```\n[x](none.md)\n```\n`[x](none.md)` <https://x.y/#z> [x](https://x.y#z)\n"
    )
    assert list(tool.dead_links(page)) == []
    page.write_text(
        "# Here\n\n[x](none.md) [x](a%20b.md#no-heading)\n[over\ntwo lines](a%20b.md#twice-2) [x](#there)\n"
    )
    faults = list(tool.dead_links(page))
    assert [fault.split(":")[1] for fault in faults] == ["3", "3", "5", "5"]
    assert faults[0].endswith("link to 'none.md', which does not exist")
    assert "link to 'a%20b.md#no-heading': " in faults[1]
    assert all(fault.endswith("has no such heading") for fault in faults[1:])


def test_a_page_of_the_site_needs_anchors_that_hold_there_and_on_github(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# Rain → sun\n\n# Plain\n\n# Plain\n")
    assert tool.anchors(page, on_site=False) == {"rain--sun", "plain", "plain-1"}
    assert tool.anchors(page, on_site=True) == {"plain"}
