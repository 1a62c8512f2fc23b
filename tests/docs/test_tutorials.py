"""The tutorials do what they say: their commands run in the order of the page, and print what the page shows."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import tutorial_pages
from repository import DOCS

TUTORIALS = DOCS / "tutorials"
FIRST = TUTORIALS / "first-result.md"
NOTEBOOK = TUTORIALS / "notebook.ipynb"
OWN_DATA = ["lidar-car"]
"""pages that make all that they need"""
ON_THE_STREET = [
    "your-recording",
    "your-method",
    "your-retriever",
    "heavy-model",
    "predictions-elsewhere",
    "cluster",
]
"""pages that go on in the folder of the first one"""


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that the first tutorial leaves, with what it printed in ``printed.json``."""
    folder = tmp_path_factory.mktemp("first")
    (folder / "printed.json").write_text(json.dumps(tutorial_pages.run(FIRST, folder)))
    return folder


def continued(street: Path, folder: Path) -> Path:
    shutil.copytree(street, folder, dirs_exist_ok=True, symlinks=True)
    (folder / "docs").symlink_to(DOCS)
    return folder


def assert_as_shown(page: Path, printed: list[list[str]]) -> None:
    for step, lines in zip(tutorial_pages.steps(page), printed, strict=True):
        missing = tutorial_pages.missing_lines(step.shown, lines)
        assert not missing, f"{page.name}:{step.block.line} shows\n{missing[0]}\nbut printed\n" + "\n".join(lines)


def test_rows_of_a_table_may_be_in_another_order_and_other_lines_may_not() -> None:
    shown = ("┏━━━┓", "│ a │ 75.0 │", "│ b │ 80.0 │", "└━━━┘", "results: here")
    frame, a, b, *rest = shown
    assert tutorial_pages.missing_lines(shown, [frame, b, a, *rest]) == []
    assert tutorial_pages.missing_lines(shown, [frame, a, "│ c │ 80.0 │", *rest])[0] == b
    assert tutorial_pages.missing_lines((rest[1], a), [a, rest[1]]) == [a]


def test_every_tutorial_is_run_and_listed() -> None:
    pages = {path.stem for path in TUTORIALS.glob("*.md")} - {"index"}
    assert pages == {FIRST.stem, *ON_THE_STREET, *OWN_DATA}
    index = (TUTORIALS / "index.md").read_text()
    assert all(f"]({name}.md)" in index for name in pages)


@pytest.mark.parametrize("name", [FIRST.stem, *ON_THE_STREET, *OWN_DATA])
def test_every_tutorial_shows_what_its_commands_print(name: str) -> None:
    shown = [step for step in tutorial_pages.steps(TUTORIALS / f"{name}.md") if step.shown]
    assert len(shown) >= 2


@pytest.mark.thorough
def test_the_first_tutorial_prints_what_it_shows(street: Path) -> None:
    assert_as_shown(FIRST, json.loads((street / "printed.json").read_text()))


@pytest.mark.thorough
@pytest.mark.parametrize("name", ON_THE_STREET)
def test_a_tutorial_that_goes_on_prints_what_it_shows(name: str, street: Path, tmp_path: Path) -> None:
    page = TUTORIALS / f"{name}.md"
    assert_as_shown(page, tutorial_pages.run(page, continued(street, tmp_path)))


@pytest.mark.thorough
@pytest.mark.parametrize("name", OWN_DATA)
def test_a_tutorial_with_data_of_its_own_prints_what_it_shows(name: str, tmp_path: Path) -> None:
    page = TUTORIALS / f"{name}.md"
    assert_as_shown(page, tutorial_pages.run(page, tmp_path))


@pytest.mark.thorough
def test_the_notebook_runs_and_prints_what_it_shows(street: Path, tmp_path: Path) -> None:
    copy = continued(street, tmp_path) / NOTEBOOK.name
    shutil.copy(NOTEBOOK, copy)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--nbmake", "--overwrite", copy.name]
    environment = {**tutorial_pages.environment(tmp_path), "PYTEST_ADDOPTS": ""}
    environment.pop("PYTEST_XDIST_WORKER", None)
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-3000:]
    for stored, fresh in zip(_code_cells(NOTEBOOK), _code_cells(copy), strict=True):
        assert tutorial_pages.missing_lines(tuple(_words(stored)), _words(fresh)) == []
        assert _pictures(stored) == _pictures(fresh)


def test_the_notebook_is_small() -> None:
    assert NOTEBOOK.stat().st_size < 250_000


@pytest.mark.parametrize(
    ("shown", "printed"),
    [
        ("a b 3", "a  b 3"),
        ("median 0.0250 m", "median 0.0251 m"),
        ("fingerprint fcb9ca3dd2b9", "fingerprint 0123456789ab"),
        ("16/16 in 5.6 s", "16/16 in 60.1 s"),
        (
            "┃ method ┃ median_seconds ┃\n│ dso │ 100.0 % │ 0.004 │",
            "┃ method ┃ median_seconds ┃\n│ dso │ 100.0 % │ 9.1 │",
        ),
        ("first\n...\nlast", "first\nbetween\nlast"),
    ],
)
def test_what_differs_between_runs_and_machines_is_the_same(shown: str, printed: str) -> None:
    assert tutorial_pages.missing_lines(tuple(shown.splitlines()), printed.splitlines()) == []


@pytest.mark.parametrize(
    ("shown", "printed"),
    [
        ("8 pairs", "9 pairs"),
        ("recall 50.0 %", "recall 62.5 %"),
        ("first\nsecond", "second\nfirst"),
        ("all is well", "all is bad"),
        ("│ dso │ 100.0 % │ 0.004 │", "│ dso │ 100.0 % │ 9.1 │"),
    ],
)
def test_what_a_page_must_not_show_is_found(shown: str, printed: str) -> None:
    assert tutorial_pages.missing_lines(tuple(shown.splitlines()), printed.splitlines())


def test_a_page_that_fails_names_its_line(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# Page\n\n```bash\necho one\n```\n\n```bash\nfalse\necho two\n```\n")
    with pytest.raises(AssertionError, match=r"page\.md:8 failed"):
        tutorial_pages.run(page, tmp_path)
    page.write_text("# Page\n\n```bash\nsleep 600 &\necho one\n```\n\n```text\none\n```\n")
    assert tutorial_pages.run(page, tmp_path) == [["one"]]
    page.write_text("# Page\n\n```text\nof no command\n```\n")
    with pytest.raises(ValueError, match="output of no command"):
        tutorial_pages.steps(page)


def _code_cells(notebook: Path) -> list[dict[str, object]]:
    cells = json.loads(notebook.read_text())["cells"]
    return [cell for cell in cells if cell["cell_type"] == "code"]


def _words(cell: dict[str, object]) -> list[str]:
    """What a cell printed, and the text of what it returned where that is no picture."""
    lines: list[str] = []
    outputs = cell["outputs"]
    assert isinstance(outputs, list)
    for output in outputs:
        data = output.get("data", {})
        text = output.get("text") or ([] if "image/png" in data else data.get("text/plain", []))
        lines += "".join(text).splitlines()
    return lines


def _pictures(cell: dict[str, object]) -> int:
    outputs = cell["outputs"]
    assert isinstance(outputs, list)
    return sum("image/png" in output.get("data", {}) for output in outputs)
