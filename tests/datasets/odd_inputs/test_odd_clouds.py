"""Point clouds and other binary files that look right and are not: read as what they are, or refused with a reason."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from refusals import refused

from baselines.published_weights import read_weights
from baselines.weights_file import read_tensors
from relocbench.datasets.core.images import read_image
from relocbench.datasets.importers.rosbag.bag import parts_of
from relocbench.datasets.sensors.cloud_files import SUFFIXES, read_cloud
from relocbench.datasets.sensors.velodyne import read_scan
from relocbench.errors import DatasetError, MethodError, RelocbenchError

LFS = f"version https://git-lfs.github.com/spec/v1\noid sha256:{'4d' * 32}\nsize 132735\n"
OPENERS: dict[str, tuple[Callable[[Path], object], type[RelocbenchError]]] = {
    **{f"a{suffix}": (read_cloud, DatasetError) for suffix in SUFFIXES},
    "scan.bin": (read_scan, DatasetError),
    "image.png": (read_image, DatasetError),
    "drive.bag": (parts_of, DatasetError),
    "drive.mcap": (parts_of, DatasetError),
    "weights.safetensors": (read_tensors, MethodError),
    "weights.pth": (read_weights, MethodError),
}


@pytest.mark.parametrize("name", OPENERS)
def test_a_pointer_of_git_lfs_is_named_as_such_wherever_a_file_is_opened(tmp_path: Path, name: str) -> None:
    opener, kind = OPENERS[name]
    (tmp_path / name).write_text(LFS)
    with refused(kind, name, None, "LFS", "132735"):
        opener(tmp_path / name)
