"""Trackers whose learned features are matched by LightGlue."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import Field

from baselines.calibration import Calibration
from baselines.feature_pnp.features import Features
from baselines.feature_pnp.tracker import FeaturePnp
from baselines.learned_pnp import published
from baselines.learned_pnp.aliked import Aliked
from baselines.learned_pnp.detector import NetworkDetector
from baselines.learned_pnp.disk import Disk
from baselines.learned_pnp.lightglue import LightGlue
from baselines.learned_pnp.superpoint import SuperPoint
from baselines.published_weights import by_place, find_weights
from relocbench.arrays import Image, Indices
from relocbench.weights import PublishedFile


class LightGluePnp(FeaturePnp):
    """Learned features, LightGlue (Lindenberger et al., ICCV 2023), MAGSAC perspective-n-point, robust refinement.

    Answers have no confidence: no calibration was fitted yet.

    Args:
        weights: file of the weights that find features, as its authors publish it or as safetensors; by default the one
            of the authors' name in torch's cache, ``$TORCH_HOME/hub/checkpoints``.
        matcher_weights: file of the weights that match these features, likewise.
        features: largest number of keypoints in each image; the authors' default is 2048.
        threshold: least probability of a match.
        longest_px: images whose longer side has more pixels are shrunk to so many.
        grid_px: side, in pixels, of the grid cells over which keypoints are distributed evenly.
        depth_radius_px: largest distance, in pixels, from a keypoint to points of a sparse map that give its depth; by
            default it follows the density of the map.
        reprojection_threshold_px: largest error, in query pixels, of an inlier.
        min_inliers: with fewer inliers, tracking fails.
        max_iterations: largest number of minimal samples.
        confidence: the probability of success at which sampling stops early.
        device: where the networks run; the pose is found on the CPU.
        seed: of the sampling.

    Raises:
        MethodError: kornia is not installed, or weights are missing or of another network.
    """

    calibration: ClassVar[Calibration | None] = None
    name: ClassVar[str]
    """that it is installed by"""
    network: ClassVar[type[NetworkDetector]]
    dimension: ClassVar[int]
    """of the descriptors"""
    file: ClassVar[PublishedFile]
    matcher_file: ClassVar[PublishedFile]

    def __init__(
        self,
        *,
        weights: Path | None = None,
        matcher_weights: Path | None = None,
        features: Annotated[int, Field(ge=4, le=20000)] = 2048,
        threshold: Annotated[float, Field(ge=0, lt=1)] = 0.1,
        longest_px: Annotated[int, Field(ge=64)] = 1280,
        grid_px: Annotated[int, Field(ge=4)] = 32,
        depth_radius_px: Annotated[float, Field(ge=0)] | None = None,
        reprojection_threshold_px: Annotated[float, Field(gt=0)] = 2.0,
        min_inliers: Annotated[int, Field(ge=4)] = 10,
        max_iterations: Annotated[int, Field(ge=1)] = 10000,
        confidence: Annotated[float, Field(gt=0, lt=1)] = 0.9999,
        device: str = "cpu",
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
        files = self.files(weights, matcher_weights)
        self._detector = self.network(files["weights"], features, longest_px, device)
        self._matcher = LightGlue(files["matcher_weights"], self.dimension, threshold, device)

    @classmethod
    def files(cls, weights: Path | None = None, matcher_weights: Path | None = None, **_: Any) -> dict[str, Path]:
        """The files that decide the answers besides parameters; with other weights, results are not continued."""
        return {
            "weights": find_weights(cls.file, weights, cls.name),
            "matcher_weights": find_weights(cls.matcher_file, matcher_weights, cls.name, "matcher_weights"),
        }

    @classmethod
    def published(cls, **_: Any) -> dict[Path, PublishedFile]:
        """The files of the authors, by where they are looked for."""
        return by_place(cls.file, cls.matcher_file)

    def detect(self, image: Image) -> Features:
        return self._detector(image)

    def match_features(self, reference: Features, query: Features) -> Indices:
        return self._matcher(reference, query)


class AlikedLightGluePnp(LightGluePnp):
    """ALIKED (Zhao et al., IEEE TIM 2023), model n16, by LightGlue; see :class:`LightGluePnp` for the parameters."""

    name: ClassVar[str] = "aliked-lightglue-pnp"
    network: ClassVar[type[NetworkDetector]] = Aliked
    dimension: ClassVar[int] = 128
    file: ClassVar[PublishedFile] = published.ALIKED["n16"]
    matcher_file: ClassVar[PublishedFile] = published.LIGHTGLUE["aliked"]


class DiskLightGluePnp(LightGluePnp):
    """DISK (Tyszkiewicz et al., NeurIPS 2020) by LightGlue; see :class:`LightGluePnp` for the parameters."""

    name: ClassVar[str] = "disk-lightglue-pnp"
    network: ClassVar[type[NetworkDetector]] = Disk
    dimension: ClassVar[int] = 128
    file: ClassVar[PublishedFile] = published.DISK
    matcher_file: ClassVar[PublishedFile] = published.LIGHTGLUE["disk"]


class SuperPointLightGluePnp(LightGluePnp):
    """SuperPoint (DeTone et al., CVPR Workshops 2018) by LightGlue; see :class:`LightGluePnp` for the parameters."""

    name: ClassVar[str] = "superpoint-lightglue-pnp"
    network: ClassVar[type[NetworkDetector]] = SuperPoint
    dimension: ClassVar[int] = 256
    file: ClassVar[PublishedFile] = published.SUPERPOINT
    matcher_file: ClassVar[PublishedFile] = published.LIGHTGLUE["superpoint"]
