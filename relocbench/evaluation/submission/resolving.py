"""Which dataset a submission answers: the dataset itself, a copy of it, or a blind export of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.fingerprint import SHORT
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey
from relocbench.datasets.core.salt import Salt
from relocbench.errors import ConfigError, PredictionError, available
from relocbench.evaluation.common.blind_names import KIND, BlindName, blind_name, is_unsalted
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

    @property
    def name(self) -> str:
        """Of the dataset, also where a blind export of it is answered."""
        return self.dataset.name

    def shown(self, pair_set: PairSet) -> str:
        """What a pair set is called in the answers."""
        return pair_set.name if self.blind is None else self.blind.pair_set(pair_set)

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

    @property
    def name(self) -> str:
        """Of the set, also where a blind export of it is answered."""
        return self.images.name

    def shown(self, task: RetrievalTask) -> str:
        """What a task is called in the answers."""
        return task.name if self.blind is None else self.blind.tasks[task.name]

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


def resolve(
    name: str, fingerprint: str, question: str, datasets: Sequence[Dataset], salt: Salt | None
) -> ResolvedDataset:
    """The dataset that answers belong to.

    Args:
        name: of the dataset or blind export, as the card has it.
        fingerprint: the same.
        question: of the dataset, where a run.yaml beside the answers says it; empty elsewhere.
        datasets: those that were given; of a blind export the dataset that it was made of, or the export itself.
        salt: of blind exports of the datasets.

    Raises:
        PredictionError: without a place: it is none of them, or another version of one.
        ConfigError: it is a blind export, and the salt is missing, or is another one.
    """
    own = next((d for d in datasets if d.name == name), None)
    if own is not None and own.fingerprint != fingerprint:
        if question and own.content_id == question:
            return ResolvedDataset(own, answered_on=fingerprint)
        raise PredictionError(other_fingerprint(name, fingerprint, own.fingerprint))
    blind = blind_name(name)
    sources = [d for d in datasets if blind is not None and d.file.made_by.get("kind") != KIND]
    if blind is not None and sources and (own is None or salt is not None):
        for source in sources:
            keys = BlindKeys(source, _needed(salt, blind), blind.edition)
            if keys.name == blind:
                return ResolvedDataset(source, keys)
        if own is None:
            raise _no_export(blind, [d.name for d in sources], _needed(salt, blind))
    if own is None:
        raise _not_given(name, [d.name for d in datasets])
    return ResolvedDataset(own)


def resolve_lists(
    name: str, fingerprint: str, sets: Mapping[str, tuple[str, OpenedSet]], salt: Salt | None
) -> ResolvedRetrievalSet:
    """The retrieval set that lists belong to.

    Args:
        name: of the dataset or blind export, as the card has it.
        fingerprint: the same.
        sets: those that were given, by what a card calls them, each with the fingerprint that the card names; of a
            blind export the dataset that it was made of, or the export itself.
        salt: of blind exports of the sets.

    Raises:
        PredictionError: without a place: it is none of them, or another version of one.
        ConfigError: it is a blind export, and the salt is missing, or is another one.
    """
    if name in sets and sets[name][0] != fingerprint:
        raise PredictionError(other_fingerprint(name, fingerprint, sets[name][0]))
    blind = blind_name(name)
    sources = [images for _, images in sets.values() if blind is not None and images.source is not None]
    if blind is not None and sources and (name not in sets or salt is not None):
        for source in sources:
            keys = BlindImages(source, _needed(salt, blind), blind.edition)
            if keys.name == blind:
                return ResolvedRetrievalSet(source, keys)
        if name not in sets:
            of = [f"{images.name} (along drives, --radius chooses)" for images in sources]
            raise _no_export(blind, of, _needed(salt, blind))
    if name not in sets:
        raise _not_given(name, list(sets))
    return ResolvedRetrievalSet(sets[name][1])


def _not_given(name: str, known: Sequence[str]) -> PredictionError:
    if is_unsalted(name):
        why = "whose keys anybody can compute; make the export again, with --salt-file, and have that answered"
        return PredictionError(f"'{name}' is a blind export of an earlier version, {why}")
    return PredictionError(f"no dataset '{name}' was given (--dataset){available(name, known)}")


def _needed(salt: Salt | None, blind: BlindName) -> Salt:
    if salt is None:
        raise ConfigError(f"'{blind}' is a blind export: give the salt that it was made with, --salt-file FILE")
    return salt


def _no_export(blind: BlindName, of: Sequence[str], salt: Salt) -> ConfigError:
    why = "it was made with another salt, or of another dataset or version"
    return ConfigError(f"'{blind}' is no export of {', '.join(of)} with this salt: {why}", salt.path)
