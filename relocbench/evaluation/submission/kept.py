"""The card that a results folder keeps of a row that was submitted."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from relocbench.errors import PredictionError
from relocbench.evaluation.common.folders import folders_with
from relocbench.evaluation.common.results import (
    DatasetResults,
    MethodResults,
    RunRecord,
)
from relocbench.evaluation.retrieval.records import SET_FILE, RetrieverResults, SetResults
from relocbench.evaluation.submission.card import CARD, Card, card_bytes, load_card


@dataclass(frozen=True)
class KeptCard:
    """A card, as it was read and as it was handed in."""

    card: Card
    data: bytes


def kept_card(folder: Path, run: RunRecord) -> KeptCard | None:
    """The card of a method's folder; None for a row that was not submitted.

    Raises:
        PredictionError: the card is missing, or is not the one that was handed in.
    """
    if not run.submitted:
        return None
    data = card_bytes(folder)
    if hashlib.sha256(data).hexdigest() != run.submitted.get(CARD):
        raise PredictionError("is not the card that came with the predictions; put the original back", folder / CARD)
    return KeptCard(load_card(folder / CARD), data)


def rows_of(results: Path) -> Iterator[MethodResults | RetrieverResults]:
    """The folders of all trackers and retrievers in a results folder. Raises PredictionError for an invalid label."""
    for root in folders_with("dataset.yaml", results):
        yield from DatasetResults(root).methods()
    for root in folders_with(SET_FILE, results):
        yield from SetResults(root).methods()
