"""Without PyTorch, Open3D and their like: what needs none of them works, and what needs one says which."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from repository import ROOT
from small_dataset import make_small_dataset

import relocbench.cli

pytestmark = pytest.mark.thorough
WITHOUT = """
import sys

class Absent:
    names = {names!r}

    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in self.names:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Absent())
"""
"""a ``sitecustomize`` for every process that is started, workers included"""


@pytest.fixture(scope="module")
def absent(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for PYTHONPATH, below which the packages that ``requirements-light.txt`` leaves out are not found."""
    light = (ROOT / "requirements-light.txt").read_text()
    kept = set(re.findall(r"^([\w.-]+)[><=]", light, flags=re.MULTILINE))
    names = {name for name, package in relocbench.cli._PACKAGES.items() if package not in kept}
    assert {"torch", "open3d", "gtsam", "kiss_icp", "numba"} <= names
    folder = tmp_path_factory.mktemp("absent")
    (folder / "sitecustomize.py").write_text(WITHOUT.format(names=names))
    return folder


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_small_dataset(tmp_path_factory.mktemp("data") / "small").root


def run(absent: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(absent), *filter(None, sys.path)])
    command = [sys.executable, "-m", "relocbench", *map(str, arguments)]
    return subprocess.run(command, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False)


def test_datasets_predictions_scores_and_boards_need_none_of_them(absent: Path, dataset: Path, tmp_path: Path) -> None:
    first, taken, board = tmp_path / "first", tmp_path / "taken", tmp_path / "board"
    for arguments in (
        ("validate", dataset),
        ("evaluate", "-d", dataset, "-m", "identity", "-o", first),
        ("evaluate", "-d", dataset, "-m", "theirs", "--predictions", "FOUND", "-o", taken),
        ("leaderboard", taken, "--out", board),
    ):
        found = next(first.glob("*/identity"), None)
        done = run(absent, *(found if word == "FOUND" else word for word in arguments))
        assert done.returncode == 0, (arguments, done.stderr)
    assert (board / "leaderboard.md").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("evaluate", "-d", "DATASET", "-m", "dso"), "no module 'numba'"),
        (("train", "gn-net", "-d", "DATASET", "-o", "OUT"), "no module '(torch|numba)'"),
        (("preview", "--out", "OUT/x.png"), r"needs the package '(open3d|numba)', which is not installed here"),
    ],
)
def test_what_needs_one_says_which(
    arguments: tuple[str, ...], words: str, absent: Path, dataset: Path, tmp_path: Path
) -> None:
    done = run(absent, *(w.replace("DATASET", str(dataset)).replace("OUT", str(tmp_path)) for w in arguments))
    assert done.returncode == 2, done.stderr
    assert re.search(words, done.stderr.strip().splitlines()[-1])
    assert "Traceback" not in done.stderr


def test_pages_for_a_browser_need_one_and_say_which(absent: Path, dataset: Path, tmp_path: Path) -> None:
    results = tmp_path / "results"
    assert run(absent, "evaluate", "-d", dataset, "-m", "identity", "-o", results, "-q").returncode == 0
    done = run(absent, "report", results, "--out", tmp_path / "report")
    assert done.returncode == 2, done.stderr
    assert re.search(r"needs the package '(plotly|itables)', which is not installed here", done.stderr)
    assert "Traceback" not in done.stderr
