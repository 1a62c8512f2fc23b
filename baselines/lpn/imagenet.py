"""A baseline for trained retrievers: what ImageNet's weights alone make of two images of one place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from baselines.device import to_device
from baselines.efficientnet_lite import IMAGENET_WEIGHTS, published_file
from baselines.lpn.backbone import EfficientNetBackbone
from baselines.lpn.backbone_weights import load_backbone
from baselines.lpn.descriptor import Turns, descriptors, over_symmetries
from baselines.lpn.images import as_bytes, as_network_takes_them, resized
from baselines.lpn.rings import Rings
from baselines.lpn.view_means import ViewMeans, unlabelled_files
from relocbench.retrieval import ImageView


class ImageNetAverage:
    """The mean over the last map of EfficientNet-Lite0 with ImageNet's weights, of the image and its mirror image.

    Nothing is learnt of places. The configurations ``global-average`` and ``street`` of ``relocbench train lpn`` start
    from this network, and with four parts the others do.

    Args:
        size: pixels; images are resized to size x size.
        parts: number of LPN's square rings, each of which has a mean of its own.
        turns: 4 describes an image by the sum over its quarter turns, for aerial images of any direction.
        unlabelled: folder with a folder for each view (``street``, ``drone``, ``satellite``) of images whose place need
            not be known; descriptors are then relative to the mean of their view.
        batch: number of images that pass the network together.
        device: where the network runs.

    Raises:
        MethodError: the package that holds the weights is not installed (the extra ``pretrained``), or there is no
            folder of unlabelled images.
    """

    name: ClassVar[str] = "imagenet-average"

    def __init__(
        self,
        size: Annotated[int, Field(ge=32)] = 256,
        parts: Annotated[int, Field(ge=1)] = 1,
        turns: Turns = 1,
        unlabelled: Path | None = None,
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
        self._rings, self._turns = Rings(parts, "ring"), turns
        self._means = ViewMeans(Path(unlabelled), self._described, parts) if unlabelled else None

    @classmethod
    def files(cls, unlabelled: Path | None = None, **_: Any) -> dict[str, Path]:
        """The files that decide the answers besides parameters; with others, results are not continued."""
        return unlabelled_files(unlabelled)

    @property
    def info(self) -> Mapping[str, Any]:
        """What a reader of results should know: the weights, and the size of images."""
        return {
            "backbone_start": IMAGENET_WEIGHTS,
            "image_size": self._size,
            "turns": self._turns,
            "centred": self._means is not None,
        }

    def describe(self, images: Sequence[ImageView]) -> NDArray[np.floating]:
        """The descriptors (N, P * 320) of images, float32 of norm 1.

        Raises:
            MethodError: there are no unlabelled images of a view, or one cannot be read.
        """
        rows = self._described(images)
        return rows if self._means is None else self._means.centred(rows, [image.view for image in images])

    @torch.inference_mode()
    def _described(self, images: Sequence[ImageView]) -> NDArray[np.floating]:
        rows = np.zeros((len(images), self._rings.parts * self._network.channels["layer4"]), dtype=np.float32)
        for start in range(0, len(images), self._batch):
            squares = as_bytes([resized(image.image, self._size) for image in images[start : start + self._batch]])
            x = (as_network_takes_them(squares, self._device) - self._mean) / self._deviation
            means = over_symmetries(lambda each: self._rings(self._network(each)).features, x, self._turns)
            rows[start : start + self._batch] = descriptors(means).cpu().numpy()
        return rows
