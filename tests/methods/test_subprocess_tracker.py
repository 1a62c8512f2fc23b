"""The second door: programs that speak the line protocol, well and badly."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from repository import DOCS
from small_dataset import ACROSS, make_small_dataset

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.images import read_depth, read_image, read_points
from relocbench.errors import MethodError
from relocbench.evaluation.tables.errors import read_errors
from relocbench.evaluation.tracking.check import check
from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods
from relocbench.methods import parse_method, subprocess_tracker
from relocbench.methods.subprocess_tracker import SubprocessTracker
from relocbench.progress import Silent
from relocbench.tracking import TrackResult

EXAMPLE = DOCS / "examples" / "constant_velocity.py"
LONG_S = 600.0
"""only a hang takes longer, on whatever machine"""
PROGRAM = """
import json, sys, time
n = 0
for line in sys.stdin:
    m = json.loads(line)
    if m["type"] in ("start", "reference"):
        if m["type"] == "reference":
            open({log!r}, "a").write(line)
        print(json.dumps({{"type": "ready", "id": m["id"]}}), flush=True)
        continue
    if m["type"] == "stop":
        open({log!r}, "a").write("stopped\\n")
        break
    open({log!r}, "a").write(line)
    n += 1
    answer = {{"type": "result", "id": m["id"], "pose": [0, 0, n, 0, 0, 0, 1], "confidence": 2, "info": {{"n": n}}}}
    good = json.dumps(answer)
    {body}
"""


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("data") / "small")


def program(tmp_path: Path, body: str) -> SubprocessTracker:
    script = tmp_path / "program.py"
    script.write_text(PROGRAM.format(log=str(tmp_path / "log"), body=body))
    return SubprocessTracker(f"{sys.executable} {script}", time_limit_s=LONG_S, start_limit_s=LONG_S)


def ask(
    tmp_path: Path, dataset: Dataset, body: str, questions: int = 1, limit_s: float = LONG_S
) -> tuple[list[TrackResult], list[str], SubprocessTracker]:
    tracker, log = program(tmp_path, body), tmp_path / "log"
    tracker.time_limit_s = limit_s
    pair_set = dataset.pair_set(ACROSS)
    prepared = tracker.prepare(dataset.reference(pair_set, pair_set.pairs[0]))
    results = [tracker.track(prepared, dataset.query(pair_set, pair_set.pairs[0])) for _ in range(questions)]
    return results, log.read_text().splitlines() if log.exists() else [], tracker


def test_an_answer_comes_back_and_the_reference_is_sent_once(
    tmp_path: Path, dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("relocbench.methods.program._STOP_GRACE_S", LONG_S)
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
        ("print(good.replace('[0', '[1e999'), flush=True)", "expected seven finite numbers"),
        ("print(good.replace('[0', '[NaN'), flush=True)", "answered 'query' with NaN, which is not a number in JSON"),
        ("print(good.replace('2,', '-Infinity,', 1), flush=True)", "with -Infinity, which is not a number in JSON"),
        ("print(good.replace('2,', '9' * 5000 + ',', 1), flush=True)", "with an integer of 5000 digits"),
        ("print(good.replace('2,', 'true,', 1), flush=True)", "'confidence' a number or null"),
        ("print(good.replace('{', '{\"pose\": null, ', 1), flush=True)", "has the key 'pose' twice"),
        ("print(good.replace('{\"n\"', '[' * 100_000 + '{\"n\"'), flush=True)", "JSON that is nested too deep"),
        ("sys.stdout.buffer.write(good.encode()[:9] + bytes([255, 10])); sys.stdout.flush()", "not UTF-8"),
        ("print(good.replace('n', chr(0)), flush=True)", "expected a JSON object"),
        ("print(good.replace('\"id\"', '\"no\"'), flush=True)", "without an id, expected the id of the question, 3"),
        (
            "print(json.dumps({**answer, 'id': True}), flush=True)",
            "with the id true, expected the id of",
        ),
    ],
)
def test_nonsense_costs_the_pair_and_says_why(tmp_path: Path, dataset: Dataset, body: str, words: str) -> None:
    results, _, tracker = ask(tmp_path, dataset, body, questions=2)
    for result in results:
        assert not result.answered
        assert result.info["status"] == "error"
    assert re.search(words, results[0].message), results[0].message
    tracker.close()


@pytest.mark.thorough
def test_a_program_that_is_too_slow_is_killed_and_started_again(tmp_path: Path, dataset: Dataset) -> None:
    """It hangs at the second query it gets. What it must answer has limits that only a hang reaches."""
    body = "time.sleep(3600 * (n == 2)); print(good, flush=True)"
    tracker = program(tmp_path, body)
    pair_set = dataset.pair_set(ACROSS)
    prepared = tracker.prepare(dataset.reference(pair_set, pair_set.pairs[0]))
    results = []
    for limit_s in (LONG_S, 1.0, LONG_S):
        tracker.time_limit_s = limit_s
        results.append(tracker.track(prepared, dataset.query(pair_set, pair_set.pairs[0])))
    assert results[0].answered
    assert results[1].message == "no answer to 'query' within 1 s"
    assert results[2].answered
    log = (tmp_path / "log").read_text().splitlines()
    tracker.close()
    assert [json.loads(line)["type"] for line in log] == ["reference", "query", "query", "reference", "query"]


def test_a_program_that_answers_no_query_is_given_up(
    tmp_path: Path, dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(subprocess_tracker, "IN_A_ROW", 3)
    results, log, tracker = ask(tmp_path, dataset, "sys.exit(3)", questions=6)
    tracker.close()
    assert [json.loads(line)["type"] for line in log].count("query") == 3
    told = [result.message for result in results]
    assert not any(message.startswith("not run") for message in told[:3])
    for result in results[3:]:
        assert result.message.startswith("not run: the program was given up when 3 queries in a row had no answer")
        assert result.message.endswith("run it again with --overwrite always")
        assert result.info["status"] == "error"


def test_a_program_with_answers_in_between_is_not_given_up(
    tmp_path: Path, dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(subprocess_tracker, "IN_A_ROW", 2)
    results, _, tracker = ask(tmp_path, dataset, "n == 2 and sys.exit(3); print(good, flush=True)", questions=9)
    tracker.close()
    assert [result.answered for result in results] == [True, False] * 4 + [True]


def test_a_stated_failure_is_no_error(tmp_path: Path, dataset: Dataset) -> None:
    body = """print(json.dumps({**answer, "pose": None, "info": None, "message": "too dark"}), flush=True)"""
    results, _, tracker = ask(tmp_path, dataset, body)
    assert (results[0].answered, results[0].message) == (False, "too dark")
    assert "status" not in results[0].info
    tracker.close()


@pytest.mark.thorough
def test_the_documented_example_keeps_the_contract_and_is_scored(tmp_path: Path, dataset: Dataset) -> None:
    method = f"cv=subprocess:{sys.executable} {EXAMPLE} --forward 0.15"
    assert [f for f in check(parse_method(method)) if not f.passed] == []
    options = EvaluateOptions(dataset=dataset.root, methods=(method,), out=tmp_path, workers=2)
    report = evaluate_methods(options, Silent())
    rows = [r for r in read_errors(report.folders[0].errors("summer__summer__cam0")) if r.group == "step_1"]
    assert max(r.translation_error_m for r in rows) < 1e-9  # frames are 0.15 m apart


BATCHING = """
import json, os, sys
declared, breaks = json.loads({declared!r}), {breaks!r}
def answer(query):
    x = int(os.path.getsize(query["image"]))
    return {{"pose": [x, 0, 0, 0, 0, 0, 1], "confidence": 2}}
for line in sys.stdin:
    m = json.loads(line)
    if m["type"] in ("start", "reference"):
        print(json.dumps({{"type": "ready", "id": m["id"], "batch": declared}}), flush=True)
        continue
    if m["type"] == "stop":
        break
    asked = m["queries"] if m["type"] == "queries" else [m]
    open({log!r}, "a").write(str(len(asked)) + " ")
    if eval(breaks):
        os._exit(3)
    results = [answer(query) for query in asked]
    if m["type"] == "queries":
        print(json.dumps({{"type": "results", "id": m["id"], "results": results}}), flush=True)
    else:
        print(json.dumps({{"type": "result", "id": m["id"], **results[0]}}), flush=True)
"""


def ask_together(
    tmp_path: Path, dataset: Dataset, declared: object, breaks: str = "False"
) -> tuple[list[TrackResult], list[int]]:
    """Answers to nine queries in one call, after one alone, and how many at a time the program was asked about."""
    tmp_path.mkdir(exist_ok=True)
    log, script = tmp_path / "log", tmp_path / "batching.py"
    script.write_text(BATCHING.format(declared=json.dumps(declared), breaks=breaks, log=str(log)))
    tracker = SubprocessTracker(f"{sys.executable} {script}", time_limit_s=LONG_S, start_limit_s=LONG_S)
    pair_set = dataset.pair_set(ACROSS)
    prepared = tracker.prepare(dataset.reference(pair_set, pair_set.pairs[0]))
    queries = [dataset.query(pair_set, pair) for pair in (*pair_set.pairs, *pair_set.pairs)][:9]
    first = tracker.track(prepared, queries[0])
    results = [first, *tracker.track_batch(prepared, queries, [None] * len(queries))]
    tracker.close()
    return results, [int(word) for word in log.read_text().split()]


def poses(results: list[TrackResult]) -> list[float | None]:
    return [None if result.T_query_ref is None else result.T_query_ref[0, 3] for result in results]


@pytest.mark.parametrize(
    ("declared", "asked"),
    [
        (None, [1] + [1] * 9),
        (1, [1] + [1] * 9),
        (4, [1, 4, 4, 1]),
        (8, [1, 8, 1]),
        (10**9, [1, 8, 1]),
    ],
)
def test_a_program_is_asked_about_as_many_queries_at_once_as_it_declares(
    tmp_path: Path, dataset: Dataset, declared: int | None, asked: list[int]
) -> None:
    results, sizes = ask_together(tmp_path, dataset, declared)
    assert sizes == asked
    alone, _ = ask_together(tmp_path / "alone", dataset, 1)
    assert poses(results) == poses(alone)
    assert None not in poses(results)


def test_of_several_queries_only_the_one_that_breaks_the_program_is_lost(tmp_path: Path, dataset: Dataset) -> None:
    alone = poses(ask_together(tmp_path / "alone", dataset, 1)[0])
    bad = alone[3]
    breaks = f"any(answer(query)['pose'][0] == {bad} for query in asked)"
    results, sizes = ask_together(tmp_path, dataset, 4, breaks)
    assert poses(results) == [None if pose == bad else pose for pose in alone]
    assert "the program ended (exit status 3) when asked 'query'" in results[alone.index(bad)].message
    assert sizes[:6] == [1, 4, 1, 1, 1, 1]


def test_a_program_that_breaks_on_many_queries_at_once_gets_fewer(tmp_path: Path, dataset: Dataset) -> None:
    results, sizes = ask_together(tmp_path, dataset, 8, "len(asked) > 3")
    assert None not in poses(results)
    assert sizes == [1, 8, *[1] * 8, 1]
    tracker_sizes = ask_together(tmp_path / "four", dataset, 4, "len(asked) > 2")[1]
    assert tracker_sizes == [1, 4, *[1] * 4, 2, 2, 1]


@pytest.mark.parametrize("declared", [0, -1, True, 2.5, "8", [8]])
def test_a_batch_that_is_no_count_costs_the_pair_and_says_why(
    tmp_path: Path, dataset: Dataset, declared: object
) -> None:
    script = tmp_path / "batching.py"
    script.write_text(BATCHING.format(declared=json.dumps(declared), breaks="False", log=str(tmp_path / "log")))
    tracker = SubprocessTracker(f"{sys.executable} {script}", time_limit_s=LONG_S, start_limit_s=LONG_S)
    pair_set = dataset.pair_set(ACROSS)
    prepared = tracker.prepare(dataset.reference(pair_set, pair_set.pairs[0]))
    result = tracker.track(prepared, dataset.query(pair_set, pair_set.pairs[0]))
    tracker.close()
    assert result.message == f"answered 'start' with the batch {json.dumps(declared)}, expected an integer from 1"


def test_a_program_that_is_not_there_is_a_users_mistake() -> None:
    with pytest.raises(MethodError, match="program"):
        SubprocessTracker("/no/such/program --flag")


def test_a_late_answer_is_never_taken_for_the_next_queries(tmp_path: Path, dataset: Dataset) -> None:
    """The program answers twice: what it says of the first query a second time comes when the second is asked."""
    results, _, tracker = ask(tmp_path, dataset, "print(good, flush=True); print(good, flush=True)", questions=2)
    tracker.close()
    assert results[0].answered
    assert results[1].message == "answered 'query' with the id 3, expected the id of the question, 4"
    assert results[1].info["status"] == "error"


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("while True: os.write(1, b'x' * 65536)", "more than 1048576 bytes without an end of line"),
        ("print(good[:-1] + ', \"more\": \"' + 'x' * 2**21 + '\"}', flush=True)", "1048576 bytes"),
        ("while True: os.write(2, b'x' * 65536)", "no answer to 'query' within 2 s"),
    ],
)
def test_a_stream_without_an_end_of_line_costs_the_pair_and_bounded_memory(
    tmp_path: Path, dataset: Dataset, body: str, words: str
) -> None:
    tracemalloc.start()
    try:
        results, _, tracker = ask(
            tmp_path, dataset, f"import os; exec({body!r})", limit_s=2.0 if "2 s" in words else LONG_S
        )
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    tracker.close()
    assert words in results[0].message
    assert most < 64 * 2**20


def test_lines_that_nobody_asked_for_stay_in_the_pipe(tmp_path: Path, dataset: Dataset) -> None:
    body = "print(good, flush=True); exec('while True: os.write(1, b\"{}\\\\n\" * 9999)')"
    results, _, tracker = ask(tmp_path, dataset, f"import os; {body}", questions=2)
    tracker.close()
    assert results[0].answered
    assert results[1].message == "answered 'query' with {}, expected an object of type 'result'"


def test_what_a_program_says_on_standard_error_is_kept_to_its_end_only(tmp_path: Path, dataset: Dataset) -> None:
    body = "sys.stderr.write('x' * 10**6 + ' the cause'); sys.stderr.flush(); sys.exit(4)"
    results, _, tracker = ask(tmp_path, dataset, body)
    tracker.close()
    assert re.fullmatch(r"the program ended \(exit status 4\) when asked 'query': x+ the cause", results[0].message)


FORKING = """
import os
def forked():
    if os.fork():
        return
    {detach}
    with open({pids!r}, "a") as stream:
        stream.write(str(os.getpid()) + "\\n")
    while True:
        time.sleep(60)
forked()
while not os.path.exists({pids!r}) or not open({pids!r}).read().endswith("\\n"):
    time.sleep(0.01)
{then}
"""


def forking(pids: Path, then: str, detach: str = "os.setsid(); os.fork() and os._exit(0)") -> str:
    """What a program does at a query: it forks a child that never ends, waits until it has told its number, goes on."""
    return f"exec({FORKING.format(pids=str(pids), detach=detach, then=then)!r})"


def gone(pids: Path) -> bool:
    """Whether all processes of a list end; waits for it for long, as a safety net."""
    until = time.monotonic() + 60
    while any(running(int(pid)) for pid in pids.read_text().split()):
        if time.monotonic() > until:
            return False
        time.sleep(0.01)
    return True


def running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere a child with a session of its own escapes")
@pytest.mark.parametrize("detach", ["pass", "os.setsid(); os.fork() and os._exit(0)"], ids=["forked", "daemon"])
@pytest.mark.parametrize(
    "then", ["print(good, flush=True)", "os._exit(3)", "os.kill(os.getpid(), 9)"],
    ids=["answers", "ends", "is killed"],
)  # fmt: skip
def test_a_child_that_a_program_forked_ends_with_it(tmp_path: Path, dataset: Dataset, then: str, detach: str) -> None:
    pids = tmp_path / "pids"
    results, _, tracker = ask(tmp_path, dataset, forking(pids, then, detach), limit_s=60.0)
    assert results[0].answered == (then == "print(good, flush=True)"), results[0].message
    if then == "os.kill(os.getpid(), 9)":
        assert "the program ended (exit status -9)" in results[0].message
    tracker.close()
    assert pids.read_text().strip()
    assert gone(pids)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere a child with a session of its own escapes")
def test_what_a_program_started_ends_when_the_process_that_asks_is_killed(tmp_path: Path, dataset: Dataset) -> None:
    pids = tmp_path / "pids"
    script = tmp_path / "program.py"
    then = f'open({str(pids)!r}, "a").write(str(os.getpid()) + chr(10)); os.kill(os.getppid(), 0); time.sleep(600)'
    script.write_text(PROGRAM.format(log=str(tmp_path / "log"), body=forking(pids, then)))
    asking = f"""
import sys
from relocbench.datasets.core.dataset import Dataset
from relocbench.methods import subprocess_tracker
from relocbench.methods.subprocess_tracker import SubprocessTracker
dataset = Dataset(__import__("pathlib").Path({str(dataset.root)!r}))
pairs = dataset.pair_set({ACROSS!r})
tracker = SubprocessTracker({f"{sys.executable} {script}"!r})
tracker.track(tracker.prepare(dataset.reference(pairs, pairs.pairs[0])), dataset.query(pairs, pairs.pairs[0]))
"""
    process = subprocess.Popen([sys.executable, "-c", asking])
    until = time.monotonic() + 120
    while not pids.exists() or pids.read_text().count("\n") < 2:
        assert process.poll() is None
        assert time.monotonic() < until
        time.sleep(0.01)
    process.kill()
    process.wait()
    assert gone(pids)
