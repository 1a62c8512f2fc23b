"""Running methods, keeping what they answer, scoring it."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command_line import relocbench
from killing import Fault, run_until_killed
from refusals import refused
from small_dataset import ACROSS, WITHIN, make_small_dataset

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import PoseLine, read_pose_lines, write_pose_lines
from relocbench.errors import DatasetError, MethodError, PredictionError
from relocbench.evaluation.common.results import DatasetResults
from relocbench.evaluation.tables.answers import read_answers
from relocbench.evaluation.tables.errors import read_errors
from relocbench.evaluation.tracking.evaluate import EvaluateOptions, Report, evaluate_methods
from relocbench.evaluation.tracking.validation import validate_results
from relocbench.files import locked_folder, read_journal
from relocbench.progress import Silent

pytestmark = pytest.mark.usefixtures("workers_kept")
HERE = "trackers_for_tests"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("data") / "small", rejected=1)


def evaluate(dataset: Dataset, out: Path, *methods: str, settings: tuple[str, ...] = (), **options: object) -> Report:
    chosen = {"workers": 0, **options}
    return evaluate_methods(
        EvaluateOptions(dataset=dataset.root, methods=methods, set=settings, out=out, **chosen),
        Silent(),
    )


def predictions(results: Path, method: str) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in sorted((results / method).glob("*.txt"))}


def questions(log: Path) -> list[str]:
    return log.read_text().splitlines() if log.exists() else []


def query_time(dataset: Dataset, index: int, pair_set: str = ACROSS) -> int:
    return dataset.pair_set(pair_set).pairs[index].query_timestamp_ns


def test_a_run_leaves_predictions_answers_errors_and_a_record(dataset: Dataset, tmp_path: Path) -> None:
    report = evaluate(dataset, tmp_path, f"s={HERE}:Shift", settings=("metres=0.25", "s.steps=5"), seed=4)
    folder = DatasetResults(report.results).method("s")
    record = folder.run_record()
    assert record.parameters == {"metres": 0.25, "steps": 5, "loud": False, "seed": 4}
    assert record.fingerprint == dataset.fingerprint
    assert record.machine["cpu"]
    assert record.start <= record.end
    lines = read_pose_lines(folder.predictions(ACROSS))
    assert [line.key for line in lines] == [p.key for p in dataset.pair_set(ACROSS).pairs]
    answers = read_answers(folder.answers(ACROSS))
    assert all(a.status == "ok" and a.seconds is not None and a.seconds >= 0 for a in answers.values())
    assert json.loads(next(iter(answers.values())).info) == {"steps": 5}
    for row, pair in zip(read_errors(folder.errors(ACROSS)), dataset.pair_set(ACROSS).pairs, strict=True):
        assert pair.T_query_ref is not None
        centre = np.array([-0.25, 0, 0]) + pair.T_query_ref[:3, :3].T @ pair.T_query_ref[:3, 3]
        assert row.translation_error_m == pytest.approx(np.linalg.norm(centre), abs=1e-12)
        assert row.distance_m == pytest.approx(pair.distance_m)
    assert not (folder.root / ".journal" / ACROSS).exists()


def test_rejected_pairs_are_never_asked_and_their_number_is_kept(dataset: Dataset, tmp_path: Path) -> None:
    log = tmp_path / "log"
    report = evaluate(dataset, tmp_path, f"{HERE}:Logging", settings=(f"log={log}",), pair_sets=(ACROSS,))
    asked = {tuple(map(int, q.split())) for q in questions(log)}
    assert asked == {p.key for p in dataset.pair_set(ACROSS).pairs}
    assert DatasetResults(report.results).record.pair_sets[ACROSS].rejected == 1


@pytest.mark.thorough
def test_predictions_do_not_depend_on_the_number_of_workers(dataset: Dataset, tmp_path: Path) -> None:
    none, two = (evaluate(dataset, tmp_path / str(n), "orb-pnp", workers=n).results for n in (0, 2))
    assert predictions(none, "orb-pnp") == predictions(two, "orb-pnp")


def test_the_failures_of_a_method_are_infinite_errors_and_break_nothing(dataset: Dataset, tmp_path: Path) -> None:
    first, second = query_time(dataset, 0), query_time(dataset, 2)
    settings = (f"log={tmp_path / 'log'}", f"fails_at={first}", f"raises_at={second}")
    report = evaluate(dataset, tmp_path, f"m={HERE}:Logging", settings=settings, pair_sets=(ACROSS,))
    every = read_errors(report.folders[0].errors(ACROSS))
    rows = {r.key[1]: r for r in every}
    assert (rows[first].status, rows[second].status) == ("failed", "error")
    assert rows[first].translation_error_m == rows[second].rotation_error_deg == float("inf")
    answers = {a.key[1]: a.message for a in read_answers(report.folders[0].answers(ACROSS)).values()}
    assert answers[first] == "nothing found"
    assert answers[second] == "ZeroDivisionError: on purpose"
    pairs = len(every)
    summary = report.folders[0].score_record().pair_sets[ACROSS]["all"]
    failed = sum(r.key[1] in (first, second) for r in every)
    assert summary["pairs"] == pairs
    assert summary["coverage"] == pytest.approx(1 - failed / pairs)
    assert "crashed on" in report.crashed[0][1]


@pytest.mark.thorough
def test_a_worker_that_dies_once_costs_nothing(dataset: Dataset, tmp_path: Path) -> None:
    settings = (f"log={tmp_path / 'log'}", f"dies_at={query_time(dataset, 2)}", "dies_once=true")
    report = evaluate(dataset, tmp_path, f"m={HERE}:Logging", settings=settings, workers=2)
    assert {r.status for r in read_errors(report.folders[0].errors(ACROSS))} == {"ok"}


def test_two_processes_never_answer_the_same_pair_set_at_once(dataset: Dataset, tmp_path: Path) -> None:
    method = f"s={HERE}:Shift"
    folder = evaluate(dataset, tmp_path, method, pair_sets=(WITHIN,)).folders[0]
    journal = folder.journal(ACROSS)
    journal.mkdir(parents=True)
    with locked_folder(journal), refused(PredictionError, journal):
        evaluate(dataset, tmp_path, method)
    assert not folder.predictions(ACROSS).exists()
    evaluate(dataset, tmp_path, method)
    assert folder.complete(ACROSS)


@pytest.mark.thorough
def test_what_a_method_prints_stays_out_of_the_result(dataset: Dataset, tmp_path: Path) -> None:
    (tmp_path / "loud.py").write_text(
        """import os
from relocbench.tracking import TrackResult
print("imported")
class T:
    def __init__(self):
        print("made")
    def track(self, reference, query, prior=None):
        print("asked")
        os.write(1, b"from a library\\n")
        return TrackResult.failure("none")
"""
    )
    command = [sys.executable, "-m", "relocbench", "evaluate", "-d", str(dataset.root), "-m", "w=loud:T"]
    command += ["--json", "--out", "results", "-j", "1"]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert set(json.loads(ended.stdout)["methods"]) == {"w"}
    assert {"imported", "made", "asked", "from a library"} <= set(ended.stderr.splitlines())


def test_answers_there_are_not_asked_for_again(dataset: Dataset, tmp_path: Path) -> None:
    log = tmp_path / "log"
    settings = (f"log={log}",)
    evaluate(dataset, tmp_path, f"m={HERE}:Logging", settings=settings)
    asked = len(questions(log))
    evaluate(dataset, tmp_path, f"m={HERE}:Logging", settings=settings)
    assert len(questions(log)) == asked


def test_overwrite_failed_asks_again_where_the_method_failed(dataset: Dataset, tmp_path: Path) -> None:
    log, failing = tmp_path / "log", query_time(dataset, 0)
    settings = (f"log={log}", f"fails_at={failing}")
    before = evaluate(dataset, tmp_path, f"m={HERE}:Logging", settings=settings, pair_sets=(ACROSS,))
    kept = {line.key: line for line in read_pose_lines(before.folders[0].predictions(ACROSS))}
    log.unlink()
    Path(f"{log}.healed").touch()
    after = evaluate(dataset, tmp_path, f"m={HERE}:Logging", settings=settings, pair_sets=(ACROSS,), overwrite="failed")
    # The warm-up call of a process may repeat a question, never one that was answered.
    assert {int(q.split()[1]) for q in questions(log)} == {failing}
    lines = {line.key: line for line in read_pose_lines(after.folders[0].predictions(ACROSS))}
    assert len(lines) > len(kept)
    assert all(np.array_equal(lines[key].T_query_ref, kept[key].T_query_ref) for key in kept)  # type: ignore[arg-type]


def test_overwrite_always_asks_for_everything_again(dataset: Dataset, tmp_path: Path) -> None:
    evaluate(dataset, tmp_path, f"m={HERE}:Shift", settings=("metres=0.1",))
    report = evaluate(dataset, tmp_path, f"m={HERE}:Shift", settings=("metres=0.2",), overwrite="always")
    line = read_pose_lines(report.folders[0].predictions(WITHIN))[0]
    assert line.T_query_ref is not None
    assert line.T_query_ref[0, 3] == 0.2


def test_two_configurations_never_share_a_folder(dataset: Dataset, tmp_path: Path) -> None:
    evaluate(dataset, tmp_path, f"m={HERE}:Shift", settings=("metres=0.1",))
    before = predictions(DatasetResults(next(tmp_path.iterdir())).root, "m")
    with refused(PredictionError, "run.yaml", None, "metres", 0.1, 0.2):
        evaluate(dataset, tmp_path, f"m={HERE}:Shift", settings=("metres=0.2",))
    with refused(PredictionError, "run.yaml", None, f"{HERE}:Shift"):
        evaluate(dataset, tmp_path, "m=identity")
    assert predictions(DatasetResults(next(tmp_path.iterdir())).root, "m") == before


def test_other_weights_are_another_configuration(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the path is the same, and where the method itself knows the path."""
    weights, own = tmp_path / "weights", tmp_path / "own"
    monkeypatch.setenv("WEIGHTS_OF_TESTS", str(own))
    weights.write_text("0.25")
    own.write_text("0.5")
    out = tmp_path / "out"
    given = f"weights={weights}"
    folder = DatasetResults(evaluate(dataset, out, f"w={HERE}:Weighted", settings=(given,)).results).method("w")
    assert folder.run_record().files == {"weights": hashlib.sha256(b"0.25").hexdigest()}
    evaluate(dataset, out, f"own={HERE}:Weighted")
    evaluate(dataset, out, f"w={HERE}:Weighted", settings=(given,))
    weights.write_text("0.75")
    own.write_text("0.75")
    with refused(PredictionError, "run.yaml", None, "weights", hashlib.sha256(b"0.25").hexdigest()[:12]):
        evaluate(dataset, out, f"w={HERE}:Weighted", settings=(given,))
    with refused(PredictionError, "run.yaml", None, "weights"):
        evaluate(dataset, out, f"own={HERE}:Weighted")


def test_a_run_that_broke_off_before_its_first_answer_does_not_stand_in_the_way(
    dataset: Dataset, tmp_path: Path
) -> None:
    weights = tmp_path / "weights"
    weights.write_text("not a number")
    with pytest.raises(MethodError):
        evaluate(dataset, tmp_path / "out", f"w={HERE}:Weighted", settings=(f"weights={weights}",))
    weights.write_text("0.25")
    report = evaluate(dataset, tmp_path / "out", f"w={HERE}:Weighted", settings=(f"weights={weights}",))
    assert all(line.T_query_ref is not None for line in read_pose_lines(report.folders[0].predictions(WITHIN)))


def test_a_method_that_cannot_be_made_costs_no_answers(dataset: Dataset, tmp_path: Path) -> None:
    weights = tmp_path / "weights"
    weights.write_text("0.25")
    given = f"weights={weights}"
    report = evaluate(dataset, tmp_path / "out", f"w={HERE}:Weighted", settings=(given,))
    before = predictions(Path(report.results), "w")
    assert before
    weights.write_text("not a number")
    with refused(MethodError, "", None, "w"):
        evaluate(dataset, tmp_path / "out", f"w={HERE}:Weighted", settings=(given,), overwrite="always")
    assert predictions(Path(report.results), "w") == before


def test_a_mistyped_method_leaves_no_folder(dataset: Dataset, tmp_path: Path) -> None:
    with pytest.raises(MethodError):
        evaluate(dataset, tmp_path / "out", "identity", "orb-pmp")
    assert not (tmp_path / "out").exists()


@pytest.mark.thorough
def test_a_killed_run_resumes_and_ends_with_the_same_bytes(dataset: Dataset, tmp_path: Path) -> None:
    log, out = tmp_path / "log", tmp_path / "out"
    arguments = ["evaluate", "-d", dataset.root, "-m", f"m={HERE}:Logging", "--set", f"log={log}"]
    arguments += ["--out", out, "-j", 1, "--pair-set", ACROSS, "-q"]
    third = Fault(r"\.jsonl$", 3, ("append",))
    run_until_killed(["python", "-m", "relocbench", *arguments], third, tmp_path / "trace")
    folder = next(out.glob("*@*/m"))
    assert not list(folder.glob("*.txt"))
    answered = [e for p in folder.rglob("*.jsonl") for e in read_journal(p)]
    assert len(answered) == 3
    log.unlink()
    assert relocbench(*arguments).status == 0
    pairs = len(dataset.pair_set(ACROSS).pairs)
    assert len(questions(log)) == pairs - len(answered) + 1  # one call to warm up
    whole = tmp_path / "whole"
    evaluate(dataset, whole, f"m={HERE}:Shift", pair_sets=(ACROSS,))
    assert predictions(next(out.iterdir()), "m") == predictions(next(whole.iterdir()), "m")


def test_a_torn_line_of_a_journal_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "1.jsonl"
    path.write_text('{"key": [1, 2]}\n{"key": [1, 3]}\n{"key": [1, ')
    assert [e["key"] for e in read_journal(path)] == [[1, 2], [1, 3]]
    path.write_text('{"key": [1, 2]}\n{"key": [1, 3]}')
    assert [e["key"] for e in read_journal(path)] == [[1, 2]]


def test_predictions_made_elsewhere_are_scored_and_missing_pairs_have_failed(dataset: Dataset, tmp_path: Path) -> None:
    theirs = tmp_path / "theirs"
    pairs = dataset.pair_set(ACROSS).pairs
    lines = [PoseLine(*p.key, p.T_query_ref) for p in reversed(pairs[1:])]
    write_pose_lines(theirs / f"{ACROSS}.txt", lines)
    report = evaluate(dataset, tmp_path / "out", "colleague", predictions=theirs)
    rows = read_errors(report.folders[0].errors(ACROSS))
    assert report.folders[0].label == "colleague"
    assert [r.status for r in rows] == ["failed"] + ["ok"] * (len(pairs) - 1)
    assert max(r.translation_error_m for r in rows[1:]) < 1e-12
    assert sorted(p.name for p in theirs.iterdir()) == [f"{ACROSS}.txt"]


def test_a_pose_that_is_not_finite_is_a_failure(dataset: Dataset, tmp_path: Path) -> None:
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    ref, query = dataset.pair_set(ACROSS).pairs[0].key
    (theirs / f"{ACROSS}.txt").write_text(f"{ref} {query} nan 0 0 0 0 0 1\n")
    report = evaluate(dataset, tmp_path / "out", predictions=theirs)
    assert {r.status for r in read_errors(report.folders[0].errors(ACROSS))} == {"failed"}


def test_validation_names_a_negative_error_as_reading_does(dataset: Dataset, tmp_path: Path) -> None:
    report = evaluate(dataset, tmp_path, "identity")
    path = report.folders[0].errors(ACROSS)
    rows = [line.split(",") for line in path.read_text().splitlines()]
    rows[1][4] = "-0.5"
    path.write_text("".join(",".join(row) + "\n" for row in rows))
    with refused(PredictionError, path, 2, "rotation_error_deg", -0.5):
        read_errors(path)
    faults = validate_results(report.results, dataset, Silent()).faults
    assert [fault.line for fault in faults if "rotation_error_deg" in fault.message] == [2]


@pytest.mark.parametrize(
    ("text", "line", "names"),
    [
        (
            "{ref} {query} 0 0 0 0 0 0 1\n{ref} {query} 0 0 0 0 0 0 1\n",
            2,
            (1,),
        ),
        ("# comment\n{ref} 17 0 0 0 0 0 0 1\n", 2, (17,)),
        ("{ref} {query} 0 0 0 0 0 0 2\n", 1, ("qw", 2)),
        ("{ref} {query} 0 0 0\n", 1, (9,)),
        ("{ref} {query} 0 0 zero 0 0 0 1\n", 1, ("tz", "zero")),
        ("{ref}.5 {query} 0 0 0 0 0 0 1\n", 1, ()),
    ],
)
def test_a_bad_prediction_file_is_named_with_its_line(
    dataset: Dataset, tmp_path: Path, text: str, line: int, names: tuple[object, ...]
) -> None:
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    ref, query = dataset.pair_set(ACROSS).pairs[0].key
    (theirs / f"{ACROSS}.txt").write_text(text.format(ref=ref, query=query))
    with refused(PredictionError, f"{ACROSS}.txt", line, *names):
        evaluate(dataset, tmp_path / "out", predictions=theirs)
    assert not list((tmp_path / "out").rglob("*.txt"))


def test_predictions_for_a_pair_set_that_is_not_there_are_refused(dataset: Dataset, tmp_path: Path) -> None:
    (tmp_path / "p").mkdir()
    (tmp_path / "p" / "a__b__c.txt").write_text("")
    with refused(PredictionError, "", None, "a__b__c"):
        evaluate(dataset, tmp_path / "out", predictions=tmp_path / "p")
    (tmp_path / "p" / "a__b__c.txt").rename(tmp_path / "p" / f"{WITHIN}.txt")
    with refused(PredictionError, tmp_path / "p", None, ACROSS):
        evaluate(dataset, tmp_path / "out", predictions=tmp_path / "p", pair_sets=(ACROSS,))
    assert not list((tmp_path / "out").rglob("run.yaml"))


def test_predictions_for_another_fingerprint_are_refused(dataset: Dataset, tmp_path: Path) -> None:
    other = make_small_dataset(tmp_path / "other", seed=3)
    report = evaluate(other, tmp_path / "results", "identity")
    with refused(PredictionError, "run.yaml", None, f"small@{other.fingerprint[:12]}"):
        evaluate(dataset, tmp_path / "out", predictions=report.folders[0].root)


def test_withheld_truth_gives_predictions_and_no_scores(tmp_path: Path) -> None:
    blind = make_small_dataset(tmp_path / "blind", truth=False)
    report = evaluate(blind, tmp_path / "out", "identity")
    assert report.folders[0].predictions(ACROSS).exists()
    assert not report.folders[0].errors(ACROSS).exists()
    assert report.folders[0].score_record().pair_sets == {}


def test_a_dataset_changed_after_it_was_made_is_refused(tmp_path: Path) -> None:
    changed = make_small_dataset(tmp_path / "changed")
    path = changed.layout.pair_file(ACROSS)
    path.write_text(path.read_text().replace("1", "2", 1))
    with refused(DatasetError, f"{ACROSS}.txt"):
        evaluate(changed, tmp_path / "out", "identity")


def test_a_truncated_image_is_named_and_loses_nothing(tmp_path: Path) -> None:
    broken = make_small_dataset(tmp_path / "broken")
    report = evaluate(broken, tmp_path / "out", "identity")
    before = predictions(report.results, "identity")
    image = next((broken.root / "traversals" / "winter" / "images").rglob("*.png"))
    image.write_bytes(image.read_bytes()[:-20])
    with refused(DatasetError, image.name, None, "manifest.csv"):
        evaluate(broken, tmp_path / "out", "orb-pnp")
    assert predictions(report.results, "identity") == before


def test_the_identity_scores_above_zero_where_pairs_are_close(dataset: Dataset, tmp_path: Path) -> None:
    report = evaluate(dataset, tmp_path, "identity")
    summary = report.folders[0].score_record().pair_sets[ACROSS]["all"]
    assert summary["coverage"] == 1.0
    assert 0.2 < float(summary["t_auc@1m"] or 0) < 1.0
    groups = report.folders[0].score_record().pair_sets[WITHIN]
    assert list(groups) == ["all", "step_1", "step_2"]
