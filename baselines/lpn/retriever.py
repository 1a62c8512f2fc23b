"""LPN and its variants as retrievers: one descriptor for each image, the concatenation of its parts.

Wang et al., "Each Part Matters", TCSVT 2021. As in the authors' evaluation, an image is resized to the training size
(bicubic, no crop), f(image) + f(mirror image) is computed, and each part is divided by its norm and by the square root
of the number of parts, so that a dot product is the mean cosine of the parts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, cast

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from baselines.device import to_device
from baselines.lpn.configurations import configuration
from baselines.lpn.descriptor import parts_of
from baselines.lpn.dmli import aligned_distance
from baselines.lpn.images import as_bytes, as_network_takes_them, resized
from baselines.lpn.network import LpnNetwork, View
from baselines.lpn.options import NetworkOptions
from baselines.lpn.weights import load_weights
from relocbench.errors import MethodError
from relocbench.retrieval import ImageView

Descriptors = NDArray[np.floating]
_TRAINED_ALIKE = ("partition", "parts", "attention", "ring_mean")
"""the network's options that distinguish the weights of one system from another's"""


class Lpn:
    """Any system of ``relocbench train lpn``; the weights file says which.

    Args:
        weights: a file of ``relocbench train lpn``.
        config: the name of a configuration that the weights must fit and whose re-ranking is used (``lpn-dmli`` takes
            the weights of ``lpn``); by default the configuration that was trained.
        batch: number of images that pass the network together.
        rerank: number of candidates of each ranking that are re-ranked by aligned parts; by default as the
            configuration says.
        device: where the network runs.

    Raises:
        MethodError: there are no weights, or the file cannot be used or holds another system.
        ConfigError: no configuration has that name.
    """

    name: ClassVar[str] = "lpn"

    def __init__(
        self,
        weights: Path | None = None,
        config: str | None = None,
        batch: Annotated[int, Field(ge=1)] = 16,
        rerank: Annotated[int, Field(ge=0)] | None = None,
        device: str = "cpu",
    ) -> None:
        if weights is None:
            raise MethodError(
                f"{self.name} needs weights: make them with `relocbench train lpn --config {config or self.name} "
                f"--dataset D --out OUT` and give --set {self.name}.weights=OUT/weights.safetensors"
            )
        network, self.about = load_weights(Path(weights))
        asked = configuration(config) if config else None
        if asked is not None:
            _check_fits(network.options, asked.network, f"'{self.about.configuration}'", asked.name, Path(weights))
        self._network = to_device(network, device).to(memory_format=torch.channels_last)
        self._device = torch.device(device)
        self._batch = batch
        top = asked.rerank_top if asked is not None else self.about.rerank_top
        self.rerank_top = top if rerank is None else rerank

    @property
    def network(self) -> LpnNetwork:
        """The network, in evaluation mode."""
        return self._network

    @property
    def info(self) -> Mapping[str, Any]:
        """What a reader of results should know: the system, its training data, and what its training started from."""
        options = self._network.options
        return {
            "configuration": self.about.configuration,
            "backbone": options.backbone,
            "backbone_start": self.about.backbone_start,
            "image_size": self.about.size,
            "trained_on": self.about.card.get("data", ""),
            "trained_views": list(self.about.views),
            "rerank_top": self.rerank_top,
        }

    def describe(self, images: Sequence[ImageView]) -> Descriptors:
        """The descriptors (N, P * D) of images, float32 of norm 1.

        Raises:
            MethodError: the network has no branch for the view of an image.
        """
        options = self._network.options
        rows = np.full((len(images), options.parts * options.width), np.nan, dtype=np.float32)
        for view in sorted({image.view for image in images}):
            self._check_view(view)
            of_view = [number for number, image in enumerate(images) if image.view == view]
            for start in range(0, len(of_view), self._batch):
                numbers = of_view[start : start + self._batch]
                squares = as_bytes([resized(images[number].image, self.about.size) for number in numbers])
                found = self._network.describe(cast(View, view), as_network_takes_them(squares, self._device))
                rows[numbers] = found.float().cpu().numpy()
        return rows

    def rerank(self, query: Descriptors, candidates: Descriptors) -> Descriptors:
        """The negative aligned distance (``dmli``) of each candidate (K, P * D) from the query (P * D,)."""
        parts = self._network.options.parts
        # The conversion copies; torch does not accept the read-only arrays of kept descriptors.
        one, others = (parts_of(torch.tensor(x), parts) for x in (query, candidates))
        return cast(Descriptors, -aligned_distance(one, others).numpy())

    def _check_view(self, view: str) -> None:
        try:
            self._network.branch(cast(View, view))
        except ValueError:
            known = ", ".join(self.about.views)
            raise MethodError(f"{self.name} has no branch for the view '{view}', it was trained on {known}") from None


class GlobalAverage(Lpn):
    """The baseline of LPN: the same network and training, with the mean over the whole map as its only part.

    Arguments are those of ``lpn``; the weights are trained by ``relocbench train lpn --config global-average``.
    """

    name: ClassVar[str] = "global-average"

    def __init__(
        self,
        weights: Path | None = None,
        batch: Annotated[int, Field(ge=1)] = 16,
        device: str = "cpu",
    ) -> None:
        super().__init__(weights, self.name, batch, 0, device)


def _check_fits(found: NetworkOptions, asked: NetworkOptions, holds: str, name: str, path: Path) -> None:
    different = [key for key in _TRAINED_ALIKE if getattr(found, key) != getattr(asked, key)]
    if different:
        raise MethodError(f"weights of {holds}, which differs from '{name}' in its {' and '.join(different)}", path)
