"""What computes the feature network: torch, or OpenVINO, which needs less time on a CPU."""

from __future__ import annotations

import sys
import warnings
from functools import cache, lru_cache
from typing import Any, Literal

import torch
from torch import Tensor, nn

from baselines.device import to_device
from baselines.gn_net.network import FeatureNet
from relocbench.errors import MethodError

Engine = Literal["torch", "openvino"]
_SIZES = 4
"""so many sizes of images stay compiled, those that came last"""


def on_engine(net: FeatureNet, engine: Engine, device: str) -> FeatureNet:
    """A copy of a network for inference.

    Args:
        engine: what computes it.
        device: where; OpenVINO computes on the CPU.

    Raises:
        MethodError: the device cannot be used, or the engine is not installed.
    """
    if engine == "torch":
        return to_device(net.for_tracking(), device)
    if device != "cpu":
        raise MethodError(f"engine 'openvino' computes on the CPU: device is '{device}', expected 'cpu'")
    return OpenVinoNet(net)


class OpenVinoNet(FeatureNet):
    """A copy of a network that OpenVINO computes, in float32, on as many threads as torch has.

    Raises:
        MethodError: openvino is not installed.
    """

    def __init__(self, net: FeatureNet) -> None:
        super().__init__(net.options)
        self.load_state_dict(net.state_dict())
        self.eval().requires_grad_(False)
        self._openvino = _imported()
        self._compiled = lru_cache(_SIZES)(self._compile)

    def with_confidences(self, images: Tensor, first: int = 0) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
        found = self._compiled(tuple(images.shape), first)(images.permute(0, 2, 3, 1).contiguous().numpy())
        maps = tuple(torch.from_numpy(each).permute(0, 3, 1, 2) for each in found.to_tuple())
        levels = self.options.levels - first
        return maps[:levels], maps[levels:]

    def _compile(self, shape: tuple[int, ...], first: int) -> Any:
        """The network for images of one shape; its maps have their channels last, as images have."""
        images = torch.zeros(shape)
        self.padded(images)  # refuses what the network cannot take
        with torch.inference_mode(False), torch.no_grad(), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the tracer: sizes are constants, as they are meant to be
            example = torch.zeros(shape).permute(0, 2, 3, 1).contiguous()
            model = self._openvino.convert_model(
                _ChannelsLast(self, first), example_input=example, input=list(example.shape)
            )
        # Where a CPU has bfloat16, OpenVINO would take it by itself.
        exact = {"INFERENCE_PRECISION_HINT": "f32", "INFERENCE_NUM_THREADS": torch.get_num_threads(), "NUM_STREAMS": 1}
        return _core().compile_model(model, "CPU", exact)


class _ChannelsLast(nn.Module):
    """Features, then confidences of images (B, H, W, C), as torch computes them."""

    def __init__(self, net: FeatureNet, first: int) -> None:
        super().__init__()
        self.net, self.first = net, first

    def forward(self, images: Tensor) -> tuple[Tensor, ...]:
        features, confidences = FeatureNet.with_confidences(self.net, images.permute(0, 3, 1, 2), self.first)
        return tuple(each.permute(0, 2, 3, 1) for each in (*features, *confidences))


def _imported() -> Any:
    """The package openvino, without the one by which it would report its use."""
    sys.modules["openvino_telemetry"] = None  # type: ignore[assignment]
    try:
        import openvino
    except ModuleNotFoundError as bad:
        if bad.name != "openvino":
            raise
        raise MethodError("engine 'openvino' needs the package openvino: pip install 'relocbench[fast]'") from bad
    return openvino


@cache
def _core() -> Any:
    """The one core of OpenVINO of this process, which lives as long.

    Each core sets the alternate stack for signals (sigaltstack(2)) and gives back the one that it found. Of two cores
    that end in the order of their making, the stack of the first, which is gone by then, would remain set, and the next
    signal with a handler would end the process.
    """
    return _imported().Core()
