"""The options of a training of the pose network; YAML keys and ``--set`` names are these fields."""

from __future__ import annotations

from dataclasses import dataclass, field

from baselines.lm_reloc.options import PoseNetOptions
from baselines.options import Options, above_0, at_least, require, share, share_below_1, valid_shares


@dataclass(frozen=True)
class TrainOptions(Options):
    """Everything that decides what is learnt, except the data.

    Raises:
        OptionError: a value is out of range.
    """

    encoder_weights: str = ""
    """a file of ``relocbench train lm-net`` (or gn-net) whose network encodes the images and is not trained; by default
    the weights of lm-net that come with the package"""
    steps: int = 1600
    batch: int = 16
    """pairs in each step, each in both directions"""
    shares: dict[str, float] = field(default_factory=dict)
    """share of the pairs by the name of a dataset, as in {photographs: 0.25}; others are drawn evenly in the rest"""
    turns: int = 2
    """views of each image and of its mirror image: the first as it is, the others turned at random, which is exact"""
    turn_deg: tuple[float, float, float] = (2.0, 6.0, 2.0)
    """largest pitch, yaw and roll of a turned view, degrees"""
    mirror: float = 0.5
    """probability that both images are mirrored left to right"""
    cache_mb: int = 1500
    """largest size of the maps of views that are kept; those beyond it are computed anew each time"""
    translation_weight: float = 0.1
    """lambda of the loss: radians per metre"""
    learning_rate: float = 2e-3
    """largest learning rate of AdamW"""
    warm_up: int = 100
    """number of steps in which the rate rises from 0"""
    final_rate: float = 0.01
    """share of the largest rate that is reached at the last step, along half a cosine"""
    weight_decay: float = 1e-2
    """of AdamW; with 0 it is Adam"""
    clip: float = 10.0
    """largest norm of the gradient; 0: no limit"""
    ema: float = 0.998
    """decay, in each step, of the exponential moving average of the weights, which is validated and kept; 0: the
    trained weights themselves are"""
    mixed_precision: bool | None = None
    """run the network in bfloat16; null: only on a GPU"""
    seed: int = 0
    """of initial weights, pairs and turns"""
    log_every: int = 20
    validate_every: int = 1600
    """steps; weights are also validated after the last step"""
    checkpoint_every: int = 100
    """steps; checkpoints are also written after each validation"""
    network: PoseNetOptions = field(default_factory=PoseNetOptions)

    def __post_init__(self) -> None:
        valid_shares(self)
        at_least(self, 1, "steps batch turns log_every validate_every checkpoint_every")
        at_least(self, 0, "warm_up seed weight_decay clip cache_mb")
        require(
            self, "turn_deg", lambda turn: 0 <= min(turn) <= max(turn) < 45, "three angles, each 0 or more and below 45"
        )
        share_below_1(self, "ema")
        share(self, "mirror final_rate")
        above_0(self, "learning_rate translation_weight")
