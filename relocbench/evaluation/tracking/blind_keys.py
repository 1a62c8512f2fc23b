"""Keys of a blind export: what images are called where neither time nor order may tell where they were taken.

A key is a whole number, and stands in files where a timestamp stands. It follows from the truth of the dataset, which
whoever is given the export does not have: the owner computes all keys again and keeps no list of them, and nobody else
can compute one.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from functools import cached_property

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey
from relocbench.errors import DatasetError
from relocbench.evaluation.common.blind_names import BlindName, BlindSecret
from relocbench.files import read_bytes


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
        check_truth(dataset)

    @cached_property
    def name(self) -> BlindName:
        """What the export is called."""
        return self._secret.name(self.dataset.name, self.edition)

    def key(self, traversal: str, timestamp_ns: int) -> int:
        """The key of the images of one time of a drive, from 0 to 2^62."""
        return int.from_bytes(self._secret.digest(f"image {traversal} {timestamp_ns}")[:8], "big") >> 2

    def pairs(self, pair_set: PairSet) -> dict[PairKey, PairKey]:
        """The evaluated pairs: keys of keyframe and query -> their times."""
        return {
            (self.key(pair_set.reference, ref), self.key(pair_set.query, query)): (ref, query)
            for ref, query in pair_set.by_key
        }

    @cached_property
    def _secret(self) -> BlindSecret:
        digest = hashlib.sha256(f"relocbench blind export 1, edition {self.edition}\n".encode())
        digest.update(f"{self.dataset.name} {self.dataset.fingerprint}\n".encode())
        for part in truth_of(self.dataset):
            digest.update(part)
        return BlindSecret(digest.digest())


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
