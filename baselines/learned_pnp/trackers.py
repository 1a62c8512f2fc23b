"""Trackers of learned features, which share the solver of ``orb-pnp``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import Field

from baselines.calibration import ALIKED_PNP, Calibration
from baselines.feature_pnp.features import Features
from baselines.feature_pnp.tracker import FeaturePnp
from baselines.learned_pnp import published
from baselines.learned_pnp.aliked import Aliked, AlikedModel
from baselines.learned_pnp.detector import NetworkDetector
from baselines.learned_pnp.disk import Disk
from baselines.learned_pnp.matching import mutual_nearest
from baselines.learned_pnp.superpoint import SuperPoint
from baselines.learned_pnp.xfeat import XFeat
from baselines.published_weights import by_place, find_weights
from relocbench.arrays import Image, Indices
from relocbench.weights import PublishedFile


class NearestPnp(FeaturePnp):
    """Learned features, mutual nearest neighbours, MAGSAC perspective-n-point, robust refinement.

    Answers have no confidence: no calibration was fitted yet.

    Args:
        weights: file of the network's weights, as its authors publish it or as safetensors; by default the one of the
            authors' name in torch's cache, ``$TORCH_HOME/hub/checkpoints``.
        features: largest number of keypoints in each image.
        ratio: a match is accepted below this ratio of the nearest to the second nearest distance; 1 accepts all.
        longest_px: images whose longer side has more pixels are shrunk to so many.
        grid_px: side, in pixels, of the grid cells over which keypoints are distributed evenly.
        depth_radius_px: largest distance, in pixels, from a keypoint to points of a sparse map that give its depth; by
            default it follows the density of the map.
        reprojection_threshold_px: largest error, in query pixels, of an inlier.
        min_inliers: with fewer inliers, tracking fails.
        max_iterations: largest number of minimal samples.
        confidence: the probability of success at which sampling stops early.
        device: where the network runs; the pose is found on the CPU.
        cache_size: number of images whose features are kept for the pairs that show them again. The answers stay the
            same, and the seconds of a pair no longer include the network where an image came before.
        seed: of the sampling.

    Raises:
        MethodError: kornia is needed and not installed, or the weights are missing or of another network.
    """

    calibration: ClassVar[Calibration | None] = None
    name: ClassVar[str]
    """that it is installed by"""
    network: ClassVar[type[NetworkDetector]]
    file: ClassVar[PublishedFile]

    def __init__(
        self,
        *,
        weights: Path | None = None,
        features: Annotated[int, Field(ge=4, le=20000)] = 3000,
        ratio: Annotated[float, Field(gt=0, le=1)] = 1.0,
        longest_px: Annotated[int, Field(ge=64)] = 1280,
        grid_px: Annotated[int, Field(ge=4)] = 32,
        depth_radius_px: Annotated[float, Field(ge=0)] | None = None,
        reprojection_threshold_px: Annotated[float, Field(gt=0)] = 2.0,
        min_inliers: Annotated[int, Field(ge=4)] = 10,
        max_iterations: Annotated[int, Field(ge=1)] = 10000,
        confidence: Annotated[float, Field(gt=0, lt=1)] = 0.9999,
        device: str = "cpu",
        cache_size: Annotated[int, Field(ge=0)] = 0,
        seed: Annotated[int, Field(ge=0)] = 0,
    ) -> None:
        super().__init__(
            features=features,
            grid_px=grid_px,
            depth_radius_px=depth_radius_px,
            reprojection_threshold_px=reprojection_threshold_px,
            min_inliers=min_inliers,
            max_iterations=max_iterations,
            confidence=confidence,
            seed=seed,
        )
        self.ratio = ratio
        self._detector = self.network(
            self.files(weights)["weights"], features, longest_px, device, cache_size=cache_size
        )

    @classmethod
    def files(cls, weights: Path | None = None, **_: Any) -> dict[str, Path]:
        """The files that decide the answers besides parameters; with other weights, results are not continued."""
        return {"weights": find_weights(cls.file, weights, cls.name)}

    @classmethod
    def published(cls, **_: Any) -> dict[Path, PublishedFile]:
        """The file of the authors, by where it is looked for."""
        return by_place(cls.file)

    def detect(self, image: Image) -> Features:
        return self._detector(image)

    def match_features(self, reference: Features, query: Features) -> Indices:
        return mutual_nearest(reference.descriptors, query.descriptors, self.ratio)


class AlikedPnp(FeaturePnp):
    """ALIKED (Zhao et al., IEEE TIM 2023), mutual nearest neighbours, MAGSAC perspective-n-point, robust refinement.

    Args:
        weights: file of the network's weights, as its authors publish it or as safetensors; by default
            ``aliked-MODEL.pth`` in torch's cache, ``$TORCH_HOME/hub/checkpoints``.
        model: variant of the network.
        features: largest number of keypoints in each image.
        ratio: a match is accepted below this ratio of the nearest to the second nearest distance; 1 accepts all.
        longest_px: images whose longer side has more pixels are shrunk to so many.
        grid_px: side, in pixels, of the grid cells over which keypoints are distributed evenly.
        depth_radius_px: largest distance, in pixels, from a keypoint to points of a sparse map that give its depth; by
            default it follows the density of the map.
        reprojection_threshold_px: largest error, in query pixels, of an inlier.
        min_inliers: with fewer inliers, tracking fails.
        max_iterations: largest number of minimal samples.
        confidence: the probability of success at which sampling stops early.
        device: where the network runs; the pose is found on the CPU.
        cache_size: number of images whose features are kept for the pairs that show them again. The answers stay the
            same, and the seconds of a pair no longer include the network where an image came before.
        seed: of the sampling.

    Raises:
        MethodError: kornia is not installed, or the weights are missing or of another network.
    """

    calibration: ClassVar[Calibration | None] = ALIKED_PNP
    name: ClassVar[str] = "aliked-pnp"

    def __init__(
        self,
        *,
        weights: Path | None = None,
        model: AlikedModel = "n16",
        features: Annotated[int, Field(ge=4, le=20000)] = 3000,
        ratio: Annotated[float, Field(gt=0, le=1)] = 1.0,
        longest_px: Annotated[int, Field(ge=64)] = 1280,
        grid_px: Annotated[int, Field(ge=4)] = 32,
        depth_radius_px: Annotated[float, Field(ge=0)] | None = None,
        reprojection_threshold_px: Annotated[float, Field(gt=0)] = 2.0,
        min_inliers: Annotated[int, Field(ge=4)] = 10,
        max_iterations: Annotated[int, Field(ge=1)] = 10000,
        confidence: Annotated[float, Field(gt=0, lt=1)] = 0.9999,
        device: str = "cpu",
        cache_size: Annotated[int, Field(ge=0)] = 0,
        seed: Annotated[int, Field(ge=0)] = 0,
    ) -> None:
        super().__init__(
            features=features,
            grid_px=grid_px,
            depth_radius_px=depth_radius_px,
            reprojection_threshold_px=reprojection_threshold_px,
            min_inliers=min_inliers,
            max_iterations=max_iterations,
            confidence=confidence,
            seed=seed,
        )
        self.ratio = ratio
        self._detector = Aliked(self.files(weights, model)["weights"], features, longest_px, device, model, cache_size)

    @classmethod
    def files(cls, weights: Path | None = None, model: AlikedModel = "n16", **_: Any) -> dict[str, Path]:
        """The files that decide the answers besides parameters; with other weights, results are not continued."""
        return {"weights": find_weights(published.ALIKED[model], weights, cls.name)}

    @classmethod
    def published(cls, model: AlikedModel = "n16", **_: Any) -> dict[Path, PublishedFile]:
        """The file of the authors, by where it is looked for."""
        return by_place(published.ALIKED[model])

    def detect(self, image: Image) -> Features:
        return self._detector(image)

    def match_features(self, reference: Features, query: Features) -> Indices:
        return mutual_nearest(reference.descriptors, query.descriptors, self.ratio)


class DiskPnp(NearestPnp):
    """DISK (Tyszkiewicz et al., NeurIPS 2020) with PnP; see :class:`NearestPnp` for the parameters."""

    name: ClassVar[str] = "disk-pnp"
    network: ClassVar[type[NetworkDetector]] = Disk
    file: ClassVar[PublishedFile] = published.DISK


class XFeatPnp(NearestPnp):
    """XFeat (Potje et al., CVPR 2024) with PnP; see :class:`NearestPnp` for the parameters."""

    name: ClassVar[str] = "xfeat-pnp"
    network: ClassVar[type[NetworkDetector]] = XFeat
    file: ClassVar[PublishedFile] = published.XFEAT


class SuperPointPnp(NearestPnp):
    """SuperPoint (DeTone et al., CVPR Workshops 2018) with PnP; see :class:`NearestPnp` for the parameters."""

    name: ClassVar[str] = "superpoint-pnp"
    network: ClassVar[type[NetworkDetector]] = SuperPoint
    file: ClassVar[PublishedFile] = published.SUPERPOINT
