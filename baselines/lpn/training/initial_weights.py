"""The weights that a training starts from: random ones, a backbone's file, or another training's network."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from baselines.efficientnet_lite import IMAGENET_WEIGHTS, published_file
from baselines.lpn.backbone_weights import load_backbone
from baselines.lpn.network import LpnNetwork, copy_weights
from baselines.lpn.stages import Stage
from baselines.lpn.training.options import TrainOptions
from baselines.lpn.weights import are_weights, load_weights
from baselines.training.random_streams import generator
from relocbench.errors import MethodError

IMAGENET = "imagenet"
"""names, in place of a file, the ImageNet weights that a package holds"""
_OF_PACKAGE = "efficientnet-lite0"
"""the backbone for which a package holds them"""
_PUBLISHED = {
    "f37072fd": "ImageNet: torchvision's resnet18 IMAGENET1K_V1",
    "0676ba61": "ImageNet: torchvision's resnet50 IMAGENET1K_V1",
    "11ad3fa6": "ImageNet: torchvision's resnet50 IMAGENET1K_V2",
    "57934424": IMAGENET_WEIGHTS,
}
"""by the first digits of the SHA-256 of published files, which are part of the files' names"""


@dataclass(frozen=True)
class Start:
    """The files that a training starts from."""

    text: str
    """where the backbone's weights came from, in words"""
    digests: dict[str, str]
    """SHA-256 of each file by the option that names it; other files make another training"""


def start_of(options: TrainOptions) -> Start:
    """The files that a training with these options starts from.

    Raises:
        MethodError: a file is missing.
    """
    names = {"start": Path(options.start) if options.start else None, "backbone_weights": _backbone_file(options)}
    digests = {option: _digest(path) for option, path in names.items() if path}
    if options.start:
        about = load_weights(Path(options.start))[1]
        text = f"network '{about.configuration}' of {Path(options.start).name} (backbone: {about.backbone_start})"
    elif backbone := names["backbone_weights"]:
        text = _source_text(backbone, digests["backbone_weights"])
    else:
        text = "drawn, no ImageNet"
    return Start(text, digests)


def initial_network(options: TrainOptions, stage: Stage, number: int, classes: int) -> LpnNetwork:
    """The network of the first stage, of index ``number``, with the weights that the training starts from.

    Raises:
        MethodError: a file is damaged, or of another network.
    """
    network = random_network(options, stage, number, classes)
    if options.start:
        path = Path(options.start)
        source, _ = load_weights(path)
        if source.classes != classes:
            raise MethodError(f"trained on {source.classes} places, this data has {classes}", path)
        try:
            copy_weights(source, network)
        except ValueError as bad:
            raise MethodError(f"cannot start from it: {bad}", path) from bad
    elif backbone := _backbone_file(options):
        for _, branch in network.named_branches():
            load_backbone(backbone, branch.backbone)
    return network


def random_network(options: TrainOptions, stage: Stage, number: int, classes: int) -> LpnNetwork:
    """The network of a stage, of index ``number``, with random weights."""
    return LpnNetwork(classes, options.system.network_in(stage), generator(options.seed, number))


def _backbone_file(options: TrainOptions) -> Path | None:
    if options.backbone_weights == IMAGENET:
        if options.network.backbone != _OF_PACKAGE:
            raise MethodError(
                f"backbone_weights={IMAGENET} exists for network.backbone={_OF_PACKAGE}, not for "
                f"{options.network.backbone}, whose weights are given as a file"
            )
        return published_file()
    return Path(options.backbone_weights) if options.backbone_weights else None


def _source_text(path: Path, digest: str) -> str:
    """What the model card says of a backbone's file."""
    file = f"file {path.name}, SHA-256 {digest[:16]}"
    if are_weights(path):
        about = load_weights(path)[1]
        learnt = f"after {about.card.get('step', '?')} steps on {about.card.get('places', '?')} places"
        return f"backbone of '{about.configuration}' {learnt}, {file} (first weights there: {about.backbone_start})"
    return _PUBLISHED.get(digest[:8], file)


def _digest(path: Path) -> str:
    if not path.is_file():
        raise MethodError("no such file of weights", path)
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
