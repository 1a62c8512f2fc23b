"""Chains of made halves: what is asked, which answer is kept, and where it is said to be lost."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_radii import write_radii
from pipelines_for_tests import FAR_M, lists
from refusals import refused
from small_dataset import ACROSS, CAMERA, make_small_dataset

from relocbench.datasets.core.dataset import Dataset
from relocbench.errors import ConfigError, PredictionError
from relocbench.evaluation.relocalization.answers import OUTCOMES, PIPELINE, PipelineAnswer
from relocbench.evaluation.relocalization.evaluate import (
    RelocalizationOptions,
    RelocalizationReport,
    evaluate_pipelines,
)
from relocbench.evaluation.relocalization.pipeline import most_confident
from relocbench.evaluation.relocalization.records import PipelineResults
from relocbench.evaluation.relocalization.score import per_query
from relocbench.evaluation.tables.errors import read_errors
from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods
from relocbench.progress import Silent

KNOWS = "pipelines_for_tests:Knows"
FRAMES = 8


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Each query is paired with the keyframe at its place and with the one before: the reach is one frame."""
    return make_small_dataset(tmp_path_factory.mktemp("data") / "small", frames=FRAMES, size=(32, 24))


def run(dataset: Dataset, out: Path, retriever: Any, *trackers: str, **options: Any) -> RelocalizationReport:
    retrievers = (retriever,) if isinstance(retriever, str) else tuple(retriever)
    given = {"top": 2, "workers": 0, **options}
    return evaluate_pipelines(
        RelocalizationOptions(dataset=dataset.root, out=out, retriever=retrievers, methods=trackers, **given), Silent()
    )


def rows(report: RelocalizationReport, tracker: str, retriever: str | None = None) -> list[PipelineAnswer]:
    return PIPELINE.read(folder(report, tracker, retriever).answers(ACROSS))


def folder(report: RelocalizationReport, tracker: str, retriever: str | None = None) -> PipelineResults:
    def named(one: PipelineResults) -> bool:
        record = one.run_record()
        return record.tracker == tracker and retriever in (None, record.retriever)

    return next(one for one in report.folders if named(one))


def found_by(dataset: Dataset, tmp_path: Path, frames: list[list[int]], name: str = "l") -> str:
    return f"{name}=predictions:{lists(dataset, tmp_path / name, frames)}"


@pytest.mark.thorough
def test_the_oracle_with_one_keyframe_scores_what_the_tracker_scores_on_its_pairs(tmp_path: Path) -> None:
    """One pair a query, with the nearest keyframe: the chain asks the same questions."""
    made = make_small_dataset(tmp_path / "d", frames=FRAMES, pairs=FRAMES, size=(32, 24))
    off = ("k=pipelines_for_tests:Knows", "s=trackers_for_tests:Shift", "o=orb-pnp", "i=identity")
    settings = ("k.reach=-1", "s.metres=0.2")
    pipeline = run(made, tmp_path / "r", "oracle", *off, top=1, set=settings)
    own = evaluate_methods(
        EvaluateOptions(
            dataset=made.root, out=tmp_path / "own", methods=off, set=settings, pair_sets=(ACROSS,), workers=0
        ),
        Silent(),
    )
    errors = ("rotation_error_deg", "translation_error_m", "mlad_translation_error_m")
    for method in own.folders:
        of_pairs = {e.key: e for e in read_errors(method.errors(ACROSS))}
        of_pipeline = rows(pipeline, method.label)
        assert {r.query_timestamp_ns for r in of_pipeline} == {query for _, query in of_pairs}
        for row in of_pipeline:
            if row.ref_timestamp_ns is not None:
                pair = of_pairs[row.ref_timestamp_ns, row.query_timestamp_ns]
                assert [getattr(row, e) for e in errors] == pytest.approx([getattr(pair, e) for e in errors])
        scores = pipeline.scores(folder(pipeline, method.label))[ACROSS]
        whole = method.score_record().pair_sets[ACROSS]["all"]
        for metric in ("recall@(0.25m,2deg)", "recall@(1m,5deg)", "t_auc@0.5m", "coverage"):
            assert scores[metric] == pytest.approx(whole[metric])
    floor = [r.translation_error_m for r in rows(pipeline, "keyframe-pose")]
    assert floor == pytest.approx([r.translation_error_m for r in rows(pipeline, "i")])


@pytest.mark.thorough
def test_where_a_pipeline_is_lost(dataset: Dataset, tmp_path: Path) -> None:
    """The basin is one frame, as far as the pairs reach; the tracker is right up to the keyframe at the place."""
    frames = [[0, 5], [5, 1], [7, 6], [2, 6], [4, 0], [0, 1], [], [7, 6]]
    report = run(
        dataset, tmp_path / "r", found_by(dataset, tmp_path, frames), f"t={KNOWS}", f"far={KNOWS}",
        set=("t.reach=0", "far.reach=0", "far.sure=far"),
    )  # fmt: skip
    near = rows(report, "t")
    with refused(ConfigError, "", None, "basin_recall", "basin_recall@1"):
        per_query(near, "basin_recall")
    assert [r.outcome for r in near] == [
        "right", "right", "retrieval", "tracking", "right", "retrieval", "retrieval", "right",
    ]  # fmt: skip
    assert [r.hit_rank for r in near] == [1, 2, None, 1, 1, None, None, 1]
    assert [r.right_rank for r in near] == [1, 2, None, None, 1, None, None, 1]
    assert [r.rank for r in near] == [1, 2, 2, 1, 1, 2, None, 1]
    assert (near[6].status, near[6].asked, near[6].translation_error_m) == ("failed", 0, np.inf)
    assert "retrieval: " in near[6].message
    assert near[5].translation_error_m == pytest.approx(FAR_M)
    surest = rows(report, "far")  # surer of the farther keyframe: right answers are passed over
    assert [r.outcome for r in surest] == [
        "choice", "choice", "retrieval", "tracking", "choice", "retrieval", "retrieval", "choice",
    ]  # fmt: skip
    for tracker in ("t", "far"):
        scores = report.scores(folder(report, tracker))[ACROSS]
        lost = [scores[f"failed_{o}"] for o in OUTCOMES if o != "right"]
        assert scores["recall@(0.25m,2deg)"] == pytest.approx(1 - sum(v for v in lost if v is not None))
        hit, without_hit = scores["right_and_hit"], scores["right_without_hit"]
        assert hit is not None
        assert without_hit is not None
        assert hit + without_hit == pytest.approx(scores["recall@(0.25m,2deg)"])
        assert (scores["basin_recall@1"], scores["hit"], scores["queries"]) == (0.5, 0.625, 8)
    assert report.scores(folder(report, "t"))[ACROSS]["right_given_hit"] == pytest.approx(4 / 5)
    floor = rows(report, "keyframe-pose")
    assert [r.asked for r in floor] == [1, 1, 1, 1, 1, 1, 0, 1]
    assert floor[0].translation_error_m == pytest.approx(0.12)


def test_a_basin_can_be_given_and_changes_no_answer(dataset: Dataset, tmp_path: Path) -> None:
    retriever = found_by(dataset, tmp_path, [[q, (q + 4) % 8] for q in range(FRAMES)])
    args = (dataset, tmp_path / "r", retriever, f"t={KNOWS}")
    narrow = run(*args, radius=0.01)
    first = rows(narrow, "t")
    scores = narrow.scores(folder(narrow, "t"))[ACROSS]
    assert (scores["hit"], scores["right_without_hit"], scores["right_given_hit"]) == (0.0, 1.0, None)
    wide = run(*args, radius=5.0)
    assert wide.scores(folder(wide, "t"))[ACROSS]["hit"] == 1.0
    assert [(r.rank, r.translation_error_m) for r in rows(wide, "t")] == [
        (r.rank, r.translation_error_m) for r in first
    ]
    assert folder(wide, "t").scores().basins[ACROSS].source == "given"
    radii = tmp_path / "radii.csv"
    write_radii(radii, ("t", "translation", "across conditions", 0.125), ("t", "rotation", "across conditions", 9))
    own = run(*args, probe=radii)
    basins = own.basins(folder(own, "t")), own.basins(folder(own, "keyframe-pose"))
    assert [b[ACROSS].source for b in basins] == ["probe", "pairs"]
    assert own.scores(folder(own, "t"))[ACROSS]["basin_recall@1"] == 1.0


@pytest.mark.parametrize("beyond", ["fail", "raise"])
def test_failures_cost_their_query(dataset: Dataset, tmp_path: Path, beyond: str) -> None:
    frames = [[0], [7], [2, 7], [7, 3], [4], [5], [6], [0, 1]]
    args = (dataset, tmp_path / "r", found_by(dataset, tmp_path, frames), f"t={KNOWS}")
    report = run(*args, set=(f"t.beyond={beyond}", "t.reach=0"))
    got = rows(report, "t")
    status = "error" if beyond == "raise" else "failed"
    assert [r.status for r in got] == ["ok", status, "ok", "ok", "ok", "ok", "ok", status]
    assert [r.rank for r in got] == [1, None, 1, 2, 1, 1, 1, None]
    assert per_query(got, "coverage").mean() == pytest.approx(6 / 8)
    assert bool(report.crashed) == (beyond == "raise")
    kept = folder(report, "t").predictions(ACROSS).read_text().splitlines()
    assert len(kept) == 6


def test_the_surest_answer_is_kept() -> None:
    assert most_confident([0.1, 0.9, 0.5], [True, True, True]) == 1
    assert most_confident([0.1, 0.9, 0.5], [True, False, True]) == 2
    assert most_confident([None, None], [True, True]) == 0
    assert most_confident([None, -5.0], [True, True]) == 1
    assert most_confident([1.0, 1.0], [True, True]) == 0
    assert most_confident([1.0], [False]) is None
    assert most_confident([], []) is None


def test_an_answer_that_cannot_be_judged_is_wrong(tmp_path: Path) -> None:
    """Without poses of the reference traversal only the pairs themselves can be."""
    made = make_small_dataset(tmp_path / "d", frames=4, size=(32, 24))
    writable = made.layout.traversal("summer").poses
    writable.write_text(writable.read_text().splitlines(keepends=True)[0])
    from relocbench.evaluation.relocalization.basin import basin
    from relocbench.evaluation.relocalization.pipeline import Retrieved, Tracked, pipeline_answers
    from relocbench.evaluation.relocalization.truth import MapTruth
    from relocbench.evaluation.tables.answers import Answer

    again = Dataset(made.root)
    times = again.traversal("winter").timestamps(CAMERA), again.traversal("summer").timestamps(CAMERA)
    truth = MapTruth(again, again.pair_set(ACROSS), *times)
    keys = [(times[1][k], times[0][q]) for q in range(4) for k in range(4)]
    off = np.eye(4)
    off[0, 3] = 1.0  # far from any threshold: the identity is 0.25 m wrong to the last digit
    tracked = Tracked({key: Answer(*key, "ok") for key in keys}, dict.fromkeys(keys, off))
    found = [Retrieved([3]), Retrieved([0]), Retrieved([0, 2]), Retrieved([])]
    got, _ = pipeline_answers(truth, found, tracked, 2, basin((9.0, 9.0), "given"))
    assert [r.outcome for r in got] == ["unreachable", "tracking", "unreachable", "retrieval"]
    assert [np.isinf(r.translation_error_m) for r in got] == [True, False, True, True]


@pytest.mark.thorough
def test_each_pair_is_asked_once_and_nothing_again(dataset: Dataset, tmp_path: Path) -> None:
    log = tmp_path / "log"
    one = found_by(dataset, tmp_path, [[q, (q + 1) % 8] for q in range(8)], "one")
    two = found_by(dataset, tmp_path, [[q, (q + 2) % 8] for q in range(8)], "two")
    tracker = f"once={KNOWS}"
    args: dict[str, Any] = {"set": (f"once.log={log}",)}
    report = run(dataset, tmp_path / "r", (one, two), tracker, **args)
    asked = log.read_text().splitlines()
    assert len(asked) == 25  # the first call of a process is repeated untimed
    assert len(set(asked)) == 24
    before = {p: p.read_bytes() for p in (tmp_path / "r").rglob("*") if p.is_file()}
    run(dataset, tmp_path / "r", (one, two), tracker, **args)
    run(dataset, tmp_path / "r", (one, two), tracker, top=1, **args)
    assert len(log.read_text().splitlines()) == 25
    changed = [p for p in before if p.read_bytes() != before[p] and p.name != "run.yaml"]
    assert changed == []
    third = found_by(dataset, tmp_path, [[7 - q] for q in range(8)], "third")
    run(dataset, tmp_path / "r", third, tracker, **args)
    new = {(7 - q, q) for q in range(8)} - {((q + k) % 8, q) for q in range(8) for k in (0, 1, 2)}
    assert len(log.read_text().splitlines()) == 25 + len(new)
    first, second = (rows(report, "once", name) for name in ("one", "two"))
    assert [r.translation_error_m for r in first] == [r.translation_error_m for r in second]


def test_a_killed_run_goes_on(dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import pipelines_for_tests

    log = tmp_path / "log"
    args = (dataset, tmp_path / "r", "oracle", f"t={KNOWS}")
    track = pipelines_for_tests.Knows.track

    def killed(self: Any, reference: Any, query: Any, prior: Any = None) -> Any:
        if log.exists() and len(log.read_text().splitlines()) == 6:
            signal.raise_signal(signal.SIGINT)
        return track(self, reference, query, prior)

    with monkeypatch.context() as patched:
        patched.setattr(pipelines_for_tests.Knows, "track", killed)
        with pytest.raises(KeyboardInterrupt):
            run(*args, set=(f"t.log={log}",))
    assert not list((tmp_path / "r").rglob("oracle+t.top2/*"))
    report = run(*args, set=(f"t.log={log}",))
    assert len(set(log.read_text().splitlines())) == 16
    assert {r.outcome for r in rows(report, "t")} == {"right"}


def test_halves_made_otherwise_are_not_mixed(dataset: Dataset, tmp_path: Path) -> None:
    args = (dataset, tmp_path / "r", "oracle", f"t={KNOWS}")
    run(*args)
    with refused(PredictionError, "run.yaml", None, "reach", 1, 0):
        run(*args, set=("t.reach=0",))
    report = run(*args, set=("t.reach=0",), overwrite="always")
    assert folder(report, "t").run_record().tracker_run.parameters["reach"] == 0  # type: ignore[union-attr]


def test_a_real_retriever_leaves_the_results_of_place_recognition(dataset: Dataset, tmp_path: Path) -> None:
    report = run(dataset, tmp_path / "r", "thumb=retrievers_for_tests:Thumbnail", f"t={KNOWS}", set=("thumb.side=4",))
    places = next((tmp_path / "r").glob("small.places-pairs@*"))
    ranked = (places / "thumb" / f"{ACROSS}.txt").read_text().splitlines()
    first = {line.split()[0]: line.split()[1] for line in reversed(ranked)}
    asked = {Path(q).stem: Path(k).stem for q, k in first.items()}
    floor = rows(report, "keyframe-pose")
    assert {str(r.query_timestamp_ns): str(r.ref_timestamp_ns) for r in floor} == asked
    assert folder(report, "t").run_record().retriever_run.parameters["side"] == 4  # type: ignore[union-attr]


def test_without_truth_there_is_nothing_to_judge(tmp_path: Path) -> None:
    made = make_small_dataset(tmp_path / "d", frames=3, truth=False, size=(32, 24))
    with refused(ConfigError, made.root, None, "ground truth"):
        run(made, tmp_path / "r", "oracle", f"t={KNOWS}")


def test_tables_are_read_as_they_were_written_and_bad_ones_are_named(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    answers = [
        PipelineAnswer(5, "failed", "retrieval", message="nothing"),
        PipelineAnswer(6, "ok", "right", 1, 2, 1, 2, 3, 0.5, 0.25, 0.125, -1.5, 0.001),
    ]
    PIPELINE.write(path, answers)
    assert PIPELINE.read(path) == answers
    good = path.read_text()
    for old, new, names in (
        ("6,ok", "5,ok", ()),
        ("ok,right", "fine,right", ("status", "fine")),
        ("ok,right", "ok,lucky", ("outcome", "lucky")),
        ("0.25", "nan", ("translation_error_m", "nan")),
        ("0.25", "", ("translation_error_m",)),
        (",2,1,2,3,", ",2,x,2,3,", ("hit_rank", "x")),
        ("status", "state", ()),
    ):
        path.write_text(good.replace(old, new, 1))
        with refused(PredictionError, path.name, None, *names):
            PIPELINE.read(path)
