"""The page of a set in a browser: its map, what errors depend on, lists of pairs, sweeps, basins, and paper."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from answered_dataset import add_answers
from browser_pages import needs_browser, serious_faults
from made_results import MadeResults, made
from small_dataset import ACROSS, make_small_dataset

from relocbench.arrays import Array
from relocbench.datasets.core.pairfile import Pair
from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.evaluation.common.results import dataset_results, write_dataset_record
from relocbench.evaluation.probe.records import RADII, SHARES, STARTS
from relocbench.evaluation.tables.matching import OFFSETS_PX, MatchingRow
from relocbench.files import dump_yaml, write_table, write_text
from relocbench.geometry import make_transform, so3_exp
from relocbench.leaderboard import load_results, make_board
from relocbench.leaderboard.boards import Boards
from relocbench.leaderboard.html.set_page import write
from relocbench.leaderboard.html.site import write_site

HOSTILE = "<img src=x onerror=alert(1)>"
pytestmark = needs_browser
_POINT = """([id, trace, point]) => {
  const chart = document.getElementById(id);
  chart.scrollIntoView({ block: "center" });
  const { left, top } = chart.getBoundingClientRect(), { xaxis, yaxis } = chart._fullLayout;
  const { x, y } = chart.data[trace];
  return [left + xaxis._offset + xaxis.d2p(x[point]), top + yaxis._offset + yaxis.d2p(y[point])];
}"""
"""Where a point of a chart lies in the window."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset whose two drives have a world each, three methods, one of which fails on two pairs, and a probe."""
    root = tmp_path_factory.mktemp("set")
    fault = make_transform(np.eye(3), [5.0, 0.0, 0.0])
    dataset = make_small_dataset(root / "dataset", frames=8, pose_fault=fault)
    write_dataset_record(dataset_results(root / "results", dataset), dataset)
    failing = {pair.key for pair in dataset.pair_set(ACROSS).evaluated[:2]}

    def wrong(pair: Pair) -> Array | None:
        assert pair.T_query_ref is not None
        off = 0.02 * (pair.query_timestamp_ns // 10**8 % 7)
        return None if pair.key in failing else make_transform(so3_exp([0.0, off, 0.0]), [off, 0, 0]) @ pair.T_query_ref

    add_answers(root / "results", dataset, "identity", "identity", lambda pair: np.eye(4))
    add_answers(root / "results", dataset, "right", "right", lambda pair: pair.T_query_ref)
    add_answers(root / "results", dataset, "wrong", "wrong", wrong)
    _write_probe(root / "results" / "probed", dataset.fingerprint)
    (entry,) = load_results(root / "results", datasets=DatasetLookup(root / "results"))
    near = {offset: 12 // offset // 2 for offset in OFFSETS_PX}
    rows = tuple(MatchingRow(1, 2, "", offset, 10, 10, count, count, 0, 0) for offset, count in near.items())
    methods = tuple(replace(m, matching={ACROSS: rows}) if m.label == "wrong" else m for m in entry.methods)
    board = make_board([replace(entry, methods=methods)])
    return write_site(Boards(board), root / "html", pairs=0).parent


def _write_probe(folder: Path, fingerprint: str) -> None:
    shares, radii = [], []
    for what, unit in (("pixels", "px"), ("translation", "m")):
        for label in ("wrong", HOSTILE):
            head = (label, what, "", "across conditions", "near", unit)
            shares += [[*head, offset, 3, 10, share, 0] for offset, share in ((0, 0.9), (4, 0.4))]
            radii.append([*head, 3, 3.0, 0, "", "", "", "", "", 0.9, 3.5, 0, 3.0, 4.25, "", "", ""])
    write_table(folder / "probe.csv", SHARES.columns, shares)
    write_table(folder / "radii.csv", RADII.columns, radii)
    start = ["wrong", "across conditions", "near", 3, 0.75, 0.25, 0.5, 0.25, 0.125, 0.375]
    write_table(folder / "starts.csv", STARTS.columns, [start])
    write_text(folder / "probe.yaml", dump_yaml({"dataset": "small", "fingerprint": fingerprint}))


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site of a sweep over pairs of two tiers, whose values are given since no dataset is at hand."""
    names = [f"s-wetness-0-0__s-wetness-{i}-0__front" for i in range(1, 5)]
    overlaps = [0.3] * 50 + [0.02] * 10
    results = MadeResults(tmp_path_factory.mktemp("swept") / "results", dict.fromkeys(names, 60), overlaps=overlaps)
    results.write_dataset()
    results.add("identity", {name: made(i, 60, 0.8) for i, name in enumerate(names)})
    results.add("good", {name: made(9 + i, 60, 0.08 * (1 + i)) for i, name in enumerate(names)})
    values = {name: i for i, name in enumerate(names, start=1)}
    found = {"name": "wetness", "axis": "wetness", "values": values, "reference": 0}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(write, "sweep_of", lambda *asked: found)
        return write_site(Boards(results.board()), results.root.parent / "html").parent


def _open(page: Any, site: Path, state: str = "") -> None:
    page.goto(next(site.glob("set-*.html")).as_uri() + (f"#{state}" if state else ""))
    page.locator("#curves").scroll_into_view_if_needed()
    page.wait_for_selector("#curves .main-svg")


def _draw(page: Any, chart: str) -> None:
    page.locator(f"#{chart}").scroll_into_view_if_needed()
    page.wait_for_selector(f"#{chart} .main-svg")


def _click(page: Any, chart: str, trace: int, point: int) -> None:
    x, y = page.evaluate(_POINT, [chart, trace, point])
    page.mouse.move(x - 1, y)
    page.mouse.move(x, y)
    page.mouse.click(x, y)


@pytest.mark.thorough
def test_a_point_of_a_curve_lists_the_pairs_up_to_it_and_beside_them_all_others(page: Any, site: Path) -> None:
    _open(page, site, f"table={ACROSS}&hide=%5B%22identity%22,%22right%22%5D&error=translation")
    _click(page, "curves", 0, 2)
    page.wait_for_selector("#list-dialog[open]")
    parts = page.locator("#list-part button")
    counts = [int(text.split(": ")[1]) for text in parts.all_inner_texts()]
    assert counts[0] + counts[1] == counts[2] == 15
    assert counts[0] < 15
    shown = page.locator("#list tbody tr")
    assert shown.count() == counts[0]
    limit = parts.first.inner_text().split("at most ")[1].split(" m")[0]
    errors = page.locator("#list tbody td:nth-child(3)")
    assert errors.first.inner_text() == limit
    parts.last.click()
    assert errors.all_inner_texts()[:2] == ["no pose", "no pose"]
    assert shown.count() == 15


@pytest.mark.thorough
def test_a_cell_of_the_matrix_lists_its_pairs_found_and_missed(page: Any, site: Path) -> None:
    _open(page, site)
    cells = page.locator(".matrix tbody tr", has_text="wrong").locator("td.share a")
    cells.last.click()
    page.wait_for_selector("#list-dialog[open]")
    found, missed = (page.locator(f"#list tbody .{word}").count() for word in ("found", "missed"))
    assert found + missed == 15
    assert page.locator("#list-title").inner_text() == f"wrong, snow, winter, day: {found} of 15 found"
    assert page.locator("#list-part button").count() == 0
    page.locator("#close").click()
    cells.first.click()  # the total, here of one pair set
    page.wait_for_selector("#list-dialog[open]")
    assert page.locator("#list-title").inner_text() == f"wrong, across conditions: {found} of 15 found"


@pytest.mark.thorough
def test_a_cell_of_a_tier_lists_the_pairs_of_this_tier(page: Any, swept: Path) -> None:
    _open(page, swept)
    cells = page.locator(".matrix tbody tr", has_text="good").locator("td.share a")
    for cell, count, pairs in ((cells.nth(-2), 200, range(1, 51)), (cells.last, 40, range(51, 61))):
        cell.click()
        page.wait_for_selector("#list-dialog[open]")
        assert f" of {count} found" in page.locator("#list-title").inner_text()
        listed = page.locator("#list tbody td:first-child").all_inner_texts()
        assert {int(name.split()[-1]) for name in listed} <= set(pairs)
        page.locator("#close").click()


@pytest.mark.thorough
def test_the_map_of_each_world_shows_its_pairs_and_opens_them(page: Any, site: Path) -> None:
    _open(page, site, f"table={ACROSS}&map=wrong")
    _draw(page, "map")
    page.wait_for_function("document.getElementById('map').data?.length === 3")
    routes, answered, without = page.evaluate("document.getElementById('map').data.map((each) => [...each.x])")
    assert (len(routes), len(answered), len(without)) == (8, 13, 2)
    assert min(answered) < -4  # beside their keyframes, where the truth puts them
    assert "no answer: 2 of 15" in page.locator("#map-keys").inner_text()
    page.locator("#map-world").select_option("1")
    page.wait_for_function("Math.min(...document.getElementById('map').data[1].x) > -4")
    page.locator("#map-list").press("Enter")  # a way for the keyboard
    page.wait_for_selector("#list-dialog[open]")
    page.keyboard.press("Escape")
    _click(page, "map", 2, 0)
    page.wait_for_url("**/pair.html#*")
    assert page.locator("#numbers .chosen .failed").inner_text() == "declined"


@pytest.mark.thorough
def test_errors_depend_on_what_is_recorded_and_a_point_opens_its_pair(page: Any, site: Path, swept: Path) -> None:
    _open(page, site, f"table={ACROSS}&hide=%5B%22identity%22,%22right%22%5D&error=rotation")
    assert "at most 12 d apart" in page.locator("#months-about").text_content()
    assert not page.locator("#months-panel").is_visible()
    _draw(page, "distance")
    points, middle = page.evaluate("document.getElementById('distance').data.map((each) => [...each.y])")
    assert (len(points), len(middle) > 1) == (13, True)
    assert page.locator("#distance .scatterlayer path.point").count() == 13
    assert page.evaluate("document.getElementById('distance').layout.shapes[0].y0") == 2
    _click(page, "distance", 0, 4)
    page.wait_for_url("**/pair.html#*method=wrong*")
    _open(page, swept)
    _draw(page, "months")
    assert page.locator("#months-about").inner_text() == "By the dates of both images."
    assert page.evaluate("Math.round(document.getElementById('months').data[0].x[0])") == 38


@pytest.mark.thorough
def test_a_sweep_has_intervals_and_opens_its_pairs(page: Any, swept: Path) -> None:
    _open(page, swept)
    _draw(page, "sweep")
    assert page.locator("#sweep-title").inner_text() == "One factor: wetness"
    good = page.evaluate("(({ data }) => data.find((each) => each.meta === 'good'))(document.getElementById('sweep'))")
    assert good["customdata"] == [1, 2, 3, 4]
    assert good["y"] == sorted(good["y"], reverse=True)
    assert all(high > 0 for high in good["error_y"]["array"][1:])
    assert "the dataset is available" in page.locator("#map-about").inner_text()
    assert not page.locator("#map-section").is_visible()
    _click(page, "sweep", 0, 1)
    page.wait_for_selector("#list-dialog[open]")
    assert ", wetness 2.000: " in page.locator("#list-title").inner_text()
    assert "of 60 found" in page.locator("#list-title").inner_text()


@pytest.mark.thorough
def test_matching_and_basins_are_drawn_also_of_methods_without_results(page: Any, site: Path) -> None:
    _open(page, site, f"table={ACROSS}&probe-what=translation")
    _draw(page, "matching")
    drawn = "document.getElementById('{}').data.map((each) => [each.meta ?? '', [...each.y]])"
    assert page.evaluate(drawn.format("matching"))[1] == ["wrong", [60, 30, 10, 0, 0]]
    _draw(page, "probe")
    assert page.evaluate(drawn.format("probe"))[1:] == [["wrong", [90, 40]], [HOSTILE, [90, 40]]]
    assert "3.50 [3.00, 4.25] m" in page.locator("#probe-widths").inner_text()
    assert page.locator("#probe-starts td").last.inner_text() == "+25.0 [+12.5, +37.5]"
    page.locator("#probe-what").select_option("pixels")
    page.locator("#probe-widths", has_text="4.25] px").wait_for()
    assert "probe-what=pixels" in page.url


@pytest.mark.thorough
@pytest.mark.parametrize("page", ["dark"], indirect=True)
def test_paper_has_what_was_chosen_and_light_colours(page: Any, site: Path) -> None:
    _open(page, site, f"table={ACROSS}&hide=%5B%22identity%22%5D&methods-find=wr")
    page.emulate_media(media="print")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    page.wait_for_selector("#probe .main-svg")  # what was never in sight is printed too
    for name in ("#choose-table", "#choose-error", ".dt-search", "#legend li:has-text('wrong')", "#map-keys"):
        assert page.locator(name).first.is_visible(), name
    for name in ("#theme", "#map-list", "#legend li:has-text('identity')", ".site-header"):
        assert not page.locator(name).is_visible(), name
    assert page.locator("#methods tbody tr").count() == 1
    assert page.evaluate("document.documentElement.dataset.theme") == "light"
    assert page.evaluate("document.getElementById('curves').offsetWidth") < 800
    page.emulate_media(media="screen")
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert page.evaluate("document.documentElement.dataset.theme") == "dark"
    _draw(page, "curves")
    fits = "(chart) => chart.querySelector('.main-svg').clientWidth === chart.clientWidth && chart.clientWidth > 900"
    page.wait_for_function(f"({fits})(document.getElementById('curves'))")


@pytest.mark.thorough
@pytest.mark.parametrize("page", ["dark"], indirect=True)
def test_all_charts_are_accessible_and_fit_a_phone(page: Any, site: Path) -> None:
    page.set_viewport_size({"width": 390, "height": 800})
    _open(page, site, f"table={ACROSS}")
    for chart in ("map", "matching", "probe"):
        _draw(page, chart)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    page.evaluate("Promise.all(document.getAnimations().map((each) => each.finished))")  # colours fade in
    assert serious_faults(page) == []
