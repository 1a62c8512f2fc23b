"""The tracker of correspondences without keypoints."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from baselines.feature_pnp.keyframe_depth import lift
from baselines.feature_pnp.pnp import Pnp, PreparedKeyframe, StrongPixels
from baselines.feature_pnp.solve import Matches2D3D
from baselines.learned_pnp import published
from baselines.learned_pnp.loftr import Loftr, LoftrImage, LoftrModel
from baselines.published_weights import by_place, find_weights
from relocbench.tracking import Query, Reference
from relocbench.weights import PublishedFile


@dataclass(frozen=True, eq=False)
class PreparedImage(PreparedKeyframe):
    """A keyframe, and what the network computes of its image alone."""

    reference: Reference
    seen: LoftrImage


@dataclass(kw_only=True, eq=False)
class LoftrPnp(Pnp[PreparedImage]):
    """LoFTR (Sun et al., CVPR 2021), MAGSAC perspective-n-point, robust refinement.

    Every 8 x 8 cell of the keyframe may have a corresponding pixel in the query; cells without a depth are left out.
    Answers have no confidence: no calibration was fitted yet.

    Args:
        weights: file of the network's weights, as kornia's maintainers publish it or as safetensors; by default the one
            of that name in torch's cache, ``$TORCH_HOME/hub/checkpoints``.
        model: what the weights were trained on, MegaDepth (``outdoor``) or ScanNet (``indoor_new``).
        threshold: least probability of a match of two cells.
        longest_px: images whose longer side has more pixels are shrunk to so many; the authors' is 840. Memory grows
            with its fourth power.
        device: where the network runs; the pose is found on the CPU.

    Raises:
        MethodError: kornia is not installed, or the weights are missing or of another network.
    """

    name: ClassVar[str] = "loftr-pnp"

    weights: Path | None = None
    model: LoftrModel = "outdoor"
    threshold: Annotated[float, Field(ge=0, lt=1)] = 0.2
    longest_px: Annotated[int, Field(ge=64)] = 840
    device: str = "cpu"

    def __post_init__(self) -> None:
        weights = self.files(**vars(self))["weights"]
        self._network = Loftr(weights, self.model, self.threshold, self.longest_px, self.device)

    @classmethod
    def files(cls, weights: Path | None = None, model: LoftrModel = "outdoor", **_: Any) -> dict[str, Path]:
        """The files that decide the answers besides parameters; with other weights, results are not continued."""
        return {"weights": find_weights(published.LOFTR[model], weights, cls.name)}

    @classmethod
    def published(cls, model: LoftrModel = "outdoor", **_: Any) -> dict[Path, PublishedFile]:
        """The file of the authors, by where it is looked for."""
        return by_place(published.LOFTR[model])

    def prepare(self, reference: Reference) -> PreparedImage:
        """Compute the features of a keyframe's cells."""
        strong = StrongPixels.of(reference, self.depth_radius_px)
        return PreparedImage(strong, reference, self._network.encode(reference.image))

    def correspond(self, reference: PreparedImage, query: Query) -> Matches2D3D:
        """The points of a keyframe's cells and the pixels that see them in a query."""
        seen = self._network.encode(query.image)
        uv_ref, uv_query = self._network(reference.seen, seen)
        lifted = lift(reference.reference, uv_ref, self.depth_radius_px)
        scale = max(1.0, float(reference.seen.factor.max()), float(seen.factor.max()))
        return Matches2D3D(
            points=lifted.points,
            pixels=uv_query[lifted.index],
            scale=np.full(len(lifted.index), scale),
            depth_direction=lifted.depth_direction,
            reference_pixels=uv_ref[lifted.index],
        )
