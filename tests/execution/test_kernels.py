"""Compiled kernels are kept apart by their sources."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from repository import ROOT

from relocbench.kernels import kernel_digest, use_kernel_cache

SQUARE = "from relocbench.kernels import njit\n\n\n@njit(cache=True)\ndef square(x):\n    return {formula}\n"
CALLER = """from relocbench.kernels import njit
from relocbench.part import square


@njit(cache=True)
def twice(x):
    return 2 * square(x)


print(twice(3.0))
"""


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    package = tmp_path / "relocbench"
    package.mkdir()
    real = ROOT / "relocbench" / "kernels.py"
    (package / "kernels.py").write_bytes(real.read_bytes())
    (package / "__init__.py").write_text("")
    (package / "part.py").write_text(SQUARE.format(formula="x * x"))
    (package / "whole.py").write_text(CALLER)
    (package / "constants.py").write_text("N = 3\n")
    (package / "other.py").write_text("pass\n")
    return tmp_path


@pytest.mark.thorough
def test_a_kernel_compiled_into_another_is_not_used_after_it_changed(sources: Path, tmp_path: Path) -> None:
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    environment |= {"XDG_CACHE_HOME": str(tmp_path / "cache"), "PYTHONPATH": str(sources)}

    def run() -> float:
        command = [sys.executable, "-m", "relocbench.whole"]
        done = subprocess.run(command, env=environment, cwd=sources, capture_output=True, text=True, check=True)
        return float(done.stdout)

    assert run() == run() == 18.0
    assert list((tmp_path / "cache").rglob("*.nbi"))
    (sources / "relocbench" / "part.py").write_text(SQUARE.format(formula="x * x * x"))
    assert run() == 54.0


def test_the_digest_follows_kernels_and_what_they_take_from_and_nothing_else(sources: Path) -> None:
    package = sources / "relocbench"
    before = kernel_digest(sources, ["relocbench"])
    (package / "other.py").write_text("changed = True\n")
    assert kernel_digest(sources, ["relocbench"]) == before
    (package / "constants.py").write_text("N = 4\n")
    assert kernel_digest(sources, ["relocbench"]) == before
    with (package / "whole.py").open("a") as stream:
        stream.write("from relocbench.constants import N\n")
    taken = kernel_digest(sources, ["relocbench"])
    assert taken != before
    (package / "constants.py").write_text("N = 5\n")
    assert kernel_digest(sources, ["relocbench"]) != taken


def test_the_users_own_folder_is_kept_and_old_ones_are_forgotten(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", "mine")
    use_kernel_cache()
    assert os.environ["NUMBA_CACHE_DIR"] == "mine"
    old, recent = (tmp_path / "relocbench" / "kernels" / name for name in ("old", "recent"))
    for folder in (old, recent):
        folder.mkdir(parents=True)
    os.utime(old, (time.time() - 40 * 86400,) * 2)
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    use_kernel_cache()
    assert Path(os.environ["NUMBA_CACHE_DIR"]).parent == recent.parent
    assert recent.exists()
    assert not old.exists()
