"""A folder of datasets that belong together, as ``build-dataset edition`` makes it.

``edition.yaml`` names the edition, and ``TIER/NUMBER`` is the dataset of one district.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import Field

from relocbench.datasets.core.schema import Strict
from relocbench.errors import DatasetError
from relocbench.files import dump_yaml, load_yaml, write_text

FILE = "edition.yaml"


class TierRecord(Strict):
    """The datasets of one tier."""

    questions: str
    """digest of the content ids of its datasets: who has the same was asked the same"""
    datasets: dict[str, str]
    """number of the district -> content id"""


class EditionFile(Strict):
    """The content of ``edition.yaml``."""

    edition: str
    split: str
    districts: int
    tiers: dict[str, TierRecord] = Field(default_factory=dict)


@dataclass(frozen=True)
class EditionFolder:
    """An edition, or those of its tiers that were built."""

    root: Path
    file: EditionFile
    pairs: Mapping[str, int]
    """tier -> number of its pairs"""
    expected: Mapping[str, str]
    """tier -> the digest of questions that everybody gets; lacks tiers of which none is published"""

    def to_dict(self) -> dict[str, Any]:
        return {"edition": str(self.root), **self.file.model_dump(), "pairs": dict(self.pairs)}


def questions_of(content_ids: Mapping[str, str]) -> str:
    """The digest of a tier's questions, from the content ids of its datasets by their numbers."""
    lines = "".join(f"{number} {content_id}\n" for number, content_id in sorted(content_ids.items()))
    return hashlib.sha256(lines.encode()).hexdigest()


def read_edition(root: Path) -> EditionFile | None:
    """The edition that a folder holds; None if it holds none. Raises DatasetError with file and line."""
    path = root / FILE
    return load_yaml(path, EditionFile, "an edition", DatasetError) if path.exists() else None


def write_edition(root: Path, file: EditionFile) -> None:
    """Write ``edition.yaml``."""
    write_text(root / FILE, dump_yaml(file.model_dump()))


def datasets_of(folder: Path) -> list[Path]:
    """The datasets of an edition or of one of its tiers; of any other folder itself.

    Raises:
        DatasetError: with file and line: a damaged ``edition.yaml``.
    """
    whole, part = read_edition(folder), read_edition(folder.parent)
    if whole is not None:
        return [folder / tier / number for tier, record in whole.tiers.items() for number in record.datasets]
    if part is not None and folder.name in part.tiers:
        return [folder / number for number in part.tiers[folder.name].datasets]
    return [folder]
