"""Names and messages of others stand on Markdown pages as text, and nothing of them acts."""

from __future__ import annotations

import re
from collections.abc import Sequence

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from markdown_it import MarkdownIt
from markdown_it.token import Token

from relocbench.pages.markdown import code, escaped, fenced, table_text

EVIL = ["<script>alert(1)</script>", "[x](javascript:alert(1))", "a|b", "`a` ``b``", "a\nb", "\\|", "\x1b[31m", "*x*"]


@pytest.mark.parametrize("text", EVIL)
def test_markdown_of_a_foreign_name_keeps_its_row_and_acts_not(text: str) -> None:
    for shown in (escaped(text), code(text)):
        assert "\n" not in shown
        assert "\x1b" not in shown
        # Bars that are not escaped would end the cell.
        assert not re.search(r"(?<!\\)(\\\\)*\|", shown)
    bare = re.sub(r"\\[\\`*_|<>\[\]]", "", escaped(text))
    assert not set("<>[]`*|") & set(bare)


@pytest.mark.parametrize("text", ["plain", "a`b", "``", "`a", "a``b```c", "\\|`"])
def test_code_spans_are_balanced(text: str) -> None:
    shown = code(text)
    if shown.startswith("<code>"):
        assert re.fullmatch(r"<code>([\w ]|&#\d+;)*</code>", shown)
        return
    ticks = re.match("`+", shown)
    assert ticks is not None
    inside = shown[len(ticks[0]) : -len(ticks[0])]
    assert shown.endswith(ticks[0])
    assert len(ticks[0]) not in {len(run) for run in re.findall("`+", inside)}
    assert inside.strip() == text


def test_a_fence_is_longer_than_what_it_holds_and_a_line_stays_one_line() -> None:
    shown = fenced(["a", "'\n````\n<script>'"]).splitlines()
    assert shown == ["`````sh", "a", r"'\n````\n<script>'", "`````"]


MARKDOWN = MarkdownIt("commonmark", {"html": True}).enable(["table", "strikethrough"])
TEXT = st.text(max_size=30) | st.text("\\`*_|<>[]()~$&#;!-+=.:1a /\"'\n\r\t\x1b\u2028\u202e", max_size=30)


def shown_text(tokens: Sequence[Token]) -> str:
    """What a reader sees of inline tokens. Fails for anything but text."""
    kinds = {token.type for token in tokens}
    assert kinds <= {"text", "text_special", "code_inline", "html_inline"}, kinds
    return "".join(token.content for token in tokens)


def seen(text: str) -> str:
    """Text as a page is to show it: one line, without control characters."""
    return "".join(c if c.isprintable() else "\ufffd" for c in " ".join(text.split()))


@given(TEXT, TEXT)
@example("&lt;b&gt;", "a\nb")
@example("~~x~~", "# x")
def test_any_text_fills_one_cell_of_a_table_and_is_seen_as_it_is(first: str, second: str) -> None:
    tokens = MARKDOWN.parse(table_text(["a", "b"], [[escaped(first), escaped(second)]], left=1) + "\n\nafter")
    assert [token.type for token in tokens].count("tr_open") == 2
    cells = [token for token in tokens if token.type == "inline"]
    found = [shown_text(cell.children or []) for cell in cells]
    assert found == ["a", "b", seen(first), seen(second), "after"]


@given(TEXT.filter(lambda text: text.strip() != ""))
def test_any_text_is_a_paragraph_of_its_own(text: str) -> None:
    tokens = MARKDOWN.parse(f"{escaped(text)}\n\nafter")
    assert [token.type for token in tokens] == ["paragraph_open", "inline", "paragraph_close"] * 2
    assert shown_text(tokens[1].children or []) == seen(text)


@given(TEXT.filter(lambda text: text.strip() != ""))
def test_any_text_is_one_piece_of_code_in_a_cell(text: str) -> None:
    tokens = MARKDOWN.parse(table_text(["a"], [[code(text)]], left=1))
    cell = [token for token in tokens if token.type == "inline"][1].children or []
    if cell[0].type == "html_inline":
        assert [token.content for token in cell if token.type == "html_inline"] == ["<code>", "</code>"]
        assert "".join(token.content for token in cell[1:-1]) == seen(text)
    else:
        assert [token.type for token in cell] == ["code_inline"]
        assert cell[0].content.strip() == seen(text).strip()


@given(st.lists(TEXT, max_size=4))
def test_any_lines_stay_lines_of_one_block_of_code(lines: list[str]) -> None:
    (block,) = MARKDOWN.parse(fenced(lines))
    assert block.type == "fence"
    assert block.content.count("\n") == len(lines)


@pytest.mark.parametrize("text", ["# x", "- x", "+ x", "1. x", "---", "==="])
def test_a_name_at_the_beginning_of_a_line_opens_no_block(text: str) -> None:
    assert escaped(text).replace("\\", "", 1) == text
    assert escaped(text) != text
