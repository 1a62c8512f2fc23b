"""GN-Net as a relocalization tracker: direct alignment, coarse to fine, on learned features in place of intensities.

von Stumberg et al., GN-Net: The Gauss-Newton Loss for Multi-Weather Relocalization, RA-L 2020.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import torch
from pydantic import Field
from torch.nn import functional

from baselines.alignment.features.pyramid import FeaturePyramid, level_coordinates
from baselines.alignment.features.reference import ReferenceFeatures
from baselines.alignment.features.settings import LM_RELOC_DAMPING, FeatureSettings
from baselines.alignment.features.solver import FeatureAlignment, align_features, coarsest_level
from baselines.alignment.matching import SINGLE_PIXEL, MatchSettings, match_pixels, match_pixels_by_level
from baselines.alignment.shared.damping import DSO_DAMPING
from baselines.alignment.shared.levels import ABANDON_FACTOR
from baselines.alignment.shared.pyramid import Level, image_pyramid, level_camera, require_pinhole
from baselines.alignment.shared.selection import choose_points
from baselines.alignment.shared.starts import ALONG_THE_ROAD, Start, moved_along, small_rotations
from baselines.calibration import GN_NET, Calibration
from baselines.feature_cache import FeatureCache
from baselines.gn_net.correspondence import Landmarks
from baselines.gn_net.engine import Engine, on_engine
from baselines.gn_net.network import FeatureNet, image_tensor
from baselines.gn_net.start import MatchedLandmarks, StartSettings, find_landmarks
from baselines.gn_net.weights import load_weights
from baselines.options import Finite
from relocbench.arrays import Array, Floats, Image
from relocbench.errors import MethodError
from relocbench.geometry import Camera
from relocbench.tracking import Query, Reference, TrackResult

SHIPPED = Path(__file__).parent / "shipped"
"""weights that come with the package, as NAME.safetensors"""
MIN_AGREEMENT = 0.005
"""below which hardly an answer was right on the districts of the calibration"""
ONE_MORE = 1e-3
"""added to an agreement before its logarithm is taken, which is finite without any then"""
ALONG = (-10.0, -6.0, -2.0, 2.0, 6.0, 10.0)
"""metres; 2 m from the multiples of 4 m at which keyframes of rendered drives stand, so that no start is the truth"""
TURNS_DEG = (-30.0, -15.0, 0.0, 15.0, 30.0)
SELECTION_LEVELS = 3
"""levels of the intensity pyramid on which points are chosen"""
Share = Annotated[float, Field(ge=0, le=1)]
Counts = tuple[Annotated[int, Field(ge=1)], ...]
CoarsePoints = Annotated[int, Field(ge=8)] | None
Maps = tuple[list[Floats], list[Floats]]
"""features (H, W, D) and confidences (H, W, 1) of each level, finest first; no confidences if the network has none"""


@dataclass(frozen=True, eq=False)
class GnNetReference:
    """A prepared keyframe, for any number of queries."""

    features: ReferenceFeatures
    pyramid: FeaturePyramid
    """feature maps, for the matching of single pixels"""
    selected: int
    """number of points with depth that were chosen"""
    landmarks: Landmarks
    """for the matched start and for the evidence of an answer"""


@dataclass(eq=False)
class GnNet:
    """Direct alignment of learned features from several starts, of which the one that fits best in the end wins.

    Starts are the prior, or the identity without one; poses along the road from there; poses of matched features; and
    poses near the best of all these. Those of matches are accurate to some pixels and also begin on the finest level,
    so that no coarser one leads away from them.
    The landmarks of the keyframe are matched in the query. Their agreement is the share of them that are matched within
    two pixels (of the finest map) of where the answer projects them. The confidence is the probability that the answer
    is within 0.25 m and 2 degrees, from a calibration of the agreement, of the lead over the best other pose, and of
    the precision that the normal equations give the translation.

    Args:
        weights: a file of ``relocbench train``; by default the weights that come with the package.
        points: largest number of points with depth; of more, those of large gradient are chosen.
        coarse_points: at most so many of them on all levels but the two finest; None: all.
        huber: in units of the spread of the reference's features on the level; larger residuals are downweighted.
        cutoff: in the same units; larger residuals are treated as outliers.
        cutoff_levels: number of the finest levels on which the cutoff applies; coarser ones only have the Huber loss.
        per_channel: apply the robust loss to each channel instead of the norm over all channels.
        iterations: largest number on each level, finest first; the last number holds for all coarser levels.
        damping: the Levenberg-Marquardt schedule, that of DSO's tracker or one for features trained by LM-Reloc's loss.
        prior_level: the coarsest level at which alignment from the prior begins, 0 the finest map; for a prior that is
            near, such as another tracker's pose, from which coarser levels may lead away. None, or without a prior:
            the coarsest level, with starts along the road.
        first_levels: each pose but those of matches is aligned so many times, beginning once on each of the coarsest
            levels, or of those from ``prior_level`` on. Coarse levels see far, but may lead away from a pose that is
            near.
        halvings: how often the image is halved; the coarsest map of each smaller image is one more level. The image of
            which no such map is left is the last.
        along: lengths in metres, positive ahead, of arcs of circles along which the camera of the prior, or of the
            identity, drives to further starts.
        turns_deg: degrees, positive to the right, by which the camera is turned at the end of an arc, 0 straight on:
            there is a start for each length and turn.
        landmarks: largest number of landmarks, drawn among the chosen points.
        matched_start: also start from the poses that the matched landmarks give.
        hypotheses: so many poses are searched for among the matched landmarks, every second one from samples among the
            nearest features first.
        multistart: also start from 26 small rotations.
        give_up: one of several starts is given up on the first level whose root mean energy is this many times that of
            the best one.
        kept: of several starts, so many go on after each level, finest first; after coarser levels than given, all.
        nearby: on the level next to the finest, the camera of the two best poses is moved by these shares of the
            points' median depth to both sides along each of its axes, and aligned from there too.
        min_points: with fewer points that have depth, tracking fails.
        min_agreement: with a smaller agreement, tracking fails; by default one below which no answer was right on
            validation districts.
        most_rival: tracking fails where a pose of matches has more than so many times the agreement of the answer.
            Right answers have less: that pose fits errors of depth, too, but not so much better. None: never.
        cache_size: number of images whose feature maps are kept for the pairs that show them again. The answers stay
            the same, and the seconds of a pair no longer include the network where an image came before.
        engine: what computes the network; ``openvino`` takes less time on a CPU and needs the extra ``fast``. Its maps
            are those of ``torch`` but for the last digits.
        device: where the network runs; the alignment runs on the CPU.
        seed: of the random choices.

    Raises:
        MethodError: there are no weights, the file cannot be used, or the engine is not installed.
    """

    uses_prior = True
    name: ClassVar[str] = "gn-net"
    trainer: ClassVar[str] = "gn-net"
    """the trainer whose weights are used"""
    calibration: ClassVar[Calibration | None] = GN_NET
    """None where none was fitted: answers have no confidence then"""

    weights: Path | None = None
    points: Annotated[int, Field(ge=1)] = 2000
    coarse_points: CoarsePoints = 200
    huber: Annotated[float, Field(gt=0)] = 0.3
    cutoff: Annotated[float, Field(gt=0)] = 1.0
    cutoff_levels: Annotated[int, Field(ge=1)] = 1
    per_channel: bool = False
    iterations: Counts = (10, 10, 20, 10, 8)
    damping: Literal["dso", "lm-reloc"] = "dso"
    prior_level: Annotated[int, Field(ge=0)] | None = None
    first_levels: Annotated[int, Field(ge=1)] = 3
    halvings: Annotated[int, Field(ge=0)] = 0
    along: tuple[Finite, ...] = ALONG
    turns_deg: tuple[Finite, ...] = TURNS_DEG
    landmarks: Annotated[int, Field(ge=4)] = StartSettings.points
    matched_start: bool = True
    hypotheses: Annotated[int, Field(ge=1)] = 2
    multistart: bool = False
    give_up: Annotated[float, Field(gt=1)] = ABANDON_FACTOR
    kept: Counts = (5, 6, 8, 12, 20)
    nearby: tuple[Share, ...] = (0.02, 0.04, 0.08)
    min_points: Annotated[int, Field(ge=8)] = 30
    min_agreement: Share = MIN_AGREEMENT
    most_rival: Annotated[float, Field(ge=1)] | None = 3.0
    cache_size: Annotated[int, Field(ge=0)] = 0
    engine: Engine = "torch"
    device: str = "cpu"
    seed: Annotated[int, Field(ge=0)] = 0

    def __post_init__(self) -> None:
        self.settings = FeatureSettings(
            huber=self.huber,
            cutoff=self.cutoff,
            cutoff_levels=self.cutoff_levels,
            per_channel=self.per_channel,
            iterations=self.iterations,
            give_up=self.give_up,
            kept=self.kept,
            nearby=self.nearby,
            damping=LM_RELOC_DAMPING if self.damping == "lm-reloc" else DSO_DAMPING,
        )
        self._along = moved_along(np.eye(4), self.along, np.deg2rad(self.turns_deg).tolist())
        self.start = StartSettings(points=self.landmarks)
        self._last: tuple[Query, FeaturePyramid] | None = None
        self._cache: FeatureCache[Maps] = FeatureCache(self.cache_size)
        weights = self.weights
        net = weights if isinstance(weights, FeatureNet) else load_weights(weights or self._shipped())
        self.net = on_engine(net, self.engine, self.device)

    @classmethod
    def assumes(cls, **parameters: Any) -> str:
        """What is assumed of how cameras move, shown behind the method's name."""
        given = parameters["prior_level"] is not None and parameters.get("start") is not None
        return ALONG_THE_ROAD if parameters["along"] and not given else ""

    @classmethod
    def files(cls, weights: Path | None = None, **_: Any) -> dict[str, Path]:
        """The files that decide the answers besides parameters; with other weights, results are not continued."""
        return {"weights": Path(weights) if weights else cls._shipped_path()}

    def prepare(self, reference: Reference) -> GnNetReference:
        """Choose points and sample their features on all levels.

        Raises:
            MethodError: the camera is not pinhole, or the image is too small for the network.
        """
        intensities = image_pyramid(reference.image, reference.camera, SELECTION_LEVELS)
        chosen = choose_points(reference, intensities, self.points, np.random.default_rng(self.seed))
        pyramid = self.features(reference.image, reference.camera)
        on_finest = replace(chosen, uv=self._on_finest(chosen.uv))
        landmarks = Landmarks.at(on_finest, pyramid, self.start.points, np.random.default_rng(self.seed))
        features = ReferenceFeatures.at_points(on_finest, pyramid, coarse_points=self.coarse_points)
        return GnNetReference(features, pyramid, len(chosen), landmarks)

    def track(self, reference: GnNetReference, query: Query, prior: Array | None = None) -> TrackResult:
        """Align a query to a prepared reference.

        Raises:
            MethodError: the camera is not pinhole, or the image is too small for the network.
        """
        if min(reference.selected, len(reference.features.levels[0])) < self.min_points:
            return TrackResult.failure(
                f"{reference.selected} reference points with depth, at least {self.min_points} are needed"
            )
        features = self._query_features(query)
        matched = find_landmarks(reference.landmarks, features, self.start)
        first = Start(np.eye(4)) if prior is None else Start(np.asarray(prior, np.float64), self.prior_level)
        return self._find(reference, features, matched, first)

    def match(self, reference: GnNetReference, query: Query, uv_ref: Array, uv_start: Array) -> Array:
        """Find single pixels of the keyframe in the query, by Gauss-Newton on features from given starts.

        Args:
            reference: the prepared keyframe.
            query: the image to search.
            uv_ref: (N, 2) pixels of the keyframe.
            uv_start: (N, 2) pixels of the query to start from.

        Returns:
            (N, 2) pixels of the query; NaN where the pixel leaves the map or its normal equations are singular.
        """
        maps: list[Level] = self._query_features(query).with_gradients()
        uv = self._on_finest(uv_ref), self._on_finest(uv_start)
        found = match_pixels(reference.pyramid.with_gradients(), maps, *uv, MatchSettings(SINGLE_PIXEL))
        return self._of_image(found)

    def match_levels(self, reference: GnNetReference, query: Query, uv_ref: Array, uv_start: Array) -> list[Array]:
        """As :meth:`match`, on each level alone, the image's first; NaN on levels that the network has no map for."""
        maps: list[Level] = self._query_features(query).with_gradients()
        uv = self._on_finest(uv_ref), self._on_finest(uv_start)
        found = match_pixels_by_level(reference.pyramid.with_gradients(), maps, *uv, MatchSettings(SINGLE_PIXEL))
        without = [np.full(np.shape(uv_ref), np.nan) for _ in range(self.net.options.finest)]
        return [*without, *map(self._of_image, found)]

    def features(self, image: Image, camera: Camera) -> FeaturePyramid:
        """The feature maps of an image (H, W) or (H, W, 3); the first is that of level ``finest``, with its camera.

        Raises:
            MethodError: the camera is not pinhole, or the image is too small for the network.
        """
        require_pinhole(camera)
        features, confidences = self._cache.get(image, self._maps)
        return FeaturePyramid.from_maps(features, level_camera(camera, self.net.options.finest), confidences)

    @torch.inference_mode()
    def _maps(self, image: Image) -> Maps:
        x = image_tensor(image).to(self.device, memory_format=torch.channels_last)
        try:
            maps = self.net.with_confidences(x)
        except ValueError as bad:
            raise MethodError(str(bad)) from bad
        for _ in range(self.halvings):
            x = functional.avg_pool2d(x, 2)
            if min(x.shape[-2:]) < self.net.options.smallest_side:
                break
            coarsest = self.net.with_confidences(x, self.net.options.levels - 1)
            maps = maps[0] + coarsest[0], maps[1] + coarsest[1]
        features, confidences = ([m[0].permute(1, 2, 0).float().cpu().numpy() for m in each] for each in maps)
        return features, confidences

    def _find(
        self, reference: GnNetReference, features: FeaturePyramid, matched: MatchedLandmarks, first: Start
    ) -> TrackResult:
        """Align from every start, of which ``first`` is the prior or the identity."""
        starts = self._starts(first, coarsest_level(reference.features, features, self.settings))
        rivals = list(matched.poses(self.hypotheses, self.seed))
        if self.matched_start:
            starts = [*(Start(pose, level) for pose in rivals for level in (self.start.level, 0)), *starts]
        found = align_features(reference.features, features, starts, self.settings)
        info = self._info(found)
        if found.failure:
            return TrackResult.failure(found.failure, **info)
        if found.final.valid < self.min_points:
            return TrackResult.failure(
                f"only {found.final.valid} of {found.residuals} residuals project into the query", **info
            )
        return self._answer(found.T_query_ref, matched, info, rivals)

    def _starts(self, first: Start, coarsest: int) -> list[Start]:
        """The prior or the identity and what is tried around it, on the levels from ``coarsest`` or its own on."""
        if first.level is not None:
            coarsest = min(first.level, coarsest)
        poses = [first.T_query_ref]
        if first.level is None and np.all(np.isfinite(first.T_query_ref)):
            poses += [moved @ first.T_query_ref for moved in self._along]
        levels = range(coarsest, max(coarsest - self.first_levels, -1), -1)
        starts = [Start(pose, level) for pose in poses for level in levels]
        if self.multistart:
            starts += [Start(turn @ first.T_query_ref) for turn in small_rotations()]
        return starts

    def _query_features(self, query: Query) -> FeaturePyramid:
        """The features of a query, of which the last are kept: a query often comes with several priors or keyframes."""
        if self._last is None or self._last[0] is not query:
            self._last = query, self.features(query.image, query.camera)
        return self._last[1]

    def _on_finest(self, uv: Array) -> Array:
        """Pixels (N, 2) of the image in the coordinates of the finest map."""
        return level_coordinates(uv, self.net.options.finest)

    def _of_image(self, uv: Array) -> Array:
        """The inverse of :meth:`_on_finest`."""
        return (uv + 0.5) * float(1 << self.net.options.finest) - 0.5

    def _answer(
        self, T_query_ref: Array, matched: MatchedLandmarks, info: dict[str, Any], rivals: Sequence[Array] = ()
    ) -> TrackResult:
        """The pose with its confidence, or a failure if too few landmarks agree with it, or far more with a rival."""
        agreement = matched.agreement(T_query_ref)
        info |= {"matches": len(matched), "agreement": agreement, "log_agreement": float(np.log(agreement + ONE_MORE))}
        if agreement < self.min_agreement:
            return TrackResult.failure(
                f"{agreement:.1%} of {matched.sought} landmarks agree with the pose, at least "
                f"{self.min_agreement:.1%} are needed",
                **info,
            )
        rival = max(map(matched.agreement, rivals), default=0.0)
        if self.most_rival is not None and rival > self.most_rival * agreement:
            return TrackResult.failure(
                f"{agreement:.1%} of {matched.sought} landmarks agree with the pose, {rival:.1%} with another one",
                **info,
            )
        confidence = None if self.calibration is None else self.calibration.confidence(info)
        return TrackResult(T_query_ref, confidence=confidence, info=info)

    def _info(self, found: FeatureAlignment) -> dict[str, Any]:
        return {
            "energy": float(found.energy),
            "misfit": float(found.misfit),
            "lead": float(found.lead),
            "precision": found.precision,
            "points": found.points,
            "inlier_share": float(found.inlier_share),
            "levels": [outcome.level for outcome in found.outcomes],
            "iterations": [int(outcome.iterations) for outcome in found.outcomes],
            "energies": [float(outcome.energy) for outcome in found.outcomes],
        }

    @classmethod
    def _shipped_path(cls) -> Path:
        return SHIPPED / f"{cls.trainer}.safetensors"

    def _shipped(self) -> Path:
        path = self._shipped_path()
        if not path.is_file():
            raise MethodError(
                f"no weights of {self.trainer} come with this version; train some (relocbench train {self.trainer} "
                f"--dataset DIR --out OUT) and give --set {self.name}.weights=OUT/weights.safetensors"
            )
        return path
