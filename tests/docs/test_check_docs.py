"""``tools/check_docs.py`` finds links to files and headings that do not exist."""

from __future__ import annotations

from pathlib import Path

import check_docs as tool
import pytest


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


def test_blocks_come_with_their_language_their_file_and_their_line(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        '# T\n\n```python title="a.py"\nx = 1\n```\n\n```bash\nrelocbench methods \\\n  --json\n# ```\n```\n'
    )
    one, other = tool.code_blocks(page)
    assert (one.language, one.title, one.line, one.lines) == ("python", "a.py", 4, ("x = 1",))
    assert (other.language, other.title, other.line) == ("bash", "", 8)
    assert [line for line, _ in tool.commands(page)] == [8]


def test_a_page_may_have_so_many_words_and_no_more(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("word " * tool.MOST_WORDS)
    assert list(tool.too_long(page)) == []
    page.write_text("word " * (tool.MOST_WORDS + 1))
    (fault,) = tool.too_long(page)
    assert str(tool.MOST_WORDS + 1) in fault


def test_a_named_test_needs_its_file_and_its_function(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("`test_check_docs.py` `test_check_docs.py::test_nowhere`\n`test_of_nothing.py`\n")
    named = [fault.split("'")[1] for fault in tool.unknown_tests(page)]
    assert named == ["test_check_docs.py::test_nowhere", "test_of_nothing.py"]
