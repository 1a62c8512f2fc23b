"""GN-Net and its variants as they are installed, which differ in weights, defaults and where alignment starts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from baselines.alignment.features.pyramid import FeaturePyramid
from baselines.alignment.shared.starts import Start
from baselines.calibration import GN_NET_CONTRASTIVE, GN_NET_FROM_PRIOR, GN_NET_PNP, LM_NET, Calibration
from baselines.gn_net.method import CoarsePoints, Counts, GnNet, GnNetReference, Share
from baselines.gn_net.start import MatchedLandmarks
from baselines.options import Finite
from relocbench.tracking import TrackResult

__all__ = ["ONE_START", "GnNet", "GnNetContrastive", "GnNetFromPrior", "GnNetPnp", "LmNet", "LmNetFromPrior"]

MIN_AGREEMENT_PNP, MIN_AGREEMENT_CONTRASTIVE, MIN_AGREEMENT_LM = 0.0125, 0.0025, 0.03
"""below which hardly an answer was right on the districts of the calibration"""
ONE_START: Mapping[str, Any] = {
    "coarse_points": None,
    "iterations": (10, 20, 50, 50, 50),
    "first_levels": 1,
    "along": (),
    "hypotheses": 1,
    "kept": (),
    "nearby": (),
}
"""parameters of one alignment from the prior or the identity, on all levels and with all points, as GN-Net describes
it, and, where matches are used, one from the pose that they give"""


@dataclass(eq=False)
class GnNetFromPrior(GnNet):
    """As :class:`GnNet`, without matches: started from the prior or the identity, and along the road from there.

    With the parameters of :data:`ONE_START` it aligns once, from the prior or the identity, as the paper's tracker.
    """

    name = "gn-net-from-prior"
    calibration = GN_NET_FROM_PRIOR

    matched_start: bool = False


@dataclass(eq=False)
class GnNetPnp(GnNet):
    """The pose that matched landmarks give, without alignment: what the start of :class:`GnNet` is worth by itself.

    The parameters of the alignment and of its starts change nothing.
    """

    name = "gn-net-pnp"
    calibration = GN_NET_PNP
    uses_prior = False

    min_agreement: Share = MIN_AGREEMENT_PNP

    @classmethod
    def assumes(cls, **_: Any) -> str:
        """Nothing: there are no starts."""
        return ""

    def _find(
        self, reference: GnNetReference, features: FeaturePyramid, matched: MatchedLandmarks, first: Start
    ) -> TrackResult:
        pose = matched.pose(self.seed)
        if pose is None:
            count = len(matched)
            return TrackResult.failure(f"no pose agrees with the {count} matched landmarks", matches=count)
        return self._answer(pose, matched, {})


@dataclass(eq=False)
class GnNetContrastive(GnNet):
    """As :class:`GnNet`, with weights of the contrastive loss alone, to show what the other losses contribute."""

    name = trainer = "gn-net-contrastive"
    calibration = GN_NET_CONTRASTIVE

    min_agreement: Share = MIN_AGREEMENT_CONTRASTIVE


@dataclass(eq=False)
class LmNet(GnNet):
    """As :class:`GnNet`, with weights trained by LM-Reloc's descent loss and its damping, from fewer starts."""

    name = trainer = "lm-net"
    calibration: ClassVar[Calibration | None] = LM_NET

    landmarks: Annotated[int, Field(ge=4)] = 400
    coarse_points: CoarsePoints = ONE_START["coarse_points"]
    iterations: Counts = ONE_START["iterations"]
    damping: Literal["dso", "lm-reloc"] = "lm-reloc"
    first_levels: Annotated[int, Field(ge=1)] = ONE_START["first_levels"]
    along: tuple[Finite, ...] = ONE_START["along"]
    hypotheses: Annotated[int, Field(ge=1)] = ONE_START["hypotheses"]
    kept: Counts = ONE_START["kept"]
    nearby: tuple[Share, ...] = ONE_START["nearby"]
    min_agreement: Share = MIN_AGREEMENT_LM


@dataclass(eq=False)
class LmNetFromPrior(LmNet):
    """As :class:`LmNet`, started from the prior or the identity alone. Answers have no confidence: none was fitted."""

    name = "lm-net-from-prior"
    calibration = None

    matched_start: bool = False
