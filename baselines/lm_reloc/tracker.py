"""LM-Reloc's trackers: the pose network alone, and the alignment of lm-net's features that starts from its pose.

von Stumberg et al., LM-Reloc: Levenberg-Marquardt Based Direct Visual Relocalization, 3DV 2020.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from baselines.alignment import FeaturePyramid
from baselines.device import to_device
from baselines.gn_net.network import image_tensor
from baselines.gn_net.tracker import MIN_AGREEMENT_LM, GnNetReference, LmNetFromPrior
from baselines.lm_reloc.euler import pose_of
from baselines.lm_reloc.network import PoseNetwork
from baselines.lm_reloc.view import inverse_depth_of_places, network_camera, seen_places, view_of
from baselines.lm_reloc.weights import load_weights
from relocbench.arrays import Array, Image
from relocbench.errors import MethodError
from relocbench.geometry import Camera
from relocbench.tracking import Query, Reference, TrackResult

SHIPPED = Path(__file__).parent / "shipped" / "pose-net.safetensors"
"""weights that come with the package"""
LEAST_SEEN = 0.05
"""share of the network's view that an image must fill"""


@dataclass(frozen=True, eq=False)
class PoseNetReference:
    """A prepared keyframe of the pose network."""

    described: Tensor
    """(1, D, G, G)"""
    depth: Tensor
    """(1, 2, G, G) inverse depth in 1/m and whether it is known"""
    seen: float
    """share of the network's view that the keyframe fills"""


class PoseNet:
    """The pose that a network predicts from two images, without alignment.

    Images of any camera are resampled to those of the network's own. Answers have no confidence: no calibration was
    fitted.

    Args:
        weights: a file of ``relocbench train pose-net``; by default the weights that come with the package.
        device: where the network runs.

    Raises:
        MethodError: there are no weights, or the file cannot be used.
    """

    def __init__(self, weights: Path | None = None, device: str = "cpu") -> None:
        self.net: PoseNetwork = to_device(load_weights(weights or _shipped()).for_tracking(), device)
        self.device = device
        options = self.net.options
        self.camera = network_camera(options.side, options.focal)
        self._last: tuple[Query, Tensor, float] | None = None

    @classmethod
    def files(cls, weights: Path | None = None, **_: Any) -> dict[str, Path]:
        """The files that decide the answers besides parameters; with other weights, results are not continued."""
        return {"weights": Path(weights) if weights else SHIPPED}

    def prepare(self, reference: Reference) -> PoseNetReference:
        """Describe a keyframe."""
        options, camera = self.net.options, reference.camera
        described, seen = self._described(reference.image, camera)
        depth = np.zeros((2, options.places, options.places), dtype=np.float32)
        if options.depth:
            depth = inverse_depth_of_places(reference.points, camera, self.camera, options.places)
        return PoseNetReference(described, torch.from_numpy(depth)[None].to(self.device), seen)

    @torch.inference_mode()
    def track(self, reference: PoseNetReference, query: Query, prior: Array | None = None) -> TrackResult:
        """Predict the pose of a query against a prepared keyframe; the prior is not used."""
        if self._last is None or self._last[0] is not query:
            self._last = query, *self._described(query.image, query.camera)
        described, seen = self._last[1:]
        if min(reference.seen, seen) < LEAST_SEEN:
            return TrackResult.failure(
                f"keyframe and query fill {reference.seen:.0%} and {seen:.0%} of the network's view of "
                f"{self._degrees:.0f} degrees, at least {LEAST_SEEN:.0%} are needed"
            )
        numbers = self.net(reference.described, described, reference.depth)[0].double().cpu().numpy()
        return TrackResult(pose_of(numbers))

    @property
    def _degrees(self) -> float:
        return float(2 * np.degrees(np.arctan2(self.camera.width / 2, self.camera.fx)))

    @torch.inference_mode()
    def _described(self, image: Image, camera: Camera) -> tuple[Tensor, float]:
        """Descriptors (1, D, G, G) of an image, and the share of the network's view that it fills."""
        view = view_of(image, camera, self.camera)
        seen = torch.from_numpy(seen_places(view.seen, self.net.options.places))[None].to(self.device)
        pixels = image_tensor(view.image).to(self.device, memory_format=torch.channels_last)
        return self.net.describe(self.net.encode(pixels), seen), float(view.seen.mean())


@dataclass(frozen=True, eq=False)
class LmRelocReference:
    """A keyframe that is prepared for both parts."""

    aligned: GnNetReference
    start: PoseNetReference


class LmReloc:
    """Direct alignment of lm-net's features from the pose that the pose network predicts, and from nowhere else.

    It is ``lm-net-from-prior`` with ``pose-net`` as its start. Answers have no confidence: no calibration was fitted.

    Args:
        weights: of the features, a file of ``relocbench train lm-net``; by default those that come with the package.
        pose_weights: of the pose network, a file of ``relocbench train pose-net``; by default those that come with the
            package.
        points: approximate number of pixels chosen from a dense depth image; all points of a sparse map are used.
        damping: the Levenberg-Marquardt schedule, that of DSO's tracker or LM-Reloc's.
        min_agreement: with a smaller share of landmarks that agree with the answer, tracking fails.
        device: where the networks run; the alignment runs on the CPU.
        seed: of the random choices.

    Raises:
        MethodError: there are no weights, or a file cannot be used.
    """

    def __init__(
        self,
        weights: Path | None = None,
        pose_weights: Path | None = None,
        points: Annotated[int, Field(ge=1)] = 2000,
        damping: Literal["dso", "lm-reloc"] = "lm-reloc",
        min_agreement: Annotated[float, Field(ge=0, le=1)] = MIN_AGREEMENT_LM,
        device: str = "cpu",
        seed: int = 0,
    ) -> None:
        self._aligner = LmNetFromPrior(
            weights=weights, points=points, damping=damping, min_agreement=min_agreement, device=device, seed=seed
        )
        self._start = PoseNet(weights=pose_weights, device=device)

    @classmethod
    def files(cls, weights: Path | None = None, pose_weights: Path | None = None, **_: Any) -> dict[str, Path]:
        """The files that decide the answers besides parameters; with other weights, results are not continued."""
        return {
            "weights": LmNetFromPrior.files(weights)["weights"],
            "pose_weights": PoseNet.files(pose_weights)["weights"],
        }

    def prepare(self, reference: Reference) -> LmRelocReference:
        """Prepare a keyframe for both parts.

        Raises:
            MethodError: the camera is not pinhole, or the image is too small for the network.
        """
        return LmRelocReference(self._aligner.prepare(reference), self._start.prepare(reference))

    def track(self, reference: LmRelocReference, query: Query, prior: Array | None = None) -> TrackResult:
        """Align a query to a prepared keyframe; the prior is not used.

        Raises:
            MethodError: the camera is not pinhole, or the image is too small for the network.
        """
        start = self._start.track(reference.start, query)
        if not start.answered:
            return start
        return self._aligner.track(reference.aligned, query, start.T_query_ref)

    def match(self, reference: LmRelocReference, query: Query, uv_ref: Array, uv_start: Array) -> Array:
        """Find single pixels of the keyframe in the query, as ``lm-net`` does."""
        return self._aligner.match(reference.aligned, query, uv_ref, uv_start)

    def match_levels(self, reference: LmRelocReference, query: Query, uv_ref: Array, uv_start: Array) -> list[Array]:
        """As :meth:`match`, on each level alone."""
        return self._aligner.match_levels(reference.aligned, query, uv_ref, uv_start)

    def features(self, image: Image, camera: Camera) -> FeaturePyramid:
        """The feature maps that are aligned, those of ``lm-net``."""
        return self._aligner.features(image, camera)


def _shipped() -> Path:
    if not SHIPPED.is_file():
        raise MethodError(
            "no weights of pose-net come with this version; train some (relocbench train pose-net --dataset DIR "
            "--out OUT) and give --set pose-net.weights=OUT/weights.safetensors, or lm-reloc.pose_weights"
        )
    return SHIPPED
