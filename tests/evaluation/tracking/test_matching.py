"""Matching quality: what methods are asked, what is kept of it, and where it is shown."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest
from board_pages import board_pages
from forgery import reseal
from refusals import Notes, refused
from small_dataset import ACROSS, WITHIN, make_small_dataset

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.pairs.correspondence_file import read_correspondences
from relocbench.datasets.pairs.correspondences import Correspondences
from relocbench.errors import PredictionError
from relocbench.evaluation.common.results import MethodResults
from relocbench.evaluation.tables.matching import MATCHING as TABLE
from relocbench.evaluation.tables.matching import OFFSETS_PX, MatchingRow, summarize_matching
from relocbench.evaluation.tracking.check import check
from relocbench.evaluation.tracking.evaluate import EvaluateOptions, Report, evaluate_methods
from relocbench.evaluation.tracking.matching import PER_PAIR, draw_starts
from relocbench.evaluation.tracking.validation import validate_results
from relocbench.geometry import Camera
from relocbench.leaderboard import write_leaderboard
from relocbench.methods import parse_method
from relocbench.progress import Silent

pytestmark = pytest.mark.usefixtures("workers_kept")
MATCHING = "m=trackers_for_tests:Matching"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("data") / "small", correspondences=60, size=(160, 120))


def evaluate(
    dataset: Dataset,
    out: Path,
    *methods: str,
    settings: tuple[str, ...] = (),
    notes: Notes | None = None,
    **more: object,
) -> Report:
    options = {"workers": 0, "matching": True, **more}
    return evaluate_methods(
        EvaluateOptions(dataset=dataset.root, methods=methods, set=settings, out=out, **options),
        notes or Silent(),
    )


def correspondences(visible: int, hidden: int, width: int = 160, height: int = 120) -> Correspondences:
    rng = np.random.default_rng(0)
    n = visible + hidden
    uv_query = np.concatenate(
        [[[0.0, 0.0], [width - 1, height - 1]], rng.uniform(0, [width - 1, height - 1], (n - 2, 2))]
    )
    return Correspondences(
        np.zeros(n, dtype=np.int64),
        np.ones(n, dtype=np.int64),
        rng.uniform(0, 100, (n, 2)),
        np.ones(n),
        uv_query,
        np.arange(n) < visible,
        ("both",) * n,
    )


CAMERA = Camera("pinhole", 160, 120, 100, 100, 79.5, 59.5)


def test_each_visible_pixel_starts_once_off_the_truth_by_one_offset_and_on_the_image() -> None:
    known = correspondences(50, 30)
    starts = draw_starts(known, CAMERA, (1, 2))
    assert len(starts) == 50
    assert np.unique(starts.offset_px, return_counts=True)[1].tolist() == [10] * len(OFFSETS_PX)
    np.testing.assert_allclose(np.linalg.norm(starts.uv_start - starts.uv_query, axis=1), starts.offset_px, atol=1e-9)
    assert np.all((starts.uv_start >= 0) & (starts.uv_start <= [159, 119]))
    rows = {tuple(row) for row in np.column_stack([known.uv_ref, known.uv_query])[:50]}
    assert {tuple(row) for row in np.column_stack([starts.uv_ref, starts.uv_query])} == rows


def test_offsets_differ_by_one_pixel_at_most_and_say_nothing_of_the_place() -> None:
    counts = [len(draw_starts(correspondences(n, 2), CAMERA, (1, n)).offset_px) for n in (3, 4, 7)]
    assert counts == [3, 4, 7]
    of_each = [draw_starts(correspondences(7, 2), CAMERA, (1, key)).offset_px for key in range(40)]
    for offsets in of_each:
        per_offset = [int(np.sum(offsets == offset)) for offset in OFFSETS_PX]
        assert max(per_offset) - min(per_offset) == 1
    assert {int(offsets[0]) for offsets in of_each} == set(OFFSETS_PX), "the first pixel gets any offset"


def test_a_pixel_that_several_correspondences_have_is_asked_once() -> None:
    known = correspondences(50, 5)
    known.uv_ref[10:20] = known.uv_ref[10]
    starts = draw_starts(known, CAMERA, (1, 2))
    assert len(starts) == len(np.unique(starts.uv_ref, axis=0)) == 41


def test_starts_depend_on_the_pair_alone_and_are_bounded() -> None:
    known, camera = correspondences(1300, 5), CAMERA
    first, again, other = (draw_starts(known, camera, key) for key in ((1, 2), (1, 2), (1, 3)))
    assert len(first) == PER_PAIR
    np.testing.assert_array_equal(first.uv_start, again.uv_start)
    assert not np.array_equal(first.uv_start, other.uv_start)
    angle = np.arctan2(*(first.uv_start - first.uv_query).T)
    assert np.abs(np.mean(np.exp(1j * angle))) < 0.1, "directions go all around"
    assert len(draw_starts(replace(known, visible=np.zeros(1305, dtype=bool)), camera, (1, 2))) == 0


def test_a_method_that_stays_at_its_starts_scores_what_the_starts_score(dataset: Dataset, tmp_path: Path) -> None:
    folder = evaluate(dataset, tmp_path, MATCHING).folders[0]
    rows = TABLE.read(folder.matching(ACROSS))
    assert [r.key for r in rows[:: len(OFFSETS_PX)]] == [p.key for p in dataset.pair_set(ACROSS).pairs]
    for row in rows:
        known = read_correspondences(dataset.layout.correspondence_file(ACROSS), row.key)
        starts = draw_starts(known, CAMERA, row.key)
        asked = starts.offset_px == row.offset_px
        right = asked & (starts.uv_ref[:, 0] >= 80)
        assert (row.pixels, row.answered) == (asked.sum(), right.sum())
        assert row.within_1px == (right.sum() if row.offset_px <= 1 else 0)
        assert row.within_3px == (right.sum() if row.offset_px <= 3 else 0)
        assert row.start_within_3px == (row.pixels if row.offset_px <= 3 else 0)
    scores = folder.score_record().matching[ACROSS]["all"]
    answered, count = (sum(getattr(r, name) for r in rows) for name in ("answered", "pixels"))
    assert scores["all"]["answered"] == pytest.approx(answered / count)
    near = [r for r in rows if r.offset_px == 1]
    assert scores["1px"]["match@1px"] == pytest.approx(sum(f.answered for f in near) / sum(f.pixels for f in near))
    assert scores["4px"]["match@3px"] == 0.0
    assert set(folder.score_record().matching[WITHIN]) == {"all", "step_1", "step_2"}


@pytest.mark.thorough
def test_any_number_of_workers_measures_the_same(dataset: Dataset, tmp_path: Path) -> None:
    none, two = (evaluate(dataset, tmp_path / str(w), MATCHING, workers=w).folders[0] for w in (0, 2))
    for name in (ACROSS, WITHIN):
        assert none.matching(name).read_bytes() == two.matching(name).read_bytes()


def test_dso_finds_more_pixels_than_its_starts(dataset: Dataset, tmp_path: Path) -> None:
    near = evaluate(dataset, tmp_path, "dso", pair_sets=(WITHIN,)).folders[0].score_record().matching[WITHIN]["step_1"]
    assert near["2px"]["match@1px"] > 0.3  # type: ignore[operator]
    assert near["2px"]["match@1px"] > near["16px"]["match@1px"]  # type: ignore[operator]


def test_without_the_option_nothing_is_asked_and_what_was_measured_stays(dataset: Dataset, tmp_path: Path) -> None:
    folder = evaluate(dataset, tmp_path, MATCHING, matching=False).folders[0]
    assert not folder.matching(ACROSS).exists()
    assert folder.score_record().matching == {}
    measured = evaluate(dataset, tmp_path, MATCHING).folders[0].score_record()
    assert evaluate(dataset, tmp_path, MATCHING, matching=False).folders[0].score_record() == measured


def test_what_is_measured_is_not_asked_again_and_a_stopped_run_goes_on(dataset: Dataset, tmp_path: Path) -> None:
    log = tmp_path / "log"
    settings = (f"log={log}",)
    folder = evaluate(dataset, tmp_path, MATCHING, settings=settings).folders[0]
    asked, whole = log.read_text().splitlines(), folder.matching(ACROSS).read_bytes()
    evaluate(dataset, tmp_path, MATCHING, settings=settings)
    assert log.read_text().splitlines() == asked
    # As a killed run leaves it: some pairs in the journal, the last line torn.
    rows = TABLE.read(folder.matching(ACROSS))
    folder.matching(ACROSS).unlink()
    journal = folder.matching_journal(ACROSS)
    journal.mkdir(parents=True)
    kept = rows[: 2 * len(OFFSETS_PX)]
    lines = [_journal_line(kept[i : i + len(OFFSETS_PX)]) for i in (0, len(OFFSETS_PX))]
    (journal / "1-1.jsonl").write_text("".join(lines) + lines[0][:20])
    log.unlink()
    evaluate(dataset, tmp_path, MATCHING, settings=settings)
    done = {r.key for r in kept}
    assert {tuple(map(int, line.split()[:2])) for line in log.read_text().splitlines()} == {
        p.key for p in dataset.pair_set(ACROSS).pairs if p.key not in done
    }
    assert folder.matching(ACROSS).read_bytes() == whole
    assert not list(folder.root.glob(".journal*"))


def _journal_line(rows: list[MatchingRow]) -> str:
    return json.dumps({"key": list(rows[0].key), "found": [astuple(r)[3:-1] for r in rows], "message": ""}) + "\n"


def test_overwriting_everything_measures_again(dataset: Dataset, tmp_path: Path) -> None:
    evaluate(dataset, tmp_path, MATCHING)
    settings = ("moves_px=2.5",)
    with refused(PredictionError, "run.yaml"):
        evaluate(dataset, tmp_path, MATCHING, settings=settings)
    folder = evaluate(dataset, tmp_path, MATCHING, settings=settings, overwrite="always").folders[0]
    assert folder.score_record().matching[ACROSS]["all"]["1px"]["match@1px"] == 0.0


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        ("few", "match"),
        ("words", "str"),
        ("infinite", "infinite"),
    ],
)
def test_an_answer_that_breaks_the_contract_finds_nothing_and_is_told(
    dataset: Dataset, tmp_path: Path, answer: str, words: str
) -> None:
    report = evaluate(dataset, tmp_path, MATCHING, settings=(f"answer={answer}",), pair_sets=(ACROSS,))
    rows = TABLE.read(report.folders[0].matching(ACROSS))
    assert all(r.answered == 0 < r.pixels for r in rows)
    ((label, message),) = report.crashed
    assert label == "m"
    assert "match crashed on" in message
    assert re.search(words, message)


@pytest.mark.parametrize(
    ("how", "workers", "told"),
    [
        ("raises_at", 0, "ZeroDivisionError: on purpose"),
        pytest.param("dies_at", 1, "SIGKILL", marks=pytest.mark.thorough),
    ],
)
def test_a_pair_that_raises_or_kills_its_worker_costs_that_pair_alone(
    dataset: Dataset, tmp_path: Path, how: str, workers: int, told: str
) -> None:
    lost = dataset.pair_set(ACROSS).pairs[2].query_timestamp_ns
    report = evaluate(dataset, tmp_path, MATCHING, settings=(f"{how}={lost}",), pair_sets=(ACROSS,), workers=workers)
    for row in TABLE.read(report.folders[0].matching(ACROSS)):
        assert (told in row.message) == bool(row.message) == (row.key[1] == lost)
        assert (row.answered > 0) == (not row.message)


def test_methods_and_pair_sets_without_matching_are_told_and_left_out(dataset: Dataset, tmp_path: Path) -> None:
    notes = Notes()
    report = evaluate(dataset, tmp_path / "a", "identity", MATCHING, notes=notes)
    assert any("not measured without match(): identity" in note for note in notes.notes)
    assert not report.folders[0].matching(ACROSS).exists()
    assert list(report.to_dict()["matching"]) == ["m"]
    bare, notes = make_small_dataset(tmp_path / "bare"), Notes()
    report = evaluate(bare, tmp_path / "b", MATCHING, notes=notes)
    assert any(f"{ACROSS} has no correspondences" in note for note in notes.notes)
    assert report.folders[0].score_record().matching == {}


def test_files_of_predictions_cannot_be_asked(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="--matching"):
        EvaluateOptions(dataset=tmp_path, predictions=tmp_path, matching=True)


@pytest.mark.thorough
def test_the_leaderboard_shows_it_for_the_methods_that_have_it(dataset: Dataset, tmp_path: Path) -> None:
    report = evaluate(dataset, tmp_path / "r", "identity", "dso", MATCHING, pair_sets=())
    board = tmp_path / "b"
    write_leaderboard(tmp_path / "r", board)
    page = board_pages(board)
    section = page.split(f"## {ACROSS.replace('_', chr(92) + '_')}")[1].split("Matching quality")[1].split("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("| ")]
    assert lines[0] == "| method | all starts | 1 px off | 2 px off | 4 px off | 8 px off | 16 px off |"
    assert {line.split(" | ")[0] for line in lines[2:]} == {"| dso", "| m", "| *the starts themselves*"}
    assert "100.0 / 100.0 | 0.0 / 100.0 | 0.0 / 0.0" in lines[-1]
    assert "these numbers are not rescored" in section
    with (board / "matching.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert {(r["pair_set"], r["group"]) for r in rows} == {
        (ACROSS, "all"),
        (WITHIN, "all"),
        (WITHIN, "step_1"),
        (WITHIN, "step_2"),
    }
    (row,) = (r for r in rows if (r["pair_set"], r["method"], r["start"]) == (ACROSS, "dso", "2px"))
    recorded = report.folders[1].score_record().matching[ACROSS]["all"]["2px"]
    assert float(row["match@3px"]) == recorded["match@3px"]
    commands = [line for line in page.splitlines() if line.startswith("relocbench evaluate")]
    assert [("--matching" in line) for line in commands] == ["identity" not in line for line in commands]


def test_without_any_the_leaderboard_is_silent_about_it(dataset: Dataset, tmp_path: Path) -> None:
    evaluate(dataset, tmp_path / "r", "identity", matching=False)
    write_leaderboard(tmp_path / "r", tmp_path / "b")
    assert "Matching quality" not in board_pages(tmp_path / "b")
    assert not (tmp_path / "b" / "matching.csv").exists()


def test_a_table_that_is_not_what_the_scores_summarise_is_refused(dataset: Dataset, tmp_path: Path) -> None:
    folder = evaluate(dataset, tmp_path / "r", MATCHING).folders[0]
    rows = TABLE.read(folder.matching(ACROSS))
    better = replace(rows[0], within_1px=0, within_3px=0)
    TABLE.write(folder.matching(ACROSS), [better, *rows[1:]])
    with refused(PredictionError, folder.matching(ACROSS), None, "changed"):
        write_leaderboard(tmp_path / "r", tmp_path / "b")
    assert [f.path for f in validate_results(tmp_path / "r", dataset, Silent()).faults] == [folder.matching(ACROSS)]
    reseal(folder)
    with refused(PredictionError, folder.matching(ACROSS), None, "differs", "scores.yaml"):
        write_leaderboard(tmp_path / "r", tmp_path / "b")
    assert [f.path for f in validate_results(tmp_path / "r", dataset, Silent()).faults] == [folder.matching(ACROSS)]
    folder.matching(ACROSS).unlink()
    with refused(PredictionError, folder.matching(ACROSS), None, "missing", "scores.yaml"):
        write_leaderboard(tmp_path / "r", tmp_path / "b")
    assert [f.path for f in validate_results(tmp_path / "r", dataset, Silent()).faults] == [folder.matching(ACROSS)]
    TABLE.write(folder.matching(ACROSS), rows[1:])
    with refused(PredictionError, folder.matching(ACROSS), None, len(rows) // len(OFFSETS_PX), "one row"):
        evaluate(dataset, tmp_path / "r", MATCHING)


@pytest.mark.parametrize(
    ("change", "line", "names"),
    [
        ((",pixels,", ",count,"), 1, ("pixels",)),
        ((",1,60,", ",1,many,"), None, ("pixels", "many")),
        ((",1,60,", ",1,0,"), None, ("within_1px", "within_3px", "answered", "pixels")),
        ((",1,60,", ",60,"), None, (11, 10)),
    ],
)
def test_a_bad_table_is_named_with_its_line(
    dataset: Dataset, tmp_path: Path, change: tuple[str, str], line: int | None, names: tuple[object, ...]
) -> None:
    folder = evaluate(dataset, tmp_path / "r", MATCHING, pair_sets=(WITHIN,)).folders[0]
    path = folder.matching(WITHIN)
    text = path.read_text()
    first = TABLE.read(path)[0].pixels
    changed = text.replace(change[0].replace("60", str(first)), change[1], 1)
    assert changed != text
    path.write_text(changed)
    with refused(PredictionError, path.name, line, *names):
        TABLE.read(path)
    found = validate_results(folder.root, dataset, Silent())
    assert any(path.name in str(fault) for fault in found.faults)


def test_validate_accepts_a_folder_with_matching_quality(dataset: Dataset, tmp_path: Path) -> None:
    folder: MethodResults = evaluate(dataset, tmp_path / "r", MATCHING).folders[0]
    assert not validate_results(folder.root, dataset, Silent()).faults


def test_groups_are_summarised_by_their_own_pairs(dataset: Dataset, tmp_path: Path) -> None:
    rows = TABLE.read(evaluate(dataset, tmp_path, MATCHING).folders[0].matching(WITHIN))
    parts = [summarize_matching(rows, group)["all"]["count"] for group in ("step_1", "step_2")]
    assert sum(parts) == summarize_matching(rows)["all"]["count"]  # type: ignore[arg-type]
    assert summarize_matching([])["all"] == {"count": 0, **dict.fromkeys(("answered", *_shares()))}


def _shares() -> tuple[str, ...]:
    return ("match@1px", "match@3px", "start@1px", "start@3px")


@pytest.mark.thorough
def test_check_method_tries_match_where_it_is_offered() -> None:
    kept = [f for f in check(parse_method("dso")) if "match" in f.check]
    assert len(kept) >= 7
    assert all(f.passed for f in kept)
    assert not [f for f in check(parse_method("identity")) if "match" in f.check]
    few = [f for f in check(parse_method(MATCHING, ("answer=few",))) if "match" in f.check]
    assert not any(f.passed for f in few)
    (together,) = (f for f in check(parse_method("trackers_for_tests:MatchesTogether")) if "each pixel" in f.check)
    assert not together.passed
