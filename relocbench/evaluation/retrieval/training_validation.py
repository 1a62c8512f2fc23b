"""Validation of retrievers during training: scoring them in memory on held-out places.

Every view is a query set for every other view. Images of a single view are divided by condition instead; towns may be
shown in different conditions, and a place that the other condition does not show is not asked for. Rankings use
descriptors alone, without reranking, and nothing is written.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from relocbench.arrays import Indices
from relocbench.errors import ConfigError
from relocbench.metrics import rank_descriptors, relevance_from_labels, score_retrieval, summarize_retrieval
from relocbench.retrieval import PlaceData, PlaceImage, Retriever
from relocbench.training import ValidationScores

METRICS = ("R@1", "R@5", "AP")
CHANCE, SPREAD = "chance R@1", "feature variance"
IMAGES_PER_PLACE = 4
_AT_ONCE = 64
_ALL_ALIKE = 1e-4


def hold_out(data: PlaceData, share: float, seed: int) -> tuple[PlaceData, PlaceData]:
    """Split a training set into places to learn from and held-out places to validate on.

    Args:
        data: the training set.
        share: of the places that are held out, two at least; places are renumbered on both sides.
        seed: of the choice.

    Raises:
        ConfigError: fewer than two places would be left on either side.
    """
    held = max(round(share * data.places), 2)
    if data.places - held < 2:
        raise ConfigError(
            f"{data.places} places are too few to hold {held} out for validation; give more data, or --no-validation"
        )
    order = np.random.default_rng(seed).permutation(data.places)
    return _of_places(data, np.sort(order[held:])), _of_places(data, np.sort(order[:held]))


class PlaceValidation:
    """A fixed choice of held-out places that retrievers are scored on.

    Args:
        data: the held-out places.
        views: the views that the retriever is for; images of other views are ignored.
        seed: of the choice of images.
        images_per_place: the largest number of images of each place and view, or condition.

    Raises:
        ConfigError: there are no two views to retrieve between, and no two conditions of the only one.
    """

    def __init__(
        self, data: PlaceData, views: Sequence[str], seed: int = 0, images_per_place: int = IMAGES_PER_PLACE
    ) -> None:
        of_views = [each for each in data.images if each.image.view in views]
        self._by_condition = len(views) == 1
        grouped = _condition if self._by_condition else _view
        chosen = _thinned(of_views, grouped, images_per_place, seed)
        groups = sorted({each.condition for each in of_views}) if self._by_condition else list(views)
        self._of_group = {group: [each for each in chosen if grouped(each) == group] for group in groups}
        missing = [group for group, of_group in self._of_group.items() if not of_group]
        pairs = permutations(({each.place for each in of_group} for of_group in self._of_group.values()), 2)
        if self._by_condition and of_views and not any(one & other for one, other in pairs):
            raise ConfigError(
                f"validation retrieves between views, or between conditions of view '{views[0]}': no held-out place is "
                "shown in two; give other data, or --no-validation"
            )
        if missing or len(groups) < 2:
            message = f"no held-out image of view '{[*missing, *views][0]}'"
            raise ConfigError(
                f"validation retrieves between views: {message} (there are {', '.join(data.views)}); "
                "choose others with --set views=[...], or --no-validation"
            )

    def __len__(self) -> int:
        """The number of images that each call describes."""
        return sum(map(len, self._of_group.values()))

    def __call__(self, retriever: Retriever) -> ValidationScores:
        """Describe all images and score each direction."""
        described = {group: _described(retriever, of_group) for group, of_group in self._of_group.items()}
        spread = _variance(np.concatenate(list(described.values())))
        by_direction, queries = {}, {}
        for asked_group, gallery_group in permutations(self._of_group, 2):
            asked, searched = (_places(self._of_group[group]) for group in (asked_group, gallery_group))
            shown = np.isin(asked, searched) if self._by_condition else np.ones(len(asked), dtype=bool)
            if not shown.any():
                continue
            relevance = relevance_from_labels(asked[shown], searched)
            ranking = rank_descriptors(described[asked_group][shown], described[gallery_group], relevance)
            values = summarize_retrieval(score_retrieval(ranking), METRICS).values
            chance = float(np.mean(relevance.positives / relevance.gallery))
            name = f"{asked_group}-{gallery_group}"
            by_direction[name] = {**values, CHANCE: chance, SPREAD: spread}
            queries[name] = int(shown.sum())
        together = {name: float(np.mean([values[name] for values in by_direction.values()])) for name in METRICS}
        return ValidationScores(together, by_direction, queries, tuple(_complaints(spread, described)))


def _complaints(spread: float, described: dict[str, NDArray[np.floating]]) -> list[str]:
    out = []
    undescribed = sum(int(np.sum(~np.isfinite(rows).all(axis=1))) for rows in described.values())
    if undescribed:
        out.append(f"{undescribed} of {sum(map(len, described.values()))} images have no finite descriptor")
    if spread < _ALL_ALIKE:
        out.append(f"all images are described alike (variance {spread:.1e}): nothing was learnt, or the wrong weights")
    return out


def _variance(rows: NDArray[np.floating]) -> float:
    """The mean squared distance of finite descriptors from their mean: 0 if all are alike, at most 1 at norm 1."""
    finite = rows[np.isfinite(rows).all(axis=1)].astype(np.float64)
    return float(np.sum(np.var(finite, axis=0))) if len(finite) else 0.0


def _described(retriever: Retriever, images: Sequence[PlaceImage]) -> NDArray[np.floating]:
    parts = [
        retriever.describe([replace(each.image) for each in images[start : start + _AT_ONCE]])
        for start in range(0, len(images), _AT_ONCE)
    ]  # copies, so that the images that they cache are released with them
    return np.concatenate(parts)


def _places(images: Sequence[PlaceImage]) -> Indices:
    return np.array([each.place for each in images], dtype=np.int64)


def _view(image: PlaceImage) -> str:
    return image.image.view


def _condition(image: PlaceImage) -> str:
    return image.condition


def _thinned(
    images: Sequence[PlaceImage], grouped: Callable[[PlaceImage], str], count: int, seed: int
) -> list[PlaceImage]:
    """At most ``count`` images of each place and group, in the order given."""
    kept: dict[tuple[int, str], int] = {}
    chosen = []
    for number in np.random.default_rng(seed).permutation(len(images)):
        key = (images[number].place, grouped(images[number]))
        kept[key] = kept.get(key, 0) + 1
        if kept[key] <= count:
            chosen.append(int(number))
    return [images[number] for number in sorted(chosen)]


def _of_places(data: PlaceData, places: Indices) -> PlaceData:
    anew = {int(place): number for number, place in enumerate(places)}
    images = tuple(replace(each, place=anew[each.place]) for each in data.images if each.place in anew)
    return PlaceData(len(places), images, data.described)
