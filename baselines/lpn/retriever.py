"""LPN and its variants as retrievers: one descriptor for each image, the concatenation of its parts.

Wang et al., "Each Part Matters", TCSVT 2021. As in the authors' evaluation, an image is resized to the training size
(bicubic, no crop), f(image) + f(mirror image) is computed, and each part is divided by its norm and by the square root
of the number of parts, so that a dot product is the mean cosine of the parts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, cast

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from baselines.device import to_device
from baselines.lpn.backbone_weights import move_towards_imagenet
from baselines.lpn.configurations import configuration
from baselines.lpn.descriptor import Turns, descriptors, over_symmetries, parts_of
from baselines.lpn.dmli import aligned_distance
from baselines.lpn.images import as_bytes, as_network_takes_them, resized
from baselines.lpn.network import LpnNetwork, View
from baselines.lpn.options import NetworkOptions
from baselines.lpn.shared_maps import SharedMaps
from baselines.lpn.view_means import ViewMeans, unlabelled_files
from baselines.lpn.weights import load_weights
from relocbench.errors import MethodError
from relocbench.retrieval import Descriptors, ImageView

TrainedShare = Annotated[float, Field(ge=0, le=1)]
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
        turns: 4 describes an image by the sum over its quarter turns, for aerial images of any direction.
        unlabelled: folder with a folder for each view (``street``, ``drone``, ``satellite``) of images whose place need
            not be known; descriptors are then relative to the mean of their view.
        trained_share: where the backbone stands between ImageNet's weights (0), from which its training must have
            started, and the trained ones (1): less than 1 keeps more of what it knew of photographs.
        shared_blocks: keep the maps of images after ``layer3`` and so many blocks of ``layer4`` for other retrievers
            of this process that give it, too, and have the same weights up to there, as those that were trained behind
            one frozen backbone; null: keep none.
        device: where the network runs.

    Raises:
        MethodError: there are no weights, or the file cannot be used or holds another system; there is no folder of
            unlabelled images; the training did not start from the weights that ``trained_share`` leads to.
        ConfigError: no configuration has that name.
    """

    name: ClassVar[str] = "lpn"

    def __init__(
        self,
        weights: Path | None = None,
        config: str | None = None,
        batch: Annotated[int, Field(ge=1)] = 16,
        rerank: Annotated[int, Field(ge=0)] | None = None,
        turns: Turns = 1,
        unlabelled: Path | None = None,
        trained_share: TrainedShare = 1.0,
        shared_blocks: Annotated[int, Field(ge=0)] | None = None,
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
        move_towards_imagenet(network, self.about, trained_share, Path(weights))
        self._trained_share = trained_share
        self._network = to_device(network, device).to(memory_format=torch.channels_last)
        self._device = torch.device(device)
        self._shared = None if shared_blocks is None else SharedMaps(self._network, shared_blocks)
        self._batch = batch
        top = asked.rerank_top if asked is not None else self.about.rerank_top
        self.rerank_top = top if rerank is None else rerank
        self._turns: Turns = turns
        self._means = ViewMeans(Path(unlabelled), self._described, network.options.parts) if unlabelled else None

    @classmethod
    def files(cls, weights: Path | None = None, unlabelled: Path | None = None, **_: Any) -> dict[str, Path]:
        """The files that decide the answers besides parameters; with others, results are not continued."""
        return ({"weights": Path(weights)} if weights else {}) | unlabelled_files(unlabelled)

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
            "turns": self._turns,
            "centred": self._means is not None,
            "trained_share": self._trained_share,
        }

    def describe(self, images: Sequence[ImageView]) -> Descriptors:
        """The descriptors (N, P * D) of images, float32 of norm 1.

        Raises:
            MethodError: the network has no branch for the view of an image, or there are no unlabelled images of it.
        """
        rows = self._described(images)
        return rows if self._means is None else self._means.centred(rows, [image.view for image in images])

    def _described(self, images: Sequence[ImageView]) -> Descriptors:
        options = self._network.options
        rows = np.full((len(images), options.parts * options.width), np.nan, dtype=np.float32)
        for view in sorted({image.view for image in images}):
            self._check_view(view)
            of_view = [number for number, image in enumerate(images) if image.view == view]
            for start in range(0, len(of_view), self._batch):
                numbers = of_view[start : start + self._batch]
                squares = as_bytes([resized(images[number].image, self.about.size) for number in numbers])
                found = self._descriptors(cast(View, view), as_network_takes_them(squares, self._device))
                rows[numbers] = found.float().cpu().numpy()
        return rows

    def _descriptors(self, view: View, images: Tensor) -> Tensor:
        if self._shared is None:
            return self._network.describe(view, images, self._turns)
        return descriptors(over_symmetries(partial(self._shared.embed, view), images, self._turns))

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
        turns: Turns = 1,
        unlabelled: Path | None = None,
        trained_share: TrainedShare = 1.0,
        device: str = "cpu",
    ) -> None:
        super().__init__(weights, self.name, batch, 0, turns, unlabelled, trained_share, device=device)


def _check_fits(found: NetworkOptions, asked: NetworkOptions, holds: str, name: str, path: Path) -> None:
    different = [key for key in _TRAINED_ALIKE if getattr(found, key) != getattr(asked, key)]
    if different:
        raise MethodError(f"weights of {holds}, which differs from '{name}' in its {' and '.join(different)}", path)
