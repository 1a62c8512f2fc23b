"""What a method does to its process costs the pair in hand alone; one Ctrl-C ends any command."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from contextvars import Context
from pathlib import Path

import numpy as np
import pytest
from command_line import relocbench
from killing import running_with, wait_until
from misbehaving import allow_few_times
from refusals import refused
from small_dataset import ACROSS, make_small_dataset
from small_views import make_small_views

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.cross_view import open_cross_view
from relocbench.errors import ConfigError
from relocbench.evaluation.isolation import losses
from relocbench.evaluation.retrieval.answers import ANSWERS as RETRIEVED
from relocbench.evaluation.retrieval.describe import anonymous, mixed
from relocbench.evaluation.retrieval.evaluate import RetrievalOptions, evaluate_retrievers
from relocbench.evaluation.tables.answers import Answer, read_answers
from relocbench.evaluation.tracking.evaluate import EvaluateOptions, Report, evaluate_methods
from relocbench.execution import MANY_TIMES, Run, parse_size, run_limited, worker_process
from relocbench.progress import Silent

pytestmark = pytest.mark.usefixtures("workers_kept")
HERE = "misbehaving"
WAIT_S = 300.0
"""for what must happen on any machine; a safety net"""


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("data") / "small", size=(64, 48))


def evaluate(dataset: Dataset, out: Path, *methods: str, settings: tuple[str, ...] = (), **more: object) -> Report:
    options = {"workers": 1, "pair_sets": (ACROSS,), **more}
    return evaluate_methods(
        EvaluateOptions(dataset=dataset.root, methods=methods, set=settings, out=out, **options),
        Silent(),
    )


def answers(report: Report, method: int = 0) -> dict[str, Answer]:
    """By the times of keyframe and query."""
    return {f"{k[0]} {k[1]}": a for k, a in read_answers(report.folders[method].answers(ACROSS)).items()}


def third(dataset: Dataset) -> str:
    """A pair which is not the first of its process."""
    return "{} {}".format(*sorted(pair.key for pair in dataset.pair_set(ACROSS).pairs)[2])


@pytest.fixture
def limit_s() -> int:
    """A limit that a process which starts keeps several times over, on this machine as busy as it is now."""
    begun = time.perf_counter()
    subprocess.run([sys.executable, "-c", "import relocbench.evaluation.isolation.isolated_process"], check=True)
    return max(1, round(3 * (time.perf_counter() - begun)))


@pytest.fixture
def few_times() -> None:
    """What is done once may take twice the time limit in the worker that lives now, so that less is waited for."""
    assert MANY_TIMES == 10, "elsewhere it may take ten times the limit, as is documented"
    done = run_limited(allow_few_times, [[2.0]], Run(), on_loss=lambda unit, loss: loss)
    assert list(done) == [(0, None)]


@pytest.mark.thorough
def test_a_method_that_ends_its_worker_costs_one_pair_and_what_it_starts_ends_with_the_run(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit_s: int
) -> None:
    """Other ways to end are shown by ``tests/execution/test_limits.py``, and what each costs by
    ``tests/evaluation/isolation/test_worker_losses.py``."""
    left = tmp_path / "left"
    monkeypatch.setenv("LEFT_BEHIND", str(left))
    at = third(dataset)

    def run(deeds: tuple[str, ...], **limits: object) -> Report:
        """With worker processes of its own, which end and have the environment of this moment."""
        methods = [f"{deed}={HERE}:Misbehaves" for deed in deeds]
        settings = tuple(word for deed in deeds for word in (f"{deed}.deed={deed}", f"{deed}.at={at}"))
        return Context().run(evaluate, dataset, tmp_path / "out", *methods, settings=settings, **limits)

    hung = run(("hang_in_native_code",), time_limit=limit_s)
    report = run(("leave", "take_memory", "start_and_leave_behind"), memory_limit="700MB")
    for words, told in (
        (f"{limit_s} s", answers(hung)),
        ("exit status 3", answers(report, 0)),
        ("700 MB", answers(report, 1)),
    ):
        assert [pair for pair, answer in told.items() if answer.status == "error"] == [at]
        assert words in told[at].message
    assert {a.status for a in answers(report, 2).values()} == {"ok"}
    assert [label for label, _ in (*hung.crashed, *report.crashed)] == ["hang_in_native_code", "leave", "take_memory"]
    assert left.exists()
    wait_until(lambda: not running_with(str(left)))


@pytest.mark.thorough
def test_predictions_do_not_depend_on_the_number_of_workers_where_pairs_are_lost(
    dataset: Dataset, tmp_path: Path
) -> None:
    settings = ("bad.deed=leave", f"bad.at={third(dataset)}")
    one, two = (
        evaluate(dataset, tmp_path / str(w), f"bad={HERE}:InBatches", settings=settings, workers=w) for w in (1, 2)
    )
    assert [pair for pair, answer in answers(one).items() if answer.status == "error"] == [third(dataset)]
    assert one.folders[0].predictions(ACROSS).read_bytes() == two.folders[0].predictions(ACROSS).read_bytes()


@pytest.mark.thorough
@pytest.mark.parametrize(("deed", "words", "tries"), [("hang", "longer than", 1), ("leave", "exit status 3", 2)])
def test_a_constructor_that_does_not_return_gives_the_method_up_and_later_methods_run(
    dataset: Dataset, tmp_path: Path, deed: str, words: str, tries: int, few_times: None, limit_s: int
) -> None:
    mark = tmp_path / "made"
    settings = (f"bad.deed={deed}", f"bad.mark={mark}")
    report = evaluate(
        dataset, tmp_path / "out", f"bad={HERE}:InConstructor", "identity", settings=settings, time_limit=limit_s
    )
    for answer in answers(report).values():
        assert answer.status == "error"
        assert answer.message.startswith("constructor: ")
        assert words in answer.message
    assert len(mark.read_text().splitlines()) == tries
    assert {a.status for a in answers(report, 1).values()} == {"ok"}
    assert [label for label, _ in report.crashed] == ["bad"]


@pytest.mark.thorough
def test_a_method_that_answers_no_batch_is_given_up(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, few_times: None, limit_s: int
) -> None:
    monkeypatch.setattr(losses, "IN_A_ROW", 3)
    settings = ("bad.deed=hang", f"bad.mark={tmp_path / 'mark'}")
    methods = (f"bad={HERE}:AlwaysInBatches", "identity")
    report = evaluate(dataset, tmp_path / "out", *methods, settings=settings, time_limit=limit_s)
    told = {answer.message for answer in answers(report).values()}
    assert all(message.startswith("not run") for message in told)
    assert len((tmp_path / "mark").read_text().splitlines()) == 3
    assert {a.status for a in answers(report, 1).values()} == {"ok"}


@pytest.mark.thorough
def test_prepare_that_does_not_return_costs_its_keyframe(
    dataset: Dataset, tmp_path: Path, few_times: None, limit_s: int
) -> None:
    mark, at = tmp_path / "mark", dataset.pair_set(ACROSS).pairs[0].ref_timestamp_ns
    settings = ("bad.deed=hang", f"bad.mark={mark}", f"bad.at=keyframe {at}")
    report = evaluate(dataset, tmp_path / "out", f"bad={HERE}:InPrepare", settings=settings, time_limit=limit_s)
    for key, answer in read_answers(report.folders[0].answers(ACROSS)).items():
        assert answer.status == ("error" if key[0] == at else "ok")
        assert answer.message.startswith(f"prepare: took longer than {2 * limit_s} s" if key[0] == at else "")
    assert len(mark.read_text().splitlines()) == 1


@pytest.mark.thorough
def test_a_method_that_writes_into_what_it_is_given_costs_its_pair_and_changes_nothing(
    dataset: Dataset, tmp_path: Path
) -> None:
    at = third(dataset)
    whats = ("query", "reference", "depth", "uv", "inverse depth", "map")
    methods = [f"m{number}={HERE}:Writes" for number in range(len(whats) + 1)]
    settings = [word for number, what in enumerate(whats) for word in (f"m{number}.what={what}", f"m{number}.at={at}")]
    report = evaluate(dataset, tmp_path, *methods, settings=tuple(settings), workers=0)
    good = answers(report, len(whats))
    assert {a.status for a in good.values()} == {"ok"}
    for number, what in enumerate(whats):
        bad = answers(report, number)
        assert [pair for pair, answer in bad.items() if answer.status == "error"] == [at], what
        assert bad[at].message.startswith("ValueError: assignment destination is read-only"), "as NumPy says it"
        assert all(good[pair].info == answer.info for pair, answer in bad.items() if pair != at)


@pytest.mark.thorough
def test_one_worker_is_another_process_and_none_is_this_one(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = "tests_of_limits_saw_this_process"
    for workers, expected in ((1, False), (0, True)):
        monkeypatch.setitem(sys.modules, loaded, np)
        report = evaluate(dataset, tmp_path / str(workers), f"who={HERE}:TellsModules", workers=workers)
        assert {loaded in a.info for a in answers(report).values()} == {expected}


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("deed", "words"),
    [
        ("leave", "exit status 3"),
        ("hang_in_native_code", "longer than"),
    ],
)
def test_an_image_on_which_a_retriever_ends_its_process_costs_itself_alone(
    tmp_path: Path, deed: str, words: str, few_times: None, request: pytest.FixtureRequest
) -> None:
    views = make_small_views(tmp_path / "views", places=3)
    opened = open_cross_view(views)
    asked = opened.tasks()[0].queries[2]
    query, name = asked.key, next(anonymous([asked], opened.fingerprint)).key
    settings = (f"bad.deed={deed}", f"bad.at='{name}'")
    options = RetrievalOptions(
        dataset=views,
        out=tmp_path / "out",
        methods=(f"bad={HERE}:Describes", "good=colour-histogram"),
        set=settings,
        pair_sets=("drone-satellite",),
        **({"time_limit": request.getfixturevalue("limit_s")} if deed == "hang_in_native_code" else {}),
    )
    report = evaluate_retrievers(options, Silent())
    bad, good = (RETRIEVED.read(folder.answers("drone-satellite")) for folder in report.folders)
    told = {a.query: a.message for a in bad if a.status == "error"}
    assert list(told) == [query]
    assert words in told[query]
    assert {a.status for a in good} == {"ok"}


@pytest.mark.thorough
def test_a_retriever_is_not_given_up_for_the_first_image_that_it_is_shown(tmp_path: Path) -> None:
    opened = open_cross_view(make_small_views(tmp_path / "views", places=3))
    gallery = opened.tasks()[0].gallery
    first = gallery[mixed(len(gallery), opened.fingerprint)[0]]
    options = RetrievalOptions(
        dataset=tmp_path / "views",
        out=tmp_path / "out",
        methods=(f"bad={HERE}:Describes",),
        set=("bad.deed=leave", f"bad.at='{next(anonymous([first], opened.fingerprint)).key}'"),
        pair_sets=("drone-satellite",),
    )
    (folder,) = evaluate_retrievers(options, Silent()).folders
    assert folder.run_record().tasks["drone-satellite"].gallery_described == len(gallery) - 1
    assert {answer.status for answer in RETRIEVED.read(folder.answers("drone-satellite"))} == {"ok"}


@pytest.mark.thorough
def test_checking_a_method_that_ends_its_process_says_so(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    checked = relocbench(
        "check-method", f"{HERE}:InConstructor", "--set", "deed=crash", "--set", f"mark={mark}", "--json"
    )
    assert checked.status == 2
    (finding,) = json.loads(checked.out)["checks"]
    assert finding["passed"] is False
    assert "SIGSEGV" in finding["detail"]


@pytest.mark.parametrize(
    ("text", "size"), [("4GB", 4 * 10**9), ("512 MiB", 2**29), ("2.5g", 2_500_000_000), ("1000", 1000), (7, 7)]
)
def test_sizes_are_read_as_people_write_them(text: str | int, size: int) -> None:
    assert parse_size(text) == size


@pytest.mark.parametrize("text", ["", "many", "4XB", "-1GB", "GB", "1e3GB"])
def test_what_is_no_size_is_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="memory_limit"):
        EvaluateOptions(dataset=tmp_path, methods=("identity",), memory_limit=text)


def test_limits_that_cannot_be_kept_are_refused(dataset: Dataset, tmp_path: Path) -> None:
    for more in ({"workers": 0}, {"scheduler": "tcp://127.0.0.1:9"}):
        with pytest.raises(ValueError, match="--time-limit"):
            EvaluateOptions(dataset=tmp_path, methods=("identity",), time_limit=3, **more)


def test_a_memory_limit_without_proc_is_one_clear_line(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("relocbench.execution.memory.PROC", tmp_path / "nowhere")
    with refused(ConfigError, "", None, "--memory-limit"):
        evaluate(dataset, tmp_path, "identity", memory_limit="1GB")


@pytest.mark.thorough
def test_a_retriever_whose_constructor_ends_the_process_is_given_up_and_later_ones_run(tmp_path: Path) -> None:
    views = make_small_views(tmp_path / "views", places=3)
    methods = (f"bad={HERE}:DescribesNever", "good=colour-histogram")
    settings = ("bad.deed=leave",)
    report = evaluate_retrievers(
        RetrievalOptions(dataset=views, out=tmp_path / "out", methods=methods, set=settings), Silent()
    )
    bad, good = (RETRIEVED.read(folder.answers("drone-satellite")) for folder in report.folders)
    assert len({a.message for a in bad}) == 1
    assert bad[0].message.startswith("constructor: ")
    assert "exit status 3" in bad[0].message
    assert {a.status for a in good} == {"ok"}


def test_an_interruption_while_a_worker_starts_comes_when_it_has_started(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where another thread of the process, which has not blocked it, is given the signal."""
    kind = multiprocessing.get_context("spawn").Process
    start, begun = kind.start, []

    def interrupted(process: multiprocessing.Process) -> None:
        other = threading.Thread(target=os.kill, args=(os.getpid(), signal.SIGINT))
        other.start()
        other.join()
        start(process)
        begun.append(process)

    def start_and_wait() -> None:
        worker_process.WorkerProcess()
        for _ in range(6000):  # on a busy machine the thread that takes the signal may run late
            time.sleep(0.1)

    monkeypatch.setattr(kind, "start", interrupted)
    live = set(worker_process._live)
    waiting = threading.Event()
    idle = threading.Thread(target=waiting.wait)
    idle.start()  # it takes the signal, which the main thread has blocked
    try:
        with pytest.raises(KeyboardInterrupt):
            start_and_wait()
    finally:
        waiting.set()
        idle.join()
    assert len(begun) == 1, "not before it had started"
    (started,) = worker_process._live - live
    started.end()
