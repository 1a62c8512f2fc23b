"""Batches of cropped and augmented pairs, the same whatever the number of background processes that read them.

The batch of a step is a function of the step and the seed alone, so that a resumed training sees the same batches.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from baselines.gn_net.training.augmentation import augment
from baselines.gn_net.training.crops import Pixels, cut_pair, mirrored
from baselines.gn_net.training.drawing import EvenDraw
from baselines.gn_net.training.options import TrainOptions
from baselines.gn_net.training.posed import cut_posed, mirrored_pose, not_posed, posed_pair
from relocbench.arrays import Image
from relocbench.training import TrainingData, TrainingPair

_CUT, _REF, _QUERY = range(3)


class Batch(NamedTuple):
    """The B pairs of one step."""

    images_ref: Tensor
    """(B, 3, S, S) float32 in [0, 1]"""
    images_query: Tensor
    """(B, 3, S, S)"""
    u_ref: Tensor
    """(B, N, 2) float32 pixels"""
    u_query: Tensor
    """(B, N, 2)"""
    u_still: Tensor
    """(B, N, 2): where the query would show the points if its camera had not moved"""
    mask: Tensor
    """(B, N) bool: rows that hold a correspondence, of which a pair may have fewer than N"""
    X_ref: Tensor
    """(B, N, 3) float32: the points in the first image's camera, metres; without pose loss all ones"""
    known: Tensor
    """(B, N) bool: rows whose depth is known; without pose loss none is"""
    intrinsics: Tensor
    """(B, 4) float32: fx, fy, cx, cy of the query's crop, pixels"""
    T_query_ref: Tensor
    """(B, 4, 4) float32: the true pose"""

    def to(self, device: torch.device) -> Batch:
        """The batch on another device."""
        return Batch(*(tensor.to(device, non_blocking=True) for tensor in self))


class Batches(Dataset[Batch]):
    """The batch of each step."""

    def __init__(self, data: TrainingData, options: TrainOptions) -> None:
        self._data = data
        self._options = options
        self._draw = EvenDraw(data, options.seed, options.shares)

    @property
    def combinations(self) -> int:
        """The number of combinations of conditions, among which pairs are drawn evenly."""
        return self._draw.combinations

    def __len__(self) -> int:
        return self._options.steps

    def __getitem__(self, step: int) -> Batch:
        parts = [self._sample(step, place) for place in range(self._options.batch)]
        return Batch(*(torch.stack(tensors) for tensors in zip(*parts, strict=True)))

    def _sample(self, step: int, place: int) -> tuple[Tensor, ...]:
        options = self._options

        def random(what: int) -> np.random.Generator:
            return np.random.default_rng([options.seed, step, place, what])

        rng = random(_CUT)
        index = self._draw[step * options.batch + place]
        pair = _accurate(self._data.load(index), options.max_sigma)
        swapped = bool(rng.random() < options.swap)
        image_ref, image_query, u_ref, u_query = _swapped(pair, swapped)
        posed = posed_pair(self._data, index, u_ref, swapped) if options.loss.pose.weight > 0 else not_posed(len(u_ref))
        if rng.random() < options.mirror:
            posed = mirrored_pose(posed, image_query.shape[1])
            (image_ref, u_ref), (image_query, u_query) = mirrored(image_ref, u_ref), mirrored(image_query, u_query)
        cut = cut_pair(image_ref, image_query, u_ref, u_query, options.crop, options.scale, options.apart, rng)
        images = [
            augment(image.astype(np.float32) / np.float32(255), options.augmentation, random(what))
            for image, what in ((cut.image_ref, _REF), (cut.image_query, _QUERY))
        ]
        chosen = rng.permutation(len(cut.u_ref))[: options.points]
        u = np.zeros((3, options.points, 2), dtype=np.float32)
        for row, pixels in zip(u, (cut.u_ref, cut.u_query, cut.u_still), strict=True):
            row[: len(chosen)] = pixels[chosen]
        mask = torch.arange(options.points) < len(chosen)
        posed = cut_posed(posed, cut)
        X_ref, known = np.ones((options.points, 3), dtype=np.float32), np.zeros(options.points, dtype=bool)
        X_ref[: len(chosen)], known[: len(chosen)] = posed.X_ref[chosen], posed.known[chosen]
        geometry = (X_ref, known, posed.intrinsics.astype(np.float32), posed.T_query_ref.astype(np.float32))
        first, second = (torch.from_numpy(np.ascontiguousarray(x.transpose(2, 0, 1))) for x in images)
        return first, second, *torch.from_numpy(u), mask, *map(torch.from_numpy, geometry)


def _accurate(pair: TrainingPair, max_sigma: float) -> TrainingPair:
    """The pair without correspondences of larger sigma; those of unknown sigma are kept."""
    if pair.sigma_px is None:
        return pair
    kept = ~(pair.sigma_px > max_sigma)
    return replace(pair, u_ref=pair.u_ref[kept], u_query=pair.u_query[kept], sigma_px=pair.sigma_px[kept])


def _swapped(pair: TrainingPair, swap: bool) -> tuple[Image, Image, Pixels, Pixels]:
    if swap:
        return pair.image_query, pair.image_ref, pair.u_query, pair.u_ref
    return pair.image_ref, pair.image_query, pair.u_ref, pair.u_query
