"""A floor for trained retrievers: what ImageNet's weights alone make of two images of one place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from baselines.device import to_device
from baselines.efficientnet_lite import IMAGENET_WEIGHTS, published_file
from baselines.lpn.backbone import EfficientNetBackbone
from baselines.lpn.backbone_weights import load_backbone
from baselines.lpn.descriptor import descriptors, with_mirror_image
from baselines.lpn.images import as_bytes, as_network_takes_them, resized
from relocbench.retrieval import ImageView


class ImageNetAverage:
    """The mean over the last map of EfficientNet-Lite0 with ImageNet's weights, of the image and its mirror image.

    Nothing is learnt of places. The configurations ``global-average`` and ``street`` of ``relocbench train lpn`` start
    from this network.

    Args:
        size: pixels; images are resized to size x size.
        batch: number of images that pass the network together.
        device: where the network runs.

    Raises:
        MethodError: the package that holds the weights is not installed (the extra ``pretrained``).
    """

    name: ClassVar[str] = "imagenet-average"

    def __init__(
        self,
        size: Annotated[int, Field(ge=32)] = 256,
        batch: Annotated[int, Field(ge=1)] = 16,
        device: str = "cpu",
    ) -> None:
        network = EfficientNetBackbone(1, torch.Generator().manual_seed(0))
        load_backbone(published_file(), network)
        self._network = to_device(network.eval(), device).to(memory_format=torch.channels_last)
        self._mean, self._deviation = (
            torch.tensor(values, device=device)[:, None, None] for values in (network.mean, network.deviation)
        )
        self._size, self._batch, self._device = size, batch, torch.device(device)

    @property
    def info(self) -> Mapping[str, Any]:
        """What a reader of results should know: the weights, and the size of images."""
        return {"backbone_start": IMAGENET_WEIGHTS, "image_size": self._size}

    @torch.inference_mode()
    def describe(self, images: Sequence[ImageView]) -> NDArray[np.floating]:
        """The descriptors (N, 320) of images, float32 of norm 1."""
        rows = np.zeros((len(images), self._network.channels["layer4"]), dtype=np.float32)
        for start in range(0, len(images), self._batch):
            squares = as_bytes([resized(image.image, self._size) for image in images[start : start + self._batch]])
            x = (as_network_takes_them(squares, self._device) - self._mean) / self._deviation
            means = with_mirror_image(lambda each: self._network(each).mean((2, 3)), x)
            rows[start : start + self._batch] = descriptors(means[:, None]).cpu().numpy()
        return rows
