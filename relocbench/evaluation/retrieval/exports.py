"""Exporting rankings to hloc: for each query its first keyframes, best first, as lines ``query keyframe``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.fingerprint import SHORT
from relocbench.datasets.core.traversal import Traversal
from relocbench.datasets.pairs.street_places import image_key
from relocbench.errors import PredictionError, available, quoted
from relocbench.evaluation.common.folders import sets_in
from relocbench.evaluation.common.image_names import listed_name
from relocbench.evaluation.retrieval.answers import ANSWERS, read_lists
from relocbench.evaluation.retrieval.records import RetrieverResults, SetResults
from relocbench.evaluation.retrieval.rescoring import street_places
from relocbench.files import write_text


@dataclass(frozen=True)
class ExportedList:
    """The list of one pair set."""

    path: Path
    queries: int
    """that the retriever ranked"""
    unanswered: int
    """of these: without a line, since nothing was retrieved for them"""


def export_lists(
    dataset: Dataset, pair_sets: Sequence[str], out: Path, results: Path, retriever: str, top: int
) -> list[ExportedList]:
    """Write ``OUT/PAIRSET/pairs.txt`` with the first keyframes that a retriever ranked for each query.

    Images have the names that exported poses have: those of where they were imported from, or else their paths below
    the dataset's ``traversals``.

    Args:
        pair_sets: to export; none for all that the retriever ranked.
        results: the results folder that holds the rankings, or the folder of one retrieval set in it.
        retriever: the label of the rankings.
        top: number of keyframes of each query, fewer where the map has not as many.

    Raises:
        PredictionError: there are no such rankings, more than one set of them, or lists that are shorter than ``top``.
        DatasetError: an image has a name that a list cannot hold.
    """
    rankings, folder = _rankings(dataset, results, retriever)
    tasks = rankings.record.tasks
    known = [n for n in dataset.pair_set_names if n in tasks and folder.complete(n)]
    for name in pair_sets:
        if name not in known:
            raise PredictionError(f"no rankings of pair set '{name}'{available(name, known)}", folder.root)
    keep = folder.run_record().keep
    chosen = [name for name in known if not pair_sets or name in pair_sets]
    if not chosen:
        raise PredictionError("holds no rankings; relocbench evaluate-retrieval makes them", folder.root)
    for name in chosen:
        if keep is not None and keep < min(top, tasks[name].gallery):
            raise PredictionError(
                f"keeps {keep} images of each query, --top is {top}; `relocbench evaluate-retrieval --keep {top}` "
                "keeps as many",
                folder.run_yaml,
            )
    return [_export(dataset, name, folder, out / name / "pairs.txt", top) for name in chosen]


def _export(dataset: Dataset, pair_set: str, folder: RetrieverResults, out: Path, top: int) -> ExportedList:
    chosen = dataset.pair_set(pair_set)
    reference, query = dataset.traversal(chosen.reference), dataset.traversal(chosen.query)
    asked, gallery = _times(query, chosen.query_camera), _times(reference, chosen.reference_camera)
    keyframes = list(gallery.values())
    lists = read_lists(folder.predictions(pair_set), asked, {key: index for index, key in enumerate(gallery)})
    lines, unanswered, answers = [], 0, ANSWERS.read(folder.answers(pair_set))
    for answer in answers:
        if answer.query not in asked:
            raise PredictionError(f"unknown query {quoted(answer.query)}", folder.answers(pair_set))
        retrieved = lists[answer.query][:top]
        unanswered += not retrieved
        name = listed_name(query, chosen.query_camera, asked[answer.query])
        shown = [listed_name(reference, chosen.reference_camera, keyframes[index]) for index in retrieved]
        lines += [f"{name} {keyframe}\n" for keyframe in shown]
    write_text(out, "".join(lines))
    return ExportedList(out, len(answers), unanswered)


def _times(traversal: Traversal, camera: str) -> dict[str, int]:
    """The times of a camera's images, in nanoseconds, by their keys."""
    return {image_key(traversal, camera, time): time for time in traversal.timestamps(camera)}


def _rankings(dataset: Dataset, results: Path, retriever: str) -> tuple[SetResults, RetrieverResults]:
    """The only retrieval set of this dataset that has a retriever's rankings, and these. Raises PredictionError."""
    made_of = ((one, one.record) for one in sets_in(results, SetResults))
    sets = [
        one
        for one, record in made_of
        if (places := street_places(dataset, record)) is not None and places.fingerprint == record.fingerprint
    ]
    labels = {one.root: [method.label for method in one.methods()] for one in sets}
    having = [one for one in sets if retriever in labels[one.root]]
    if not having:
        known = sorted({label for of in labels.values() for label in of})
        raise PredictionError(
            f"no rankings of '{retriever}' on {dataset.name}@{dataset.fingerprint[:SHORT]}; there are "
            f"{', '.join(known) or 'none'}",
            results,
        )
    if len(having) > 1:
        raise PredictionError(
            f"there are {len(having)} sets of rankings of '{retriever}'; name the folder of one: --results "
            f"{' or '.join(str(one.root) for one in having)}",
            results,
        )
    return having[0], having[0].method(retriever)
