"""Keys of a blind export: what images are called where neither time nor order may tell where they were taken.

A key is a whole number, and stands in files where a timestamp stands. It follows from the truth of the dataset, which
whoever is given the export does not have: the owner computes all keys again and keeps no list of them, and nobody else
can compute one.
"""

from __future__ import annotations

import hashlib
import hmac
import re
from dataclasses import dataclass
from functools import cached_property

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey
from relocbench.errors import DatasetError
from relocbench.files import read_bytes

_ID_CHARACTERS = 12
_NAME = re.compile(r"(?P<dataset>.+)\.blind(?P<edition>[0-9]{1,9})-(?P<id>[0-9a-f]{12})")


@dataclass(frozen=True)
class BlindName:
    """The name of a blind export, which says what it is of."""

    dataset: str
    """name of the dataset that it was made of"""
    edition: int
    id: str
    """digest of the dataset's truth and the edition"""

    def __str__(self) -> str:
        return f"{self.dataset}.blind{self.edition}-{self.id}"


def blind_name(name: str) -> BlindName | None:
    """The parts of a blind export's name; None for the name of something else."""
    found = _NAME.fullmatch(name)
    return None if found is None else BlindName(found["dataset"], int(found["edition"]), found["id"])


class BlindKeys:
    """The keys of one export of a dataset.

    Args:
        edition: exports of other editions have other keys, so that answers to one are not answers to another.

    Raises:
        DatasetError: the truth of the dataset is withheld, so that keys could be computed by anybody.
    """

    def __init__(self, dataset: Dataset, edition: int = 1) -> None:
        self.dataset = dataset
        self.edition = edition
        withheld = [s.name for s in dataset.pair_sets() if not s.has_truth or not s.asked]
        if withheld:
            told = f"the truth of '{withheld[0]}' is withheld, and keys of a blind export follow from the truth"
            raise DatasetError(told, dataset.root)

    @cached_property
    def name(self) -> BlindName:
        """What the export is called."""
        identity = hmac.new(self._secret, b"name", hashlib.sha256).hexdigest()[:_ID_CHARACTERS]
        return BlindName(self.dataset.name, self.edition, identity)

    def key(self, traversal: str, timestamp_ns: int) -> int:
        """The key of the images of one time of a drive, from 0 to 2^62."""
        digest = hmac.new(self._secret, f"image {traversal} {timestamp_ns}".encode(), hashlib.sha256).digest()
        return int.from_bytes(digest[:8], "big") >> 2

    def pairs(self, pair_set: PairSet) -> dict[PairKey, PairKey]:
        """The pairs that are asked: keys of keyframe and query -> their times."""
        return {
            (self.key(pair_set.reference, ref), self.key(pair_set.query, query)): (ref, query)
            for ref, query in pair_set.by_key
        }

    @cached_property
    def _secret(self) -> bytes:
        # The bytes themselves, behind words of our own: digests of pair files stand in published results.
        digest = hashlib.sha256(f"relocbench blind export 1, edition {self.edition}\n".encode())
        digest.update(f"{self.dataset.name} {self.dataset.fingerprint}\n".encode())
        for name in self.dataset.pair_set_names:
            digest.update(f"{name}\n".encode())
            digest.update(read_bytes(self.dataset.layout.pair_file(name), "a pair file", DatasetError))
        return digest.digest()
