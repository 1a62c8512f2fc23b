"""The task of retrievers in a submission: lists of images of a retrieval set, or of a blind export of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from relocbench.datasets.checks.faults import Findings
from relocbench.datasets.pairs.street_places import StreetPlaces
from relocbench.errors import PredictionError
from relocbench.evaluation.common.blind_names import BlindName
from relocbench.evaluation.common.results import MethodResults, RunRecord
from relocbench.evaluation.retrieval.answers import write_answers, write_lists
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
    check_blind_only,
    files_of_units,
    run_beside,
    withheld,
)
from relocbench.evaluation.submission.rankings import TaskLists, read_ranked
from relocbench.evaluation.submission.resolving import ResolvedRetrievalSet, resolve_lists
from relocbench.files import read_bytes, write_bytes
from relocbench.progress import Reporter


@dataclass(frozen=True, eq=False)
class RankedDataset(AnsweredDataset):
    """The lists of a retriever for one dataset."""

    record_file = SET_FILE
    units: Sequence[TaskLists]
    resolved: ResolvedRetrievalSet

    @property
    def blind_export(self) -> BlindName | None:
        return None if self.resolved.blind is None else self.resolved.blind.name

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
            write_answers(row.answers(of.name), answers)
        return row

    def run_record(self, fields: dict[str, Any]) -> RunRecord:
        opened = self.resolved.images
        return RetrievalRun(**fields, dataset=opened.name, fingerprint=opened.fingerprint, question=opened.content_id)

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
        resolved = resolve_lists(folder.name, answered.fingerprint, self._sets)
        check_blind_only(folder, self._options, is_blind=resolved.blind is not None)
        if resolved.blind is not None:
            name, fingerprint = folder.name, answered.fingerprint
        else:
            name, fingerprint = resolved.images.name, resolved.images.fingerprint
        run_beside(folder, RetrievalRun, name, fingerprint, findings)
        tasks = {task.name: task for task in resolved.images.tasks()}
        files = files_of_units(folder, "task", list(tasks), "lists of images (TASK.txt)", findings)
        units = [read_ranked(files[n], t, resolved, findings) if n in files else TaskLists(t) for n, t in tasks.items()]
        return RankedDataset(folder, units, resolved)
