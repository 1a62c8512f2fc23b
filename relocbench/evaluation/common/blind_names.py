"""Names of blind exports, and what the keys and names in them are drawn from: the salt of whoever makes the export.

The owner of the salt computes all of them again and keeps no list. Nobody else can compute one, or learn from one
whether a guess at the dataset, its recipe or its truth is right.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from relocbench.datasets.core.salt import SALT_KEY, Salt
from relocbench.errors import ConfigError, DatasetError

KIND = "blind"
"""``kind`` in ``made_by`` of a blind export"""
_ID_CHARACTERS = 16
_NAME = re.compile(rf"blind(?P<edition>[0-9]{{1,9}})-(?P<id>[0-9a-f]{{{_ID_CHARACTERS}}})")
_UNSALTED = re.compile(r".+\.blind[0-9]{1,9}-[0-9a-f]{12}")
_SEEDED = ("synthetic", "cross-view", "photographs")
"""kinds of datasets whose truth follows from the options, unless a salt went into it"""


@dataclass(frozen=True)
class BlindName:
    """The name of a blind export, which does not say what it is of."""

    edition: int
    id: str
    """keyed digest of what the dataset contains and of the edition"""

    def __str__(self) -> str:
        return f"blind{self.edition}-{self.id}"


def blind_name(name: str) -> BlindName | None:
    """The parts of a blind export's name; None for the name of something else, or of an export without a salt."""
    match = _NAME.fullmatch(name)
    return None if match is None else BlindName(int(match["edition"]), match["id"])


def is_unsalted(name: str) -> bool:
    """Whether a name is that of a blind export of an earlier version, whose keys followed from the dataset alone."""
    return _UNSALTED.fullmatch(name) is not None


@dataclass(frozen=True)
class BlindSecret:
    """What one edition of the blind export of a dataset, or of a retrieval set, is drawn from."""

    salt: Salt
    kind: str
    content_id: str
    """of the dataset or retrieval set: a copy that was built again on another processor has the same"""
    edition: int

    @property
    def name(self) -> BlindName:
        """What the export is called."""
        return BlindName(self.edition, self.digest("name").hex()[:_ID_CHARACTERS])

    def digest(self, of: str) -> bytes:
        """(32,) bytes that stand for some words."""
        return self.salt.digest(f"{self.kind}, edition {self.edition}, of {self.content_id}\n{of}")

    def numbered(self, noun: str, names: Iterable[str]) -> dict[str, str]:
        """Names, each with the one that it has in the export: the noun and a number, in an order that says nothing."""
        mixed = sorted(set(names), key=lambda name: self.digest(f"{noun} {name}"))
        return {name: f"{noun}{number}" for number, name in enumerate(mixed, start=1)}


def check_salt(salt: Salt, made_by: Mapping[str, Any], name: str, root: Path) -> None:
    """Check that nobody but the owner of a salt can make a dataset that is asked blind.

    Args:
        made_by: how the dataset was made, as its ``dataset.yaml`` says.
        name: of the dataset.
        root: its folder.

    Raises:
        DatasetError: its truth follows from its options, and no salt went into it.
        ConfigError: it was built with another salt.
    """
    if made_by.get("kind") in _SEEDED and SALT_KEY not in made_by:
        message = f"'{name}' was built without a salt, and whoever guesses its options builds it again"
        raise DatasetError(f"{message}; build it with --salt-file", root)
    if made_by.get(SALT_KEY, salt.check) != salt.check:
        raise ConfigError(f"is another salt than the one that '{name}' was built with", salt.path)
