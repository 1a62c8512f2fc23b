"""Batches of images by view, the same whatever the number of background processes that read them.

The batch of a step is a function of the step and the seed alone, so that a resumed training sees the same batches. The
images of each view are gone through round after round, each in a random order of its own and independently of other
views: the drone and satellite images of a batch show different places, as in the authors' loader. Paired batches (DWDR)
show the same place by drone and by satellite in each row: the first half of the rows follows the rounds of the
satellite's images, the second half those of the drone's, and the partner is drawn from the place's images.

Where the backbone is frozen, batches have cached maps of its images, each of a version drawn at random, in place of
images.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from baselines.lpn.images import as_bytes, resized
from baselines.lpn.network import VIEWS, View
from baselines.lpn.training.augmentation import augmented
from baselines.lpn.training.cached_maps import CachedMaps
from baselines.lpn.training.options import TrainOptions
from baselines.training.random_streams import shuffled_round
from relocbench.errors import ConfigError
from relocbench.retrieval import PlaceData

Batch = dict[View, tuple[Tensor, Tensor]]
"""by view: images (B, 3, S, S) uint8, or cached maps (B, C, h, w) float16, and places (B,) int64"""

_ROUND, _PARTNER, _AUGMENT, _VERSION = range(4)


class PlaceBatches(Dataset[Batch]):
    """The batch of each step.

    Raises:
        ConfigError: a view has no images, or there are fewer than two places (with both views, if batches are paired).
    """

    def __init__(self, data: PlaceData, options: TrainOptions, steps: int = 0) -> None:
        self._data, self._options, self.steps = data, options, steps
        self.maps: CachedMaps | None = None
        self._of_view = {view: self._images(view) for view in options.views}
        self._row_of = {number: row for numbers in self._of_view.values() for row, number in enumerate(numbers)}
        if len({data.images[i].place for numbers in self._of_view.values() for i in numbers}) < 2:
            raise ConfigError("places to learn from: expected two or more, with images of the requested views")
        self._of_place: dict[View, dict[int, list[int]]] = {}
        for view, numbers in self._of_view.items():
            by_place = self._of_place.setdefault(view, {})
            for number in numbers:
                by_place.setdefault(data.images[number].place, []).append(number)
        if options.paired:
            self._keep_pairs()

    @property
    def steps_per_epoch(self) -> int:
        """See ``TrainOptions.steps_per_epoch``."""
        fewest = min(len(numbers) for numbers in self._of_view.values())
        return self._options.steps_per_epoch or max(fewest // self._options.batch, 1)

    @property
    def places_by_view(self) -> dict[View, int]:
        """The number of places that each view shows."""
        return {view: len(by_place) for view, by_place in self._of_place.items()}

    @property
    def places_of_all_views(self) -> int:
        """The number of places that all views show; only from them is learnt what the views have in common."""
        return len(set.intersection(*(set(by_place) for by_place in self._of_place.values())))

    def __len__(self) -> int:
        return self.steps

    def __getitem__(self, step: int) -> Batch:
        numbers = self._numbers(step)
        return {view: self._read(view, numbers[view], step) for view in self._options.views}

    def _numbers(self, step: int) -> dict[View, list[int]]:
        """The indices of the images of a batch, by view."""
        batch = self._options.batch
        if not self._options.paired:
            return {view: [self._draw(view, step * batch + row) for row in range(batch)] for view in self._of_view}
        half = batch // 2
        led = {view: [self._draw(view, step * half + row) for row in range(half)] for view in self._pair}
        satellite, drone = self._pair
        rng = np.random.default_rng([self._options.seed, step, _PARTNER])
        chosen: dict[View, list[int]] = {
            satellite: led[satellite] + self._partners(satellite, led[drone], rng),
            drone: self._partners(drone, led[satellite], rng) + led[drone],
        }
        others = {
            view: [self._draw(view, step * batch + row) for row in range(batch)]
            for view in self._of_view
            if view not in self._pair
        }
        return {**chosen, **others}

    def _read(self, view: View, numbers: Sequence[int], step: int) -> tuple[Tensor, Tensor]:
        options = self._options
        places = torch.tensor([self._data.images[number].place for number in numbers])
        if self.maps is not None:
            rng = np.random.default_rng([options.seed, step, _VERSION, VIEWS.index(view)])
            versions = rng.integers(self.maps.versions(view), size=len(numbers))
            rows = [self._row_of[number] for number in numbers]
            return self.maps.read(view, list(zip(rows, versions.tolist(), strict=True))), places
        images = []
        for row, number in enumerate(numbers):
            rng = np.random.default_rng([options.seed, step, _AUGMENT, VIEWS.index(view), row])
            square = resized(self._data.images[number].image.read(), options.size)
            images.append(augmented(square, view, options, rng))
        return as_bytes(images), places

    def _draw(self, view: View, draw: int) -> int:
        numbers = self._of_view[view]
        _, index = shuffled_round(self._options.seed, (_ROUND, VIEWS.index(view)), draw, len(numbers))
        return numbers[index]

    def _partners(self, view: View, led: Sequence[int], rng: np.random.Generator) -> list[int]:
        of_place = self._of_place[view]
        return [int(rng.choice(of_place[self._data.images[number].place])) for number in led]

    def _images(self, view: View) -> list[int]:
        numbers = [number for number, each in enumerate(self._data.images) if each.image.view == view]
        if not numbers:
            raise ConfigError(
                f"no images of view '{view}' to learn from; available: {', '.join(self._data.views) or 'none'} "
                "(--set views=[...] says which are learnt from)"
            )
        return numbers

    _pair: tuple[View, View] = ("satellite", "drone")

    def _keep_pairs(self) -> None:
        """Drop the images of places that only one of the two views shows."""
        both = set.intersection(*(set(self._of_place[view]) for view in self._pair))
        if len(both) < 2:
            raise ConfigError("paired batches need two or more places with drone and satellite images")
        for view in self._pair:
            self._of_view[view] = [n for n in self._of_view[view] if self._data.images[n].place in both]
