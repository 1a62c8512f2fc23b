"""Place-recognition networks as retrievers, with the weights of their authors or of a training of the user's own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from baselines.device import device_named, to_device
from baselines.place_networks import published
from baselines.place_networks.backbone import BackboneName
from baselines.place_networks.gem import load_gem
from baselines.place_networks.images import ImageSize, network_input
from baselines.place_networks.megaloc import load_megaloc
from baselines.place_networks.netvlad import load_netvlad
from baselines.place_networks.network import PlaceNetwork
from baselines.published_weights import PublishedWeights
from relocbench.errors import MethodError
from relocbench.retrieval import ImageView
from relocbench.weights import PublishedFile

Batch = Annotated[int, Field(ge=1)]
Size = int | str | None


class PlaceRetriever(PublishedWeights):
    """Describes images by a network; their dot products are cosine similarities.

    An image that is too small for the network has no descriptor.

    Raises:
        MethodError: the size is none, or too small for the network; or the device cannot be used.
    """

    def __init__(self, network: PlaceNetwork, size: Size, batch: int, device: str, multiple: int = 1) -> None:
        self.size = ImageSize.of(size)
        self._network, self._batch, self._multiple = network, batch, multiple
        self._device = device_named(device)
        if self.size.width is not None and not network.takes(*self.size.resized(1, 1, multiple)):
            raise MethodError(f"{self.name}: images of {self.size} are too small, the network needs {network.least}")
        to_device(network, device)

    @property
    def info(self) -> Mapping[str, Any]:
        """What a reader of results should know."""
        return {
            "backbone": self._network.on,
            "dimensions": self._network.dimensions,
            "image_size": str(self.size),
        }

    @torch.inference_mode()
    def describe(self, images: Sequence[ImageView]) -> NDArray[np.floating]:
        """The descriptors (N, D) of images, float32 of norm 1; NaN for an image that is too small."""
        rows = np.full((len(images), self._network.dimensions), np.nan, dtype=np.float32)
        by_shape: dict[tuple[int, int], list[int]] = {}
        for number, image in enumerate(images):
            by_shape.setdefault((image.image.shape[0], image.image.shape[1]), []).append(number)
        for shape, alike in by_shape.items():
            size = self.size.resized(*shape, self._multiple)
            if not self._network.takes(*size):
                continue
            for start in range(0, len(alike), self._batch):
                numbers = alike[start : start + self._batch]
                given = network_input([images[number].image for number in numbers], size, self._device)
                rows[numbers] = self._network(given).cpu().numpy()
        return rows


class CosPlace(PlaceRetriever):
    """CosPlace (Berton et al., CVPR 2022): a backbone, generalised-mean pooling, a linear layer.

    Args:
        weights: file of the network's weights, as its authors or their training save it, or as safetensors; by default
            the authors' file of ``backbone`` and ``dimensions`` in torch's cache, ``$TORCH_HOME/hub/checkpoints``.
        backbone: of the weights; by default what the file holds, and without a file ResNet50.
        dimensions: of a descriptor; by default what the file holds, and without a file 2048.
        size: that images are resized to: WIDTHxHEIGHT, a number of pixels of the shorter side, or null for none.
        batch: number of images that pass the network together.
        device: where the network runs.

    Raises:
        MethodError: the weights are missing or of another network, the size is none, or the device cannot be used.
    """

    name: ClassVar[str] = "cosplace"

    def __init__(
        self,
        *,
        weights: Path | None = None,
        backbone: BackboneName | None = None,
        dimensions: int | None = None,
        size: Size = None,
        batch: Batch = 8,
        device: str = "cpu",
    ) -> None:
        path = self.files(weights, backbone=backbone, dimensions=dimensions)["weights"]
        network = load_gem(path, self.name)
        held = network.kind.name, network.dimensions
        if (backbone or held[0], dimensions or held[1]) != held:
            asked = f"{backbone or 'any backbone'} with {dimensions or 'any number of'} dimensions"
            raise MethodError(f"weights on {held[0]} with {held[1]} dimensions, expected {asked}", path)
        super().__init__(network, size, batch, device)

    @classmethod
    def file(cls, backbone: BackboneName | None = None, dimensions: int | None = None, **_: Any) -> PublishedFile:
        return published.cosplace(backbone or "ResNet50", dimensions or 2048)


class EigenPlaces(CosPlace):
    """EigenPlaces (Berton et al., ICCV 2023): CosPlace's network, trained for changes of viewpoint.

    Its parameters are those of :class:`CosPlace`.
    """

    name: ClassVar[str] = "eigenplaces"

    @classmethod
    def file(cls, backbone: BackboneName | None = None, dimensions: int | None = None, **_: Any) -> PublishedFile:
        return published.eigenplaces(backbone or "ResNet50", dimensions or 2048)


class NetVlad(PlaceRetriever):
    """NetVLAD (Arandjelovic et al., CVPR 2016), in the layout of pytorch-NetVlad and Patch-NetVLAD.

    Args:
        weights: file of the network's weights, as pytorch-NetVlad, Patch-NetVLAD or the Deep Visual Geo-localization
            Benchmark save it, or as safetensors; by default Patch-NetVLAD's file of ``model`` in torch's cache,
            ``$TORCH_HOME/hub/checkpoints``.
        model: which of Patch-NetVLAD's files: the training data and the number of dimensions after whitening.
        size: that images are resized to: WIDTHxHEIGHT, a number of pixels of the shorter side, or null for none.
        batch: number of images that pass the network together.
        device: where the network runs.

    Raises:
        MethodError: the weights are missing or of another network, the size is none, or the device cannot be used.
    """

    name: ClassVar[str] = "netvlad"

    def __init__(
        self,
        *,
        weights: Path | None = None,
        model: published.NetVladModel = "pitts_WPCA4096",
        size: Size = "640x480",
        batch: Batch = 8,
        device: str = "cpu",
    ) -> None:
        super().__init__(load_netvlad(self.files(weights, model=model)["weights"]), size, batch, device)

    @classmethod
    def file(cls, model: published.NetVladModel = "pitts_WPCA4096", **_: Any) -> PublishedFile:
        return published.NETVLAD[model]


class MegaLoc(PlaceRetriever):
    """MegaLoc (Berton and Masone, CVPR Workshops 2025): DINOv2 and SALAD's aggregation by optimal transport.

    Args:
        weights: file of the network's weights, as its authors publish it; by default ``megaloc.safetensors`` in torch's
            cache, ``$TORCH_HOME/hub/checkpoints``.
        size: that images are resized to: WIDTHxHEIGHT, a number of pixels of the shorter side, or null for none; sides
            are then rounded to the nearest multiples of 14.
        batch: number of images that pass the network together.
        device: where the network runs.

    Raises:
        MethodError: the weights are missing or of another network, the size is none or too small, or the device cannot
            be used.
    """

    name: ClassVar[str] = "megaloc"
    authors_file: ClassVar[PublishedFile] = published.MEGALOC

    def __init__(
        self, *, weights: Path | None = None, size: Size = "322x322", batch: Batch = 8, device: str = "cpu"
    ) -> None:
        network = load_megaloc(self.files(weights)["weights"])
        super().__init__(network, size, batch, device, network.patch)
