"""The time of a step of GN-Net's training with default options: making a batch, forward and backward pass.

Images are smooth noise of 512x512 pixels in memory, the query's shifted by whole pixels, with 4000 correspondences for
each pair; no files are read. Times are medians over the steps, in wall-clock seconds and, since other programs lengthen
these, in processor seconds. The batch is made in the same process, whereas a training makes it in the background.

    python benchmarks/publish/gn_net_training.py [--steps N] [--set key=value ...] [--trainer gn-net]
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import torch

from baselines.gn_net.tracker import GnNet
from baselines.gn_net.training.loop import Training
from baselines.gn_net.training.options import TrainOptions
from baselines.options import options_from_dict
from relocbench.methods.trainers import trainer_named, trainer_options
from relocbench.training import PairLabel, TrainingPair, TrainingRun

SIDE, CORRESPONDENCES, PAIRS = 512, 4000, 8


class Made:
    """Training pairs of smooth noise."""

    def __init__(self) -> None:
        rng = np.random.default_rng(0)
        noise = rng.normal(size=(SIDE + 64, SIDE + 64, 3)).astype(np.float32)
        smooth = cv2.GaussianBlur(noise, (0, 0), 3.0)
        self._world = np.clip(127 + 90 * smooth / smooth.std(), 0, 255).astype(np.uint8)

    def __len__(self) -> int:
        return PAIRS

    def label(self, index: int) -> PairLabel:
        return PairLabel("made", "a", f"b{index}", "front", "dry", "wet")

    def load(self, index: int) -> TrainingPair:
        rng = np.random.default_rng([1, index])
        shift = rng.integers(0, 32, 2)
        u_ref = rng.uniform(32, SIDE - 33, (CORRESPONDENCES, 2)).astype(np.float32)
        images = [self._world[:SIDE, :SIDE], self._world[shift[1] : shift[1] + SIDE, shift[0] : shift[0] + SIDE]]
        return TrainingPair(self.label(index), images[0], images[1], u_ref, (u_ref - shift).astype(np.float32))

    def describe(self) -> Mapping[str, str]:
        return {"made": "0"}


def main() -> None:
    """Print a table and one JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=5)
    parser.add_argument("--trainer", default="gn-net")
    parser.add_argument("--set", action="append", default=[], dest="settings")
    given = parser.parse_args()
    usual = trainer_named(given.trainer).default_options()
    options = options_from_dict(TrainOptions, trainer_options(usual, None, given.settings))
    device = "cuda" if torch.cuda.is_available() else "cpu"
    rows: dict[str, list[float]] = {"batch": [], "batch, processor": [], "step": [], "step, processor": []}
    with TemporaryDirectory() as folder:
        training = Training(Made(), None, options, TrainingRun(Path(folder), device=device), GnNet)
        for number in range(given.steps + 1):
            start = time.perf_counter(), time.process_time()
            batch = training.batches[number]
            middle = time.perf_counter(), time.process_time()
            training.one_step(batch)
            end = time.perf_counter(), time.process_time()
            if number:  # the first step allocates memory memory
                rows["batch"].append(middle[0] - start[0])
                rows["batch, processor"].append(middle[1] - start[1])
                rows["step"].append(end[0] - middle[0])
                rows["step, processor"].append(end[1] - middle[1])
    medians = {name: float(np.median(values)) for name, values in rows.items()}
    words = f"{options.batch} pairs of {options.crop}x{options.crop}, {options.points} points"
    print(f"{given.trainer}: {words}, {torch.get_num_threads()} threads")
    for name, seconds in medians.items():
        print(f"  {name:<18} {seconds:7.3f} s")
    print(json.dumps({"benchmark": "gn_net_training", "device": device, **medians}))


if __name__ == "__main__":
    main()
