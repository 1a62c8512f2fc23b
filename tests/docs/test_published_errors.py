"""The tables that people read first have the numbers of the published pages, and these follow from published errors."""

from __future__ import annotations

import re
from pathlib import Path

import archives
import distances
import edition_page
import pytest
from repository import ROOT

from relocbench.datasets.importers.edition.dataset import recipe

EDITION = ROOT / "leaderboard" / "edition" / "2026.1-test.md"
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")
QUOTED = re.compile(r"[-+]\d+\.\d+ \[[-+.\d]+, [-+.\d]+\](?: \*)?")


def test_what_is_packed_is_unpacked_and_the_same_errors_give_the_same_bytes(tmp_path: Path) -> None:
    results = tmp_path / "results"
    method = results / "town-02@0123456789ab" / "orb-pnp"
    method.mkdir(parents=True)
    (method.parent / "dataset.yaml").write_text("name: town-02\n")
    for name, text in (("run.yaml", "a"), ("scores.yaml", "b"), ("p.errors.csv", "c"), ("p.txt", "d"), ("p.csv", "e")):
        (method / name).write_text(text)
    out = tmp_path / "errors" / "02" / "orb-pnp.tar.xz"
    archives.pack(results, "town-02", "orb-pnp", out)
    first = out.read_bytes()
    archives.pack(results, "town-02", "orb-pnp", out)
    assert out.read_bytes() == first
    there = archives.unpack(tmp_path / "errors", tmp_path / "there")
    found = {p.relative_to(there).as_posix(): p.read_text() for p in there.rglob("*") if p.is_file()}
    assert found == {
        "town-02@0123456789ab/dataset.yaml": "name: town-02\n",
        "town-02@0123456789ab/orb-pnp/run.yaml": "a",
        "town-02@0123456789ab/orb-pnp/scores.yaml": "b",
        "town-02@0123456789ab/orb-pnp/p.errors.csv": "c",
        "town-02@0123456789ab/orb-pnp/p.txt": "d",
        "town-02@0123456789ab/orb-pnp/p.csv": "e",
    }
    with pytest.raises(SystemExit, match="holds no archive"):
        archives.unpack(tmp_path / "none", tmp_path / "there")


@pytest.mark.parametrize(("page", "methods"), [("README.md", edition_page.SUMMARY), ("docs/results.md", None)])
def test_the_tables_that_people_read_first_have_the_shares_of_the_edition(
    page: str, methods: tuple[str, ...] | None
) -> None:
    published = {method: row for method, row in table_of(EDITION.read_text()).items() if not method.startswith("*")}
    shown = table_of(tables_of(ROOT / page)[0])
    assert list(shown) == list(methods or published)
    for method, shares in shown.items():
        assert shares.keys() == published[method].keys()
        for tier, share in shares.items():
            apart = abs(float(share) - float(published[method][tier].split()[0]))
            assert apart < (0.11 if "." in share else 0.56), (method, tier)


def tables_of(page: Path) -> list[str]:
    """The tables of a page whose rows are methods."""
    return [part for part in page.read_text().split("\n\n") if part.startswith("| method |")]


def table_of(text: str) -> dict[str, dict[str, str]]:
    """The cells of the first table of a text, by the first cell of their row and by the head of their column."""
    text = text.replace("`", "")
    rows = [line.strip("| ").split(" | ") for line in re.findall(r"(?:^\|.*\n?)+", text, re.MULTILINE)[0].splitlines()]
    return {row[0]: dict(zip(rows[0][1:], row[1:], strict=True)) for row in rows[2:]}


@pytest.mark.parametrize(
    ("page", "end"),
    [
        ("docs/results.md", "## Real images"),
        ("docs/feature-trackers.md", "## What alignment adds"),
    ],
)
def test_differences_that_people_read_stand_on_the_page_with_their_stars(page: str, end: str) -> None:
    quoted = set(QUOTED.findall((ROOT / page).read_text().split(end)[0]))
    assert quoted
    assert quoted <= set(QUOTED.findall(EDITION.read_text()))


@pytest.mark.thorough
def test_the_distances_that_people_read_are_those_of_the_published_pairs() -> None:
    text, _ = distances.table(ROOT / "leaderboard")
    assert f"\n\n{text}\n\n" in (ROOT / "docs" / "results.md").read_text()


@pytest.mark.thorough
def test_the_page_is_printed_again_from_the_published_errors(tmp_path: Path) -> None:
    archives.unpack(EDITION.parent / "predictions" / EDITION.stem, tmp_path)
    page = EDITION.read_text()
    again = edition_page.page(recipe("2026.1"), "test", tmp_path)

    def tables(text: str) -> list[str]:
        return [line for line in text.splitlines() if line.startswith(("|", "#"))]

    for old, new in zip(tables(page), tables(again), strict=True):
        # Processors differ in the last digits, and a number may be rounded to the other side.
        assert NUMBER.sub("#", old) == NUMBER.sub("#", new)
        apart = zip(NUMBER.findall(old), NUMBER.findall(new), strict=True)
        assert all(abs(float(a) - float(b)) <= 0.11 for a, b in apart), (old, new)
