"""A folder of datasets that belong together, as ``build-dataset edition`` makes it.

``edition.yaml`` names the edition, and ``TIER/NUMBER`` is the dataset of one district.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import Field

from relocbench.datasets.core.layout import DatasetLayout
from relocbench.datasets.core.schema import Name, Strict
from relocbench.errors import DatasetError
from relocbench.files import dump_yaml, load_yaml, write_text
from relocbench.metrics.pose.tiers import TIERS

FILE = "edition.yaml"
_TIER = re.compile(rf"(?<=-)(?:{'|'.join(TIERS)})-(?=\d+$)")


class TierRecord(Strict):
    """The datasets of one tier."""

    questions: str
    """digest of the content ids of its datasets: who has the same was asked the same"""
    datasets: dict[Name, str]
    """number of the district -> content id"""


class EditionFile(Strict):
    """The content of ``edition.yaml``."""

    edition: str
    split: str
    districts: int
    tiers: dict[Name, TierRecord] = Field(default_factory=dict)


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


def district_name(edition: str, split: str, tier: str, number: int) -> str:
    """The name of a district's dataset."""
    return f"relocbench-{edition}-{split}-{tier}-{number:02d}"


def road_of(name: str) -> str:
    """The road that a dataset of this name is of: all tiers of a district show the same town."""
    return _TIER.sub("", name) if name.startswith("relocbench-") else name


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
        DatasetError: with file and line: a damaged ``edition.yaml``, one without a finished tier, or a dataset that is
            missing.
    """
    if DatasetLayout(folder).dataset_yaml.exists():
        return [folder]
    root, part = folder, ""
    edition = read_edition(folder)
    if edition is None:
        root, part = folder.resolve().parent, folder.resolve().name
        edition = read_edition(root)
    if edition is None or (part and part not in edition.tiers):
        return [folder]
    again = f"run `relocbench build-dataset edition {edition.edition}` again"
    if not edition.tiers:
        raise DatasetError(f"no tier is finished; {again}", root / FILE)
    tiers = (
        [(folder, edition.tiers[part])] if part else [(folder / name, edition.tiers[name]) for name in edition.tiers]
    )
    found = [of / number for of, record in tiers for number in record.datasets]
    for path in found:
        if not DatasetLayout(path).dataset_yaml.exists():
            raise DatasetError(f"{path} is missing or not finished; {again}", root / FILE)
    return found
