"""Whatever a method answers costs its own pair: the run goes on, and what it leaves can be read and scored."""

from __future__ import annotations

import csv
import json
import signal
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from misbehaving_trackers import CASES, FRAMES, Batching, Case, Declaring, Raising, case_of
from refusals import refused
from retrievers_for_tests import Thumbnail
from small_dataset import ACROSS, STEP_NS, make_small_dataset

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import read_pose_lines
from relocbench.errors import PredictionError, one_line
from relocbench.evaluation.isolation.answers import ask, checked_answer, checked_pixels
from relocbench.evaluation.isolation.guard import batch_of, guarded, neighbours_of
from relocbench.evaluation.isolation.handles import LocalTracker
from relocbench.evaluation.isolation.info_text import INFO_CHARACTERS
from relocbench.evaluation.probe.records import RADII
from relocbench.evaluation.relocalization.basin import read_basins
from relocbench.evaluation.retrieval.answers import ANSWERS as RETRIEVED
from relocbench.evaluation.retrieval.describe import Describer
from relocbench.evaluation.retrieval.ranking import rank_task
from relocbench.evaluation.retrieval.run import RetrieverSession
from relocbench.evaluation.tables.answers import Answer, read_answers
from relocbench.evaluation.tables.errors import read_errors
from relocbench.evaluation.tables.matching import MATCHING
from relocbench.evaluation.tracking.check import check
from relocbench.evaluation.tracking.evaluate import EvaluateOptions, Report, evaluate_methods
from relocbench.leaderboard.tracking.load import load_results
from relocbench.methods import parse_method
from relocbench.metrics import relevance_from_labels
from relocbench.progress import Silent
from relocbench.retrieval import ImageView, RetrievalTask
from relocbench.tracking import Query, Reference, TrackResult

HERE = "misbehaving_trackers"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("data") / "small"
    return make_small_dataset(folder, frames=FRAMES, size=(48, 36), splits={"test": [ACROSS]})


@pytest.fixture(scope="module")
def report(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Report:
    """The report of a method that misbehaves in another way at each pair, and of a good one that is asked after it."""
    methods = (f"bad={HERE}:Misbehaving", "good=trackers_for_tests:Shift")
    out = tmp_path_factory.mktemp("results")
    return evaluate_methods(EvaluateOptions(dataset=dataset.root, methods=methods, out=out, workers=1), Silent())


@pytest.fixture(scope="module")
def answers(report: Report) -> dict[str, Answer]:
    """By the name of the case."""
    return {
        case_of(*key).name: answer for key, answer in reversed(read_answers(report.folders[0].answers(ACROSS)).items())
    }


@pytest.mark.thorough
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_what_a_method_answers_costs_its_own_pair_and_is_told(case: Case, answers: dict[str, Answer]) -> None:
    answer = answers[case.name]
    assert (answer.status, answer.confidence) == (case.status, case.confidence), answer.message
    assert case.message in answer.message
    assert answer.message.isprintable()
    assert len(answer.message) <= 500
    assert len(answer.info) <= INFO_CHARACTERS
    info = json.loads(answer.info, parse_constant=pytest.fail)
    assert case.info is None or case.info(info)


@pytest.mark.thorough
def test_methods_after_a_misbehaving_one_are_asked_and_all_is_scored_and_ranked(
    dataset: Dataset, report: Report
) -> None:
    bad, good = report.folders
    answered = {answer.key for answer in read_answers(bad.answers(ACROSS)).values() if answer.status == "ok"}
    assert {line.key for line in read_pose_lines(bad.predictions(ACROSS))} == answered
    pairs = [pair.key for pair in dataset.pair_set(ACROSS).pairs]
    assert [row.status for row in read_errors(good.errors(ACROSS))] == ["ok"] * len(pairs)
    assert [row.key for row in read_errors(bad.errors(ACROSS))] == pairs
    entry = load_results(report.results.parent)[0]
    assert [method.label for method in entry.methods] == ["bad", "good"]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_check_and_validation_see_what_a_run_sees(case: Case, answers: dict[str, Answer]) -> None:
    """They ask by the same function; here without a run around it."""
    view: Any = SimpleNamespace(timestamp_ns=0)
    tracker = SimpleNamespace(track=lambda reference, query, prior: case.answer())
    ((answer,), _) = ask(tracker, None, [view])
    assert answer.status == case.status
    assert case.message in answer.message


def test_a_checked_answer_holds_copies() -> None:
    pose = np.eye(4)
    answer = checked_answer(TrackResult(pose))
    pose[0, 3] = 9
    assert answer.pose == [0, 0, 0, 0, 0, 0, 1]


def test_an_interruption_by_the_user_goes_on_even_where_the_method_catches_it() -> None:
    def catching() -> str:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            return "caught"
        return "never came"

    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        guarded(catching)
    assert signal.getsignal(signal.SIGINT) is before
    assert guarded(lambda: "calm") == ("calm", None)


@pytest.mark.parametrize(
    ("answer", "broken", "words"),
    [
        ("breaks", 1, "GeneratorExit: in the middle"),
        ("endless", 4, "track_batch returned more than 4 results for 4 queries"),
        ("few", 4, "track_batch returned 3 results for 4 queries"),
        ("number", 4, "TypeError: 'int' object is not iterable"),
    ],
)
def test_a_batch_that_breaks_costs_the_queries_that_break_it(answer: str, broken: int, words: str) -> None:
    views: list[Any] = [SimpleNamespace(timestamp_ns=n * STEP_NS) for n in range(4)]
    answers, _ = ask(Batching(answer), None, views)
    assert [a.status for a in answers].count("error") == broken
    assert answers[3].message == words
    assert answers[3].status == "error"


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("word", "'neighbours' is many, expected a whole number from 0 to 100"),
        ("negative", "'neighbours' is -1, expected"),
        ("huge", "'neighbours' is 1000000000000000000000000000000, expected"),
        ("array", "'neighbours' is [1. 1. 1.], expected"),
        ("object", "whose __str__ raised ZeroDivisionError), expected"),
        ("raises", "'neighbours' cannot be read: LookupError: not known yet"),
    ],
)
def test_neighbours_that_are_no_number_are_told(what: str, words: str) -> None:
    count, fault = neighbours_of(Declaring(what))
    assert (count, words in (fault or "")) == (0, True), fault


class Sized:
    """Answers any number of queries at once, of which it says something."""

    def __init__(self, batch_size: Any) -> None:
        self.batch_size = batch_size

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        return TrackResult(np.eye(4))

    def track_batch(self, reference: Reference, queries: Any, priors: Any) -> list[TrackResult]:
        return [TrackResult(np.eye(4)) for _ in queries]


@pytest.mark.parametrize(
    ("told", "batch", "words"),
    [
        (3, 3, None),
        (np.int64(8), 8, None),
        (10**30, 8, None),
        (0, 1, "'batch_size' is 0, expected a whole number from 1"),
        ("many", 1, "'batch_size' is many, expected a whole number from 1"),
        (2.5, 1, "'batch_size' is 2.5, expected a whole number from 1"),
    ],
)
def test_a_batch_size_is_a_number_or_is_told(told: object, batch: int, words: str | None) -> None:
    count, fault = batch_of(Sized(told))
    assert count == batch
    assert fault is None if words is None else words in (fault or "")
    declared = LocalTracker(Sized(told)).declared
    assert (declared.batch, declared.fault) == (count, fault or "")


@pytest.mark.thorough
def test_a_declaration_that_is_no_number_costs_the_methods_pairs_alone(dataset: Dataset, tmp_path: Path) -> None:
    methods = (f"bad={HERE}:Declaring", f"fine={HERE}:Declaring", f"batch={HERE}:Batching")
    options = {"set": ("fine.what=number", "batch.answer=breaks"), "workers": 1, "out": tmp_path}
    report = evaluate_methods(EvaluateOptions(dataset=dataset.root, methods=methods, **options), Silent())
    rows = [read_errors(folder.errors(ACROSS)) for folder in report.folders]
    assert {row.status for row in rows[0]} == {"error"}
    assert {row.status for row in rows[1]} == {"ok"}
    assert all((row.status == "error") == (row.key[1] // STEP_NS % 10 == 3) for row in rows[2])


def test_check_method_tells_the_faults_and_never_breaks() -> None:
    findings = {f.check: f for f in check(parse_method(f"m={HERE}:Declaring"))}
    assert not findings["says how many neighbours it wants"].passed
    tracker = parse_method(f"m={HERE}:Misbehaving")
    assert sum(not f.passed for f in check(tracker)) == 0, "made-up views fall on the case that answers rightly"


@pytest.mark.parametrize(
    ("ends", "words"),
    [
        (np.zeros((2, 2), dtype=int), "match returned an array of int64, expected an array of floats"),
        (np.zeros((2, 2), dtype=object), "match returned an array of object"),
        ([[0.0, 0.0]] * 2, "match returned list"),
        (np.zeros((3, 2)), r"match returned shape (3, 2), expected (2, 2)"),
        (np.full((2, 2), np.inf), "an infinite pixel"),
        (Raising(), "match returned Raising"),
    ],
)
def test_pixels_that_are_none_are_told(ends: Any, words: str) -> None:
    pixels, fault = checked_pixels(ends, None, 2)
    assert pixels is None
    assert words in str(fault)


def test_pixels_are_copied_to_plain_floats() -> None:
    given = np.zeros((2, 2), dtype=np.float16).view(np.matrix)
    pixels, fault = checked_pixels(given, None, 2)
    assert fault is None
    assert type(pixels) is np.ndarray
    assert pixels.dtype == np.float64


class Reordering(Thumbnail):
    """A retriever that answers ``rerank`` wrongly, or says wrongly how many it orders."""

    def __init__(self, top: Any = 2, scores: Any = None) -> None:
        super().__init__()
        self.top, self.scores = top, scores

    @property
    def rerank_top(self) -> Any:
        if isinstance(self.top, Exception):
            raise self.top
        return self.top

    @property
    def info(self) -> Any:
        return {"loss": float("nan"), "all": "x" * 200_000}

    def rerank(self, query: Any, candidates: Any) -> Any:
        if isinstance(self.scores, BaseException):
            raise self.scores
        return self.scores


def task() -> RetrievalTask:
    rng = np.random.default_rng(0)

    def view(index: int) -> ImageView:
        image = rng.integers(0, 255, (16, 16, 3), dtype=np.uint8)
        return ImageView(f"i{index}", "street", lambda: image)

    images = tuple(view(index) for index in range(6))
    return RetrievalTask("made", images[:2], images[2:], relevance_from_labels([0, 1], [0, 1, 0, 1]))


@pytest.mark.parametrize(
    ("retriever", "words"),
    [
        (Reordering("many"), "'rerank_top' is not a whole number from 0 to 1000000"),
        (Reordering(-1), "'rerank_top' is not a whole number from 0 to 1000000: -1"),
        (Reordering(LookupError("no")), "LookupError: no"),
        (Reordering(2, np.zeros(2, dtype=int)), "rerank returned an array of int64"),
        (Reordering(2, np.full(2, np.inf)), "not finite"),
        (Reordering(2, [1.0, 2.0]), "rerank returned list for 2 candidates"),
        (Reordering(2, Raising()), "rerank returned Raising"),
        (Reordering(2, KeyboardInterrupt("mine")), "KeyboardInterrupt: mine"),
    ],
)
def test_what_a_retriever_says_of_its_reordering_costs_its_queries_alone(retriever: Any, words: str) -> None:
    asking = RetrieverSession(lambda: retriever, [task()], 0)
    done = asking.ask(task(), None)
    assert [answer.status for answer in done.answers] == ["error"] * 2
    assert all(words in answer.message for answer in done.answers), done.answers[0].message
    assert asking.info["cut"] is True


class Describing:
    """A retriever that answers what it is given."""

    def __init__(self, answer: Any) -> None:
        self.answer = answer

    def describe(self, images: Any) -> Any:
        if isinstance(self.answer, BaseException):
            raise self.answer
        return self.answer(len(images)) if callable(self.answer) else self.answer


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (lambda n: [[1.0, 2.0]] * n, "describe returned list"),
        (lambda n: np.ones((n, 4), dtype=object), "describe returned an array of object"),
        (lambda n: np.ones((n, 4), dtype=complex), "describe returned an array of complex128"),
        (lambda n: np.ones((n, 4), dtype=np.longdouble), "describe returned an array of float128"),
        (lambda n: np.ones((n + 1, 4)), "expected (1, D)"),
        (lambda n: np.ones((n, 4, 2)), "expected (1, D)"),
        (Raising(), "describe returned Raising"),
        (GeneratorExit("closed"), "GeneratorExit: closed"),
        (KeyboardInterrupt("mine"), "KeyboardInterrupt: mine"),
    ],
)
def test_descriptors_that_are_none_cost_their_images_alone(answer: Any, words: str) -> None:
    described = Describer(Describing(answer))(task().gallery, lambda count: None)
    assert not described.finite.any()
    assert all(words in message for message in described.messages), described.messages[0]


def test_descriptors_that_overflow_retrieve_nothing_or_something_but_end_nothing() -> None:
    for value in (1e300, np.inf, np.nan):
        describer = Describer(Describing(lambda n, value=value: np.full((n, 3), value)))
        queries, gallery = (describer(side, lambda count: None) for side in (task().queries, task().gallery))
        rows = list(rank_task(task(), queries, gallery, describer.handle, None))
        assert len(rows) == 2


READERS: dict[str, tuple[Callable[[Path], object], str, int]] = {
    "answers": (read_answers, "ref_timestamp_ns,query_timestamp_ns,status,seconds,confidence,message,info", 7),
    "retrieved": (RETRIEVED.read, "query,group,status,positives,ranks,seconds,message", 7),
    "matching": (MATCHING.read, ",".join(MATCHING.columns), len(MATCHING.columns)),
    "basin": (read_basins, ",".join(RADII.columns), len(RADII.columns)),
}


@pytest.mark.parametrize("kind", READERS)
def test_a_field_that_is_too_long_to_read_is_one_line_with_file_and_place(kind: str, tmp_path: Path) -> None:
    read, header, columns = READERS[kind]
    path = tmp_path / "table.csv"
    path.write_text(f"{header}\n" + "," * (columns - 1) + "x" * (csv.field_size_limit() + 1) + "\n")
    with refused(PredictionError, "table.csv", 2, "131", "072"):
        read(path)


def test_every_word_of_a_method_is_one_printable_line() -> None:
    assert one_line("a\nb\u2028c\x00\x1b") == "a b c??"
    assert one_line(Raising()) == "(an object of type Raising, whose __str__ raised ZeroDivisionError)"
    assert len(one_line("x" * 10**7)) == 500


def test_every_case_of_the_table_has_a_pair_of_the_dataset(dataset: Dataset) -> None:
    asked = {case_of(*pair.key).name for pair in dataset.pair_set(ACROSS).pairs}
    assert asked == {case.name for case in CASES}
