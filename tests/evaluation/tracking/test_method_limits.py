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
from killing import is_running
from made_pairs import SETTINGS
from misbehaving import allow_few_times
from small_dataset import ACROSS, make_small_dataset
from small_views import make_small_views

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.cross_view import open_cross_view
from relocbench.errors import ConfigError
from relocbench.evaluation.common import worker_losses
from relocbench.evaluation.common.answer_table import Answer, read_answers
from relocbench.evaluation.common.worker import Shown, Unit, append_entry
from relocbench.evaluation.common.worker_losses import LossHandler
from relocbench.evaluation.retrieval.answers import read_answers as retrieved
from relocbench.evaluation.retrieval.describe import anonymous
from relocbench.evaluation.retrieval.evaluate import RetrievalOptions, evaluate_retrievers
from relocbench.evaluation.tracking.evaluate import EvaluateOptions, Report, evaluate_methods
from relocbench.execution import IN_A_ROW, MANY_TIMES, Loss, Run, Step, parse_size, run_limited, worker_process
from relocbench.methods import parse_method
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


@pytest.mark.parametrize(
    ("deed", "words", "more"),
    [
        ("hang", "took longer than the time limit of 2 s", {"time_limit": 2.0}),
        ("hang_in_native_code", "took longer than the time limit of 2 s", {"time_limit": 2.0}),
        ("leave", "the worker process died twice on this pair (exit status 3)", {}),
        ("crash", "the worker process died twice on this pair (signal SIGSEGV)", {}),
        ("kill_itself", "the worker process died twice on this pair (signal SIGKILL: out of memory,", {}),
        ("take_memory", "took more memory than the limit of 700 MB", {"memory_limit": "700MB"}),
        ("raise_memory_error", "MemoryError: Unable to allocate", {}),
        ("fork_sleepers", "the worker process died twice on this pair (exit status 4)", {}),
    ],
)
def test_a_method_that_misbehaves_costs_one_pair_and_later_methods_run(
    dataset: Dataset, tmp_path: Path, deed: str, words: str, more: dict[str, object]
) -> None:
    at = third(dataset)
    settings = (f"bad.deed={deed}", f"bad.at={at}")
    report = evaluate(dataset, tmp_path, f"bad={HERE}:Misbehaves", "identity", settings=settings, **more)
    told = {pair: answer.message for pair, answer in answers(report).items() if answer.status == "error"}
    print(f"\n{deed}: {told}")
    assert list(told) == [at]
    assert told[at].startswith(words)
    assert {a.status for pair, a in answers(report).items() if pair != at} == {"ok"}
    assert {a.status for a in answers(report, 1).values()} == {"ok"}
    assert report.broken[0][0] == "bad"


def test_of_a_batch_only_the_pair_that_ends_the_process_is_lost(dataset: Dataset, tmp_path: Path) -> None:
    at = third(dataset)
    settings = ("bad.deed=leave", f"bad.at={at}")
    report = evaluate(dataset, tmp_path, f"bad={HERE}:InBatches", settings=settings)
    assert [pair for pair, answer in answers(report).items() if answer.status == "error"] == [at]


def test_predictions_do_not_depend_on_the_number_of_workers_where_pairs_are_lost(
    dataset: Dataset, tmp_path: Path
) -> None:
    settings = ("bad.deed=leave", f"bad.at={third(dataset)}")
    one, two = (
        evaluate(dataset, tmp_path / str(w), f"bad={HERE}:Misbehaves", settings=settings, workers=w) for w in (1, 2)
    )
    assert one.folders[0].predictions(ACROSS).read_bytes() == two.folders[0].predictions(ACROSS).read_bytes()


@pytest.fixture
def few_times() -> None:
    """What is done once may take twice the time limit in the worker that lives now, so that less is waited for."""
    assert MANY_TIMES == 10, "elsewhere it may take ten times the limit, as is documented"
    done = run_limited(allow_few_times, [2.0], Run(), on_loss=lambda unit, loss: loss)
    assert list(done) == [(0, None)]


@pytest.mark.parametrize(
    ("deed", "words", "tries"),
    [
        pytest.param(*("hang", "constructor: took longer than 2 s, 2 times the time limit", 1), marks=pytest.mark.slow),
        ("leave", "constructor: the worker process died twice (exit status 3)", 2),
    ],
)
def test_a_constructor_that_does_not_return_gives_the_method_up_and_later_methods_run(
    dataset: Dataset, tmp_path: Path, deed: str, words: str, tries: int, few_times: None
) -> None:
    mark = tmp_path / "made"
    settings = (f"bad.deed={deed}", f"bad.mark={mark}")
    report = evaluate(
        dataset, tmp_path / "out", f"bad={HERE}:InConstructor", "identity", settings=settings, time_limit=1.0
    )
    assert all(a.status == "error" and a.message.startswith(words) for a in answers(report).values())
    assert len(mark.read_text().splitlines()) == tries
    assert {a.status for a in answers(report, 1).values()} == {"ok"}
    ((label, told),) = report.broken
    assert label == "bad"
    assert words in told


@pytest.mark.parametrize(
    ("name", "deed", "words"),
    [
        ("AlwaysMisbehaves", "hang", "longer than the time limit of 1 s"),
        ("AlwaysMisbehaves", "leave", "exit status 3"),
        pytest.param(*("AlwaysInBatches", "hang", "longer than the time limit of 1 s"), marks=pytest.mark.slow),
    ],
)
def test_a_method_that_answers_no_pair_is_given_up(
    dataset: Dataset,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    few_times: None,
    name: str,
    deed: str,
    words: str,
) -> None:
    monkeypatch.setattr(worker_losses, "IN_A_ROW", 3)
    settings = (f"bad.deed={deed}", f"bad.mark={tmp_path / 'mark'}")
    report = evaluate(dataset, tmp_path / "out", f"bad={HERE}:{name}", "identity", settings=settings, time_limit=1.0)
    told = [answer.message for answer in answers(report).values()]
    tried = (tmp_path / "mark").read_text().splitlines()
    keyframes = len({pair.ref_timestamp_ns for pair in dataset.pair_set(ACROSS).pairs})
    asked = 0 if "Batches" in name else 3
    assert sum(not message.startswith("not asked: ") for message in told) == asked
    assert len(tried) == (keyframes + 3 if deed == "leave" else 3), "a death may be an accident, and is tried twice"
    (message,) = {message for message in told if message.startswith("not asked: ")}
    assert "given up when 3 calls in a row were lost, without any answer before" in message
    assert words in message
    assert message.endswith("and run again with --overwrite failed")
    assert {a.status for a in answers(report, 1).values()} == {"ok"}
    assert report.broken[0][0] == "bad"


def unit_of(*keys: int, journal: Path) -> Unit:
    spec = parse_method("identity")
    return Unit(spec, Path("d"), "a", "b", "c", tuple((0, key) for key in keys), journal, Shown(), patient=True)


def test_losses_with_answers_in_between_do_not_give_a_method_up_and_those_without_do(tmp_path: Path) -> None:
    written: list[str] = []

    def write(unit: Unit, key: tuple[int, int], message: str) -> None:
        written.append(message)
        append_entry(unit.journal, {"key": list(key)})

    losses = LossHandler(write)
    patient = []
    for number in range(4 * IN_A_ROW):
        journal = tmp_path / str(number)
        journal.mkdir()
        (unit,) = losses.runnable_units([unit_of(1, 2, journal=journal)], lambda count: None)
        patient.append(unit.patient)
        if number % 4 == 0:  # every fourth unit answers its first pair and loses its second one, the others lose one
            append_entry(journal, {"key": [0, 1]})
        key = unit.keys[number % 4 == 0]
        losses.unit_ended(losses.handle_loss(unit, Loss(Step("", (key,)), "time", "took longer")))
    assert written == ["took longer"] * 4 * IN_A_ROW
    assert patient == [True, True, False, False] + [False, True, False, False] * (IN_A_ROW - 1)
    while not written[-1].startswith("not asked"):
        journal = tmp_path / f"more{len(written)}"
        journal.mkdir()
        for unit in losses.runnable_units([unit_of(1, journal=journal)], lambda count: None):
            losses.unit_ended(losses.handle_loss(unit, Loss(Step("", unit.keys), "time", "took longer")))
    lost = written[4 * IN_A_ROW : -1]
    assert len(lost) == IN_A_ROW - 4, "three without an answer, and the one after the last answer, came before"
    told = f"{IN_A_ROW} calls in a row were lost, after {IN_A_ROW} answered pairs (took longer); mend"
    assert told in written[-1]


@pytest.mark.slow
def test_prepare_that_does_not_return_costs_its_keyframe(dataset: Dataset, tmp_path: Path, few_times: None) -> None:
    mark, at = tmp_path / "mark", dataset.pair_set(ACROSS).pairs[0].ref_timestamp_ns
    settings = ("bad.deed=hang", f"bad.mark={mark}", f"bad.at=keyframe {at}")
    report = evaluate(dataset, tmp_path / "out", f"bad={HERE}:InPrepare", settings=settings, time_limit=1.0)
    for key, answer in read_answers(report.folders[0].answers(ACROSS)).items():
        assert answer.status == ("error" if key[0] == at else "ok")
        assert answer.message.startswith("prepare: took longer than 2 s" if key[0] == at else "")
    assert len(mark.read_text().splitlines()) == 1


def test_prepare_that_always_ends_the_process_is_not_tried_on_every_keyframe(dataset: Dataset, tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    settings = ("bad.deed=leave", f"bad.mark={mark}")
    report = evaluate(dataset, tmp_path / "out", f"bad={HERE}:InPrepare", settings=settings, workers=1)
    assert {a.status for a in answers(report).values()} == {"error"}
    tried = mark.read_text().splitlines()
    assert len(tried) == 6, "three keyframes, each twice"
    assert len({p.ref_timestamp_ns for p in dataset.pair_set(ACROSS).pairs}) > 3


def test_a_method_that_prepares_some_keyframes_is_tried_on_all(tmp_path: Path) -> None:
    dataset = make_small_dataset(tmp_path / "data", frames=5, size=(64, 48))
    first, *others = sorted({p.ref_timestamp_ns for p in dataset.pair_set(ACROSS).pairs})
    settings: tuple[str, ...] = ("bad.deed=leave", f"bad.mark={tmp_path / 'mark'}")
    settings = (*settings, f"bad.at={','.join(f'keyframe {at}' for at in others)}")
    report = evaluate(dataset, tmp_path / "out", f"bad={HERE}:InPrepare", settings=settings)
    assert {pair.split()[0] for pair, answer in answers(report).items() if answer.status == "ok"} == {str(first)}
    tried = (tmp_path / "mark").read_text().splitlines()
    assert sorted(tried) == sorted(2 * [str(at) for at in others])
    assert len(others) > 3


def test_what_a_method_leaves_behind_ends_with_the_run(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    left = tmp_path / "left"
    monkeypatch.setenv("LEFT_BEHIND", str(left))
    settings = ("bad.deed=start_and_leave_behind", f"bad.at={third(dataset)}")
    # With worker processes of its own, which end and have the environment of this moment.
    report = Context().run(evaluate, dataset, tmp_path / "out", f"bad={HERE}:Misbehaves", settings=settings)
    assert {a.status for a in answers(report).values()} == {"ok"}
    wait_until(lambda: not any(is_running(int(pid)) for pid in left.read_text().split()))


@pytest.mark.parametrize("what", ["query", "reference", "depth", "uv", "inverse depth", "map"])
def test_a_method_that_writes_into_what_it_is_given_costs_its_pair_and_changes_nothing(
    dataset: Dataset, tmp_path: Path, what: str
) -> None:
    at = third(dataset)
    methods = (f"bad={HERE}:Writes", f"good={HERE}:Writes")
    settings = (f"bad.what={what}", f"bad.at={at}")
    report = evaluate(dataset, tmp_path, *methods, settings=settings, workers=0)
    bad, good = answers(report), answers(report, 1)
    assert [pair for pair, answer in bad.items() if answer.status == "error"] == [at]
    assert bad[at].message.startswith("ValueError: assignment destination is read-only")
    assert {a.status for a in good.values()} == {"ok"}
    assert all(good[pair].info == answer.info for pair, answer in bad.items() if pair != at)


def test_one_worker_is_another_process_and_none_is_this_one(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = "tests_of_limits_saw_this_process"
    for workers, expected in ((1, False), (0, True)):
        monkeypatch.setitem(sys.modules, loaded, np)
        report = evaluate(dataset, tmp_path / str(workers), f"who={HERE}:TellsModules", workers=workers)
        assert {loaded in a.info for a in answers(report).values()} == {expected}


@pytest.mark.parametrize(
    ("deed", "words", "more"),
    [
        ("leave", "the worker process died twice (exit status 3)", {}),
        pytest.param("hang_in_native_code", "took longer than the time limit of 2 s", {"time_limit": 2.0}),
    ],
)
def test_an_image_on_which_a_retriever_ends_its_process_costs_itself_alone(
    tmp_path: Path, deed: str, words: str, more: dict[str, object], few_times: None
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
        **more,
    )
    report = evaluate_retrievers(options, Silent())
    bad, good = (retrieved(folder.answers("drone-satellite")) for folder in report.folders)
    told = {a.query: a.message for a in bad if a.status == "error"}
    print(f"\n{deed}: {told}")
    assert list(told) == [query]
    assert told[query].startswith(words)
    assert {a.status for a in good} == {"ok"}


def test_checking_a_method_that_ends_its_process_says_so(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    checked = relocbench(
        "check-method", f"{HERE}:InConstructor", "--set", "deed=crash", "--set", f"mark={mark}", "--json"
    )
    assert checked.status == 2
    (finding,) = json.loads(checked.out)["checks"]
    assert finding["passed"] is False
    assert finding["detail"] == "it ended (signal SIGSEGV)"


@pytest.mark.parametrize(
    ("text", "size"), [("4GB", 4 * 10**9), ("512 MiB", 2**29), ("2.5g", 2_500_000_000), ("1000", 1000), (7, 7)]
)
def test_sizes_are_read_as_people_write_them(text: str | int, size: int) -> None:
    assert parse_size(text) == size


@pytest.mark.parametrize("text", ["", "many", "4XB", "-1GB", "GB", "1e3GB"])
def test_what_is_no_size_is_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="expected a size"):
        EvaluateOptions(dataset=tmp_path, methods=("identity",), memory_limit=text)


def test_limits_that_cannot_be_kept_are_refused(dataset: Dataset, tmp_path: Path) -> None:
    for more in ({"workers": 0}, {"scheduler": "tcp://127.0.0.1:9"}):
        with pytest.raises(ValueError, match="--time-limit cannot be kept"):
            EvaluateOptions(dataset=tmp_path, methods=("identity",), time_limit=3, **more)


def test_a_memory_limit_without_proc_is_one_clear_line(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("relocbench.execution.memory.PROC", tmp_path / "nowhere")
    with pytest.raises(ConfigError, match="--memory-limit needs /proc"):
        evaluate(dataset, tmp_path, "identity", memory_limit="1GB")


def test_a_retriever_whose_constructor_ends_the_process_is_given_up_and_later_ones_run(tmp_path: Path) -> None:
    views = make_small_views(tmp_path / "views", places=3)
    methods = (f"bad={HERE}:DescribesNever", "good=colour-histogram")
    settings = ("bad.deed=leave",)
    report = evaluate_retrievers(
        RetrievalOptions(dataset=views, out=tmp_path / "out", methods=methods, set=settings), Silent()
    )
    bad, good = (retrieved(folder.answers("drone-satellite")) for folder in report.folders)
    assert {a.message for a in bad} == {"constructor: the worker process died twice (exit status 3)"}
    assert {a.status for a in good} == {"ok"}


def wait_until(true: object, process: subprocess.Popen[str] | None = None) -> None:
    """Raises where it does not come true in time, or the process ends before."""
    until = time.monotonic() + WAIT_S
    while not true():  # type: ignore[operator]
        assert time.monotonic() < until
        assert process is None or process.poll() is None, process.communicate()
        time.sleep(0.02)


def group_of(pid: int) -> list[int]:
    """A process, its descendants, and what these have started in sessions of their own."""
    from relocbench.execution.descendants import descendants

    return [pid, *descendants(pid)]


def interrupted(command: list[str], reached: object, kind: signal.Signals, to_group: bool, cwd: Path) -> str:
    """Run a command, interrupt it when it has ``reached`` its work, and see that it ends; returns what it said."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    process = subprocess.Popen(
        command, cwd=cwd, env=environment, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, process_group=0
    )
    try:
        wait_until(reached, process)
        processes = group_of(process.pid)
        start = time.monotonic()
        (os.killpg if to_group else os.kill)(process.pid, kind)
        process.wait(WAIT_S)
    finally:
        process.kill()
    seconds = time.monotonic() - start
    wait_until(lambda: not any(is_running(pid) for pid in processes))
    _, err = process.communicate()
    print(f"\nended {seconds:.2f} s after {kind.name} to the {'group' if to_group else 'process'}")
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert err.count("relocbench: interrupted; the same command goes on where it stopped") == 1
    return err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("deed", "workers", "kind", "to_group"),
    [
        ("hang", 1, signal.SIGINT, True),
        ("hang_in_native_code", 2, signal.SIGINT, False),
        ("hang_in_native_code", 1, signal.SIGTERM, False),
    ],
)
def test_one_signal_ends_an_evaluation_while_its_method_hangs(
    dataset: Dataset, tmp_path: Path, deed: str, workers: int, kind: signal.Signals, to_group: bool
) -> None:
    mark = tmp_path / "mark"
    command = [sys.executable, "-m", "relocbench", "evaluate", "-d", str(dataset.root), "-m", f"bad={HERE}:Misbehaves"]
    command += ["--set", f"deed={deed}", "--set", f"at={third(dataset)}", "--set", f"mark={mark}", "-j", str(workers)]
    interrupted([*command, "-o", str(tmp_path / "out")], mark.exists, kind, to_group, tmp_path)


@pytest.mark.slow
def test_one_ctrl_c_ends_a_command_whose_worker_starts_up(dataset: Dataset, tmp_path: Path) -> None:
    (tmp_path / "slow_start.py").write_text(
        "import pathlib, sys, time\n"
        "if sys.argv[0] == '-c':  # the method's process\n"
        "    pathlib.Path('mark').touch()\n"
        "    time.sleep(1000)\n"
        "from misbehaving import Misbehaves\n"
    )
    command = [
        sys.executable,
        "-m",
        "relocbench",
        "evaluate",
        "-d",
        str(dataset.root),
        "-m",
        "slow=slow_start:Misbehaves",
    ]
    interrupted([*command, "-j", "1"], (tmp_path / "mark").exists, signal.SIGINT, True, tmp_path)


@pytest.mark.slow
def test_one_ctrl_c_ends_a_program_that_does_not_answer(dataset: Dataset, tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(
        "import json, pathlib, sys, time\n"
        "for line in sys.stdin:\n"
        "    if '\"query\"' in line:\n"
        "        pathlib.Path('mark').touch()\n"
        "        time.sleep(1000)\n"
        "    print(json.dumps({'type': 'ready', 'id': json.loads(line)['id']}), flush=True)\n"
    )
    method = f"p=subprocess:{sys.executable} {program}"
    command = [sys.executable, "-m", "relocbench", "evaluate", "-d", str(dataset.root), "-m", method, "-j", "2"]
    interrupted(command, (tmp_path / "mark").exists, signal.SIGINT, True, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_one_ctrl_c_ends_a_build(tmp_path: Path, workers: int) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-m", "relocbench", "build-dataset", "synthetic", "--preset", "smoke"]
    command += ["--size", "2048x2048", "--out", str(out), "-j", str(workers)]
    interrupted(command, lambda: any(out.rglob("poses.csv")), signal.SIGINT, True, tmp_path)


@pytest.mark.slow
def test_one_ctrl_c_ends_a_training(dataset: Dataset, tmp_path: Path) -> None:
    made = make_small_dataset(tmp_path / "d", frames=5, correspondences=300, splits={"train": [ACROSS]})
    out = tmp_path / "out"
    command = [sys.executable, "-m", "relocbench", "train", "gn-net", "-d", str(made.root), "-o", str(out)]
    command += ["-j", "1", "--device", "cpu", "--no-validation", *SETTINGS, "--set=steps=1000000"]
    interrupted(command, lambda: any(out.glob("log*")), signal.SIGINT, True, tmp_path)


@pytest.mark.slow
def test_one_ctrl_c_ends_a_command_that_does_not_hear_of_it(tmp_path: Path) -> None:
    """Native code in the command's own process, which has let go of the interpreter."""
    program = (
        "import ctypes, pathlib, relocbench.cli, relocbench.cli.app\n"
        "def stuck(**_):\n"
        "    pathlib.Path('mark').touch()\n"
        "    ctypes.CDLL(None).pause()\n"
        "    while True: ctypes.CDLL(None).pause()\n"
        "def hear_nothing(*_): ctypes.CDLL(None).sleep(1000)\n"
        "import signal, relocbench.cli.interruption as interruption\n"
        "interruption._interrupt = hear_nothing\n"
        "relocbench.cli.app.app = stuck\n"
        "relocbench.cli.main()\n"
    )
    interrupted([sys.executable, "-c", program], (tmp_path / "mark").exists, signal.SIGINT, True, tmp_path)


@pytest.mark.slow
def test_one_ctrl_c_ends_a_leaderboard_and_the_same_command_writes_it_later(dataset: Dataset, tmp_path: Path) -> None:
    results, out, mark = tmp_path / "results", tmp_path / "out", tmp_path / "mark"
    evaluate(dataset, results, "identity", workers=0)
    program = (
        "import pathlib, sys, time\n"
        "def stop(event, arguments):\n"
        "    if event == 'os.rename' and str(arguments[1]).endswith('.png') and not pathlib.Path('mark').exists():\n"
        "        pathlib.Path('mark').touch()\n"
        "        time.sleep(1000)\n"
        "sys.addaudithook(stop)\n"
        "import relocbench.cli\n"
        "relocbench.cli.main()\n"
    )
    command = [sys.executable, "-c", program, "leaderboard", str(results), "-o", str(out)]
    interrupted(command, mark.exists, signal.SIGINT, True, tmp_path)
    assert not (out / "leaderboard.md").exists()
    assert relocbench("leaderboard", results, "-o", out, "-q").status == 0
    assert (out / "leaderboard.md").exists()


@pytest.mark.slow
@pytest.mark.parametrize("keep", ["kept = Slow()", "atexit.register(time.sleep, 1000)"])
def test_one_ctrl_c_ends_a_command_whose_interpreter_would_take_long_to_end(tmp_path: Path, keep: str) -> None:
    """Python ends the thread that sees to the end before it takes itself down."""
    program = (
        "import atexit, pathlib, time, relocbench.cli, relocbench.cli.app\n"
        "class Slow:\n"
        "    def __del__(self, sleep=time.sleep): sleep(1000)\n"
        "def work(**_):\n"
        "    pathlib.Path('mark').touch()\n"
        "    time.sleep(1000)\n"
        "relocbench.cli.app.app = work\n"
        f"{keep}\n"
        "relocbench.cli.main()\n"
    )
    interrupted([sys.executable, "-c", program], (tmp_path / "mark").exists, signal.SIGINT, True, tmp_path)


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
