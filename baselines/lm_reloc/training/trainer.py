"""The pose network's trainer in the sense of ``relocbench.training``."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from baselines.gn_net.tracker import LmNet
from baselines.gn_net.weights import load_weights
from baselines.lm_reloc.training.loop import Training
from baselines.lm_reloc.training.options import TrainOptions
from baselines.options import filled, options_from_dict, plain
from relocbench.training import PosedTrainingData, TrainingReport, TrainingRun, Validate


class PoseNetTrainer:
    """Trains the pose network on the frozen features of another training."""

    needs_correspondences = False

    def default_options(self) -> dict[str, Any]:
        """See ``relocbench.training.Trainer``. The encoder's shape is not among them, as its weights decide it."""
        values = plain(TrainOptions())
        del values["network"]["encoder"]
        return values

    def train(
        self, data: PosedTrainingData, validate: Validate | None, options: Mapping[str, Any], run: TrainingRun
    ) -> TrainingReport:
        """See ``relocbench.training.Trainer``.

        Raises:
            MethodError: also if the encoder's weights cannot be used.
        """
        chosen = filled(self.default_options(), options)
        path = Path(str(chosen.get("encoder_weights") or LmNet.files()["weights"]))
        encoder = load_weights(path)
        if isinstance(chosen.get("network"), Mapping):
            chosen["network"] = {"encoder": plain(encoder.options), **chosen["network"]}
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        return Training(data, validate, options_from_dict(TrainOptions, chosen), encoder, digest, run).run_to_end()
