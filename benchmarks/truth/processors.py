"""What depends on the processor: datasets built with libraries set to compute as on other processors.

Each setting restricts one library to older instructions, or to another number of threads. The published imported
datasets and a small rendered one are built with each setting and compared, file by file, with those of the default. A
setting has no effect on a processor that lacks the instructions in question.

    python benchmarks/truth/processors.py [--recordings FOLDER] [--only NAME,...]

It prints a table, the files that differ, and by how many grey levels images do. The last line is JSON.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.images import read_image

SETTINGS: dict[str, dict[str, str]] = {
    "plain": {},
    "OpenBLAS Prescott": {"OPENBLAS_CORETYPE": "Prescott"},
    "OpenBLAS Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "OpenCV without AVX2 and SSE4": {"OPENCV_CPU_DISABLE": "AVX512-SKX,AVX2,FP16,AVX,SSE4.2,SSE4.1"},
    "Numba generic": {"NUMBA_CPU_NAME": "generic"},
    "NumPy without AVX2": {"NPY_DISABLE_CPU_FEATURES": "X86_V3"},
    "PyTorch default": {"ATEN_CPU_CAPABILITY": "default"},
    "two threads": {"OMP_NUM_THREADS": "2"},
}
"""environment variables by setting"""


def builds(recordings: Path | None) -> dict[str, list[str]]:
    """Arguments of ``relocbench build-dataset`` by name."""
    found = {
        "town_smoke": ["synthetic", "--preset", "smoke", "--name", "town_smoke"],
    }
    if recordings is not None:
        kitti, xyz = recordings / "kitti_odometry", recordings / "tum_rgbd" / "rgbd_dataset_freiburg1_xyz"
        found["kitti_06"] = ["kitti", str(kitti), "--sequence", "06", "--pair-step", "1,2,4,8"]
        found["fr1_xyz"] = ["tum-rgbd", str(xyz), "--pair-step", "1,2,4", "--name", "fr1_xyz"]
    return found


def build(arguments: Sequence[str], out: Path, setting: dict[str, str], kernels: Path) -> Dataset:
    """Build a dataset in a process with a setting, with newly compiled kernels."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_CACHE_DIR": str(kernels), **setting}
    command = [
        sys.executable,
        "-m",
        "relocbench",
        "build-dataset",
        *arguments,
        "--out",
        str(out),
        "-q",
        "--workers",
        "1",
    ]
    subprocess.run(command, env=environment, check=True, stdout=sys.stderr)
    return Dataset(out)


def manifest(dataset: Dataset) -> dict[str, str]:
    """The SHA-256 of each file."""
    with dataset.layout.manifest.open(encoding="utf-8") as stream:
        return {row["path"]: row["sha256"] for row in csv.DictReader(stream)}


def most_levels(name: str, one: Dataset, other: Dataset) -> int | None:
    """The largest difference of two images in grey levels; None if the files are not images."""
    if "/images/" not in name:
        return None
    a, b = (read_image(d.root / name).astype(np.int16) for d in (one, other))
    return int(np.abs(a - b).max())


def compare(name: str, setting: str, plain: Dataset, other: Dataset) -> dict[str, object]:
    """A row with the differences between two builds of a dataset."""
    before, after = manifest(plain), manifest(other)
    differ = sorted(k for k in before.keys() | after.keys() if before.get(k) != after.get(k))
    levels = [most_levels(k, plain, other) for k in differ if k in before and k in after]
    return {
        "dataset": name,
        "setting": setting,
        "files": len(before),
        "differ": len(differ),
        "images": sum(level is not None for level in levels),
        "grey_levels": max((level for level in levels if level is not None), default=0),
        "others": [k for k in differ if "/images/" not in k],
        "same_question": plain.content_id == other.content_id,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=Path, help="folder of kitti_odometry/ and tum_rgbd/")
    parser.add_argument(
        "--only", default="", help="only settings whose name contains one of these words, separated by commas"
    )
    asked = parser.parse_args()
    words = [word for word in asked.only.split(",") if word]
    recordings = None if asked.recordings is None else asked.recordings.resolve()
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        plain: dict[str, Dataset] = {}
        for setting, environment in SETTINGS.items():
            if setting != "plain" and words and not any(word in setting for word in words):
                continue
            for name, arguments in builds(recordings).items():
                folder = Path(scratch) / setting.replace(" ", "-")
                made = build(arguments, folder / name, environment, folder / "kernels")
                if setting == "plain":
                    plain[name] = made
                    continue
                row = compare(name, setting, plain[name], made)
                rows.append(row)
                print(
                    f"{name:12} {setting:30} {row['differ']:3} of {row['files']} files differ, {row['images']} of them "
                    f"images (by {row['grey_levels']} grey levels at most); "
                    f"question {'the same' if row['same_question'] else 'DIFFERS'}",
                    *([str(row["others"])] if row["others"] else []),
                    flush=True,
                )
    print(json.dumps({"rows": rows}))


if __name__ == "__main__":
    main()
