"""The site of results: harmless, repeatable, and working from the disk."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from browser_pages import needs_browser, serious_faults
from made_results import NIGHT, WINTER, MadeResults, made

from relocbench.evaluation.common.folders import SetLike
from relocbench.leaderboard import load_results, make_board
from relocbench.leaderboard.boards import Boards
from relocbench.leaderboard.html import links, matrix
from relocbench.leaderboard.html.data import floats, script_json
from relocbench.leaderboard.html.looks import looks
from relocbench.leaderboard.html.rows import sections
from relocbench.leaderboard.html.site import write_site
from relocbench.leaderboard.retrieval.board import RetrievalBoard
from relocbench.metrics import CORRECT

HOSTILE = "<script>alert(1)</script>"


@pytest.fixture(scope="module")
def boards(tmp_path_factory: pytest.TempPathFactory) -> Boards:
    """One set with a trivial baseline, a good method, and one with a hostile name that misses a pair set."""
    results = MadeResults(tmp_path_factory.mktemp("made") / "results", {WINTER: 60, NIGHT: 40})
    results.write_dataset()
    results.add("identity", {WINTER: made(1, 60, 0.8), NIGHT: made(2, 40, 0.8)})
    results.add("good", {WINTER: made(3, 60, 0.05), NIGHT: made(4, 40, 0.1)})
    results.add("other", {WINTER: made(5, 60, 0.3)})
    (entry,) = load_results(results.root)
    methods = tuple(replace(m, label=HOSTILE) if m.label == "other" else m for m in entry.methods)
    return Boards(make_board([replace(entry, methods=methods)]))


@pytest.fixture(scope="module")
def site(boards: Boards, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_site(boards, tmp_path_factory.mktemp("site") / "html").parent


def test_twenty_methods_are_told_apart_and_keep_their_looks() -> None:
    labels = [f"method-{i:02d}" for i in range(20)]
    found = looks(labels[::-1], ())
    assert len({(look["light"], look["dash"]) for look in found.values()}) == 20
    assert len({(look["dark"], look["dash"]) for look in found.values()}) == 20
    assert looks(labels, ()) == found


def test_a_payload_cannot_end_its_script() -> None:
    text = script_json({HOSTILE: ["\u2028", float("inf"), float("nan")]})
    assert not set("<>&\u2028") & set(text)
    assert json.loads(text) == {HOSTILE: ["\u2028", "Infinity", None]}


def test_floats_are_little_endian_float32() -> None:
    assert floats(np.array([1.0])) == {":f4": "AACAPw=="}


def test_scripts_have_the_colours_of_cells() -> None:
    script = (Path(matrix.__file__).parent / "assets" / "core.js").read_text(encoding="utf-8")
    scale = re.search(r"QUALITY = (.*);", script)
    assert scale is not None
    hexes = ["#{:02x}{:02x}{:02x}".format(*colour) for colour in (matrix.BAD, matrix.MIDDLE, matrix.GOOD)]
    assert json.loads(scale[1]) == [[0, hexes[0]], [0.5, hexes[1]], [1, hexes[2]]]


def test_links_hold_what_names_must_not() -> None:
    town = cast(SetLike, SimpleNamespace(name="town", fingerprint="ab" * 32))
    state = {"set": links.set_id(town), "method": "x&y=<"}
    assert links.hash_of(state) == "set=town-abababababab&method=x%26y%3D%3C"


def test_ids_are_names_of_files_and_do_not_collide() -> None:
    names = [HOSTILE, "<script>alert(2)</script>", "../up", "a/b", "a-b", "", "x" * 400]
    ids = [links.file_id(name) for name in names]
    assert len(set(ids)) == len(names)
    assert all(name and "/" not in name and "<" not in name and len(name) <= 120 for name in ids)


def test_no_page_has_a_foreign_name_as_markup(site: Path) -> None:
    for path in [*site.glob("*.html"), *site.glob("data/**/*.js")]:
        assert HOSTILE not in path.read_text(encoding="utf-8"), path.name


def test_a_method_without_a_pair_set_has_no_total_and_no_rank_on_the_start_page(site: Path) -> None:
    rows = (site / "index.html").read_text(encoding="utf-8").split("<tr")
    (row,) = [row for row in rows if "&lt;script&gt;" in row and "data-order" in row]
    assert '<td data-order="1000000"></td><td data-order="-1"><span class="missing">' in row
    assert NIGHT in row


def test_words_behind_names_stand_on_every_page_and_are_explained(boards: Boards, tmp_path: Path) -> None:
    assert boards.tracking is not None
    dataset = boards.tracking.datasets[0]
    elsewhere = [
        replace(m, run=m.run.model_copy(update={"made_elsewhere": True, "assumes": "it <b>sails</b>"}))
        if m.label == "good"
        else m
        for m in dataset.entry.methods
    ]
    board = make_board([replace(dataset.entry, methods=tuple(elsewhere))])
    write_site(Boards(board), tmp_path)
    mark = '<span class="tag">made elsewhere</span>'
    assert all(mark in (tmp_path / name).read_text() for name in ("index.html", "method-good.html", "reading.html"))
    (payload,) = (tmp_path / "data" / "sets").glob("*.js")
    assert '"made elsewhere"' in payload.read_text()
    assumed = '<span class="tag">it &lt;b&gt;sails&lt;/b&gt;</span>'
    assert all(assumed in (tmp_path / name).read_text() for name in ("index.html", "method-good.html"))


def test_chance_stands_below_retrievers(boards: Boards) -> None:
    chances = SimpleNamespace(chance={"R@1": 0.125}, view_query="street", view_gallery="street")
    table = SimpleNamespace(name="a task", queries=8, rows=(), records=(chances,))
    record = SimpleNamespace(name="places", fingerprint="ab" * 32)
    asked = SimpleNamespace(title="places", record=record, tables=(table,), methods=())
    board = cast(RetrievalBoard, SimpleNamespace(metric="R@1", sets=(asked,), over=()))
    (section,) = sections(Boards(None, board, None))
    (row,) = section["rows"]
    assert (row["method"], row["value"], row["rank"], row["baseline"]) == ("(chance)", "12.5", "", True)


def test_pages_of_methods_that_left_are_removed(boards: Boards, tmp_path: Path) -> None:
    write_site(boards, tmp_path)
    assert (tmp_path / "method-good.html").exists()
    write_site(Boards(None), tmp_path)
    assert not list(tmp_path.glob("method-*.html"))


@pytest.mark.thorough
@needs_browser
@pytest.mark.parametrize("page", ["light", "dark"], indirect=True)
def test_every_kind_of_page_opens_from_the_disk_and_is_accessible(page: Any, site: Path) -> None:
    kinds = ["index.html", "reading.html", "method-good.html", next(site.glob("set-*.html")).name]
    for name in kinds:
        page.goto((site / name).as_uri())
        page.wait_for_load_state()
        if name.startswith("set-"):
            for chart in ("curves", "heat", "route", "distance", "angle", "risk", "cost"):
                page.locator(f"#{chart}").scroll_into_view_if_needed()
                page.wait_for_selector(f"#{chart} .main-svg")
        assert serious_faults(page) == [], name


@needs_browser
def test_the_start_page_sorts_and_searches_and_keeps_both_in_its_address(page: Any, site: Path) -> None:
    page.goto((site / "index.html").as_uri())
    methods = page.locator("#table-1 tbody tr td:nth-child(1)")
    page.locator("#table-1 thead th").first.click()
    shown = methods.all_inner_texts()
    assert shown == sorted(shown)
    page.locator("input[type=search]").fill("good")
    assert {text.split()[0] for text in methods.all_inner_texts()} == {"good"}
    page.goto("about:blank#" + page.url.partition("#")[2])
    page.goto((site / "index.html").as_uri() + "#" + page.url.partition("#")[2])
    assert {text.split()[0] for text in methods.all_inner_texts()} == {"good"}
    assert page.told == []


@pytest.mark.thorough
@needs_browser
def test_a_number_opens_its_pairs_worst_first(page: Any, site: Path, boards: Boards) -> None:
    assert boards.tracking is not None
    (good,) = [m for m in boards.tracking.datasets[0].entry.methods if m.label == "good"]
    joint = np.concatenate([rows.errors.joint_error(*CORRECT) for rows in good.errors.values()])
    metres = np.concatenate([rows.errors.translation_error_m for rows in good.errors.values()])
    page.goto(next(site.glob("set-*.html")).as_uri())
    row = page.locator("#methods tbody tr", has_text="good")
    row.locator("button.cell").first.click()
    page.wait_for_selector("#list-dialog[open]")
    errors = page.locator("#list tbody tr")
    assert errors.count() == 50
    assert errors.first.locator("td").nth(2).inner_text() == f"{metres[np.argmax(joint)]:.3f}"
    assert "100 entries" in page.locator("#list-dialog .dt-info").inner_text()
    assert serious_faults(page) == []


@pytest.mark.thorough
@needs_browser
def test_a_method_that_misses_a_pair_set_has_no_curve_of_the_total(page: Any, site: Path) -> None:
    address = next(site.glob("set-*.html")).as_uri()
    drawn = "[...document.getElementById('curves').data].map((each) => each.meta)"
    page.goto(address)
    page.locator("#curves").scroll_into_view_if_needed()
    page.wait_for_selector("#curves .main-svg")
    assert sorted(page.evaluate(drawn)) == ["good", "identity"]
    assert f"{HOSTILE} on {NIGHT}" in page.locator("#about").inner_text()
    page.goto("about:blank")
    page.goto(f"{address}#table={WINTER}")
    page.locator("#curves").scroll_into_view_if_needed()
    page.wait_for_selector("#curves .main-svg")
    assert sorted(page.evaluate(drawn)) == [HOSTILE, "good", "identity"]
    assert page.told == []
