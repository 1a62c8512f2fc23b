"""One Ctrl-C, or SIGTERM, ends any command in a line, whatever its method or its workers do."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from command_line import relocbench
from killing import WAIT_S, is_running, running_with, wait_until
from made_pairs import SETTINGS
from small_dataset import ACROSS, make_small_dataset

from relocbench.datasets.core.dataset import Dataset
from relocbench.execution.descendants import descendants

HERE = "misbehaving"
RELOCBENCH = (sys.executable, "-m", "relocbench")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("data") / "small", size=(64, 48))


def stopped(
    command: list[str], reached: Callable[[], bool], kind: signal.Signals, to_group: bool, cwd: Path
) -> tuple[int, str]:
    """Run a command, send it a signal when it has ``reached`` its work, and see that all its processes end.

    Returns its status and what it said.
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    process = subprocess.Popen(
        command, cwd=cwd, env=environment, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, process_group=0
    )
    try:
        wait_until(reached, process)
        processes = [process.pid, *descendants(process.pid)]
        (os.killpg if to_group else os.kill)(process.pid, kind)
        process.wait(WAIT_S)
    finally:
        process.kill()
    wait_until(lambda: not any(is_running(pid) for pid in processes))
    _, err = process.communicate()
    return process.returncode, err


def interrupted(
    command: list[str], reached: Callable[[], bool], kind: signal.Signals, to_group: bool, cwd: Path
) -> str:
    """The same with a signal that a command answers by saying so; returns what it said."""
    status, err = stopped(command, reached, kind, to_group, cwd)
    assert status == 130, err
    assert "Traceback" not in err
    assert err.count("relocbench: interrupted; the same command goes on where it stopped") == 1
    return err


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("deed", "workers", "kind", "to_group"),
    [
        ("hang_in_native_code", 1, signal.SIGINT, True),
        ("hang", 2, signal.SIGINT, False),
        ("hang_in_native_code", 1, signal.SIGTERM, False),
    ],
)
def test_one_signal_ends_an_evaluation_while_its_method_hangs(
    dataset: Dataset, tmp_path: Path, deed: str, workers: int, kind: signal.Signals, to_group: bool
) -> None:
    mark = tmp_path / "mark"
    command = [*RELOCBENCH, "evaluate", "-d", str(dataset.root), "-m", f"bad={HERE}:Misbehaves"]
    at = "{} {}".format(*dataset.pair_set(ACROSS).pairs[2].key)
    command += ["--set", f"deed={deed}", "--set", f"at={at}", "--set", f"mark={mark}", "-j", str(workers)]
    interrupted([*command, "-o", str(tmp_path / "out")], mark.exists, kind, to_group, tmp_path)


@pytest.mark.thorough
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere a child with a session of its own escapes")
@pytest.mark.parametrize("sandbox", ["auto", "none"])
def test_a_kill_leaves_no_process_of_a_method_behind(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sandbox: str
) -> None:
    left = str(tmp_path / "left")
    monkeypatch.setenv("LEFT_BEHIND", left)
    command = [*RELOCBENCH, "evaluate", "-d", str(dataset.root), "-m", f"bad={HERE}:Misbehaves", "-j", "1"]
    at = "{} {}".format(*dataset.pair_set(ACROSS).pairs[2].key)
    command += ["--set", "deed=leave_behind_and_hang", "--set", f"at={at}", "--sandbox", sandbox]
    command += ["-o", str(tmp_path / "out")]
    status, err = stopped(command, lambda: len(running_with(left)) == 2, signal.SIGKILL, False, tmp_path)
    assert status == -signal.SIGKILL, err
    assert not running_with(left)


@pytest.mark.thorough
def test_one_ctrl_c_ends_a_command_whose_worker_starts_up(dataset: Dataset, tmp_path: Path) -> None:
    (tmp_path / "slow_start.py").write_text(
        "import pathlib, sys, time\n"
        "if sys.argv[0] == '-c':  # the method's process\n"
        "    pathlib.Path('mark').touch()\n"
        "    time.sleep(1000)\n"
        "from misbehaving import Misbehaves\n"
    )
    command = [*RELOCBENCH, "evaluate", "-d", str(dataset.root), "-m", "slow=slow_start:Misbehaves"]
    interrupted([*command, "-j", "1"], (tmp_path / "mark").exists, signal.SIGINT, True, tmp_path)


@pytest.mark.thorough
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
    command = [*RELOCBENCH, "evaluate", "-d", str(dataset.root), "-m", method, "-j", "2"]
    interrupted(command, (tmp_path / "mark").exists, signal.SIGINT, True, tmp_path)


@pytest.mark.thorough
@pytest.mark.parametrize("workers", [1, 2])
def test_one_ctrl_c_ends_a_build(tmp_path: Path, workers: int) -> None:
    out = tmp_path / "out"
    command = [*RELOCBENCH, "build-dataset", "synthetic", "--preset", "smoke"]
    command += ["--size", "2048x2048", "--out", str(out), "-j", str(workers)]
    interrupted(command, lambda: any(out.rglob("poses.csv")), signal.SIGINT, True, tmp_path)


@pytest.mark.thorough
def test_one_ctrl_c_ends_a_training(dataset: Dataset, tmp_path: Path) -> None:
    made = make_small_dataset(tmp_path / "d", frames=5, correspondences=300, splits={"train": [ACROSS]})
    out = tmp_path / "out"
    command = [*RELOCBENCH, "train", "gn-net", "-d", str(made.root), "-o", str(out)]
    command += ["-j", "1", "--device", "cpu", "--no-validation", *SETTINGS, "--set=steps=1000000"]
    interrupted(command, lambda: any(out.glob("log*")), signal.SIGINT, True, tmp_path)


@pytest.mark.thorough
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
        "relocbench.cli.app._commands = lambda: stuck\n"
        "relocbench.cli.main()\n"
    )
    interrupted([sys.executable, "-c", program], (tmp_path / "mark").exists, signal.SIGINT, True, tmp_path)


@pytest.mark.thorough
def test_what_other_threads_meet_after_a_ctrl_c_is_not_printed(tmp_path: Path) -> None:
    """As multiprocessing's thread does that hands files to workers, when these have ended."""
    program = (
        "import pathlib, sys, threading, time, relocbench.cli, relocbench.cli.app\n"
        "import relocbench.cli.interruption as interruption\n"
        "def meet():\n"
        "    interruption._heard.wait()\n"
        "    sys.excepthook(EOFError, EOFError(), None)\n"
        "def work(**_):\n"
        "    threading.Thread(target=meet, daemon=True).start()\n"
        "    pathlib.Path('mark').touch()\n"
        "    time.sleep(1000)\n"
        "relocbench.cli.app._commands = lambda: work\n"
        "relocbench.cli.main()\n"
    )
    err = interrupted([sys.executable, "-c", program], (tmp_path / "mark").exists, signal.SIGINT, True, tmp_path)
    assert "EOFError" not in err


@pytest.mark.thorough
def test_one_ctrl_c_ends_a_leaderboard_and_the_same_command_writes_it_later(dataset: Dataset, tmp_path: Path) -> None:
    results, out, mark = tmp_path / "results", tmp_path / "out", tmp_path / "mark"
    assert relocbench("evaluate", "-d", dataset.root, "-m", "identity", "-j", 0, "-o", results, "-q").status == 0
    program = (
        "import pathlib, sys, time\n"
        "def stop(event, arguments):\n"
        "    if event == 'os.rename' and str(arguments[1]).endswith('.csv') and not pathlib.Path('mark').exists():\n"
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


@pytest.mark.thorough
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
        "relocbench.cli.app._commands = lambda: work\n"
        f"{keep}\n"
        "relocbench.cli.main()\n"
    )
    interrupted([sys.executable, "-c", program], (tmp_path / "mark").exists, signal.SIGINT, True, tmp_path)


def test_an_interruption_that_a_library_wraps_in_an_error_of_its_own_ends_in_a_line(tmp_path: Path) -> None:
    """Pydantic's serializers raise a PydanticSerializationError where a KeyboardInterrupt comes in Python code."""
    script = (
        "import os, signal, sys, types; import relocbench.cli as cli\n"
        "def run():\n"
        "    try: os.kill(os.getpid(), signal.SIGINT); signal.pause()\n"
        "    except KeyboardInterrupt as bad: raise ValueError('a library') from bad\n"
        "sys.modules['relocbench.cli.app'] = types.SimpleNamespace(run=run); cli.main()"
    )
    command = [sys.executable, "-c", script]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=WAIT_S)
    assert (ended.returncode, ended.stdout) == (130, "")
    assert ended.stderr == "relocbench: interrupted; the same command goes on where it stopped\n"
