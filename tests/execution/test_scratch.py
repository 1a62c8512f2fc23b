"""Folders that one process of a method alone uses: private, swept when their owner was killed, caches kept."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from refusals import refused

from relocbench import kernels
from relocbench.errors import RelocbenchError
from relocbench.execution import ScratchFolder, scratch

OWNER = """
import sys, time
from relocbench.execution import ScratchFolder
folder = ScratchFolder()
(folder.path / "note").touch()
print(folder.path, flush=True)
time.sleep(1000)
"""


@pytest.fixture(autouse=True)
def base(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Temporary files of this test alone."""
    (tmp_path / "tmp").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    return tmp_path / "tmp"


def test_it_is_removed_with_its_owner(base: Path) -> None:
    folder = ScratchFolder()
    assert list(base.glob("*/*")) == [folder.path]
    folder.remove()
    assert list(base.iterdir()) == []
    ScratchFolder()
    assert list(base.iterdir()) == []


@pytest.mark.thorough
def test_folders_in_folders_a_thousand_deep_are_removed(base: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = ScratchFolder()
    monkeypatch.chdir(folder.path)
    (folder.path / "closed" / "within").mkdir(parents=True)
    (folder.path / "closed").chmod(0)  # of which root takes no notice
    for _ in range(1500):
        os.mkdir("f")  # noqa: PTH102  the whole path is too long to be named
        os.chdir("f")
    os.chdir(base)
    folder.remove()
    assert list(base.iterdir()) == []


def test_one_that_a_killed_process_left_is_removed_by_the_next_and_a_living_ones_is_not(base: Path) -> None:
    owner = subprocess.Popen([sys.executable, "-c", OWNER], stdout=subprocess.PIPE, text=True)
    assert owner.stdout is not None
    theirs = Path(owner.stdout.readline().strip())
    try:
        assert theirs.parent.parent == base
        scratch.sweep()
        ScratchFolder().remove()
        assert (theirs / "note").exists(), "its owner lives"
    finally:
        owner.send_signal(signal.SIGKILL)
        owner.wait()
        owner.stdout.close()
    assert (theirs / "note").exists()
    scratch.sweep()
    assert not theirs.exists()


def test_nothing_else_is_swept(base: Path, tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    kept.mkdir()
    folder = ScratchFolder()
    (folder.path.parent / "link").symlink_to(kept)
    (folder.path.parent / "file").touch()
    (base / "relocbench-of-others").mkdir()
    scratch.sweep()
    assert kept.is_dir()
    assert len(list(base.iterdir())) == 2
    assert len(list(folder.path.parent.iterdir())) == 3


def test_a_link_that_another_user_may_have_laid_is_not_followed(base: Path, tmp_path: Path) -> None:
    (tmp_path / "mine" / "folder").mkdir(parents=True)
    (base / f"relocbench-methods-{os.geteuid()}").symlink_to(tmp_path / "mine")
    with refused(RelocbenchError):
        ScratchFolder()
    assert (tmp_path / "mine" / "folder").exists()


def test_caches_of_compiled_kernels_are_not_among_those_of_a_method_that_is_not_trusted(tmp_path: Path) -> None:
    variables = {name: str(tmp_path / name) for name in ("NUMBA_CACHE_DIR", scratch.KERNEL_CACHE, "HF_HOME")}
    assert scratch.shared_folders(variables, kernels=False) == [tmp_path / "HF_HOME"]
    assert len(scratch.shared_folders(variables)) == 3


def test_home_caches_and_temporary_files_lie_in_it_and_downloaded_weights_do_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "user"))
    monkeypatch.setenv("HF_HOME", "mine")
    for name in ("XDG_CACHE_HOME", "TORCH_HOME", "MPLCONFIGDIR", "CUDA_CACHE_PATH", scratch.KERNEL_CACHE):
        monkeypatch.delenv(name, raising=False)
    folder = ScratchFolder()
    found = folder.environment()
    private = {name for name, value in found.items() if value.startswith(str(folder.path))}
    assert private == {"HOME", "TMPDIR", "TMP", "TEMP"} | {
        f"XDG_{kind}_HOME" for kind in ("CACHE", "CONFIG", "DATA", "STATE")
    }
    assert found["HF_HOME"] == "mine"
    assert found["TORCH_HOME"] == str(tmp_path / "user" / ".cache" / "torch")
    assert found["PATH"] == os.environ["PATH"]


def test_compiled_kernels_are_shared(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "user"))
    for name in ("XDG_CACHE_HOME", "NUMBA_CACHE_DIR", scratch.KERNEL_CACHE):
        monkeypatch.delenv(name, raising=False)
    kernels.use_kernel_cache()
    ours = os.environ["NUMBA_CACHE_DIR"]
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    folder = ScratchFolder()
    for name, value in folder.environment().items():
        monkeypatch.setenv(name, value)
    kernels.use_kernel_cache()
    assert os.environ["NUMBA_CACHE_DIR"] == ours
    assert ours.startswith(str(tmp_path / "user"))
