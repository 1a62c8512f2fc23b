"""What a process in a sandbox sees, writes and leaves behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from refusals import refused

import relocbench.execution as execution
from relocbench.errors import ConfigError
from relocbench.execution import Run, sandbox
from relocbench.execution.sandbox import BUBBLEWRAP, NAMESPACES, NONE, Sandbox, _works

KINDS = (NAMESPACES, BUBBLEWRAP)


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    if not _works(request.param):
        pytest.skip(f"{request.param} do not work on this system")
    return str(request.param)


def inside(
    kind: str, code: str, *, writable: tuple[Path, ...] = (), hidden: tuple[Path, ...] = ()
) -> subprocess.Popen[str]:
    return Sandbox(kind, hidden).start([sys.executable, "-I", "-c", code], writable, stdout=subprocess.PIPE, text=True)


def printed(process: subprocess.Popen[str]) -> str:
    return process.communicate(timeout=60)[0].strip()


def test_a_hidden_folder_is_empty_and_cannot_be_uncovered(kind: str, tmp_path: Path) -> None:
    (tmp_path / "truth").write_text("a pose")
    code = f"""import os, subprocess
print(os.listdir({str(tmp_path)!r}))
for command in (["umount", {str(tmp_path)!r}], ["unshare", "-Urm", "umount", {str(tmp_path)!r}]):
    subprocess.run(command, stderr=subprocess.DEVNULL)
print(os.listdir({str(tmp_path)!r}))
"""
    assert printed(inside(kind, code, hidden=(tmp_path,))) == "[]\n[]"
    assert (tmp_path / "truth").read_text() == "a pose"


def test_a_working_folder_that_is_hidden_is_empty_too(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "truth").write_text("a pose")
    monkeypatch.chdir(tmp_path)
    assert printed(inside(kind, "import os; print(os.listdir())", hidden=(tmp_path,))) == "[]"


def test_only_what_is_given_can_be_written_to(kind: str, tmp_path: Path) -> None:
    own, other = tmp_path / "own", tmp_path / "other"
    own.mkdir()
    other.mkdir()
    code = f"""
for folder in ({str(own)!r}, {str(other)!r}, "/dev/shm"):
    try:
        open(folder + "/note", "w").close()
        print("written")
    except OSError as bad:
        print(bad.strerror)
"""
    assert printed(inside(kind, code, writable=(own,))) == "written\nRead-only file system\nwritten"
    assert [path.name for path in (*own.iterdir(), *other.iterdir())] == ["note"]
    assert not Path("/dev/shm/note").exists()


def test_what_may_be_written_to_is_there_in_a_hidden_folder(kind: str, tmp_path: Path) -> None:
    own = tmp_path / "inner" / "own"
    (tmp_path / "inner" / "hidden" / "too").mkdir(parents=True)
    own.mkdir()
    code = f"""import os
open({str(own)!r} + "/note", "w").close()
print(os.listdir({str(tmp_path)!r}), os.listdir({str(own.parent)!r}))
try:
    open({str(tmp_path)!r} + "/note", "w").close()
except OSError as bad:
    print(bad.strerror)
"""
    hidden = tmp_path, own.parent / "hidden" / "too"
    assert printed(inside(kind, code, writable=(own,), hidden=hidden)) == "['inner'] ['own']\nRead-only file system"
    assert (own / "note").exists()


def test_root_changes_no_system_and_reads_no_disk(kind: str) -> None:
    code = """import glob, pathlib
try:
    open("/proc/sys/kernel/core_pattern", "r+").close()
    print("opened")
except OSError:
    pass
print([path for path in glob.glob("/dev/*") if pathlib.Path(path).is_block_device()])
"""
    assert printed(inside(kind, code)) == "[]"


def test_a_signal_to_its_group_reaches_nobody_outside(kind: str) -> None:
    code = "import os, signal; signal.signal(15, signal.SIG_IGN); os.kill(0, 15); print(os.getsid(0) == os.getpid())"
    assert printed(inside(kind, code)) in {"True", "False"}, "this process was not ended"


def test_no_process_outside_is_seen(kind: str) -> None:
    code = """import os
pids = [name for name in os.listdir("/proc") if name.isdigit()]
print(len(pids), os.getppid(), "RELOCBENCH_SANDBOX" in os.environ)
"""
    assert printed(inside(kind, code)) == "2 1 False"


def test_no_argument_and_no_open_file_names_a_folder(kind: str, tmp_path: Path) -> None:
    code = """import os, pathlib
for pid in (name for name in os.listdir("/proc") if name.isdigit()):
    print(pathlib.Path(f"/proc/{pid}/cmdline").read_bytes())
print("open", *os.listdir("/proc/self/fd"))
"""
    own, hidden = tmp_path / "own", tmp_path / "hidden"
    own.mkdir()
    hidden.mkdir()
    seen = printed(inside(kind, code, writable=(own,), hidden=(hidden,)))
    assert str(tmp_path) not in seen
    assert seen.splitlines()[-1] == "open 0 1 2 3", "the last one is /proc/self/fd"
    assert "cmdline" in seen.splitlines()[0], "the arguments of process 1 were read, too"


@pytest.mark.parametrize(
    ("code", "status"), [("raise SystemExit(7)", 7), ("import os; os.kill(os.getpid(), 11)", 128 + signal.SIGSEGV)]
)
def test_it_ends_as_the_command_ends(kind: str, code: str, status: int) -> None:
    process = inside(kind, code)
    printed(process)
    assert process.returncode == status


@pytest.mark.parametrize("goes_on", [False, True], ids=["the command ends", "its caller is killed"])
def test_a_process_that_was_forked_off_twice_ends_with_it(kind: str, goes_on: bool) -> None:
    """It holds a pipe open for as long as it lives."""
    held, kept = os.pipe()
    code = f"""import os, time
if not os.fork():
    os.setsid()
    if not os.fork():
        os.write({kept}, b"!")
        time.sleep(600)
    os._exit(0)
os.wait()
{"time.sleep(600)" if goes_on else ""}
"""
    start = f"""import os, time
from relocbench.execution.sandbox import Sandbox
process = Sandbox({kind!r}).start([{sys.executable!r}, "-I", "-c", {code!r}], [], pass_fds=({kept},))
os.close({kept})
time.sleep(600)
"""
    caller = subprocess.Popen([sys.executable, "-c", start], pass_fds=(kept,))
    os.close(kept)
    if goes_on:
        assert os.read(held, 1) == b"!"
        caller.kill()
    while os.read(held, 1):
        pass
    os.close(held)
    caller.kill()
    caller.wait()


def test_one_that_is_required_and_not_there_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(execution, "working_sandbox", lambda: NONE)
    with refused(ConfigError):
        Run(sandbox="required").sandbox_of_methods()
    with refused(ConfigError):
        Run(workers=0, sandbox="required").sandbox_of_methods()
    monkeypatch.setattr(sandbox, "working_sandbox", lambda: NONE)
    with refused(ConfigError):  # as it is found out by a worker of a cluster
        assert Sandbox("", required=True).exists
    with Run().hiding(tmp_path).sandbox_of_methods().start(["true"], []) as process:
        assert process.args == ["true"]
