"""Names and messages of others stand on Markdown pages as text, and nothing of them acts."""

from __future__ import annotations

import re

import pytest

from relocbench.pages.markdown import code, escaped, fenced

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


def test_a_fence_is_longer_than_what_it_holds() -> None:
    shown = fenced(["a", "'\n````\n<script>'"]).splitlines()
    assert (shown[0], shown[-1]) == ("`````sh", "`````")


@pytest.mark.parametrize("text", ["# x", "- x", "+ x", "1. x", "---", "===", "~~~sh"])
def test_a_name_at_the_beginning_of_a_line_opens_no_block(text: str) -> None:
    assert escaped(text).replace("\\", "", 1) == text
    assert escaped(text) != text
