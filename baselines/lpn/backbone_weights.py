"""Backbone weights from a user's file, such as the ImageNet weights that torchvision publishes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from torch import Tensor

from baselines.efficientnet_lite import are_published, from_published
from baselines.lpn.backbone import Backbone
from baselines.lpn.weights import are_weights, load_weights
from baselines.torch_file import load_torch_file
from baselines.weights_file import read_tensors
from relocbench.errors import MethodError

_CLASSIFIER = ("fc.weight", "fc.bias")
_COUNTER = ".num_batches_tracked"
"""absent in older files and without influence"""


def load_backbone(path: Path, backbone: Backbone) -> None:
    """Replace the backbone's weights with those of a file, except its classifier.

    Args:
        path: a state dict of torchvision's ResNet of the same depth, or of the package that holds EfficientNet-Lite0,
            as ``.safetensors`` or written by ``torch.save``, or the weights of another LPN training, of which the
            backbone for drone and satellite is taken. Only tensors are read; pickled code is refused.
        backbone: changed in place, unless the file is refused.

    Raises:
        MethodError: the file is missing, damaged, of another kind, or of another network.
    """
    tensors = _read(path)
    if are_published(tensors):
        tensors = {f"encoder.{name}": tensor for name, tensor in from_published(tensors).items()}
    expected = backbone.state_dict()
    found = {name: tensor for name, tensor in tensors.items() if name not in _CLASSIFIER}
    for name in sorted(expected.keys() | found.keys()):
        if name.endswith(_COUNTER):
            continue
        if name not in found or name not in expected:
            what = "is missing" if name in expected else "is not part of it"
            raise MethodError(f"weights of another network than this backbone: '{name}' {what}", path)
        if found[name].shape != expected[name].shape:
            shapes = f"{tuple(found[name].shape)}, expected {tuple(expected[name].shape)}"
            raise MethodError(f"weights of another network than this backbone: '{name}' is {shapes}", path)
        if not found[name].is_floating_point() or not bool(found[name].isfinite().all()):
            raise MethodError(f"'{name}' holds values that are not finite numbers", path)
    backbone.load_state_dict({name: found.get(name, tensor).to(tensor.dtype) for name, tensor in expected.items()})


def _read(path: Path) -> Mapping[str, Tensor]:
    if not path.is_file():
        raise MethodError("no such file of weights", path)
    if are_weights(path):
        return load_weights(path)[0].branch("satellite").backbone.state_dict()
    if path.suffix == ".safetensors":
        return read_tensors(path)[1]
    try:
        content = load_torch_file(path)
    except ValueError as bad:
        expected = "expected a state dict, saved by torch.save or as .safetensors"
        raise MethodError(f"not a readable file of weights ({bad}): {expected}", path) from bad
    if (
        not isinstance(content, Mapping)
        or not all(isinstance(value, Tensor) for value in content.values())
        or not all(isinstance(name, str) for name in content)
    ):
        raise MethodError("not a state dict: expected only names and tensors", path)
    return content
