"""Which dataset a submission answers: the dataset itself, a copy of it, or a blind export of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.fingerprint import SHORT
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey
from relocbench.errors import PredictionError, available
from relocbench.evaluation.common.blind_names import BlindName, blind_name
from relocbench.evaluation.retrieval.blind_export import BlindImages
from relocbench.evaluation.retrieval.opening import OpenedSet
from relocbench.evaluation.tracking.blind_keys import BlindKeys
from relocbench.retrieval import RetrievalTask


@dataclass(frozen=True, eq=False)
class ResolvedDataset:
    """A dataset whose pairs are answered, and what they are called in the answers."""

    dataset: Dataset
    blind: BlindKeys | None = None
    """of answers to a blind export of the dataset"""
    answered_on: str = ""
    """of answers to a copy of the dataset: its fingerprint"""

    def keys(self, pair_set: PairSet) -> dict[PairKey, PairKey]:
        """The evaluated pairs: as answers name them -> their times in the dataset."""
        return self.blind.pairs(pair_set) if self.blind is not None else {key: key for key in pair_set.by_key}

    def why_unknown(self, pair_set: PairSet, key: PairKey) -> str:
        """Why a pair is not an evaluated one, in words."""
        unknown = f"unknown pair {key[0]} {key[1]}"
        if self.blind is not None:
            if key in pair_set.by_key:
                return (
                    f"{unknown}: these are real timestamps, and the card names a blind export, whose keys are expected"
                )
            return f"{unknown}: not keys of the blind export {self.blind.name}; expected one of its pairs"
        if (key[1], key[0]) in pair_set.by_key:
            return f"{unknown}: keyframe and query are exchanged"
        return f"{unknown}; expected one of the {len(pair_set.evaluated)} pairs of the dataset"


@dataclass(frozen=True, eq=False)
class ResolvedRetrievalSet:
    """A retrieval set whose queries are answered, and what its images are called in the answers."""

    images: OpenedSet
    blind: BlindImages | None = None
    """of answers to a blind export of the set"""

    def queries(self, task: RetrievalTask) -> dict[str, str]:
        """The queries of a task: as answers name them -> their names in the set."""
        return self.blind.queries(task) if self.blind is not None else {one.key: one.key for one in task.queries}

    def gallery(self, task: RetrievalTask) -> dict[str, str]:
        """The gallery of a task, in the same way."""
        return self.blind.gallery(task) if self.blind is not None else {one.key: one.key for one in task.gallery}


def other_fingerprint(name: str, claimed: str, true: str) -> str:
    """What is wrong with the fingerprint that a card has of a dataset, in words."""
    if claimed and true.startswith(claimed.lower()):
        return f"the fingerprint of '{name}' is to be given in full, as its dataset.yaml has it: {true}"
    return f"the fingerprint of '{name}' is {claimed[:SHORT]}, the dataset given has {true[:SHORT]}"


def resolve(name: str, fingerprint: str, question: str, datasets: Sequence[Dataset]) -> ResolvedDataset:
    """The dataset that answers belong to.

    Args:
        name: of the dataset or blind export, as the card has it.
        fingerprint: the same.
        question: of the dataset, where a run.yaml beside the answers says it; empty elsewhere.
        datasets: those that were given; of a blind export the dataset that it was made of, or the export itself.

    Raises:
        PredictionError: without a place: it is none of them, or another version or export of one.
    """
    own = next((d for d in datasets if d.name == name), None)
    blind = blind_name(name)
    source = None if blind is None else next((d for d in datasets if d.name == blind.dataset), None)
    if own is not None and own.fingerprint != fingerprint:
        if source is None and question and own.content_id == question:
            return ResolvedDataset(own, answered_on=fingerprint)
        raise PredictionError(other_fingerprint(name, fingerprint, own.fingerprint))
    if blind is not None and source is not None:
        keys = BlindKeys(source, blind.edition)
        _check_export(blind, keys.name, source.fingerprint)
        return ResolvedDataset(source, keys)
    if own is not None:
        return ResolvedDataset(own)
    raise PredictionError(f"no dataset '{name}' was given (--dataset){available(name, [d.name for d in datasets])}")


def resolve_lists(name: str, fingerprint: str, sets: Mapping[str, tuple[str, OpenedSet]]) -> ResolvedRetrievalSet:
    """The retrieval set that lists belong to.

    Args:
        name: of the dataset or blind export, as the card has it.
        fingerprint: the same.
        sets: those that were given, by what a card calls them, each with the fingerprint that the card names; of a
            blind export the dataset that it was made of, or the export itself.

    Raises:
        PredictionError: without a place: it is none of them, or another version or export of one.
    """
    blind = blind_name(name)
    source = next((images for _, images in sets.values() if blind is not None and images.name == blind.dataset), None)
    if name in sets and sets[name][0] != fingerprint:
        raise PredictionError(other_fingerprint(name, fingerprint, sets[name][0]))
    if blind is not None and source is not None:
        keys = BlindImages(source, blind.edition)
        _check_export(blind, keys.name, source.fingerprint)
        return ResolvedRetrievalSet(source, keys)
    if name in sets:
        return ResolvedRetrievalSet(sets[name][1])
    if blind is not None:
        of = ", ".join(images.name for _, images in sets.values())
        message = f"an export of '{blind.dataset}', and the datasets given are {of} (along drives, --radius chooses)"
        raise PredictionError(f"no dataset '{name}' was given (--dataset): it is {message}")
    raise PredictionError(f"no dataset '{name}' was given (--dataset){available(name, sets)}")


def _check_export(named: BlindName, own: BlindName, fingerprint: str) -> None:
    """Raise PredictionError unless a name is that of the export that a dataset gives."""
    if named != own:
        raise PredictionError(
            f"'{named}' is another export than that of {own.dataset}@{fingerprint[:SHORT]}, whose edition "
            f"{own.edition} is '{own}'"
        )
