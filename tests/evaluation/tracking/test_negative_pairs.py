"""Pairs of different places, from the dataset to the leaderboard: asked like others, and counted for themselves."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from board_pages import board_pages
from command_line import relocbench
from forgery import change_yaml, forge_errors, reseal
from refusals import refused
from small_dataset import ACROSS, make_small_dataset

from relocbench.datasets.core import fingerprint
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_table import write_pairs
from relocbench.datasets.core.pairfile import ELSEWHERE, PoseLine, write_pose_lines
from relocbench.datasets.inspect.summary import take_inventory
from relocbench.datasets.learning.training_pairs import DatasetPairs
from relocbench.datasets.pairs.correspondence_file import read_correspondences
from relocbench.errors import PredictionError
from relocbench.evaluation.common.dataset_lookup import DatasetLookup
from relocbench.evaluation.common.results import MethodResults
from relocbench.evaluation.tables.answers import ANSWERS, Answer, read_answers
from relocbench.evaluation.tables.errors import PairErrors, read_errors
from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods
from relocbench.evaluation.tracking.exports import export_poses
from relocbench.evaluation.tracking.validation import validate_results
from relocbench.leaderboard import load_results, write_leaderboard
from relocbench.progress import Silent

pytestmark = pytest.mark.usefixtures("workers_kept")
COUNT = 6


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    root = tmp_path_factory.mktemp("data") / "small"
    return make_small_dataset(root, frames=8, elsewhere=COUNT, correspondences=50)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """The same dataset without pairs of different places."""
    return make_small_dataset(tmp_path_factory.mktemp("data") / "small", frames=8, correspondences=50)


def evaluate(dataset: Dataset, out: Path, *methods: str, **options: object) -> list[MethodResults]:
    chosen = {"workers": 0, **options}
    return evaluate_methods(EvaluateOptions(dataset=dataset.root, methods=methods, out=out, **chosen), Silent()).folders


def confidently(dataset: Dataset, folder: Path, *, right: int = 0) -> Path:
    """Predictions made elsewhere: of the pairs of different places, two are sure, one is not, one says nothing."""
    folder.mkdir()
    confidences = {0: 0.9, 1: 0.5, 2: 0.49, 3: None}
    pair_set = dataset.pair_set(ACROSS)
    lines, answers = [], []
    for place, pair in enumerate(pair_set.negative_pairs):
        if place not in confidences:
            answers.append(Answer(*pair.key, "failed"))
            continue
        lines.append(PoseLine(*pair.key, pair.T_query_ref if place < right else np.eye(4)))
        answers.append(Answer(*pair.key, "ok", confidence=confidences[place]))
    lines += [PoseLine(*pair.key, pair.T_query_ref) for pair in pair_set.pairs]
    answers += [Answer(*pair.key, "ok", confidence=1.0) for pair in pair_set.pairs]
    write_pose_lines(folder / f"{ACROSS}.txt", lines)
    ANSWERS.write(folder / f"{ACROSS}.csv", answers)
    return folder


@pytest.mark.thorough
def test_all_pairs_are_asked_and_no_other_score_counts_those_of_different_places(
    dataset: Dataset, plain: Dataset, tmp_path: Path
) -> None:
    with_them = evaluate(dataset, tmp_path / "with", "identity", "clock", "orb-pnp")
    without = evaluate(plain, tmp_path / "without", "identity", "clock", "orb-pnp")
    asked = {p.key for p in dataset.pair_set(ACROSS).evaluated}
    assert len(asked) == len(plain.pair_set(ACROSS).pairs) + COUNT
    for ours, theirs in zip(with_them, without, strict=True):
        assert read_answers(ours.answers(ACROSS)).keys() == asked
        for groups in (ours.score_record().pair_sets, theirs.score_record().pair_sets):
            for name in ("median_seconds", "p95_seconds"):
                groups[ACROSS]["all"].pop(name)
        assert ours.score_record().pair_sets[ACROSS].keys() == {"all"}
        a, b = (f.score_record().pair_sets[ACROSS]["all"] for f in (ours, theirs))
        assert {k: v for k, v in a.items() if "seconds" not in k} == {k: v for k, v in b.items() if "seconds" not in k}
        assert theirs.score_record().elsewhere == {}
        assert ours.score_record().elsewhere.keys() == {ACROSS}
    identity = with_them[0].score_record().elsewhere[ACROSS]
    assert identity == {
        "pairs": COUNT,
        "answered": COUNT,
        "confident": COUNT,
        "answered_share": 1.0,
        "confident_share": 1.0,
        "confident_high": 1.0,
    }


@pytest.mark.thorough
def test_a_wrong_answer_counts_unless_its_confidence_is_small(dataset: Dataset, tmp_path: Path) -> None:
    theirs = confidently(dataset, tmp_path / "mine")
    (folder,) = evaluate(dataset, tmp_path / "out", predictions=theirs)
    found = folder.score_record().elsewhere[ACROSS]
    assert (found["pairs"], found["answered"], found["confident"]) == (COUNT, 4, 3)
    assert folder.score_record().pair_sets[ACROSS]["all"]["recall@(0.25m,2deg)"] == 1.0
    (folder,) = evaluate(dataset, tmp_path / "right", predictions=confidently(dataset, tmp_path / "guess", right=1))
    assert folder.score_record().elsewhere[ACROSS]["confident"] == 2, "an answer that is right is not held against it"


def test_the_bound_without_any_confident_answer_is_clopper_and_pearsons(dataset: Dataset, tmp_path: Path) -> None:
    folder = tmp_path / "silent"
    folder.mkdir()
    write_pose_lines(folder / f"{ACROSS}.txt", [])
    (made,) = evaluate(dataset, tmp_path / "out", predictions=folder)
    assert made.score_record().elsewhere[ACROSS]["confident_high"] == pytest.approx(1 - 0.025 ** (1 / COUNT))


@pytest.mark.thorough
def test_the_leaderboard_shows_them_and_computes_them_anew(dataset: Dataset, tmp_path: Path) -> None:
    evaluate(dataset, tmp_path / "out", "identity", "clock")
    evaluate(dataset, tmp_path / "out", predictions=confidently(dataset, tmp_path / "mine"))
    for name, named in (("claimed", ()), ("rescored", (dataset.root,))):
        lookup = DatasetLookup(tmp_path / "out", named)
        write_leaderboard(tmp_path / "out", tmp_path / name, datasets=lookup)
        with (tmp_path / name / "leaderboard.csv").open(newline="", encoding="utf-8") as stream:
            rows = {(r["pair_set"], r["method"]): r for r in csv.DictReader(stream) if r["split"] != "all"}
        for place in (ACROSS, "total"):
            mine = rows[place, "mine"]
            assert (mine["pairs"], mine["elsewhere"]) == (str(len(dataset.pair_set(ACROSS).pairs)), str(COUNT))
            assert float(mine["elsewhere_answered"]) == pytest.approx(4 / COUNT)
            assert float(mine["elsewhere_confident"]) == pytest.approx(3 / COUNT)
            assert float(mine["elsewhere_confident_high"]) > 3 / COUNT
            assert float(mine["coverage"]) == 1.0
        page = board_pages(tmp_path / name)
        assert "| elsewhere | elsewhere_answered, % | elsewhere_confident, % | elsewhere_confident_high, % |" in page
        with (tmp_path / name / "errors.csv").open(newline="", encoding="utf-8") as stream:
            groups = [row["group"] for row in csv.DictReader(stream) if row["method"] == "mine"]
        assert groups.count(ELSEWHERE) == COUNT
    outcome = relocbench("evaluate", "-d", dataset.root, "-m", "identity", "-o", tmp_path / "out", "-j", 0)
    assert f"{COUNT} negative pairs" in outcome.out
    told = json.loads(
        relocbench("evaluate", "-d", dataset.root, "-m", "identity", "-o", tmp_path / "o", "-j", 0, "--json").out
    )
    assert told["elsewhere"]["identity"][ACROSS]["pairs"] == COUNT


@pytest.mark.thorough
def test_a_page_without_them_does_not_speak_of_them(plain: Dataset, tmp_path: Path) -> None:
    evaluate(plain, tmp_path / "out", "identity")
    write_leaderboard(tmp_path / "out", tmp_path / "board")
    assert "different places" not in board_pages(tmp_path / "board")


def test_forged_numbers_and_groups_are_refused(dataset: Dataset, tmp_path: Path) -> None:
    (honest,) = evaluate(dataset, tmp_path / "out", predictions=confidently(dataset, tmp_path / "mine"))
    assert not validate_results(tmp_path / "out", dataset, Silent()).faults

    def copy(name: str) -> MethodResults:
        shutil.copytree(tmp_path / "out", tmp_path / name)
        return MethodResults(tmp_path / name / honest.root.parent.name / honest.label)

    summary = copy("summary")
    change_yaml(summary.scores_yaml, lambda scores: scores["elsewhere"][ACROSS].update(confident=0))
    with refused(PredictionError, summary.errors(ACROSS), None, "confident", "3 here", "0 in scores.yaml"):
        load_results(tmp_path / "summary")

    def claims_failure(row: PairErrors) -> PairErrors:
        return PairErrors(**{**vars(row), "confidence": 0.1 if row.group == ELSEWHERE else row.confidence})

    errors = copy("errors")
    forge_errors(errors, ACROSS, claims_failure)
    change_yaml(
        errors.scores_yaml,
        lambda scores: scores["elsewhere"].update(
            {ACROSS: read_errors(errors.errors(ACROSS)).different_places.to_dict()}
        ),
    )
    reseal(errors)
    load_results(tmp_path / "errors")
    with refused(PredictionError, errors.errors(ACROSS), None, "confidence", 0.1, 0.9):
        load_results(tmp_path / "errors", datasets=DatasetLookup(tmp_path / "errors", [dataset.root]))

    record = copy("record")
    change_yaml(
        record.root.parent / "dataset.yaml",
        lambda values: values["pair_sets"][ACROSS].update(elsewhere=COUNT - 1, pairs=1),
    )
    with refused(PredictionError, record.errors(ACROSS), None, f"{COUNT} pairs"):
        load_results(tmp_path / "record")


@pytest.mark.thorough
def test_results_of_versions_that_knew_no_different_places_are_read(plain: Dataset, tmp_path: Path) -> None:
    (folder,) = evaluate(plain, tmp_path / "out", "identity")
    change_yaml(folder.scores_yaml, lambda scores: scores.pop("elsewhere"))
    change_yaml(
        folder.root.parent / "dataset.yaml", lambda values: [s.pop("elsewhere") for s in values["pair_sets"].values()]
    )
    (entry,) = load_results(tmp_path / "out", datasets=DatasetLookup(tmp_path / "out", [plain.root]))
    assert entry.methods[0].rescored
    assert not validate_results(tmp_path / "out", plain, Silent()).faults


@pytest.mark.thorough
def test_nothing_else_uses_them(dataset: Dataset, tmp_path: Path) -> None:
    apart = {p.key for p in dataset.pair_set(ACROSS).negative_pairs}
    assert len(apart) == COUNT
    rows = read_correspondences(dataset.layout.correspondence_file(ACROSS))
    assert not apart & set(zip(rows.ref_timestamp_ns.tolist(), rows.query_timestamp_ns.tolist(), strict=True))
    assert all(p.overlap is None for p in dataset.pair_set(ACROSS).negative_pairs)
    splits = {"train": [ACROSS]}
    train = make_small_dataset(tmp_path / "d", frames=8, elsewhere=COUNT, correspondences=50, splits=splits)
    assert len(DatasetPairs([train.root], "train")) == len(train.pair_set(ACROSS).pairs)
    (found,) = (s for s in take_inventory(dataset).pair_sets if s.name == ACROSS)
    assert (found.pairs, found.elsewhere) == (len(dataset.pair_set(ACROSS).pairs), COUNT)
    assert found.distance_m is not None
    assert found.distance_m.greatest < 0.3
    evaluate(dataset, tmp_path / "out", "identity")
    (zipped,) = export_poses(dataset, [ACROSS], "tum", tmp_path / "tum", tmp_path / "out", "identity")
    queries = {p.query_timestamp_ns for p in dataset.pair_set(ACROSS).pairs}
    assert len(zipped.read_text().splitlines()) == len(queries)
    outcome = relocbench("validate", dataset.root)
    assert outcome.status == 0, outcome.err


def test_matching_is_measured_on_pairs_of_one_place(dataset: Dataset, tmp_path: Path) -> None:
    (folder,) = evaluate(dataset, tmp_path / "out", "m=trackers_for_tests:Matching", matching=True, pair_sets=(ACROSS,))
    with folder.matching(ACROSS).open(newline="", encoding="utf-8") as stream:
        keys = {(int(r["ref_timestamp_ns"]), int(r["query_timestamp_ns"])) for r in csv.DictReader(stream)}
    assert keys == {p.key for p in dataset.pair_set(ACROSS).pairs}
    (entry,) = load_results(tmp_path / "out", datasets=DatasetLookup(tmp_path / "out", [dataset.root]))
    assert entry.methods[0].matching


def test_the_floor_of_times_is_not_fitted_to_them(dataset: Dataset, plain: Dataset, tmp_path: Path) -> None:
    (ours,), (theirs,) = (evaluate(d, tmp_path / str(i), "clock") for i, d in enumerate((dataset, plain)))
    of_one_place = theirs.predictions(ACROSS).read_text().splitlines()
    assert set(of_one_place) < set(ours.predictions(ACROSS).read_text().splitlines())


@pytest.mark.thorough
def test_withheld_truth_does_not_say_which_pairs_they_are(tmp_path: Path) -> None:
    withheld = make_small_dataset(tmp_path / "d", frames=8, elsewhere=COUNT, truth=False)
    pair_set = withheld.pair_set(ACROSS)
    assert {(p.group, p.overlap, p.scale_change, p.source, p.distance_m) for p in pair_set.evaluated} == {
        ("", None, None, pair_set.evaluated[0].source, None)
    }
    assert len(pair_set.pairs) == len(pair_set.evaluated)
    assert relocbench("validate", withheld.root).status == 0
    (folder,) = evaluate(withheld, tmp_path / "out", "identity")
    assert len(read_answers(folder.answers(ACROSS))) == len(pair_set.evaluated)
    table = withheld.layout.pair_table(ACROSS)
    table.write_text(table.read_text().replace(",,", f",{ELSEWHERE},", 1))
    outcome = relocbench("validate", withheld.root)
    assert "the group says that it is a negative pair" in outcome.out + outcome.err


def test_only_datasets_with_them_have_the_second_format(dataset: Dataset, plain: Dataset, tmp_path: Path) -> None:
    assert (dataset.file.format_version, plain.file.format_version) == (2, 1)
    shutil.copytree(dataset.root, tmp_path / "d", symlinks=True)
    path = tmp_path / "d" / "dataset.yaml"
    path.write_text(path.read_text().replace("format_version: 2", "format_version: 1"))
    outcome = relocbench("validate", tmp_path / "d")
    assert "format_version 2" in outcome.out + outcome.err
    path.write_text(path.read_text().replace("format_version: 1", "format_version: 9"))
    outcome = relocbench("inspect", tmp_path / "d")
    assert outcome.status == 2
    assert "format_version 9 is not supported, expected one of 1, 2, 3, 4" in outcome.err


def test_the_question_covers_which_pairs_they_are(dataset: Dataset, tmp_path: Path) -> None:
    shutil.copytree(dataset.root, tmp_path / "d", symlinks=True)
    layout = Dataset(tmp_path / "d").layout
    table = layout.pair_table(ACROSS)
    pairs = Dataset(tmp_path / "d").pair_set(ACROSS).all_pairs
    place = next(i for i, p in enumerate(pairs) if p.is_negative)
    renamed = [*pairs]
    object.__setattr__(renamed[place], "group", "")
    write_pairs(layout.pair_file(ACROSS), table, renamed)
    fingerprint.write_manifest(layout)
    change_yaml(
        layout.dataset_yaml,
        lambda v: v.update(fingerprint=fingerprint.compute(layout, 2, {k: tuple(n) for k, n in v["splits"].items()})),
    )
    assert Dataset(tmp_path / "d").content_id != dataset.content_id
