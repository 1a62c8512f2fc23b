"""The page of a pair: what is written for it, and how it behaves in a browser."""

from __future__ import annotations

import base64
import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from answered_dataset import add_answers
from browser_pages import needs_browser, serious_faults
from command_line import relocbench
from made_results import WINTER, MadeResults, made
from small_dataset import ACROSS, WITHIN, make_small_dataset

from relocbench.arrays import Array
from relocbench.datasets.core.pairfile import Pair
from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.evaluation.common.results import (
    dataset_results,
    write_dataset_record,
)
from relocbench.geometry import make_transform, so3_exp
from relocbench.leaderboard import load_results, make_board
from relocbench.leaderboard.boards import Boards
from relocbench.leaderboard.html import chosen as chosen_rows
from relocbench.leaderboard.html.pair_page import write as pair_page
from relocbench.leaderboard.html.pair_page.write import chosen_pairs
from relocbench.leaderboard.html.site import write_site

HOSTILE = "<script>document.title = 'taken over'</script><img src=x onerror=alert(1)>"
MATCHED = {"shown_matches": [[10, 20, 30.5, 40, 1], [50, 60, 70, 80, 0], [100, 100, 110, 100, 1]]}
FAULT = make_transform(so3_exp([0.0, np.radians(4.0), 0.0]), [0.25, 0.0, 0.0])
_GO_TO_ONE_WITHOUT_IMAGES = """async () => {
  const { set, pairset } = relocbench.state.all();
  const errors = await relocbench.load(`errors/${set}/${pairset}`);
  const answers = await relocbench.load(`pairs/${set}/${pairset}`);
  const row = [...Array(errors.pairs).keys()].find((i) => !answers.pictured.includes(i));
  const [reference, query] = [errors.units.reference, errors.units.query].map((times) => times[row]);
  location.hash = `set=${set}&pairset=${pairset}&pair=${reference}-${query}`;
}"""


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset, and beside it results: identity, one that is right, one that is wrong or fails, one far away."""
    root = tmp_path_factory.mktemp("pairs")
    dataset = make_small_dataset(root / "dataset", frames=8, size=(160, 120))
    write_dataset_record(dataset_results(root / "results", dataset), dataset)
    failing = {pair_set.evaluated[0].key for pair_set in dataset.pair_sets()}

    def wrong(pair: Pair) -> Array | None:
        assert pair.T_query_ref is not None
        return None if pair.key in failing else FAULT @ pair.T_query_ref

    add_answers(root / "results", dataset, "identity", "identity", lambda pair: np.eye(4))
    add_answers(root / "results", dataset, "right", "right", lambda pair: pair.T_query_ref)
    add_answers(root / "results", dataset, "wrong", "wrong", wrong, message=HOSTILE, info=json.dumps(MATCHED))
    add_answers(root / "results", dataset, "far", "far", lambda pair: make_transform(np.eye(3), [80.0, 0.0, 0.0]))
    return root / "results"


def _boards(results: Path) -> Boards:
    return Boards(make_board(load_results(results, datasets=DatasetLookup(results))))


@pytest.fixture(scope="module")
def site(results: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_site(_boards(results), tmp_path_factory.mktemp("site") / "html", pairs=2).parent


@pytest.fixture(scope="module")
def numbers_only(results: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site of the same results where the dataset is not available."""
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    shutil.copytree(results, elsewhere / "results")
    return write_site(_boards(elsewhere / "results"), elsewhere / "html").parent


@pytest.mark.thorough
def test_the_worst_of_each_method_that_is_no_floor_are_chosen(results: Path) -> None:
    (dataset,) = _boards(results).tracking.datasets  # type: ignore[union-attr]
    methods = {method.label: method for method in dataset.entry.methods}
    errors = methods["wrong"].errors[ACROSS]
    chosen = chosen_pairs([methods["wrong"]], ACROSS, 1)
    assert errors.statuses.index("failed") in chosen
    assert len(chosen) <= 3
    drawn = chosen_pairs([methods["identity"]], ACROSS, 3)
    assert len(errors) // 2 in drawn
    assert len(drawn) in (3, 4)
    assert drawn == chosen_pairs([methods["identity"]], ACROSS, 3)
    assert chosen_pairs(list(methods.values()), ACROSS, 0) == []


def test_every_image_of_a_chosen_pair_is_written_once(site: Path) -> None:
    depths = {path.relative_to(site / "data" / "depths") for path in site.glob("data/depths/*/*/*.js")}
    images = {path.relative_to(site / "data" / "images") for path in site.glob("data/images/*/*/*.js")}
    assert depths
    assert depths < images
    assert {path.parts[1] for path in images} == {"summer__cam0", "winter__cam0"}
    assert {path.parts[1] for path in depths} == {"summer__cam0"}


def test_the_same_results_give_the_same_bytes(results: Path, site: Path, tmp_path: Path) -> None:
    again = write_site(_boards(results), tmp_path / "again", pairs=2).parent
    files = sorted(path.relative_to(site) for path in site.rglob("*") if path.is_file())
    assert files == sorted(path.relative_to(again) for path in again.rglob("*") if path.is_file())
    assert [path for path in files if (site / path).read_bytes() != (again / path).read_bytes()] == []


@pytest.mark.thorough
def test_pictures_of_pairs_that_are_no_longer_chosen_are_removed(results: Path, tmp_path: Path) -> None:
    write_site(_boards(results), tmp_path, pairs=1)
    assert list(tmp_path.glob("data/images/*/*/*.js"))
    write_site(_boards(results), tmp_path, pairs=0)
    assert not list(tmp_path.glob("data/images/*/*/*.js"))
    assert list(tmp_path.glob("data/pairs/*/*.js"))


def test_without_the_dataset_there_are_answers_but_no_truth_and_no_pictures(numbers_only: Path) -> None:
    (payload, *_) = numbers_only.glob("data/pairs/*/*.js")
    text = payload.read_text(encoding="utf-8")
    assert '"truth":null' in text
    assert '"pictured":[]' in text
    assert not (numbers_only / "data" / "images").exists()


def test_with_too_many_answers_only_the_chosen_pairs_have_poses(
    results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chosen_rows, "MOST_ROWS", 10)
    payloads: dict[str, Any] = {}

    def keep(site: Path, key: str, payload: object) -> Path:
        payloads[key] = payload
        return site / key

    monkeypatch.setattr(pair_page, "write_data", keep)
    board = _boards(results).tracking
    assert board is not None
    pair_page.write_pair_pages(board, tmp_path, pairs=1)
    for key, payload in payloads.items():
        if key.startswith("pairs/"):
            rows = payload["rows"]
            assert 0 < len(rows) < 8
            assert payload["pictured"] == list(range(len(rows)))
            assert len(base64.b64decode(payload["truth"][":f4"])) == len(rows) * 12 * 4
            assert len(base64.b64decode(payload["methods"]["right"]["poses"][":f4"])) == len(rows) * 12 * 4


def test_results_that_no_dataset_explains_still_have_pages_of_pairs(tmp_path: Path) -> None:
    results = MadeResults(tmp_path / "results", {WINTER: 6})
    results.write_dataset()
    results.add("good", {WINTER: made(3, 6, 0.05)})
    site = write_site(_boards(results.root), tmp_path / "html").parent
    assert (site / "pair.html").exists()
    assert len(list(site.glob("data/pairs/*/*.js"))) == 1


@pytest.mark.thorough
def test_the_command_line_says_how_many_pairs_have_images(results: Path, tmp_path: Path) -> None:
    told = relocbench("report", results, "--out", tmp_path / "none", "--pairs", 0, "--quiet")
    assert told.status == 0, told.err
    assert not (tmp_path / "none" / "data" / "images").exists()
    board = tmp_path / "board"
    told = relocbench("leaderboard", results, "--out", board, "--html", "--pairs", 1, "--quiet")
    assert told.status == 0, told.err
    assert list((board / "html").glob("data/images/*/*/*.js"))


def _open_list(page: Any, site: Path, label: str, pair_set: str = ACROSS) -> None:
    """Open the first pair, the worst one, of a method's list."""
    (of_set,) = site.glob("set-*.html")
    page.goto(f"{of_set.as_uri()}#table={pair_set}&method={label}&pairs=1")
    if (site / "data" / "images").exists():
        page.wait_for_selector("#list img[src^=data]")
    page.locator("#list a").first.click()
    page.wait_for_selector("#numbers tr")


def _correlation(page: Any, key: str) -> float:
    page.keyboard.press(key)
    return float(page.wait_for_selector("#agreement[data-correlation]").get_attribute("data-correlation"))


def _alpha(page: Any) -> float:
    """The share of the warped keyframe's canvas that shows something."""
    return float(
        page.evaluate(
            """() => {
              const c = document.getElementById("warp");
              const d = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
              return d.filter((v, i) => i % 4 === 3 && v).length / (d.length / 4);
            }"""
        )
    )


@pytest.mark.thorough
@needs_browser
def test_a_list_opens_a_pair_whose_warp_at_the_truth_agrees_best(page: Any, site: Path) -> None:
    _open_list(page, site, "wrong")
    page.keyboard.press("ArrowRight")  # the worst one has no pose
    page.locator("#place", has_text="2 of").wait_for()
    truth, answer, keyframe = (_correlation(page, key) for key in "tak")
    assert truth > 0.8
    assert truth > answer + 0.2
    assert truth > keyframe + 0.1
    page.locator("[data-pose=truth]").click()
    assert page.locator("[data-pose=truth]").get_attribute("aria-pressed") == "true"
    assert _alpha(page) > 0.6
    assert page.told == []


@pytest.mark.thorough
@needs_browser
def test_matches_are_drawn_of_methods_that_tell_them(page: Any, site: Path) -> None:
    _open_list(page, site, "wrong")
    page.locator("#matches svg").wait_for()
    lines = page.locator("#matches line")
    assert lines.count() == 3
    assert lines.first.get_attribute("stroke-dasharray")
    assert [lines.last.get_attribute(name) for name in ("x1", "y1", "x2", "y2")] == ["100", "100", "278", "100"]
    assert "2 that agree" in page.locator("#matches-about").inner_text()
    assert re.search(r"traversals/\w+/images/\w+/\d+\.png$", page.locator("#query-file").inner_text())
    page.locator("#method").select_option("right")
    page.wait_for_selector("#matches-section", state="hidden")
    assert page.told == []


@pytest.mark.thorough
@needs_browser
def test_the_slider_wipes_and_b_blinks(page: Any, site: Path) -> None:
    _open_list(page, site, "right")
    page.wait_for_selector("#agreement[data-correlation]")
    # Holes are hatched: the query below must not pass for the keyframe.
    alpha = (
        "node => node.getContext('2d').getImageData(0, 0, node.width, node.height).data.filter((_, i) => i % 4 === 3)"
    )
    assert page.locator("#warp").evaluate(f"node => ({alpha})(node).every((value) => value === 255)")
    page.locator("#wipe").fill("20")
    assert "80%" in page.locator("#warp").evaluate("node => node.style.clipPath")
    page.locator("#wipe").press("ArrowRight")  # moves the slider, not to the next pair
    assert "79%" in page.locator("#warp").evaluate("node => node.style.clipPath")
    assert "1 of" in page.locator("#place").inner_text()
    page.keyboard.press("b")
    assert not page.locator("#warp").is_visible()
    page.locator("#blink").click()
    assert page.locator("#warp").is_visible()
    assert page.told == []


@pytest.mark.thorough
@needs_browser
def test_arrows_walk_the_list_and_the_address_finds_the_pair_again(page: Any, site: Path) -> None:
    _open_list(page, site, "right", WITHIN)
    first = page.url
    assert page.locator("#previous").is_disabled()
    page.keyboard.press("ArrowRight")
    page.locator("#place", has_text="2 of").wait_for()
    second = page.url
    assert second != first
    page.goto("about:blank")
    page.goto(second)
    page.locator("#place", has_text="2 of").wait_for()
    page.keyboard.press("ArrowLeft")
    page.locator("#place", has_text="1 of").wait_for()
    every = int(page.locator("#place").inner_text().split()[2])
    page.locator("#pictured").check()
    assert 0 < int(page.locator("#place").inner_text().split()[2]) < every
    page.locator("#method").select_option("far")
    page.locator("#plan-key", has_text="outside").wait_for()
    assert "method=far" in page.url
    page.locator("#verdict .missed").wait_for()
    page.evaluate("location.hash += '&within=1000000,360'")  # the thresholds of the list that a pair is opened from
    page.locator("#verdict .found").wait_for()
    assert page.told == []


@pytest.mark.thorough
@needs_browser
@pytest.mark.parametrize("page", ["light", "dark"], indirect=True)
def test_a_message_is_shown_as_text_and_the_page_is_accessible(page: Any, site: Path) -> None:
    _open_list(page, site, "wrong")
    page.keyboard.press("a")
    page.wait_for_selector("#query-large")
    assert HOSTILE in page.locator("#numbers").inner_text()
    assert "taken over" not in page.title()
    for width in (1280, 390):
        page.set_viewport_size({"width": width, "height": 800})
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), width
        page.evaluate("Promise.all(document.getAnimations().map((each) => each.finished))")  # colours fade in
        assert serious_faults(page) == []
    assert page.told == []


@pytest.mark.thorough
@needs_browser
def test_without_images_the_page_says_how_to_bring_them(page: Any, numbers_only: Path, site: Path) -> None:
    _open_list(page, numbers_only, "right")
    page.locator("#none", has_text="--dataset FOLDER").wait_for()
    assert not page.locator("#pictures").is_visible()
    assert not page.locator("#thumbs").is_visible()
    assert page.locator("#plan svg").is_visible()
    _open_list(page, site, "right")  # its worst pair has images, others have none
    page.wait_for_selector("#thumbs", state="visible")
    page.evaluate(_GO_TO_ONE_WITHOUT_IMAGES)
    page.locator("#none p").wait_for()
    assert "larger --pairs" in page.locator("#none").inner_text()
    assert not page.locator("#thumbs").is_visible()
    page.goto((site / "pair.html").as_uri())
    page.locator("#note", has_text="shows one pair").wait_for()
    of_set = next(site.glob("set-*.html")).stem.removeprefix("set-")
    page.goto(f"{(site / 'pair.html').as_uri()}#set={of_set}&pairset={ACROSS}&pair=1-2&method=right")
    page.locator("#note", has_text="has no pair 1-2").wait_for()
    assert page.told == []


@pytest.mark.thorough
@needs_browser
def test_what_lies_outside_an_undistorted_image_is_not_compared(page: Any, site: Path) -> None:
    page.goto((site / "pair.html").as_uri())
    share, correlation = page.evaluate(
        """() => {
          const [warped, query] = [new ImageData(8, 8), new ImageData(8, 8)];
          for (let i = 0; i < 64; i++) {
            const outside = i % 8 < 4, value = (i * 37) % 200;
            warped.data.set([value, value, value, 255], 4 * i);
            query.data.set(outside ? [0, 0, 0, 0] : [value, value, value, 255], 4 * i);
          }
          const found = relocbench.warp.compare(warped, query);
          return [found.share, found.correlation];
        }"""
    )
    assert share == 0.5
    assert correlation == pytest.approx(1.0)
