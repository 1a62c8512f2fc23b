"""The commands that the published results name give the datasets that were published."""

from __future__ import annotations

import csv
import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from relocbench.datasets.dataset import Dataset

ROOT = Path(__file__).parents[1]
RECORDINGS = Path(os.environ.get("RELOCBENCH_REAL_DATA", ROOT.parent / "shared" / "data"))
SCRIPT = ROOT / "tools" / "publish_leaderboard.sh"
TABLE = ROOT / "leaderboard" / "leaderboard.csv"


def published() -> dict[str, tuple[str, str]]:
    """Dataset -> question and fingerprint."""
    with TABLE.open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    if "question" not in rows[0]:
        pytest.skip(
            f"{TABLE.relative_to(ROOT)} was printed before tables told the question; `make leaderboard` prints it"
        )
    return {row["dataset"]: (row["question"], row["fingerprint"]) for row in rows}


def published_command(name: str, out: Path) -> list[str]:
    """The words of the script's line that builds a dataset, its variables filled in."""
    assignments = {
        "kitti": RECORDINGS / "kitti_odometry",
        "xyz": RECORDINGS / "tum_rgbd" / "rgbd_dataset_freiburg1_xyz",
        "desk": RECORDINGS / "tum_rgbd" / "rgbd_dataset_freiburg1_desk",
        "by_nc": "CC BY-NC-SA 3.0 (KITTI)",
        "by": "CC BY 4.0 (TUM RGB-D)",
        "scratch": out,
    }
    (line,) = [
        text
        for text in SCRIPT.read_text(encoding="utf-8").splitlines()
        if text.startswith("relocbench build-dataset") and f'"$scratch/{name}"' in text
    ]
    words = shlex.split(line)
    for variable, value in sorted(assignments.items(), key=lambda item: -len(item[0])):
        words = [word.replace(f"${variable}", str(value)) for word in words]
    return words[1:]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["kitti_06", "fr1_xyz", "fr1_xyz_to_desk"])
def test_a_published_dataset_is_what_its_command_gives_on_this_machine(name: str, tmp_path: Path) -> None:
    if not (RECORDINGS / "kitti_odometry").is_dir() or not (RECORDINGS / "tum_rgbd").is_dir():
        pytest.skip(f"no recordings in {RECORDINGS}")
    question, fingerprint = published()[name]
    command = [sys.executable, "-m", "relocbench", *published_command(name, tmp_path), "--workers", "1"]
    subprocess.run(command, check=True)
    made = Dataset(tmp_path / name)
    assert made.question == question
    if name == "kitti_06":  # it links its images, and nothing in it depends on the processor
        assert made.fingerprint == fingerprint
