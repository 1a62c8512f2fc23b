"""Names of blind exports, and what their keys are drawn from.

Keys follow from the truth of a dataset, which whoever is given the export does not have: the owner computes all keys
again and keeps no list of them, and nobody else can compute one.
"""

from __future__ import annotations

import hashlib
import hmac
import re
from dataclasses import dataclass

_ID_CHARACTERS = 12
_NAME = re.compile(r"(?P<dataset>.+)\.blind(?P<edition>[0-9]{1,9})-(?P<id>[0-9a-f]{12})")


@dataclass(frozen=True)
class BlindName:
    """The name of a blind export, which says what it is of."""

    dataset: str
    """name of the dataset, or of the retrieval set, that it was made of"""
    edition: int
    id: str
    """digest of the dataset's truth and the edition"""

    def __str__(self) -> str:
        return f"{self.dataset}.blind{self.edition}-{self.id}"


def blind_name(name: str) -> BlindName | None:
    """The parts of a blind export's name; None for the name of something else."""
    match = _NAME.fullmatch(name)
    return None if match is None else BlindName(match["dataset"], int(match["edition"]), match["id"])


@dataclass(frozen=True)
class BlindSecret:
    """What a blind export is drawn from."""

    secret: bytes
    """a digest of the truth and the edition"""

    def name(self, dataset: str, edition: int) -> BlindName:
        """What the export of a dataset is called."""
        return BlindName(dataset, edition, self.digest("name").hex()[:_ID_CHARACTERS])

    def digest(self, of: str) -> bytes:
        """(32,) bytes that stand for some words."""
        return hmac.new(self.secret, of.encode(), hashlib.sha256).digest()
