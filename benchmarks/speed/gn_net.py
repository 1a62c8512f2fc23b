"""The time of GN-Net's network for an image, compared with ResNet-18, and the time of its losses for a pair, on the
CPU.

The reference is the time of torchvision's ResNet-18 for its features of the same 512x512 image (without pooling and
classifier), in channels-last layout and with batch normalisation folded like the network's. The two run alternately, so
that other programs affect both: on two threads in wall-clock time, and on one thread in processor time. Without
``--weights`` the network is gn-net's own, with the weights that come with it.

    python benchmarks/speed/gn_net.py [--repeats N] [--weights FILE]
"""

# ruff: noqa: E402  (the number of threads must be set before torch is imported)
from __future__ import annotations

import os

THREADS = 2
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = str(THREADS)

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.fx.experimental.optimization import fuse
from torchvision.models import resnet18

from baselines.gn_net.losses.total import LossOptions, total_loss
from baselines.gn_net.method import SHIPPED
from baselines.gn_net.network import FeatureNet
from baselines.gn_net.weights import load_weights, save_weights

SIZE = 512
POINTS = 1024


def plain_reference() -> nn.Module:
    """ResNet-18 up to its last feature map."""
    torch.manual_seed(0)
    net = resnet18(weights=None).eval().requires_grad_(False)
    fused = fuse(net)
    fused.avgpool = nn.Identity()
    fused.fc = nn.Identity()
    return fused.to(memory_format=torch.channels_last)


def medians_ms(
    works: dict[str, Callable[[], object]], repeats: int, clock: Callable[[], float] = time.perf_counter
) -> dict[str, float]:
    """The median milliseconds of each function, called alternately."""
    times: dict[str, list[float]] = {name: [] for name in works}
    for round_number in range(repeats + 1):
        for name, work in works.items():
            start = clock()
            work()
            if round_number:  # the first round warms up
                times[name].append(1e3 * (clock() - start))
    return {name: float(np.median(each)) for name, each in times.items()}


def loss_work(net: FeatureNet, options: LossOptions) -> Callable[[], object]:
    """The time of all losses of one pair, forward and backward to given feature maps."""
    generator = torch.Generator().manual_seed(0)
    images = torch.rand((2, 3, SIZE, SIZE), generator=generator)
    with torch.no_grad():
        maps = net(images)
    u_ref, u_query = torch.rand((2, 1, POINTS, 2), generator=generator) * (SIZE - 1)
    mask = torch.ones((1, POINTS), dtype=torch.bool)

    def work() -> Tensor:
        leaves = [level.detach().requires_grad_() for level in maps]
        ref, query = [level[:1] for level in leaves], [level[1:] for level in leaves]
        total = total_loss(ref, query, u_ref, u_query, mask, options, generator).total
        total.backward()
        return total

    return work


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=15)
    shipped = SHIPPED / "gn-net.safetensors"
    parser.add_argument("--weights", type=Path, default=shipped, help="weights file, whose network is timed")
    asked = parser.parse_args()
    repeats = asked.repeats
    torch.set_num_threads(THREADS)

    net = load_weights(asked.weights)
    tracking, reference = net.for_tracking(), plain_reference()
    image = torch.rand((1, 3, SIZE, SIZE), generator=torch.Generator().manual_seed(0))
    image = image.to(memory_format=torch.channels_last)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "net.safetensors"
        save_weights(path, net, {})
        weights_bytes = path.stat().st_size
    with torch.inference_mode():
        forward = medians_ms({"network": lambda: tracking(image), "resnet18": lambda: reference(image)}, repeats)
        torch.set_num_threads(1)
        alone = medians_ms(
            {"network": lambda: tracking(image), "resnet18": lambda: reference(image)}, repeats, time.process_time
        )
    work = loss_work(tracking, LossOptions(level_weights=(1.0,) * net.options.levels))
    loss_ms = medians_ms({"losses": work}, max(3, repeats // 3), time.process_time)["losses"]

    shapes = [tuple(level.shape[1:]) for level in tracking(image)]
    print(f"parameters                     {net.parameters_count} ({weights_bytes / 1e6:.2f} MB on disk)")
    print(f"maps of a {SIZE}x{SIZE} image        {shapes}")
    print(f"one image, {THREADS} threads           {forward['network']:.0f} ms, ResNet-18 {forward['resnet18']:.0f} ms")
    print(f"one image, one thread          {alone['network']:.0f} ms, ResNet-18 {alone['resnet18']:.0f} ms (processor)")
    print(f"losses of a pair               {loss_ms:.0f} ms ({POINTS} points, all levels, there and back, one thread)")
    summary = {
        "benchmark": "gn_net",
        "parameters": net.parameters_count,
        "weights_bytes": weights_bytes,
        "network_ms": round(forward["network"], 1),
        "resnet18_ms": round(forward["resnet18"], 1),
        "ratio": round(forward["resnet18"] / forward["network"], 2),
        "network_processor_ms": round(alone["network"], 1),
        "resnet18_processor_ms": round(alone["resnet18"], 1),
        "processor_ratio": round(alone["resnet18"] / alone["network"], 2),
        "losses_processor_ms": round(loss_ms, 1),
    }
    print(json.dumps(summary))


if __name__ == "__main__":
    main()
