"""Asking retrievers: rankings and exact ranks, failures, what a killed run leaves, what is told of a bad one."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from refusals import refused
from retrievers_for_tests import Thumbnail
from small_views import make_small_views

from relocbench.arrays import Image
from relocbench.datasets.cross_view import open_cross_view
from relocbench.errors import DatasetError, MethodError, PredictionError
from relocbench.evaluation.retrieval.answers import ANSWERS, read_lists
from relocbench.evaluation.retrieval.check import check_retriever
from relocbench.evaluation.retrieval.describe import BATCH
from relocbench.evaluation.retrieval.evaluate import RetrievalOptions, RetrievalReport, evaluate_retrievers
from relocbench.evaluation.retrieval.handles import retriever_handle
from relocbench.evaluation.retrieval.ranking import nearest, rank_task
from relocbench.evaluation.retrieval.run import RetrieverSession, check_task
from relocbench.execution import Run, Scheduler, kept_workers
from relocbench.methods import RETRIEVERS, parse_method
from relocbench.metrics import (
    chance_level,
    exact_scores,
    rank_descriptors,
    rank_scores,
    relevance_from_labels,
    score_retrieval,
)
from relocbench.progress import Silent
from relocbench.retrieval import ImageView, RetrievalTask

HERE = "retrievers_for_tests"
D2S, S2D = "drone-satellite", "satellite-drone"


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_small_views(tmp_path_factory.mktemp("views") / "town")


def run(views: Path, out: Path, *methods: str, **options: Any) -> RetrievalReport:
    return evaluate_retrievers(
        RetrievalOptions(dataset=views, out=out, methods=methods, **{"workers": 0, **options}), Silent()
    )


def digest(key: str, salt: str = "") -> str:
    """How an image is called where a method sees it."""
    return hashlib.blake2s(key.encode(), digest_size=8, key=salt.encode()[:32]).hexdigest()


def made_task(vectors: Sequence[Sequence[int]], labels: Sequence[int], queries: int = 1) -> RetrievalTask:
    """A task whose images are their own 2 x 2 thumbnails; the first ones are the queries."""

    def view(index: int) -> ImageView:
        grey = np.array(vectors[index], dtype=np.uint8).reshape(2, 2, 1)
        return ImageView(f"i{index}", "street", lambda: np.repeat(grey, 3, axis=2))

    names = [view(i) for i in range(len(vectors))]
    relevance = relevance_from_labels(labels[:queries], labels[queries:])
    return RetrievalTask("made", tuple(names[:queries]), tuple(names[queries:]), relevance)


def test_an_image_under_two_names_is_described_once() -> None:
    read: list[str] = []

    def view(key: str, content: str, side: str = "drone") -> ImageView:
        grey = np.full((2, 2, 3), ord(content[:1] or key[:1]), dtype=np.uint8)

        def counted() -> Image:
            read.append(key)
            return grey

        return ImageView(key, side, counted, content)

    queries = (view("q0", "a"), view("q1", "a"), view("q2", ""))
    gallery = (view("g0", "b"), view("g1", "a"), view("g2", ""), view("g3", "a", "satellite"))
    task = RetrievalTask("made", queries, gallery, relevance_from_labels([0, 0, 0], [0, 0, 1, 1]))
    asking = RetrieverSession(Thumbnail, [task], 0)
    done = asking.ask(task, None)
    assert read == ["g0", "g1", "g2", "g3", "q2"]  # q0 and q1 hold what g1 holds; the satellite's view is another
    assert (done.run.queries_described, done.run.gallery_described) == (3, 4)
    assert [len(done.lists[f"q{k}"]) for k in range(3)] == [4, 4, 4]


def test_lists_and_ranks_are_those_of_the_descriptors(views: Path, tmp_path: Path) -> None:
    report = run(views, tmp_path, f"t={HERE}:Thumbnail", keep=3)
    for task in report.asked.chosen:
        queries, gallery = (Thumbnail().describe(side) for side in (task.queries, task.gallery))
        expected = score_retrieval(rank_descriptors(queries, gallery, task.relevance))
        values = report.scores(report.folders[0])[task.name]
        for metric in ("R@1", "R@5", "AP", "MRR", "R@top1%"):
            assert values[metric] == pytest.approx(expected.per_query(metric).mean(), abs=1e-12)
        best = np.argsort(-(queries @ gallery.T), axis=1)[:, :3]
        lines = report.folders[0].predictions(task.name).read_text().split("\n")
        assert lines == [
            *(f"{q.key} {task.gallery[i].key}" for q, row in zip(task.queries, best, strict=True) for i in row),
            "",
        ]


def test_scores_do_not_depend_on_how_many_lines_are_kept(views: Path, tmp_path: Path) -> None:
    few, all_of_them = (run(views, tmp_path / str(k), f"t={HERE}:Thumbnail", keep=k) for k in (1, 1000))
    for task in (D2S, S2D):
        tables = [r.folders[0].answers(task) for r in (few, all_of_them)]
        assert [a.ranks for a in ANSWERS.read(tables[0])] == [a.ranks for a in ANSWERS.read(tables[1])]
        assert len(few.folders[0].predictions(task).read_text().splitlines()) == len(ANSWERS.read(tables[0]))


def test_scoring_ones_own_complete_lists_gives_the_same_ranks(views: Path, tmp_path: Path) -> None:
    mine = run(views, tmp_path / "a", f"t={HERE}:Thumbnail", keep=1000)
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    for task in (D2S, S2D):
        (theirs / f"{task}.txt").write_bytes(mine.folders[0].predictions(task).read_bytes())
    again = run(views, tmp_path / "b", predictions=theirs)
    assert again.folders[0].label == "theirs"
    for task in (D2S, S2D):
        for a, b in zip(*(ANSWERS.read(r.folders[0].answers(task)) for r in (mine, again)), strict=True):
            assert (a.query, a.group, a.status, a.positives, a.ranks) == (
                b.query,
                b.group,
                b.status,
                b.positives,
                b.ranks,
            )


def test_images_that_tasks_share_are_described_once(views: Path, tmp_path: Path) -> None:
    opened = open_cross_view(views)
    one = opened.tasks()[0]
    other = RetrievalTask("again", one.gallery, one.queries, relevance_from_labels(range(9), [0] * 16))
    log = tmp_path / "log"
    asking = RetrieverSession(lambda: Thumbnail(log=str(log)), [one, other], 0)
    first, second = asking.ask(one, None), asking.ask(other, None)
    seen = log.read_text().split()
    images = {digest(v.key) for v in (*one.queries, *one.gallery)}
    assert sorted(seen[1:]) == sorted(images)  # the first one was for warming up
    assert first.run.gallery_seconds is not None
    assert second.run.gallery_seconds is None
    assert [a.seconds for a in second.answers] != [None] * 9


def test_a_method_sees_no_path_that_could_name_the_place(views: Path, tmp_path: Path) -> None:
    log = tmp_path / "log"
    run(views, tmp_path / "out", f"t={HERE}:Thumbnail", set=(f"log={log}",))
    assert all("/" not in word and len(word) == 16 for word in log.read_text().split())


def test_an_image_that_breaks_costs_itself_alone(views: Path, tmp_path: Path) -> None:
    opened = open_cross_view(views)
    queries = opened.tasks()[0].queries
    broken, blind = queries[3].key, queries[5].key
    report = run(
        views,
        tmp_path,
        f"p={HERE}:Picky",
        set=(f"raises={digest(broken, opened.fingerprint)}", f"blind={digest(blind, opened.fingerprint)}"),
        pair_sets=(D2S,),
    )
    answers = {a.query: a for a in ANSWERS.read(report.folders[0].answers(D2S))}
    assert (answers[broken].status, answers[broken].message) == ("error", "ZeroDivisionError: on purpose")
    assert (answers[blind].status, answers[blind].ranks) == ("failed", ())
    assert sum(a.status == "ok" for a in answers.values()) == len(queries) - 2
    values = report.scores(report.folders[0])[D2S]
    assert (values["failed"], values["broke"], values["queries"]) == (1, 1, len(queries))
    assert values["R@1"] is not None
    assert values["R@1"] <= 1 - 2 / len(queries)
    assert "crashed on 1 of 16 queries" in report.crashed[0][1]


def test_a_method_that_always_breaks_has_failed_on_every_query(views: Path, tmp_path: Path) -> None:
    report = run(views, tmp_path, f"p={HERE}:Picky", set=("always=true",))
    for task in (D2S, S2D):
        assert {a.status for a in ANSWERS.read(report.folders[0].answers(task))} == {"error"}
        assert report.scores(report.folders[0])[task]["R@1"] == 0.0
    assert "on purpose" in report.crashed[0][1]
    assert "0 of 16 queries and 0 of 9 gallery images were described" in report.suspicions[0][1]


def test_a_fitting_retriever_is_fitted_anew_to_each_gallery(views: Path, tmp_path: Path) -> None:
    report = run(views, tmp_path, f"w={HERE}:Whitened")
    runs = report.folders[0].run_record().tasks
    assert all(runs[task].fit_seconds is not None for task in (D2S, S2D))
    task = report.asked.chosen[0]
    gallery = Thumbnail().describe(task.gallery)
    queries = Thumbnail().describe(task.queries) - gallery.mean(axis=0)
    expected = score_retrieval(rank_descriptors(queries, gallery - gallery.mean(axis=0), task.relevance))
    assert report.scores(report.folders[0])[task.name]["AP"] == pytest.approx(expected.average_precision.mean())
    broken = run(views, tmp_path, f"b={HERE}:Whitened", set=("breaks=true",))
    assert "fit: ValueError: too few images" in broken.crashed[0][1]


@pytest.mark.thorough
def test_a_retriever_lives_in_one_process_wherever_the_rest_of_the_work_runs(views: Path) -> None:
    images = open_cross_view(views).tasks()[0].gallery[:3]
    nobody = Scheduler(address="tcp://127.0.0.1:9")
    with kept_workers():
        asked = retriever_handle(parse_method(f"{HERE}:OfItsProcess", kind=RETRIEVERS), Run(2, scheduler=nobody))
        before = asked.info
        assert asked.fit(images, 0)[2] == ""
        described = [asked.describe((one,)) for one in images for _ in range(3)]
        assert all(not broke and len(values) == 1 for values, _, broke in described)
        assert asked.info == before
        peak = asked.peak_memory_bytes
    assert before["process"] != os.getpid()
    assert peak is None or 10**7 < peak < 10**10, "that of a Python with NumPy; none is told without /proc"
    assert (peak is not None) == Path("/proc/self/status").exists()


def test_reranking_orders_the_first_and_leaves_the_rest(views: Path, tmp_path: Path) -> None:
    plain = run(views, tmp_path, f"t={HERE}:Thumbnail", keep=1000, pair_sets=(S2D,))
    turned = run(views, tmp_path, f"r={HERE}:Reversing", set=("top=3",), keep=1000, pair_sets=(S2D,))
    task = next(t for t in plain.asked.chosen if t.name == S2D)
    keys = [{v.key: i for i, v in enumerate(side)} for side in (task.queries, task.gallery)]
    before, after = (read_lists(r.folders[0].predictions(S2D), *keys) for r in (plain, turned))
    ranks = {a.query: a.ranks for a in ANSWERS.read(turned.folders[0].answers(S2D))}
    for q, key in enumerate(keys[0]):
        assert after[key] == before[key][2::-1] + before[key][3:]
        positives = set(task.relevance.of(q).tolist())
        assert ranks[key] == tuple(i + 1 for i, image in enumerate(after[key]) if image in positives)
    of_task = turned.folders[0].run_record().tasks[S2D]
    assert of_task.rerank_top == 3
    assert (of_task.dimensions, of_task.descriptor_bytes) == (64, 64 * 4)


@pytest.mark.parametrize(("fault", "words"), [("raise", "rerank"), ("nan", "not finite")])
def test_a_fault_in_reranking_is_the_querys_failure(views: Path, tmp_path: Path, fault: str, words: str) -> None:
    report = run(views, tmp_path, f"r={HERE}:Reversing", set=(f"fault={fault}",), pair_sets=(S2D,))
    answers = ANSWERS.read(report.folders[0].answers(S2D))
    assert {a.status for a in answers} == {"error"}
    assert all(words in a.message and a.ranks == () for a in answers)


def test_equal_scores_put_wrong_images_first() -> None:
    task = made_task([[9, 9, 9, 9]] * 5, [1, 0, 1, 0, 0])
    same = RetrieverSession(Constant4, [task], 0).ask(task, None)
    assert same.answers[0].ranks == (4,)
    assert same.lists == {"i0": ["i1", "i3", "i4", "i2"]}, "the same order"


class Constant4:
    def describe(self, images: Sequence[ImageView]) -> Any:
        return np.ones((len(images), 4))


def test_ranks_after_reranking_follow_the_rule_of_ties_on_both_sides() -> None:
    """Against the plain computation on a matrix in which the first K stand above everything else."""
    rng = np.random.default_rng(3)
    labels = rng.integers(0, 4, 40)
    task = made_task(rng.integers(0, 4, (40, 4)).tolist(), labels.tolist(), queries=10)

    class Coarse:
        rerank_top = 5

        def describe(self, images: Sequence[ImageView]) -> Any:
            return np.stack([one.image[..., 0].ravel() for one in images]).astype(np.float64)

        def rerank(self, query: Any, candidates: Any) -> Any:
            return (candidates[:, 0] + query[0]).astype(np.float64)

    method = Coarse()
    answers = RetrieverSession(lambda: method, [task], 0).ask(task, None).answers
    a, b = method.describe(task.queries), method.describe(task.gallery)
    scores = a @ b.T
    for q, row in enumerate(scores):
        head = np.argsort(-row, kind="stable")[:5]
        row[head] = 1e6 + method.rerank(a[q], b[head])
    expected = rank_scores(scores, task.relevance)
    assert [a.ranks for a in answers] == [tuple((expected.of(q) + 1).tolist()) for q in range(10)]


def test_junk_is_neither_retrieved_nor_in_the_way() -> None:
    task = made_task([[9, 0, 0, 0], [9, 0, 0, 0], [9, 0, 0, 0], [0, 9, 0, 0]], [5, -1, 5, 0])
    done = RetrieverSession(lambda: Thumbnail(side=2), [task], 0).ask(task, None)
    assert done.answers[0].ranks == (1,)
    assert done.lists == {"i0": ["i2", "i3"]}


def test_a_gallery_without_descriptors_leaves_nothing_retrieved() -> None:
    task = made_task([[9, 0, 0, 0], [9, 0, 0, 1]], [1, 1])

    class Blind:
        def describe(self, images: Sequence[ImageView]) -> Any:
            return np.array([[1.0] if one.key == digest("i0") else [np.nan] for one in images])

    done = RetrieverSession(Blind, [task], 0).ask(task, None)
    assert (done.answers[0].status, done.answers[0].ranks, done.lists) == ("failed", (), {"i0": []})


def test_the_first_of_a_ranking_are_those_of_a_full_sort() -> None:
    rng = np.random.default_rng(1)
    for count in (1, 3, 10, 50):
        scores = rng.integers(0, 6, 30).astype(float)
        scores[rng.integers(0, 30, 5)] = np.nan
        right = rng.random(30) < 0.3
        ordered = sorted(np.flatnonzero(np.isfinite(scores)), key=lambda i: (-scores[i], right[i], i))
        assert nearest(scores, count, right).tolist() == ordered[:count]


@pytest.mark.thorough
def test_exact_scores_do_not_depend_on_blocks_and_agree_with_ranking() -> None:
    rng = np.random.default_rng(2)
    query, gallery = rng.normal(size=(9, 33)).astype(np.float32), rng.normal(size=(21, 33))
    query[4], gallery[7, 0], gallery[8] = np.nan, np.inf, gallery[9]
    whole = next(exact_scores(query, gallery))[1]
    parts = np.concatenate([s for _, s in exact_scores(query, gallery, block=2, gallery_block=5)])
    assert np.array_equal(whole, parts, equal_nan=True)
    assert np.isnan(whole[4]).all()
    assert np.isnan(whole[:, 7]).all()
    assert np.array_equal(whole[:, 8], whole[:, 9], equal_nan=True)
    relevance = relevance_from_labels(rng.integers(0, 5, 9), rng.integers(0, 5, 21))
    assert np.array_equal(rank_scores(whole, relevance).position, rank_descriptors(query, gallery, relevance).position)


@pytest.mark.thorough
def test_the_level_of_chance_is_what_random_orders_score() -> None:
    rng = np.random.default_rng(0)
    relevance = relevance_from_labels([0, 1, 9], [0, 0, 0, 1, 2, 3, 4, 5, -1, 7, 8])
    metrics = ("R@1", "R@5", "R@20", "R@top1%", "AP", "AP_rectangle", "MRR")
    drawn = [score_retrieval(rank_scores(rng.random((3, 11)), relevance)) for _ in range(4000)]
    level = chance_level(relevance, metrics)
    for metric in metrics:
        values = np.array([s.per_query(metric).mean() for s in drawn])
        assert level[metric] == pytest.approx(values.mean(), abs=4 * values.std() / np.sqrt(len(values)) + 1e-12)
    single = chance_level(relevance_from_labels([3], [1, 2, 3]), ("R@1", "MRR", "AP"))
    assert single["R@1"] == pytest.approx(1 / 3)
    assert single["AP"] == pytest.approx((single["R@1"] + single["MRR"]) / 2)


def test_a_killed_run_loses_the_task_in_hand_and_ends_with_the_same_rankings(views: Path, tmp_path: Path) -> None:
    log = tmp_path / "log"
    calls = 1 + 9 + 16 + 1  # warming up, both sides of the first task, and into the second
    settings = (f"log={log}", f"calls={calls}")
    with pytest.raises(KeyboardInterrupt):
        run(views, tmp_path / "out", f"e={HERE}:Ends", set=settings)
    folder = next((tmp_path / "out").glob("*@*/e"))
    assert sorted(p.name for p in folder.iterdir()) == [f"{D2S}.csv", f"{D2S}.txt", "run.yaml"]
    first = (folder / f"{D2S}.csv").read_bytes()
    log.write_text("")  # it would be killed again
    report = run(views, tmp_path / "out", f"e={HERE}:Ends", set=(f"log={log}", f"calls={calls}"))
    assert (folder / f"{D2S}.csv").read_bytes() == first
    whole = run(views, tmp_path / "whole", f"e={HERE}:Ends", set=(f"log={tmp_path / 'other'}", "calls=1000"))
    for task in (D2S, S2D):
        mine, theirs = (r.folders[0].predictions(task).read_bytes() for r in (report, whole))
        assert mine == theirs
    assert set(report.folders[0].run_record().tasks) == {D2S, S2D}


def test_what_is_there_is_not_asked_again(views: Path, tmp_path: Path) -> None:
    log = tmp_path / "log"
    common = (views, tmp_path / "out", f"t={HERE}:Thumbnail")
    run(*common, set=(f"log={log}",))
    once = log.read_text()
    run(*common, set=(f"log={log}",))
    assert log.read_text() == once
    run(*common, set=(f"log={log}",), overwrite="failed")
    assert log.read_text() == once
    run(*common, set=(f"log={log}",), overwrite="always")
    assert len(log.read_text()) == 2 * len(once)


def test_answers_made_otherwise_are_refused(views: Path, tmp_path: Path) -> None:
    run(views, tmp_path, f"t={HERE}:Thumbnail", keep=5)
    with refused(PredictionError, "run.yaml", None, "8", "4"):
        run(views, tmp_path, f"t={HERE}:Thumbnail", set=("side=4",), keep=5)
    with refused(PredictionError, "run.yaml", None, "retrievers_for_tests:Thumbnail"):
        run(views, tmp_path, f"t={HERE}:Constant", keep=5)
    with refused(PredictionError, "run.yaml", None, "5", "--keep", "7"):
        run(views, tmp_path, f"t={HERE}:Thumbnail", keep=7)
    assert run(views, tmp_path, f"t={HERE}:Thumbnail", keep=7, overwrite="always").folders[0].run_record().keep == 7


def test_weights_are_known_by_their_content_and_tell_of_themselves(views: Path, tmp_path: Path) -> None:
    weights = tmp_path / "weights"
    weights.write_text("6")
    options: dict[str, Any] = {"set": (f"f.weights={weights}",), "pair_sets": (D2S,)}
    report = run(views, tmp_path / "out", f"f={HERE}:FromFile", **options)
    assert report.folders[0].run_record().info == {"side": 6, "from": "a file"}
    run(views, tmp_path / "out", f"f={HERE}:FromFile", **options)
    weights.write_text("7")
    with refused(PredictionError, "run.yaml"):
        run(views, tmp_path / "out", f"f={HERE}:FromFile", **options)
    weights.write_text("no number")
    with refused(MethodError, "", None, "f"):
        run(views, tmp_path / "out", f"f={HERE}:FromFile", overwrite="always", **options)
    assert report.folders[0].complete(D2S)  # what cannot be made costs nothing


def test_a_bad_image_stops_the_run_with_its_name(tmp_path: Path) -> None:
    made = make_small_views(tmp_path / "town", places=3)
    bad = made / "test" / "query_drone" / "0001" / "0.png"
    bad.write_bytes(bad.read_bytes()[:-20])
    with refused(DatasetError, "0001/0.png"):
        run(made, tmp_path / "out", f"t={HERE}:Thumbnail", pair_sets=(D2S,))
    assert not list((tmp_path / "out").rglob("*.csv"))


def test_a_method_that_cannot_go_on_ends_the_run(views: Path, tmp_path: Path) -> None:
    class Stops:
        def describe(self, images: Sequence[ImageView]) -> Any:
            raise MethodError("weights are for 4 parts")

    task = open_cross_view(views).tasks()[0]
    with refused(MethodError, "", None, "4"):
        RetrieverSession(Stops, [task], 0).ask(task, None)


def test_images_are_let_go_of_batch_by_batch() -> None:
    """A gallery of any size goes through: no image outlives its batch."""
    held: list[Any] = []

    def read(index: int) -> np.ndarray:
        return np.full((4, 4, 3), index % 251, dtype=np.uint8)

    def view(index: int) -> ImageView:
        return ImageView(f"i{index}", "drone", lambda: read(index))

    class Weak:
        def describe(self, images: Sequence[ImageView]) -> Any:
            import weakref

            alive = sum(ref() is not None for ref in held)
            assert alive <= 2 * BATCH
            held.extend(weakref.ref(one) for one in images)
            return np.ones((len(images), 2))

    count = 6 * BATCH
    task = RetrievalTask(
        "t", (view(0),), tuple(view(i) for i in range(1, count)), relevance_from_labels([0], [0] * (count - 1))
    )
    done = RetrieverSession(Weak, [task], 0).ask(task, 5)
    assert done.answers[0].status == "ok", done.answers[0].message
    assert len(held) >= count


def test_descriptors_of_changing_length_are_a_fault_of_the_later_images() -> None:
    vectors = [[i, 0, 0, 0] for i in range(BATCH + 2)]
    task = made_task(vectors, [0] * len(vectors))

    class Growing:
        calls = 0

        def describe(self, images: Sequence[ImageView]) -> Any:
            self.calls += 1
            return np.ones((len(images), 2 if self.calls <= 2 else 3))

    done = RetrieverSession(Growing, [task], 0).ask(task, None)
    assert "3 numbers an image, 2 before" in done.answers[0].message


@pytest.mark.parametrize(
    ("queries", "gallery", "name"),
    [
        (["a", "a"], ["b"], "a"),
        (["a"], ["b c"], "b c"),
        (["#a"], ["b"], "#a"),
        (["a"], [], "t"),
        (["a", "b"], ["c", "d"], "t"),
    ],
)
def test_a_task_that_cannot_be_asked_is_refused(queries: list[str], gallery: list[str], name: str) -> None:
    def view(key: str) -> ImageView:
        return ImageView(key, "street", lambda: np.zeros((2, 2, 3), dtype=np.uint8))

    relevance = relevance_from_labels([0], [0])
    task = RetrievalTask("t", tuple(map(view, queries)), tuple(map(view, gallery)), relevance)
    with refused(DatasetError, "", None, name):
        check_task(task)


def test_hints_name_what_to_look_at_where_nothing_is_found(views: Path, tmp_path: Path) -> None:
    report = run(views, tmp_path, f"c={HERE}:Constant", f"t={HERE}:Thumbnail")
    told = dict(report.suspicions)
    assert set(told) == {"c"}
    for words in ("a random order gives", "16 of 16 queries have", "variance 0 of 1", "wrong or untrained weights"):
        assert words in next(message for label, message in report.suspicions if D2S in message)


@pytest.mark.parametrize("method", ["Thumbnail", "Whitened", "Reversing"])
def test_retrievers_that_keep_the_contract_pass_the_check(method: str, views: Path) -> None:
    findings = check_retriever(parse_method(f"{HERE}:{method}", kind=RETRIEVERS), views)
    assert [f for f in findings if not f.passed] == []
    assert len(findings) >= 18


@pytest.mark.parametrize(
    ("method", "settings", "failed"),
    [
        ("Constant", [], "describes different images differently"),
        ("Whitened", ["breaks=true"], "fits to a gallery"),
        ("Reversing", ["fault=nan"], "re-ranks the first 2"),
        ("Picky", ["always=true"], "describes a street"),
        *(("WrongShapes", [f"answer={i}"], "describes a street") for i in range(5)),
        ("makes_nothing", [], "has describe()"),
    ],
)
def test_a_breach_of_the_contract_is_found(method: str, settings: list[str], failed: str) -> None:
    findings = check_retriever(parse_method(f"{HERE}:{method}", settings, kind=RETRIEVERS))
    assert failed in {f.check for f in findings if not f.passed}


def test_wrong_shapes_are_the_methods_error(tmp_path: Path) -> None:
    made = make_small_views(tmp_path / "town", places=2)
    for answer in range(5):
        report = run(made, tmp_path / "out", f"w{answer}={HERE}:WrongShapes", set=(f"answer={answer}",))
        assert "describe returned" in report.crashed[0][1]


def test_answers_keep_their_order_and_their_digits(views: Path, tmp_path: Path) -> None:
    report = run(views, tmp_path, f"t={HERE}:Thumbnail")
    path = report.folders[0].answers(D2S)
    rows = ANSWERS.read(path)
    assert [r.query for r in rows] == [q.key for q in report.asked.chosen[0].queries]
    assert [r.group for r in rows][:4] == ["0000", "0000", "0001", "0001"]
    text = path.read_text()
    for old, new, line, names in (
        (",ok,", ",fine,", 2, ("status", "fine")),
        (",1,1,", ",1,1 2,", 2, (2, 1)),
        (",1,1,", ",1,0,", 2, ("ranks", 0)),
        ("query,group", "query,grp", 1, ()),
    ):
        path.write_text(text.replace(old, new, 1))
        with refused(PredictionError, path.name, line, *names):
            ANSWERS.read(path)


def test_rank_task_hears_of_each_block() -> None:
    heard: list[int] = []
    task = made_task([[9, 0, 0, 0], [9, 0, 0, 0], [0, 9, 0, 0]], [1, 1, 0], queries=2)
    from relocbench.evaluation.retrieval.describe import Describer

    describer = Describer(Thumbnail(side=2))
    queries, gallery = (describer(side, lambda count: None) for side in (task.queries, task.gallery))
    list(rank_task(task, queries, gallery, None, None, heard.append))
    assert sum(heard) == 2


def test_a_grey_image_is_seen_in_three_channels(tmp_path: Path) -> None:
    made = make_small_views(tmp_path / "town", places=2)
    for path in (made / "test").rglob("*.png"):
        grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert grey is not None
        cv2.imwrite(str(path), grey)
    assert run(made, tmp_path / "out", f"t={HERE}:Thumbnail").crashed == []
