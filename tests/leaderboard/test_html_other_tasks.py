"""The pages of retrievers and of pipelines: what is written for them, and how they behave in a browser."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser_pages import needs_browser, serious_faults
from pipelines_for_tests import lists
from small_dataset import ACROSS, make_small_dataset
from small_views import make_small_views

from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.evaluation.relocalization.evaluate import RelocalizationOptions, evaluate_pipelines
from relocbench.evaluation.retrieval.evaluate import RetrievalOptions, evaluate_retrievers
from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods
from relocbench.leaderboard import load_results, make_board
from relocbench.leaderboard.boards import Boards
from relocbench.leaderboard.common.by_query import load_board
from relocbench.leaderboard.html import links
from relocbench.leaderboard.html.chosen import worst_and_drawn
from relocbench.leaderboard.html.pipeline_pages.payloads import PipelinePages
from relocbench.leaderboard.html.pipeline_pages.queries import retrieval_seconds
from relocbench.leaderboard.html.retrieval_pages.queries import RankedQueries, distances_of, kept_lists
from relocbench.leaderboard.html.site import write_site
from relocbench.leaderboard.html.thumbnails import small, thumbnail_name
from relocbench.leaderboard.relocalization.board import RELOCALIZATION, Pipeline, PipelineBoard
from relocbench.leaderboard.retrieval.board import RETRIEVAL, RetrievalBoard, Retriever
from relocbench.metrics import chance_level
from relocbench.progress import Silent

FRAMES = 8
HOSTILE = "<script>document.title='taken over'</script>"
PLACE = "<script>alert(1)"
HERE = "retrievers_for_tests"
S2D = "satellite-drone"
NEAR = "near+knows.top2"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of all three tasks on drives and of retrievers on views, one of whose places has a hostile name."""
    root = tmp_path_factory.mktemp("made")
    dataset = make_small_dataset(root / "data" / "small", frames=FRAMES, size=(32, 24))
    views = make_small_views(root / "data" / "views", places=6)
    for folder in (views / "test").iterdir():
        (folder / "0003").rename(folder / PLACE)
    near = lists(dataset, root / "near", [[q, (q + 5) % FRAMES] for q in range(FRAMES)])
    ask = RelocalizationOptions(
        dataset=dataset.root,
        out=root / "results",
        retriever=("oracle", f"near=predictions:{near}"),
        methods=("knows=pipelines_for_tests:Knows",),
        set=("knows.reach=0", "knows.beyond=fail"),
        top=2,
        workers=0,
    )
    evaluate_pipelines(ask, Silent())
    named = {"dataset": dataset.root, "out": root / "results", "workers": 0}
    evaluate_methods(EvaluateOptions(**named, methods=("identity",), pair_sets=(ACROSS,)), Silent())
    evaluate_retrievers(RetrievalOptions(**named, methods=(f"thumb={HERE}:Thumbnail",), radius=0.2), Silent())
    given = {**named, "dataset": views, "methods": (f"thumb={HERE}:Thumbnail", f"same={HERE}:Constant")}
    evaluate_retrievers(RetrievalOptions(**given), Silent())
    return root


def _boards(made: Path, *, lookup: bool = True) -> Boards:
    results = made / "results"
    asked: dict[str, Any] = {"datasets": DatasetLookup(results, [made / "data"] if lookup else [])}
    entries = load_results(results, **asked)
    return Boards(
        make_board(entries), load_board(RETRIEVAL, results, **asked), load_board(RELOCALIZATION, results, **asked)
    )


def _hostile(boards: Boards) -> Boards:
    """The same boards with a retriever and a chain of a hostile name."""
    assert boards.retrieval is not None
    assert boards.relocalization is not None

    def renamed(method: Any) -> Any:
        return replace(method, label=HOSTILE) if method.label in ("same", "oracle+knows.top2") else method

    def of_hostile(board: Any) -> Any:
        sets = []
        for of in board.sets:
            tables = [replace(t, rows=tuple(replace(r, method=renamed(r.method)) for r in t.rows)) for t in of.tables]
            sets.append(replace(of, methods=tuple(map(renamed, of.methods)), tables=tuple(tables)))
        return replace(board, sets=tuple(sets))

    return Boards(boards.tracking, of_hostile(boards.retrieval), of_hostile(boards.relocalization))


@pytest.fixture(scope="module")
def boards(made: Path) -> Boards:
    return _boards(made)


@pytest.fixture(scope="module")
def retrieval(boards: Boards) -> RetrievalBoard:
    assert boards.retrieval is not None
    return boards.retrieval


@pytest.fixture(scope="module")
def pipelines(boards: Boards) -> PipelineBoard:
    assert boards.relocalization is not None
    return boards.relocalization


@pytest.fixture(scope="module")
def site(boards: Boards, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_site(_hostile(boards), tmp_path_factory.mktemp("site") / "html", pairs=2).parent


def _payload(site: Path, key: str) -> Any:
    text = (site / links.data_file(key)).read_text(encoding="utf-8")
    return json.loads(re.sub(r"^relocbench_data\(\"[^\"]*\",|\);\n$", "", text))


def _set(board: RetrievalBoard, part: str) -> Any:
    return next(asked for asked in board.sets if part in asked.record.name)


@pytest.mark.thorough
def test_no_page_and_no_payload_has_a_foreign_name_as_markup(site: Path) -> None:
    for path in [*site.glob("*.html"), *site.glob("data/**/*.js")]:
        assert HOSTILE not in path.read_text(encoding="utf-8"), path.name
        assert PLACE not in path.read_text(encoding="utf-8"), path.name


@pytest.mark.thorough
def test_the_same_boards_give_the_same_bytes(boards: Boards, site: Path, tmp_path: Path) -> None:
    again = write_site(_hostile(boards), tmp_path / "again", pairs=2).parent
    files = sorted(path.relative_to(site) for path in site.rglob("*") if path.is_file())
    assert files == sorted(path.relative_to(again) for path in again.rglob("*") if path.is_file())
    assert [path for path in files if (site / path).read_bytes() != (again / path).read_bytes()] == []


def test_every_file_of_the_site_is_listed_and_goes_with_its_results(boards: Boards, tmp_path: Path) -> None:
    write_site(boards, tmp_path, pairs=1)
    written = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()}
    listed = (tmp_path / "files.txt").read_text().splitlines()[1:]
    assert set(listed) == written - {"files.txt"}
    write_site(Boards(boards.tracking), tmp_path)
    assert not [
        *tmp_path.glob("retrieval-*"),
        *tmp_path.glob("relocalization-*"),
        *tmp_path.glob("data/thumbnails/*/*"),
    ]


def test_chance_is_the_one_of_the_tables_at_the_depths_that_both_have(retrieval: RetrievalBoard) -> None:
    asked = _set(retrieval, "views")
    task = asked.truth.tasks[S2D]
    depths, recall = RankedQueries(asked, S2D).answers()["chance"]
    expected = chance_level(task.relevance, ["R@1", "R@5", "R@10"])
    for depth in (1, 5, 10):
        assert recall[depths.index(depth)] == pytest.approx(expected[f"R@{depth}"], abs=1e-6)
    assert recall[-1] == 1.0


def test_rankings_made_elsewhere_end_where_their_lists_do(retrieval: RetrievalBoard) -> None:
    """The lists of ``near`` have two keyframes of eight, those of ``thumb`` all."""
    pairs, radius = _set(retrieval, "places-pairs"), _set(retrieval, "places-0.2m")
    assert kept_lists(pairs, pairs.methods[0], ACROSS).depth == 2
    assert kept_lists(radius, radius.methods[0], ACROSS).depth is None


def test_the_first_image_is_as_far_as_the_poses_say(retrieval: RetrievalBoard) -> None:
    """Frames are 0.15 m apart along the road, and winter is 0.12 m beside summer."""
    for part in ("places-pairs", "places-0.2m"):
        distances = distances_of(_set(retrieval, part).truth, ACROSS)
        assert distances is not None
        gap = np.abs(np.arange(FRAMES)[:, None] - np.arange(FRAMES)) * 0.15
        assert distances.metres == pytest.approx(np.hypot(gap, 0.12), abs=1e-3)
        assert distances.nearest == pytest.approx(np.full(FRAMES, 0.12), abs=1e-3)
    assert distances_of(_set(retrieval, "views").truth, S2D) is None


def test_right_images_are_marked_with_and_without_the_dataset(made: Path, retrieval: RetrievalBoard) -> None:
    without = _boards(made, lookup=False).retrieval
    assert without is not None
    for part, task in (("places-pairs", ACROSS), ("views", S2D)):
        known, told = _set(retrieval, part), _set(without, part)
        assert told.truth is None
        for method, other in zip(known.methods, told.methods, strict=True):
            marks = kept_lists(known, method, task).right
            assert marks == kept_lists(told, other, task).right
            found = [one for one, answer in zip(marks, method.answers[task], strict=True) if answer.ranks[:1] == (1,)]
            assert all(one[0] for one in found)


def test_the_worst_queries_of_each_method_that_is_no_baseline_are_chosen(retrieval: RetrievalBoard) -> None:
    asked = _set(retrieval, "views")
    same = next(m for m in asked.methods if m.label == "same")
    first = np.array([answer.ranks[0] for answer in same.answers[S2D]])
    how_bad = RankedQueries(replace(asked, methods=(same,)), S2D).how_bad()
    assert int(np.argmax(first)) in worst_and_drawn(how_bad, len(first), 1)
    baseline: Retriever = replace(same, run=same.run.model_copy(update={"target": "random"}))
    assert RankedQueries(replace(asked, methods=(baseline,)), S2D).how_bad() == []
    assert len(worst_and_drawn([], len(first), 2)) == 2
    assert worst_and_drawn(how_bad, len(first), 0) == []


def test_each_picture_is_written_once_and_is_small(site: Path, retrieval: RetrievalBoard) -> None:
    asked = _set(retrieval, "views")
    payload = _payload(site, f"lists/{links.set_id(asked.record)}/{S2D}")
    names = {name for name in [*payload["pictures"], *payload["queries"].values()] if name}
    there = {path.stem for path in site.glob(f"data/thumbnails/{links.set_id(asked.record)}/*.js")}
    assert names
    assert names <= there
    assert small(np.zeros((900, 1200, 3), dtype=np.uint8)).shape == (210, 280, 3)
    assert small(np.zeros((24, 32), dtype=np.uint8)).shape == (24, 32)
    assert thumbnail_name(PLACE) != thumbnail_name(PLACE + "2")


def test_shares_of_a_pipeline_add_up(pipelines: PipelineBoard) -> None:
    (asked,) = pipelines.sets
    payload = PipelinePages().payload(pipelines, asked)
    for table in payload["tables"]:
        for row in table["rows"]:
            assert sum(row["values"][name] for name in payload["losses"]) == pytest.approx(1.0)


def test_the_keyframes_of_a_pipeline_and_their_errors_are_those_of_its_table(
    site: Path, pipelines: PipelineBoard
) -> None:
    (asked,) = pipelines.sets
    pipeline: Pipeline = next(c for c in asked.methods if c.label == NEAR)
    told = _payload(site, f"candidates/{links.set_id(asked.record)}/{ACROSS}")["pipelines"][NEAR]
    for answer, keyframes in zip(pipeline.answers[ACROSS], told, strict=True):
        assert len(keyframes) == answer.asked == 2
        hits = [rank for rank, one in enumerate(keyframes, start=1) if one[3]]
        assert (hits[0] if hits else None) == answer.hit_rank
        kept = [one for one in keyframes if one[0] == str(answer.ref_timestamp_ns)]
        assert [float(one[6]) for one in kept] == pytest.approx([answer.translation_error_m] * len(kept))


def test_seconds_of_both_stages_part_only_where_the_rankings_are_those_of_the_pipeline(
    made: Path, boards: Boards, tmp_path: Path
) -> None:
    shutil.copytree(made / "results", tmp_path / "results")
    run = next(tmp_path.glob("results/*.places-pairs@*/near/run.yaml"))
    run.write_text(run.read_text().replace("predictions:", "predictions:other/"))
    changed = load_board(RELOCALIZATION, tmp_path / "results", datasets=DatasetLookup(tmp_path / "results"))
    assert changed is not None
    assert boards.relocalization is not None
    for board, there in ((boards.relocalization, True), (changed, False)):
        (asked,) = board.sets
        pipeline = next(c for c in asked.methods if c.label == NEAR)
        oracle = next(c for c in asked.methods if c.run.retriever == "oracle")
        assert (retrieval_seconds(pipeline, ACROSS) is not None) == there
        assert retrieval_seconds(oracle, ACROSS) is None


def test_sets_and_methods_of_all_tasks_are_counted(boards: Boards, site: Path) -> None:
    assert boards.sets == len([*site.glob("set-*"), *site.glob("retrieval-*"), *site.glob("relocalization-*")]) == 5
    assert boards.methods == {"identity", "near", "same", "thumb"}
    assert len([*site.glob("method-*")]) == len(boards.methods)


def test_a_method_page_has_its_results_as_a_retriever_and_in_pipelines(site: Path) -> None:
    page = (site / "method-near.html").read_text(encoding="utf-8")
    assert "As a retriever" in page
    assert "In full pipelines" in page
    assert "Numbers on all sets" not in page
    assert "relocbench evaluate-retrieval" in page


def _open(page: Any, site: Path, pattern: str, state: str = "") -> None:
    (found,) = site.glob(pattern)
    page.goto("about:blank")
    page.goto(found.as_uri() + state)


@pytest.mark.thorough
@needs_browser
@pytest.mark.parametrize(
    ("page", "pattern", "charts"),
    [
        ("light", "retrieval-*0.2m*.html", ("recall", "distance", "heat")),
        ("dark phone", "relocalization-*.html", ("losses", "curves", "clock", "heat")),
    ],
    indirect=["page"],
)
def test_pages_open_from_the_disk_fit_their_window_and_are_accessible(
    page: Any, site: Path, pattern: str, charts: tuple[str, ...]
) -> None:
    _open(page, site, pattern)
    for chart in charts:
        page.locator(f"#{chart}").scroll_into_view_if_needed()
        page.wait_for_selector(f"#{chart} .main-svg")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert serious_faults(page) == []
    page.locator("#methods button.cell").first.click()
    page.locator("#list a").first.click()
    page.wait_for_selector("#numbers tr")
    page.wait_for_function("document.images.length && [...document.images].every((image) => image.naturalWidth)")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert serious_faults(page) == []


@pytest.mark.thorough
@needs_browser
def test_the_queries_of_a_hostile_method_are_listed_worst_first_and_walked_through(page: Any, site: Path) -> None:
    _open(page, site, "retrieval-views-*.html", f"#table={S2D}")
    page.locator("#methods tbody tr", has_text=HOSTILE).locator("button.cell").first.click()
    ranks = [int(text) for text in page.locator("#list tbody tr td:nth-child(4)").all_inner_texts()]
    assert ranks == sorted(ranks, reverse=True)
    assert page.locator("#list tbody", has_text=PLACE).count() == 1
    page.locator("#list a").first.click()
    page.locator("#place", has_text="1 of 6").wait_for()
    assert page.locator("#top .card").count() == 5
    assert f"rank {ranks[0]} of 12" in page.locator("#verdict").inner_text()
    page.keyboard.press("ArrowRight")
    page.locator("#place", has_text="2 of 6").wait_for()
    page.keyboard.press("m")
    page.wait_for_function("document.getElementById('method').value === 'thumb'")
    address = page.url
    assert "method=thumb" in address
    assert page.locator("#right .card").count() == 2
    assert page.told == []
    page.goto("about:blank")
    page.goto(address)
    page.wait_for_selector("#numbers tr")
    assert page.locator("#method").input_value() == "thumb"
    assert page.title() != "taken over"


@pytest.mark.thorough
@needs_browser
def test_recall_is_drawn_to_the_end_of_each_ranking(page: Any, site: Path) -> None:
    _open(page, site, "retrieval-*pairs*.html")
    page.wait_for_selector("#recall .main-svg")
    ends = page.evaluate("document.getElementById('recall').data.map((one) => [one.name, one.x.at(-1), one.y[0]])")
    assert ends[0] == ["near", 2, 100.0]
    assert ends[1][:2] == ["chance", FRAMES]
    assert page.told == []


@pytest.mark.thorough
@needs_browser
def test_the_page_of_a_located_query_says_what_it_was_lost_to_and_links_the_pair(page: Any, site: Path) -> None:
    _open(page, site, "relocalization-*.html", f"#table={ACROSS}")
    page.locator("#methods tbody tr", has_text="keyframe-pose").first.locator("button.cell").first.click()
    page.wait_for_selector("#list-dialog[open]")
    page.locator("#list a").first.click()
    page.wait_for_selector("#asked tr")
    page.locator("#method").select_option(NEAR)
    page.wait_for_function("location.hash.includes('near')")
    assert page.locator("#verdict").inner_text() == "Right: within 0.25 m and 2°."
    first = page.locator("#asked tr").first
    assert first.locator("td").nth(4).inner_text() == "yes"
    first.locator("a").click()
    page.wait_for_selector("#numbers tr")
    assert "pair.html#set=" in page.url
    assert page.told == []
