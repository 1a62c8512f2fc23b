"""Two commands never write to one folder at once."""

from __future__ import annotations

import errno
import fcntl
import os
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest
from command_line import relocbench
from small_dataset import ACROSS, make_small_dataset

from relocbench.datasets.importers import KINDS
from relocbench.errors import DatasetError
from relocbench.files import locked_folder, locked_output

AT_WORK = "another process holds the lock of this folder; wait for it to end"
COMMANDS = {
    **{f"build-dataset {kind}": ["build-dataset", kind, "recording"] for kind in KINDS},
    "build-dataset synthetic": ["build-dataset", "synthetic"],
    "build-dataset cross-view": ["build-dataset", "cross-view"],
    "build-dataset synthetic --recording": ["build-dataset", "synthetic", "--recording", "kitti"],
    "export": ["export", "-d", "data", "--format", "tum"],
    "leaderboard": ["leaderboard", "results"],
    "train, a tracker": ["train", "gn-net", "-d", "data"],
    "train, a retriever": ["train", "lpn", "-d", "data"],
    "inspect --pictures": ["inspect", "data", "--pairs", "1"],
    "inspect --ground-truth": ["inspect", "data", "--json"],
    "demo": ["demo", "--quiet"],
    "probe": ["probe", "-d", "data", "-m", "identity"],
}
OUT = {"inspect --pictures": "--pictures", "inspect --ground-truth": "--ground-truth"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a dataset in ``data``."""
    root = tmp_path_factory.mktemp("commands")
    make_small_dataset(root / "data")
    return root


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_whose_folder_another_process_writes_to_changes_nothing(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(folder)
    out = tmp_path / "out"
    out.mkdir()
    (out / "half").write_text("of a table")
    with locked_folder(out):
        ended = relocbench(*COMMANDS[name], OUT.get(name, "--out"), out)
    assert ended.status == 2
    assert ended.complaint == f"relocbench: {out}: {AT_WORK}"
    assert {path: path.read_text() for path in out.iterdir()} == {out / "half": "of a table"}


def test_the_folder_is_free_again_however_the_process_ended(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    program = (
        "import sys; from pathlib import Path; from relocbench.files import locked_output\n"
        "with locked_output(Path(sys.argv[1])): print('in', flush=True); sys.stdin.read()\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-c", program, str(out)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"in\n"
        export = ["export", "-d", folder / "data", "--format", "tum", "--pair-set", ACROSS, "--quiet", "--out", out]
        assert AT_WORK in relocbench(*export).complaint
        assert not list(out.iterdir())
        other.kill()
    assert relocbench(*export).status == 0
    assert [path.name for path in out.iterdir()] == [f"{ACROSS}.txt"]


def test_a_command_that_fails_leaves_no_folder_behind(tmp_path: Path) -> None:
    out = tmp_path / "new" / "deep"
    ended = relocbench("build-dataset", "kitti", tmp_path / "nowhere", "--sequence", "06", "--out", out, "--quiet")
    assert ended.status == 2
    assert not (tmp_path / "new").exists()
    out.mkdir(parents=True)
    assert relocbench("build-dataset", "kitti", tmp_path / "nowhere", "--out", out, "--quiet").status == 2
    assert out.is_dir()


def test_a_part_of_the_work_may_guard_the_same_folder_again(tmp_path: Path) -> None:
    again = tmp_path / "." / ".." / tmp_path.name
    with ExitStack() as entered:
        entered.enter_context(locked_output(tmp_path))
        entered.enter_context(locked_output(again))
        with pytest.raises(DatasetError, match=AT_WORK):
            entered.enter_context(locked_folder(tmp_path, DatasetError))
    with locked_folder(tmp_path):
        pass


def test_a_file_system_without_locks_is_written_to_as_ever(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def flock(descriptor: int, operation: int) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", flock)
    with locked_output(tmp_path / "out"):
        (tmp_path / "out" / "file").touch()
    assert (tmp_path / "out" / "file").exists()
