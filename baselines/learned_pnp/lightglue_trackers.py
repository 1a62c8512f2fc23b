"""Trackers whose learned features are matched by LightGlue."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import Field

from baselines.feature_pnp.features import Features
from baselines.learned_pnp import published
from baselines.learned_pnp.detector import NetworkDetector
from baselines.learned_pnp.kornia_networks import Aliked, Disk
from baselines.learned_pnp.lightglue import LightGlue
from baselines.learned_pnp.superpoint import SuperPoint
from baselines.learned_pnp.trackers import NetworkPnp
from baselines.published_weights import by_place, find_weights
from relocbench.arrays import Indices
from relocbench.weights import PublishedFile


@dataclass(kw_only=True, eq=False)
class LightGluePnp(NetworkPnp):
    """Learned features, LightGlue (Lindenberger et al., ICCV 2023), MAGSAC perspective-n-point, robust refinement.

    Args:
        matcher_weights: file of the weights that match these features, likewise.
        features: largest number of keypoints in each image; the authors' default is 2048.
        threshold: least probability of a match.
    """

    dimension: ClassVar[int]
    """of the descriptors"""
    matcher_file: ClassVar[PublishedFile]

    matcher_weights: Path | None = None
    features: Annotated[int, Field(ge=4, le=20000)] = 2048
    threshold: Annotated[float, Field(ge=0, lt=1)] = 0.1

    def __post_init__(self) -> None:
        super().__post_init__()
        weights = self.files(**vars(self))["matcher_weights"]
        self._matcher = LightGlue(weights, self.dimension, self.threshold, self.device)

    @classmethod
    def files(cls, weights: Path | None = None, matcher_weights: Path | None = None, **_: Any) -> dict[str, Path]:
        matcher = find_weights(cls.matcher_file, matcher_weights, cls.name, "matcher_weights")
        return {**super().files(weights), "matcher_weights": matcher}

    @classmethod
    def published(cls, **_: Any) -> dict[Path, PublishedFile]:
        return by_place(cls.file, cls.matcher_file)

    def match_features(self, reference: Features, query: Features) -> Indices:
        return self._matcher(reference, query)


class AlikedLightGluePnp(LightGluePnp):
    """ALIKED (Zhao et al., IEEE TIM 2023), model n16, by LightGlue."""

    name: ClassVar[str] = "aliked-lightglue-pnp"
    network: ClassVar[type[NetworkDetector]] = Aliked
    dimension: ClassVar[int] = 128
    file: ClassVar[PublishedFile] = published.ALIKED["n16"]
    matcher_file: ClassVar[PublishedFile] = published.LIGHTGLUE["aliked"]


class DiskLightGluePnp(LightGluePnp):
    """DISK (Tyszkiewicz et al., NeurIPS 2020) by LightGlue."""

    name: ClassVar[str] = "disk-lightglue-pnp"
    network: ClassVar[type[NetworkDetector]] = Disk
    dimension: ClassVar[int] = 128
    file: ClassVar[PublishedFile] = published.DISK
    matcher_file: ClassVar[PublishedFile] = published.LIGHTGLUE["disk"]


class SuperPointLightGluePnp(LightGluePnp):
    """SuperPoint (DeTone et al., CVPR Workshops 2018) by LightGlue."""

    name: ClassVar[str] = "superpoint-lightglue-pnp"
    network: ClassVar[type[NetworkDetector]] = SuperPoint
    dimension: ClassVar[int] = 256
    file: ClassVar[PublishedFile] = published.SUPERPOINT
    matcher_file: ClassVar[PublishedFile] = published.LIGHTGLUE["superpoint"]
