"""Keys of a blind export: what images are called where neither time nor order may tell where they were taken.

A key is a whole number, and stands in files where a timestamp stands.
"""

from __future__ import annotations

from functools import cached_property

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey
from relocbench.evaluation.common.blind_names import BlindName, BlindSecret, check_truth, truth_of


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
        named = f"{self.dataset.name} {self.dataset.fingerprint}"
        return BlindSecret.of("relocbench blind export 1", self.edition, named, truth_of(self.dataset))
