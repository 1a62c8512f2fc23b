"""The folder of a project of COLMAP: where its models lie, and which of them is meant."""

from __future__ import annotations

import struct
from pathlib import Path

from relocbench.datasets.importers.colmap.model import form_of
from relocbench.errors import ConfigError, DatasetError, available

_PLACES = ("sparse", "dense", "dense/sparse", "sparse/*", "dense/*/sparse", "[0-9]*", "reconstruction")
"""where COLMAP's mapper, its undistorter and kapture put models; of several the mapper's go first"""


def model_folder(project: Path, wanted: str = "") -> Path:
    """The folder of the model that a folder is or holds.

    Args:
        wanted: the model's folder within ``project``; empty: the only one.

    Raises:
        ConfigError: there is no such model, or there are several and none is named.
        DatasetError: there is none.
    """
    if wanted:
        found = project / wanted
        if not form_of(found):
            raise ConfigError(f"--sparse-model: no model {wanted!r} in {project}{available(wanted, _names(project))}")
        return found
    if form_of(project):
        return project
    names = _names(project)
    if not names:
        raise DatasetError("holds no model of COLMAP; expected cameras.bin or cameras.txt, or sparse/0", project)
    if len(names) > 1:
        counts = ", ".join(f"{name} ({_count(project / name)} images)" for name in names)
        raise ConfigError(f"{project} holds {len(names)} models: {counts}; name one by --sparse-model")
    return project / names[0]


def _names(project: Path) -> list[str]:
    found = [path for place in _PLACES for path in sorted(project.glob(place)) if form_of(path)]
    return list(dict.fromkeys(path.relative_to(project).as_posix() for path in found))


def _count(model: Path) -> int:
    """The number of images of a model, as its file says."""
    path = model / f"images{form_of(model)}"
    if not path.is_file():
        return 0
    if path.suffix == ".bin":
        with path.open("rb") as stream:
            start = stream.read(8)
        return int(struct.unpack("<Q", start)[0]) if len(start) == 8 else 0
    with path.open("rb") as stream:
        return (sum(not line.startswith(b"#") for line in stream) + 1) // 2
