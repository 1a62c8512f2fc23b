"""Trackers of learned features, which share the solver of ``orb-pnp``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from baselines.calibration import ALIKED_PNP, Calibration
from baselines.feature_pnp.features import Features
from baselines.feature_pnp.tracker import FeaturePnp
from baselines.learned_pnp import published
from baselines.learned_pnp.detector import NetworkDetector
from baselines.learned_pnp.kornia_networks import Aliked, AlikedModel, Disk, XFeat
from baselines.learned_pnp.superpoint import SuperPoint
from baselines.published_weights import PublishedWeights
from relocbench.arrays import Floats, Image, Indices
from relocbench.weights import PublishedFile


@dataclass(kw_only=True, eq=False)
class NetworkPnp(PublishedWeights, FeaturePnp):
    """Learned features, MAGSAC perspective-n-point, robust refinement. Subclasses match.

    Answers have no confidence unless a subclass has a calibration.

    Args:
        weights: file of the weights that find features, as its authors publish it or as safetensors; by default the one
            of the authors' name in torch's cache, ``$TORCH_HOME/hub/checkpoints``.
        longest_px: images whose longer side has more pixels are shrunk to so many.
        device: where the networks run; the pose is found on the CPU.

    Raises:
        MethodError: kornia is needed and not installed, or weights are missing or of another network.
    """

    network: ClassVar[type[NetworkDetector]]

    weights: Path | None = None
    longest_px: Annotated[int, Field(ge=64)] = 1280
    device: str = "cpu"

    def __post_init__(self) -> None:
        self._detector = self.detector()

    def detector(self, **more: Any) -> NetworkDetector:
        """The network with its weights."""
        weights = self.files(**vars(self))["weights"]
        return self.network(weights, self.features, self.longest_px, self.device, **more)

    def detect(self, image: Image) -> Features:
        return self._detector(image)


@dataclass(kw_only=True, eq=False)
class NearestPnp(NetworkPnp):
    """A :class:`NetworkPnp` that matches mutual nearest neighbours.

    Args:
        ratio: a match is accepted below this ratio of the nearest to the second nearest distance; 1 accepts all.
        cache_size: number of images whose features are kept for the pairs that show them again. The answers stay the
            same, and the seconds of a pair no longer include the network where an image came before.
    """

    ratio: Annotated[float, Field(gt=0, le=1)] = 1.0
    cache_size: Annotated[int, Field(ge=0)] = 0

    def detector(self, **more: Any) -> NetworkDetector:
        return super().detector(cache_size=self.cache_size, **more)

    def match_features(self, reference: Features, query: Features) -> Indices:
        return mutual_nearest(reference.descriptors, query.descriptors, self.ratio)


@dataclass(kw_only=True, eq=False)
class AlikedPnp(NearestPnp):
    """ALIKED (Zhao et al., IEEE TIM 2023), mutual nearest neighbours, MAGSAC perspective-n-point, robust refinement.

    Args:
        model: variant of the network; the weights that are looked for by default are ``aliked-MODEL.pth``.
    """

    calibration: ClassVar[Calibration | None] = ALIKED_PNP
    name: ClassVar[str] = "aliked-pnp"
    network: ClassVar[type[NetworkDetector]] = Aliked

    model: AlikedModel = "n16"

    def detector(self, **more: Any) -> NetworkDetector:
        return super().detector(model=self.model, **more)

    @classmethod
    def file(cls, model: AlikedModel = "n16", **_: Any) -> PublishedFile:
        return published.ALIKED[model]


class DiskPnp(NearestPnp):
    """DISK (Tyszkiewicz et al., NeurIPS 2020) with PnP."""

    name: ClassVar[str] = "disk-pnp"
    network: ClassVar[type[NetworkDetector]] = Disk
    authors_file: ClassVar[PublishedFile] = published.DISK


class XFeatPnp(NearestPnp):
    """XFeat (Potje et al., CVPR 2024) with PnP."""

    name: ClassVar[str] = "xfeat-pnp"
    network: ClassVar[type[NetworkDetector]] = XFeat
    authors_file: ClassVar[PublishedFile] = published.XFEAT


class SuperPointPnp(NearestPnp):
    """SuperPoint (DeTone et al., CVPR Workshops 2018) with PnP."""

    name: ClassVar[str] = "superpoint-pnp"
    network: ClassVar[type[NetworkDetector]] = SuperPoint
    authors_file: ClassVar[PublishedFile] = published.SUPERPOINT


def mutual_nearest(first: Floats, second: Floats, ratio: float = 1.0) -> Indices:
    """Match descriptors (N, D) and (M, D) of norm 1 that are each other's nearest neighbour.

    Args:
        ratio: a match is accepted below this ratio of the nearest to the second nearest distance, as seen from
            ``first``; 1 accepts all.

    Returns:
        Indices (K, 2) into both, in the order of ``first``.
    """
    if len(first) == 0 or len(second) == 0:
        return np.zeros((0, 2), dtype=np.intp)
    similarity = first @ second.T
    nearest, back = similarity.argmax(axis=1), similarity.argmax(axis=0)
    accepted = back[nearest] == np.arange(len(first))
    if ratio < 1.0 and len(second) > 1:
        two = -np.partition(-similarity, 1, axis=1)[:, :2].astype(np.float64)
        distance = np.sqrt(np.maximum(2.0 - 2.0 * two, 0.0))  # of vectors of norm 1
        accepted &= distance[:, 0] < ratio * distance[:, 1]
    index = np.flatnonzero(accepted)
    return np.stack([index, nearest[index]], axis=-1)
