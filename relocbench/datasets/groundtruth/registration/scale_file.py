"""The scale of a build's drives on disk, beside what is in enlarged metres: ``groundtruth/scale.yaml``."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from relocbench.datasets.core.schema import Strict
from relocbench.datasets.groundtruth.registration.scene_scale import SceneScale
from relocbench.errors import DatasetError
from relocbench.files import dump_yaml, load_yaml, write_text

FILE = "scale.yaml"


class ScaleFile(Strict):
    """The content of ``scale.yaml``: by how much all lengths in the folder of ground truth are enlarged."""

    factor: float = Field(1.0, gt=0)
    reason: str = ""
    max_sigma_m: float | None = None
    """largest sigma of an accepted pair's position, in metres that are not enlarged"""


def write_scale(folder: Path, scale: SceneScale, max_sigma_m: float) -> None:
    """Write ``scale.yaml`` into the folder of ground truth; without it, nothing is enlarged."""
    file = ScaleFile(factor=scale.factor, reason=scale.reason, max_sigma_m=max_sigma_m)
    write_text(folder / FILE, dump_yaml(file.model_dump(mode="json")))


def read_scale(folder: Path) -> ScaleFile:
    """The scale of a folder of ground truth; 1 if it has no ``scale.yaml``. Raises DatasetError with the file."""
    path = folder / FILE
    return load_yaml(path, ScaleFile, "the scale of the scene", DatasetError) if path.exists() else ScaleFile()
