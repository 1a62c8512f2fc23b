"""Names of blind exports, and what their keys are drawn from.

Keys follow from the truth of a dataset, which whoever is given the export does not have: the owner computes all keys
again and keeps no list of them, and nobody else can compute one.
"""

from __future__ import annotations

import hashlib
import hmac
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from relocbench.datasets.core.dataset import Dataset
from relocbench.errors import DatasetError
from relocbench.files import read_bytes

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

    @classmethod
    def of(cls, kind: str, edition: int, named: str, truth: Iterable[bytes]) -> BlindSecret:
        """The secret that follows from the kind of export, the set's name and fingerprint, and its truth."""
        digest = hashlib.sha256(f"{kind}, edition {edition}\n{named}\n".encode())
        for part in truth:
            digest.update(part)
        return cls(digest.digest())

    def name(self, dataset: str, edition: int) -> BlindName:
        """What the export of a dataset is called."""
        return BlindName(dataset, edition, self.digest("name").hex()[:_ID_CHARACTERS])

    def digest(self, of: str) -> bytes:
        """(32,) bytes that stand for some words."""
        return hmac.new(self.secret, of.encode(), hashlib.sha256).digest()


def check_truth(dataset: Dataset) -> None:
    """Raise DatasetError where the truth of a dataset is withheld, so that keys could be computed by anybody."""
    withheld = [s.name for s in dataset.pair_sets() if not s.has_truth or not s.evaluated]
    if withheld:
        message = f"the truth of '{withheld[0]}' is withheld, and keys of a blind export follow from the truth"
        raise DatasetError(message, dataset.root)


def truth_of(dataset: Dataset) -> Iterator[bytes]:
    """The truth of a dataset: its pair files, each behind its name.

    The bytes themselves, since digests of pair files stand in published results.
    """
    for name in dataset.pair_set_names:
        yield f"{name}\n".encode()
        yield read_bytes(dataset.layout.pair_file(name), "a pair file", DatasetError)
