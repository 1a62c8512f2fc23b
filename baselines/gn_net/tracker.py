"""GN-Net as a relocalization tracker: direct alignment, coarse to fine, on learned features in place of intensities.

von Stumberg et al., GN-Net: The Gauss-Newton Loss for Multi-Weather Relocalization, RA-L 2020.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from baselines.alignment import (
    DSO_DAMPING,
    LM_RELOC_DAMPING,
    SINGLE_PIXEL,
    FeatureAlignment,
    FeaturePyramid,
    FeatureSettings,
    Level,
    MatchSettings,
    ReferenceFeatures,
    Start,
    align_features_best,
    choose_points,
    image_pyramid,
    level_camera,
    match_pixels,
    match_pixels_by_level,
    require_pinhole,
    small_rotations,
)
from baselines.alignment.features.pyramid import level_coordinates
from baselines.gn_net.correspondence import Landmarks
from baselines.gn_net.network import FeatureNet, image_tensor
from baselines.gn_net.start import SeenLandmarks, StartSettings, find_landmarks
from baselines.gn_net.weights import load_weights
from relocbench.errors import MethodError
from relocbench.geometry import Camera
from relocbench.tracking import Query, Reference, TrackResult

Array = NDArray[np.float64]

SHIPPED = Path(__file__).parent / "shipped"
"""weights that come with the package, as NAME.safetensors"""
SELECTION_LEVELS = 3
"""of the intensity pyramid, which points are chosen on"""
MIN_VALID_SHARE = 0.1
"""of the reference's points must project into the query for an answer"""


@dataclass(frozen=True, eq=False)
class GnNetReference:
    """A prepared keyframe: the network is not asked about it again, however many queries follow."""

    features: ReferenceFeatures
    pyramid: FeaturePyramid
    """its maps, for matching single pixels"""
    selected: int
    """points with depth that were chosen"""
    landmarks: Landmarks | None
    """some of them, to start from; None where no start is searched for"""


class GnNet:
    """Direct alignment of learned features from the prior, or from the identity without one.

    Confidence, 0 to 1: the share of the landmarks that the matched start looked for and that the query shows within two
    pixels (of the finest map) of where the answer puts them. Without ``matched_start``, the share of the reference's
    points that are in view and within the cutoff, which does not compare between keyframes.

    Args:
        weights: a file of ``relocbench train``; default: those that come with the package.
        points: about so many pixels are chosen from a dense depth; points of a sparse map are all used.
        huber: in units of the reference features' spread on the level; larger residuals weigh less.
        cutoff: in the same units; larger residuals are held for outliers.
        cutoff_levels: on so many of the finest levels; coarser ones only have the Huber loss.
        per_channel: robust loss on each channel, else on the norm over all.
        damping: schedule of Levenberg-Marquardt, of DSO's tracker or for features trained by LM-Reloc's loss; default:
            what the method of this name is trained for.
        matched_start: start also from the pose that agrees with the nearest features, matched coarse to fine; the
            lowest final energy wins.
        multistart: start also from 26 small rotations; the lowest final energy wins.
        min_points: fewer points with depth are a stated failure.
        device: where the network runs; the alignment is on the CPU.
        seed: of the choice of points.

    Raises:
        MethodError: there are no weights, or the file is not one of weights.
    """

    uses_prior = True
    name: ClassVar[str] = "gn-net"
    usual_damping: ClassVar[Literal["dso", "lm-reloc"]] = "dso"

    def __init__(
        self,
        weights: Path | None = None,
        points: Annotated[int, Field(ge=1)] = 2000,
        huber: Annotated[float, Field(gt=0)] = 0.3,
        cutoff: Annotated[float, Field(gt=0)] = 1.0,
        cutoff_levels: Annotated[int, Field(ge=1)] = 1,
        per_channel: bool = False,
        damping: Literal["dso", "lm-reloc"] | None = None,
        matched_start: bool = True,
        multistart: bool = False,
        min_points: Annotated[int, Field(ge=8)] = 30,
        device: str = "cpu",
        seed: int = 0,
    ) -> None:
        self.settings = FeatureSettings(
            huber=huber,
            cutoff=cutoff,
            cutoff_levels=cutoff_levels,
            per_channel=per_channel,
            damping=LM_RELOC_DAMPING if (damping or self.usual_damping) == "lm-reloc" else DSO_DAMPING,
        )
        self.points = points
        self.start = StartSettings() if matched_start else None
        self.multistart = multistart
        self.min_points = min_points
        self.device = device
        self.seed = seed
        self._last: tuple[Query, FeaturePyramid] | None = None
        self.net = self._to_device(
            weights if isinstance(weights, FeatureNet) else load_weights(weights or self._shipped())
        )

    @classmethod
    def files(cls, weights: Path | None = None, **_: Any) -> dict[str, Path]:
        """What decides the answers besides parameters, so that results of other weights are not gone on with."""
        return {"weights": Path(weights) if weights else cls._shipped_path()}

    def prepare(self, reference: Reference) -> GnNetReference:
        """Choose points and look up their features on all levels.

        Raises:
            MethodError: the camera is not pinhole, or the image is too small for the network.
        """
        intensities = image_pyramid(reference.image, reference.camera, SELECTION_LEVELS)
        chosen = choose_points(reference, intensities, self.points, np.random.default_rng(self.seed))
        pyramid = self.features(reference.image, reference.camera)
        on_finest = replace(chosen, uv=self._on_finest(chosen.uv))
        landmarks = None
        if self.start is not None:
            landmarks = Landmarks.at(on_finest, pyramid, self.start.points, np.random.default_rng(self.seed))
        return GnNetReference(ReferenceFeatures.at_points(on_finest, pyramid), pyramid, len(chosen), landmarks)

    def track(self, reference: GnNetReference, query: Query, prior: Array | None = None) -> TrackResult:
        """Align a query to a prepared reference.

        Raises:
            MethodError: the camera is not pinhole, or the image is too small for the network.
        """
        if min(reference.selected, len(reference.features.levels[0])) < self.min_points:
            return TrackResult.failure(
                f"{reference.selected} reference points with depth, at least {self.min_points} are needed"
            )
        first = np.eye(4) if prior is None else np.asarray(prior, dtype=np.float64)
        features = self._query_features(query)
        starts = [Start(first)]
        if self.multistart:
            starts += [Start(turn @ first) for turn in small_rotations()]
        seen = None
        if self.start is not None and reference.landmarks is not None:
            seen = find_landmarks(reference.landmarks, features, self.start)
            matched = seen.pose(self.seed)
            # First, as it mostly wins: what others cannot reach any more they give up early.
            starts = starts if matched is None else [Start(matched, self.start.level), *starts]
        return self._answer(align_features_best(reference.features, features, starts, self.settings), seen)

    def match(self, reference: GnNetReference, query: Query, uv_ref: Array, uv_start: Array) -> Array:
        """Where single pixels of the keyframe are in the query, by Gauss-Newton on features from given starts.

        Args:
            uv_ref, uv_start: (N, 2) pixels of the keyframe, and of the query to start from.

        Returns:
            (N, 2) pixels of the query; NaN where the derivative leaves the map or says nothing.
        """
        maps: list[Level] = self._query_features(query).with_gradients()
        uv = self._on_finest(uv_ref), self._on_finest(uv_start)
        found = match_pixels(reference.pyramid.with_gradients(), maps, *uv, MatchSettings(SINGLE_PIXEL))
        return self._of_image(found)

    def match_levels(self, reference: GnNetReference, query: Query, uv_ref: Array, uv_start: Array) -> list[Array]:
        """As :meth:`match` on each level alone, the image's own first; NaN on levels that the network has no map of."""
        maps: list[Level] = self._query_features(query).with_gradients()
        uv = self._on_finest(uv_ref), self._on_finest(uv_start)
        found = match_pixels_by_level(reference.pyramid.with_gradients(), maps, *uv, MatchSettings(SINGLE_PIXEL))
        without = [np.full(np.shape(uv_ref), np.nan) for _ in range(self.net.options.finest)]
        return [*without, *map(self._of_image, found)]

    @torch.inference_mode()
    def features(self, image: NDArray[np.uint8], camera: Camera) -> FeaturePyramid:
        """Feature maps of an (H, W) or (H, W, 3) image; the first is that of level ``finest``, with its camera.

        Raises:
            MethodError: the camera is not pinhole, or the image is too small for the network.
        """
        require_pinhole(camera)
        try:
            maps = self.net(image_tensor(image).to(self.device, memory_format=torch.channels_last))
        except ValueError as bad:
            raise MethodError(str(bad)) from bad
        of_finest = level_camera(camera, self.net.options.finest)
        return FeaturePyramid.from_maps([m[0].permute(1, 2, 0).float().cpu().numpy() for m in maps], of_finest)

    def _query_features(self, query: Query) -> FeaturePyramid:
        """Features of a query. The last are kept: a query is often asked about from several priors or keyframes."""
        if self._last is None or self._last[0] is not query:
            self._last = query, self.features(query.image, query.camera)
        return self._last[1]

    def _on_finest(self, uv: Array) -> Array:
        """Pixels (N, 2) of the image as pixels of the finest map."""
        return level_coordinates(uv, self.net.options.finest)

    def _of_image(self, uv: Array) -> Array:
        """The inverse of :meth:`_on_finest`."""
        return (uv + 0.5) * float(1 << self.net.options.finest) - 0.5

    def _answer(self, found: FeatureAlignment, seen: SeenLandmarks | None) -> TrackResult:
        info = self._info(found)
        if found.failure:
            return TrackResult.failure(found.failure, **info)
        if found.final.valid < max(self.min_points, MIN_VALID_SHARE * found.residuals):
            return TrackResult.failure(
                f"only {found.final.valid} of {found.residuals} residuals project into the query", **info
            )
        if seen is None:
            return TrackResult(found.T_query_ref, confidence=float(found.inlier_share), info=info)
        info["matches"] = len(seen.matches)
        return TrackResult(found.T_query_ref, confidence=seen.agreement(found.T_query_ref), info=info)

    def _info(self, found: FeatureAlignment) -> dict[str, Any]:
        return {
            "energy": float(found.energy),
            "points": found.points,
            "inlier_share": float(found.inlier_share),
            "levels": [outcome.level for outcome in found.outcomes],
            "iterations": [int(outcome.iterations) for outcome in found.outcomes],
            "energies": [float(outcome.energy) for outcome in found.outcomes],
        }

    @classmethod
    def _shipped_path(cls) -> Path:
        return SHIPPED / f"{cls.name}.safetensors"

    def _shipped(self) -> Path:
        path = self._shipped_path()
        if not path.is_file():
            raise MethodError(
                f"no weights of {self.name} come with this version; train some (relocbench train {self.name} "
                f"--dataset DIR --out OUT) and give --set {self.name}.weights=OUT/weights.safetensors"
            )
        return path

    def _to_device(self, net: FeatureNet) -> FeatureNet:
        try:
            return net.for_tracking().to(self.device)
        except (RuntimeError, AssertionError) as bad:  # torch says which: no such device, or no driver
            raise MethodError(f"device '{self.device}' cannot be used: {str(bad).splitlines()[0]}") from bad


class GnNetContrastive(GnNet):
    """As :class:`GnNet`, with weights trained without the Gauss-Newton loss: what that loss is worth."""

    name = "gn-net-contrastive"


class LmNet(GnNet):
    """As :class:`GnNet`, with weights trained by LM-Reloc's descent loss, and its damping."""

    name = "lm-net"
    usual_damping = "lm-reloc"
