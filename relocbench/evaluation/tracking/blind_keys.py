"""Keys of a blind export: what drives, cameras and images are called where no name may tell where they were taken.

The key of an image is a whole number, and stands in files where a timestamp stands.
"""

from __future__ import annotations

from functools import cached_property

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.layout import pair_set_name
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey
from relocbench.datasets.core.salt import Salt
from relocbench.evaluation.common.blind_names import BlindName, BlindSecret


class BlindKeys:
    """The names and keys of one export of a dataset.

    Args:
        salt: exports with other salts have other keys, and whoever does not have it cannot compute one.
        edition: exports of other editions have other keys, so that answers to one are not answers to another.
    """

    def __init__(self, dataset: Dataset, salt: Salt, edition: int = 1) -> None:
        self.dataset, self.salt = dataset, salt
        self._secret = BlindSecret(salt, "blind export 2", dataset.content_id, edition)

    @property
    def name(self) -> BlindName:
        """What the export is called."""
        return self._secret.name

    @cached_property
    def drives(self) -> dict[str, str]:
        """The drives of all pair sets -> what they are called."""
        return self._secret.numbered("drive", (n for s in self.dataset.pair_sets() for n in (s.reference, s.query)))

    @cached_property
    def cameras(self) -> dict[str, str]:
        """The cameras of all pair sets -> what they are called."""
        return self._secret.numbered("camera", (c for s in self.dataset.pair_sets() for c in s.cameras))

    def pair_set(self, pair_set: PairSet) -> str:
        """What a pair set is called."""
        drives = self.drives[pair_set.reference], self.drives[pair_set.query]
        return pair_set_name(*drives, *(self.cameras[camera] for camera in pair_set.cameras))

    def key(self, traversal: str, camera: str, timestamp_ns: int) -> int:
        """The key of an image, from 0 to 2^62."""
        return int.from_bytes(self._secret.digest(f"image {traversal} {camera} {timestamp_ns}")[:8], "big") >> 2

    def pairs(self, pair_set: PairSet) -> dict[PairKey, PairKey]:
        """The evaluated pairs: keys of keyframe and query -> their times."""
        s = pair_set
        return {
            (self.key(s.reference, s.reference_camera, ref), self.key(s.query, s.query_camera, query)): (ref, query)
            for ref, query in s.by_key
        }
