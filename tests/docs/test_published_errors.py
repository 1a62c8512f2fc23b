"""The tables that people read first have the numbers of the published pages, and these follow from published errors."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from repository import ROOT

sys.path.insert(0, str(ROOT / "benchmarks" / "publish"))
import archives
import cross_weather
import edition_page
import groups

from relocbench.datasets.importers.edition.districts import District

WEATHER = ROOT / "leaderboard" / "weather"
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")
QUOTED = re.compile(r"[-+]\d+\.\d+ \[[-+.\d]+, [-+.\d]+\](?: \*)?")


def test_what_is_packed_is_unpacked_and_the_same_errors_give_the_same_bytes(tmp_path: Path) -> None:
    results = tmp_path / "results"
    method = results / "town-02@0123456789ab" / "orb-pnp"
    method.mkdir(parents=True)
    (method.parent / "dataset.yaml").write_text("name: town-02\n")
    for name, text in (("run.yaml", "a"), ("scores.yaml", "b"), ("p.errors.csv", "c"), ("p.txt", "d"), ("p.csv", "e")):
        (method / name).write_text(text)
    district = District(2, 5, ("Rain",))
    out = cross_weather.packed(tmp_path / "errors", district, "orb-pnp")
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


def test_the_tables_of_the_results_page_have_the_published_shares() -> None:
    text = (WEATHER / "cross_weather.md").read_text()
    published = {metric: shares_of(text, metric) for metric in groups.METRICS}
    for name, part in zip(("SUMMARY", "RESULTS"), tables_of(ROOT / "docs" / "results.md"), strict=True):
        columns = getattr(cross_weather, name)
        for method, shares in table_of(part).items():
            for (column, (metric, group)), (head, share) in zip(columns.items(), shares.items(), strict=True):
                # the page has one decimal, so that a rounded share may be off by half a percent and half a decimal
                apart = abs(float(share) - float(published[metric][method][group]))
                assert head == column
                assert apart < (0.11 if "." in share else 0.56), (method, column)


def test_the_table_of_readme_has_the_shares_of_the_edition() -> None:
    published = table_of((ROOT / "leaderboard" / "edition" / "2026.1-test.md").read_text())
    (part,) = tables_of(ROOT / "README.md")
    shown = table_of(part)
    assert list(shown) == list(edition_page.SUMMARY)
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


def shares_of(page: str, metric: str) -> dict[str, dict[str, str]]:
    """The shares of a metric by method and group, of the groups of all changes and of those of each condition."""
    together, by_condition = (
        table_of(page.split(f"{heading}\n")[1]) for heading in (f"## {metric}, %", f"### {metric}, %, by condition")
    )
    return {method: row | by_condition[method] for method, row in together.items()}


@pytest.mark.parametrize(
    ("page", "end"),
    [
        ("docs/results.md", "## Real images"),
        ("docs/gn-net-results.md", "## On real images"),
        ("docs/feature-trackers.md", "## What alignment adds"),
    ],
)
def test_differences_that_people_read_stand_on_the_page_with_their_stars(page: str, end: str) -> None:
    quoted = set(QUOTED.findall((ROOT / page).read_text().split(end)[0]))
    assert quoted
    assert quoted <= set(QUOTED.findall((WEATHER / "cross_weather.md").read_text()))


@pytest.mark.thorough
def test_the_page_is_printed_again_from_the_published_errors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (WEATHER / "cross_weather.md").read_text()
    methods = [method for method in shares_of(page, groups.METRICS[0]) if not method.startswith("*")]
    given = {name.split("=")[0]: name for name in cross_weather.METHODS}
    words = [word for method in methods for word in ("-m", given[method])]
    asked = ["cross_weather.py", "--only-print", "--errors", WEATHER / "errors", "--out", tmp_path, *words]
    monkeypatch.setattr(sys, "argv", list(map(str, asked)))
    cross_weather.main()
    again = (tmp_path / "cross_weather.md").read_text()

    def tables(text: str) -> list[str]:
        return [line for line in text.splitlines() if line.startswith(("|", "#"))]

    for old, new in zip(tables(page), tables(again), strict=True):
        # Processors differ in the last digits, and a number may be rounded to the other side.
        assert NUMBER.sub("#", old) == NUMBER.sub("#", new)
        apart = zip(NUMBER.findall(old), NUMBER.findall(new), strict=True)
        assert all(abs(float(a) - float(b)) <= 0.11 for a, b in apart), (old, new)
