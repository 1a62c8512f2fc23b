"""The batches of a training, read ahead by background processes; the same whatever their number."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeVar

import cv2
import torch
from torch.utils.data import DataLoader, Dataset

Batch = TypeVar("Batch")

_PREFETCH = 2


def batches_in_order(batches: Dataset[Batch], first: int, last: int, workers: int, pin_memory: bool) -> Iterator[Batch]:
    """The batches of the steps from ``first`` to ``last``, excluding it, in order.

    Args:
        batches: the batch of each step.
        first: a step, counted from 0.
        last: the first step that is left out.
        workers: number of background processes; 0: read in this process.
        pin_memory: whether to place batches in page-locked memory, for a GPU.
    """
    loader = DataLoader(
        batches,
        batch_size=None,
        sampler=range(first, last),
        num_workers=workers,
        worker_init_fn=_one_thread,
        prefetch_factor=_PREFETCH if workers else None,
        multiprocessing_context="spawn" if workers else None,
        pin_memory=pin_memory,
        generator=torch.Generator().manual_seed(0),  # the loader draws a seed that nothing uses
    )
    return iter(loader)


def _one_thread(_: int) -> None:
    """Leave the cores to the training; the loader limits torch's threads in the same way."""
    cv2.setNumThreads(1)
