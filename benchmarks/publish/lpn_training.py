"""The time of a step of LPN's training, with and without a frozen backbone: making a batch, forward and backward pass.

EfficientNet-Lite0 with ImageNet's weights (the extra ``pretrained``), images of 128 pixels of smooth noise in memory, 8
of each view in a step. Times are medians over the steps in processor seconds of one thread, which other programs
lengthen less than wall-clock seconds. Maps of a frozen backbone are computed before, which is not in them.

    python benchmarks/publish/lpn_training.py [--steps N]
"""

from __future__ import annotations

import argparse
import json
import time
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import torch

from baselines.lpn.training.loop import Training
from baselines.lpn.training.options import TrainOptions
from baselines.lpn.training.trainer import LpnTrainer
from baselines.options import filled, options_from_dict
from relocbench.arrays import Image
from relocbench.retrieval import ImageView, PlaceData, PlaceImage
from relocbench.training import TrainingRun

SIDE, PLACES = 128, 240
CASES: tuple[tuple[str, dict[str, Any]], ...] = (
    ("lpn", {}),
    ("lpn", {"frozen": "layer3"}),
    ("lpn", {"frozen": "layer3", "frozen_blocks": 4}),
    ("lpn", {"frozen": "layer3", "frozen_blocks": 5}),
    ("lpn-branch5", {"frozen": "layer3", "frozen_blocks": 5}),
)


def image(place: int, view: str) -> Image:
    """Smooth noise (SIDE, SIDE, 3)."""
    noise = np.random.default_rng([place, len(view)]).normal(size=(SIDE, SIDE, 3)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 3.0)
    grey: Image = np.clip(127 + 90 * smooth / smooth.std(), 0, 255).astype(np.uint8)
    return grey


def places() -> PlaceData:
    """An image of each view of each place."""
    images = [
        PlaceImage(ImageView(f"{view}/{place}", view, partial(image, place, view)), place)
        for place in range(PLACES)
        for view in ("drone", "satellite")
    ]
    return PlaceData(PLACES, tuple(images), (("made", "0"),))


def seconds_of(name: str, frozen: dict[str, Any], steps: int) -> list[float]:
    """Processor seconds of some steps, without the first, which allocates memory."""
    given = {"network": {"backbone": "efficientnet-lite0"}, "size": SIDE, "backbone_weights": "imagenet", **frozen}
    given["versions"] = {"drone": 1, "satellite": 1}
    options = options_from_dict(TrainOptions, filled(LpnTrainer().options_of(name), given)).with_rates()
    out = []
    with TemporaryDirectory() as folder:
        training = Training(places(), None, options, TrainingRun(Path(folder), device="cpu"))
        training.cache_maps()
        for number in range(steps + 1):
            start = time.process_time()
            training.one_step(training.batches[number])
            out.append(time.process_time() - start)
    return out[1:]


def main() -> None:
    """Print a table and one JSON line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=9)
    steps = parser.parse_args().steps
    torch.set_num_threads(1)
    found: list[dict[str, Any]] = []
    for name, frozen in CASES:
        seconds = float(np.median(seconds_of(name, frozen, steps)))
        words = " ".join(f"{key}={value}" for key, value in frozen.items()) or "nothing frozen"
        found.append({"system": name, "options": words, "seconds": round(seconds, 4)})
        print(f"{name:<12} {words:<32} {seconds:7.3f} s a step, 1 / {found[0]['seconds'] / seconds:.1f} of the first")
    print(json.dumps({"benchmark": "lpn_training", "steps": found}))


if __name__ == "__main__":
    main()
