"""The task of retrievers in a submission: lists of images of a retrieval set, or of a blind export of it.

Every fault of a file is found, with its line.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from relocbench.datasets.checks.faults import Findings
from relocbench.datasets.pairs.street_places import StreetPlaces
from relocbench.errors import PredictionError, quoted
from relocbench.evaluation.common.results import MethodResults, RunRecord
from relocbench.evaluation.retrieval.answers import ANSWERS, list_lines, write_lists
from relocbench.evaluation.retrieval.external import answers_to
from relocbench.evaluation.retrieval.opening import OpenedSet, open_set
from relocbench.evaluation.retrieval.records import (
    SET_FILE,
    RetrievalRun,
    RetrieverResults,
    SetResults,
    set_results,
    write_set_record,
)
from relocbench.evaluation.retrieval.score import score_retriever
from relocbench.evaluation.submission.card import Answered
from relocbench.evaluation.submission.contract import (
    AnsweredDataset,
    SubmissionOptions,
    SubmissionTask,
    UnitAnswers,
    check_blind_only,
    files_of_units,
    run_beside,
    withheld,
)
from relocbench.evaluation.submission.resolving import ResolvedRetrievalSet, resolve_lists
from relocbench.files import read_bytes, write_bytes
from relocbench.progress import Reporter
from relocbench.retrieval import RetrievalTask

_LINE_BYTES, _SPARE_BYTES = 512, 2**16
_REAL = ": this is a real name, and the card names a blind export, whose keys are expected"
MOST_IMAGES = 10_000
"""of one query's list"""


@dataclass
class TaskLists(UnitAnswers):
    """What was submitted for a retrieval task."""

    task: RetrievalTask
    lists: dict[str, list[str]] = field(default_factory=dict)
    """retrieved images of each answered query, best first, by their names in the set"""

    @property
    def name(self) -> str:
        return self.task.name

    @property
    def asked(self) -> int:
        return len(self.task.queries)

    @property
    def answered(self) -> int:
        return len(self.lists)

    def oddities(self) -> Iterator[str]:
        lists = list(self.lists.values())
        if lists:
            yield "no answer has seconds"
        if len(lists) > 1 and all(one == lists[0] for one in lists):
            yield "all queries have one list"


def read_ranked(path: Path, task: RetrievalTask, resolved: ResolvedRetrievalSet, findings: Findings) -> TaskLists:
    """Read ``TASK.txt``, a line ``query db`` for each retrieved image; keys of a blind export become names again."""
    out = TaskLists(task, given=True)
    queries, gallery = resolved.queries(task), resolved.gallery(task)
    names = {image.key for image in (*task.queries, *task.gallery)} if resolved.blind is not None else set()
    most = _SPARE_BYTES + _LINE_BYTES * len(queries) * min(len(gallery), MOST_IMAGES)
    with findings.catching():
        seen: set[tuple[str, str]] = set()
        for number, words in list_lines(path, most):
            if len(words) != 2:
                out.invalid += 1
                findings.fault(f"expected 'query db', found {len(words)} words", path, number)
                continue
            query, image = words
            if query not in queries:
                out.unknown += 1
                message = f"unknown query {quoted(query)}; queries are such as '{next(iter(queries))}'"
                findings.fault(message + (_REAL if query in names else ""), path, number)
            elif image not in gallery:
                out.unknown += 1
                message = (
                    f"image {quoted(image)} is not in the gallery, whose images are such as '{next(iter(gallery))}'"
                )
                findings.fault(message + (_REAL if image in names else ""), path, number)
            elif (query, image) in seen:
                out.duplicate += 1
                findings.fault(f"image {quoted(image)} occurs again for the query {quoted(query)}", path, number)
            else:
                seen.add((query, image))
                out.lists.setdefault(queries[query], []).append(gallery[image])
    return out


@dataclass(frozen=True, eq=False)
class RankedDataset(AnsweredDataset):
    """The lists of a retriever for one dataset."""

    record_file = SET_FILE
    units: Sequence[TaskLists]
    resolved: ResolvedRetrievalSet

    def home(self, results: Path) -> Path:
        opened = self.resolved.images
        if opened.source is None:
            raise withheld(opened.name, self.folder)
        return set_results(results, opened).root

    def write_row(self, home: Path, made: Path, label: str) -> MethodResults:
        row, given = RetrieverResults(made / label), [of for of in self.units if of.given]
        if (home / SET_FILE).exists():  # other tasks of the same set may have been evaluated
            write_bytes(made / SET_FILE, read_bytes(home / SET_FILE, "a record", PredictionError))
        write_set_record(SetResults(made), self.resolved.images, [of.task for of in given])
        for of in given:
            gallery = {image.key: index for index, image in enumerate(of.task.gallery)}
            lists = {q.key: [gallery[key] for key in of.lists.get(q.key, ())] for q in of.task.queries}
            kept, answers = answers_to(of.task, lists)
            write_lists(row.predictions(of.name), kept)
            ANSWERS.write(row.answers(of.name), answers)
        return row

    def run_record(self, fields: dict[str, Any]) -> RunRecord:
        opened = self.resolved.images
        return RetrievalRun.on(opened, **fields)

    def score(self, row: MethodResults) -> None:
        score_retriever(SetResults(row.root.parent).record, RetrieverResults(row.root))


class Retrieval(SubmissionTask):
    """Retrieval sets whose queries are answered, by what a card calls them."""

    def __init__(self, root: Path, options: SubmissionOptions, reporter: Reporter) -> None:
        self._options = options
        self._sets: dict[str, tuple[str, OpenedSet]] = {}
        for path in options.datasets:
            opened = open_set(path, root, options.retrieval, reporter)
            named = opened.source.dataset if isinstance(opened.source, StreetPlaces) else opened
            self._sets[named.name] = named.fingerprint, opened

    def read(self, folder: Path, answered: Answered, findings: Findings) -> RankedDataset:
        resolved = resolve_lists(folder.name, answered.fingerprint, self._sets, self._options.salt)
        check_blind_only(folder, self._options, is_blind=resolved.blind is not None)
        if resolved.blind is not None:
            name, fingerprint = folder.name, answered.fingerprint
        else:
            name, fingerprint = resolved.images.name, resolved.images.fingerprint
        run_beside(folder, RetrievalRun, name, fingerprint, findings)
        tasks = {resolved.shown(task): task for task in resolved.images.tasks()}
        files = files_of_units(folder, "task", list(tasks), "lists of images (TASK.txt)", findings)
        units = [read_ranked(files[n], t, resolved, findings) if n in files else TaskLists(t) for n, t in tasks.items()]
        return RankedDataset(folder, units, resolved)
