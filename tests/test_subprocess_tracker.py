"""The second door: programs that speak the line protocol, well and badly."""

from __future__ import annotations

import json
import re
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from small_dataset import ACROSS, make_small_dataset

from relocbench.datasets.dataset import Dataset
from relocbench.datasets.images import read_depth, read_image, read_points
from relocbench.errors import MethodError
from relocbench.evaluation.check import check
from relocbench.evaluation.evaluate import EvaluateOptions, evaluate_methods
from relocbench.evaluation.results import read_errors
from relocbench.methods import parse_method
from relocbench.methods.subprocess_tracker import SubprocessTracker
from relocbench.progress import Silent
from relocbench.tracking import TrackResult

EXAMPLE = Path(__file__).parents[1] / "docs" / "examples" / "constant_velocity.py"
PROGRAM = """
import json, sys, time
n = 0
for line in sys.stdin:
    m = json.loads(line)
    if m["type"] in ("start", "reference"):
        if m["type"] == "reference":
            open({log!r}, "a").write(line)
        print(json.dumps({{"type": "ready"}}), flush=True)
        continue
    if m["type"] == "stop":
        open({log!r}, "a").write("stopped\\n")
        break
    open({log!r}, "a").write(line)
    n += 1
    good = json.dumps({{"type": "result", "pose": [0, 0, n, 0, 0, 0, 1], "confidence": 2, "info": {{"n": n}}}})
    {body}
"""


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("data") / "small")


def ask(
    tmp_path: Path, dataset: Dataset, body: str, questions: int = 1, limit_s: float = 20.0
) -> tuple[list[TrackResult], list[str], SubprocessTracker]:
    log = tmp_path / "log"
    script = tmp_path / "program.py"
    script.write_text(PROGRAM.format(log=str(log), body=body))
    tracker = SubprocessTracker(f"{sys.executable} {script}", time_limit_s=limit_s)
    pair_set = dataset.pair_set(ACROSS)
    prepared = tracker.prepare(dataset.reference(pair_set, pair_set.pairs[0]))
    results = [tracker.track(prepared, dataset.query(pair_set, pair_set.pairs[0])) for _ in range(questions)]
    return results, log.read_text().splitlines() if log.exists() else [], tracker


def test_an_answer_comes_back_and_the_reference_is_sent_once(tmp_path: Path, dataset: Dataset) -> None:
    results, log, tracker = ask(tmp_path, dataset, "print(good, flush=True)", questions=3)
    assert [r.T_query_ref[2, 3] for r in results if r.T_query_ref is not None] == [1, 2, 3]
    assert results[0].confidence == 2
    assert results[2].info == {"n": 3}
    assert [json.loads(line)["type"] for line in log] == ["reference", "query", "query", "query"]
    tracker.close()
    assert (tmp_path / "log").read_text().endswith("stopped\n")


def test_the_files_that_a_program_gets_hold_the_keyframe(tmp_path: Path, dataset: Dataset) -> None:
    log = ask(tmp_path, dataset, "print(good, flush=True)")
    reference = json.loads(log[1][0])
    pair_set = dataset.pair_set(ACROSS)
    expected = dataset.reference(pair_set, pair_set.pairs[0])
    # The tracker still holds the scratch folder.
    assert np.array_equal(read_image(Path(reference["image"])), expected.image)
    assert expected.depth is not None
    assert np.array_equal(read_depth(Path(reference["depth"])), expected.depth)
    assert reference["points"] is None
    assert reference["camera"]["model"] == "pinhole"
    assert str(dataset.root) not in log[1][0], "a program must not be led to the ground truth"


def test_sparse_keyframes_come_as_points(tmp_path: Path) -> None:
    sparse = make_small_dataset(tmp_path / "sparse", sparse=True)
    _, log, tracker = ask(tmp_path, sparse, "print(good, flush=True)")
    reference = json.loads(log[0])
    assert reference["depth"] is None
    assert len(read_points(Path(reference["points"]))) > 100
    tracker.close()


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("print('hello', flush=True)", "answered 'query' with 'hello', expected a JSON object"),
        ("print('{}', flush=True)", "expected an object of type 'result'"),
        ("sys.exit('no weights')", r"ended \(exit status 1\) when asked 'query': no weights"),
        ("print(good.replace('1]', '2]'), flush=True)", "quaternion qx qy qz qw has norm 2"),
        ("print(good.replace(' 0,', '', 1), flush=True)", "expected seven finite numbers"),
        ("print(good.replace('[0', '[NaN'), flush=True)", "expected seven finite numbers"),
    ],
)
def test_nonsense_costs_the_pair_and_says_why(tmp_path: Path, dataset: Dataset, body: str, words: str) -> None:
    results, _, tracker = ask(tmp_path, dataset, body, questions=2)
    for result in results:
        assert not result.answered
        assert result.info["status"] == "error"
    assert re.search(words, results[0].message), results[0].message
    tracker.close()


def test_a_program_that_is_too_slow_is_killed_and_started_again(tmp_path: Path, dataset: Dataset) -> None:
    start = time.monotonic()
    mark = tmp_path / "log2"
    body = (
        f"import os; first = not os.path.exists({str(mark)!r}); open({str(mark)!r}, 'a').close(); "
        "time.sleep(60 * first); print(good, flush=True)"
    )
    results, log, tracker = ask(tmp_path, dataset, body, questions=2, limit_s=1.0)
    assert time.monotonic() - start < 30
    assert results[0].message == "no answer to 'query' within 1 s"
    assert results[1].answered
    assert [json.loads(line)["type"] for line in log].count("reference") == 2
    tracker.close()


def test_a_stated_failure_is_no_error(tmp_path: Path, dataset: Dataset) -> None:
    body = """print(json.dumps({"type": "result", "pose": None, "message": "too dark"}), flush=True)"""
    results, _, tracker = ask(tmp_path, dataset, body)
    assert (results[0].answered, results[0].message) == (False, "too dark")
    assert "status" not in results[0].info
    tracker.close()


def test_the_documented_example_keeps_the_contract_and_is_scored(tmp_path: Path, dataset: Dataset) -> None:
    method = f"cv=subprocess:{sys.executable} {EXAMPLE} --forward 0.15"
    assert [f for f in check(parse_method(method)) if not f.passed] == []
    options = EvaluateOptions(dataset=dataset.root, methods=(method,), out=tmp_path, workers=2)
    report = evaluate_methods(options, Silent())
    rows = [r for r in read_errors(report.folders[0].errors("summer__summer__cam0")) if r.group == "step_1"]
    assert max(r.translation_error_m for r in rows) < 1e-9  # frames are 0.15 m apart


def test_a_program_that_is_not_there_is_a_users_mistake() -> None:
    with pytest.raises(MethodError, match="no program"):
        SubprocessTracker("/no/such/program --flag")
