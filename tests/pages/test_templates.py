"""Templates: what they show of others is text, what they lack is an error, and only writing a page loads them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from jinja2 import UndefinedError

from relocbench.pages import render

FOREIGN = "<b>a|b</b> `it's`"


@pytest.fixture
def beside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package of its own, beside whose modules templates may lie."""
    (tmp_path / "__init__.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path.parent)
    return tmp_path


def rendered(folder: Path, file: str, text: str, **values: object) -> str:
    (folder / file).write_text(text, encoding="utf-8")
    return render(f"{folder.name}.page", file, **values)


@pytest.mark.parametrize(
    ("shown", "expected"),
    [
        ("| {{ name | escaped }} |", r"| \<b\>a\|b\</b\> \`it's\` |"),
        ("| {{ name | code }} |", r"| `` <b>a\|b</b> `it's` `` |"),
        ("{{ [name] | fenced }}", f"```sh\n{FOREIGN}\n```"),
        ("{{ table(['n'], [['1']], left=0) }}", "| n |\n| --: |\n| 1 |"),
    ],
)
def test_markdown_shows_foreign_text_through_filters(beside: Path, shown: str, expected: str) -> None:
    assert rendered(beside, "page.md.j2", shown, name=FOREIGN) == expected


def test_html_escapes_everything_once_and_keeps_its_own_markup(beside: Path) -> None:
    text = (
        "{% macro bold() %}<b>{{ caller() }}</b>{% endmacro %}{% call bold() %}{{ name }}{% endcall %}: {{ count }}\n"
    )
    page = rendered(beside, "page.html.j2", text, name=FOREIGN, count=2)
    assert page == "<b>&lt;b&gt;a|b&lt;/b&gt; `it&#x27;s`</b>: 2\n"


def test_lines_of_statements_leave_nothing_behind(beside: Path) -> None:
    text = "# Page\n\n{% for n in numbers %}\n  {% if n > 1 %}\n- {{ n }}\n  {% endif %}\n{% endfor %}\n"
    assert rendered(beside, "page.md.j2", text, numbers=[1, 2, 3]) == "# Page\n\n- 2\n- 3\n"


@pytest.mark.parametrize("text", ["{{ absent }}", "{{ given.absent }}", "{% if absent %}x{% endif %}"])
@pytest.mark.parametrize("kind", ["md", "html"])
def test_a_value_that_nobody_gave_is_an_error(beside: Path, text: str, kind: str) -> None:
    with pytest.raises(UndefinedError, match="absent"):
        rendered(beside, f"page.{kind}.j2", text, given=0)


def test_a_template_that_is_not_there_is_named(beside: Path) -> None:
    with pytest.raises(FileNotFoundError, match=f"{beside.name}/gone"):
        render(f"{beside.name}.page", "gone.md.j2")


def test_a_template_includes_those_of_another_folder(beside: Path) -> None:
    text = "{% include 'relocbench.leaderboard.common/commands.md.j2' %}"
    page = rendered(beside, "page.md.j2", text, commands=[("a_b", ["run a"])], page_command="run b")
    assert page == "a\\_b:\n\n```sh\nrun a\n```\n\nThis page:\n\n```sh\nrun b\n```\n"


def test_a_script_has_templates_beside_it(tmp_path: Path) -> None:
    (tmp_path / "table.md.j2").write_text("{{ words }}\n", encoding="utf-8")
    (tmp_path / "table.py").write_text(
        "from relocbench.pages import render\nprint(end=render(__name__, 'table.md.j2', words='found'))\n"
    )
    for command in (["table.py"], ["-c", "import table"]):
        done = subprocess.run(
            [sys.executable, *command],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            capture_output=True,
            text=True,
            check=True,
        )
        assert done.stdout == "found\n"


@pytest.mark.thorough
def test_templates_are_loaded_where_a_page_is_written() -> None:
    code = (
        "import sys, relocbench, relocbench.leaderboard.tracking.set_page, relocbench.evaluation.probe.write\n"
        "sys.exit('jinja2' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
