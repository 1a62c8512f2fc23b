"""The task of trackers in a submission: poses of the pairs of a dataset, or of a blind export of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from relocbench.datasets.checks.faults import Findings
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import PoseLine, write_pose_lines
from relocbench.evaluation.common.blind_names import BlindName
from relocbench.evaluation.common.opening import open_for_evaluation
from relocbench.evaluation.common.results import (
    DatasetResults,
    MethodResults,
    RunRecord,
    dataset_results,
    write_dataset_record,
)
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
from relocbench.evaluation.submission.folder import answer_files
from relocbench.evaluation.submission.poses import PairSetAnswers, read_answered
from relocbench.evaluation.submission.resolving import ResolvedDataset, resolve
from relocbench.evaluation.submission.suspicions import same_answers
from relocbench.evaluation.tables.answers import write_answers
from relocbench.evaluation.tracking.score import read_predictions, score_method
from relocbench.progress import Reporter


@dataclass(frozen=True, eq=False)
class TrackedDataset(AnsweredDataset):
    """The answers of a tracker to one dataset."""

    record_file = "dataset.yaml"
    units: Sequence[PairSetAnswers]
    resolved: ResolvedDataset

    @property
    def blind_export(self) -> BlindName | None:
        return None if self.resolved.blind is None else self.resolved.blind.name

    def home(self, results: Path) -> Path:
        dataset = self.resolved.dataset
        for of in self.units:
            if not of.pair_set.has_truth:
                raise withheld(of.name, dataset.root)
        return dataset_results(results, dataset).root

    def write_row(self, home: Path, made: Path, label: str) -> MethodResults:
        row = MethodResults(made / label)
        write_dataset_record(DatasetResults(made), self.resolved.dataset)
        for of in self.units:
            if of.given:
                lines = [PoseLine(*key, of.poses[key]) for key in of.pair_set.by_key if key in of.poses]
                write_pose_lines(row.predictions(of.name), lines)
                write_answers(row.answers(of.name), of.complete_answers())
        return row

    def run_record(self, fields: dict[str, Any]) -> RunRecord:
        dataset = self.resolved.dataset
        return RunRecord(
            **fields,
            dataset=dataset.name,
            fingerprint=dataset.fingerprint,
            question=dataset.content_id,
            answered_on=self.resolved.answered_on,
        )

    def score(self, row: MethodResults) -> None:
        score_method(self.resolved.dataset, self.resolved.dataset.pair_sets(), row)

    def same_as_others(self, home: Path, label: str) -> Iterator[str]:
        given = sum(of.answered for of in self.units)
        for row in DatasetResults(home).methods() if home.is_dir() and given else ():
            if row.label != label:
                same = sum(
                    same_answers(of.poses, read_predictions(row.predictions(of.name), of.pair_set))
                    for of in self.units
                    if row.predictions(of.name).exists()
                )
                if 2 * same > given:
                    yield f"{same} of {given} answers are those of '{row.label}'"


class Tracking(SubmissionTask):
    """Datasets whose pairs are answered."""

    def __init__(self, root: Path, options: SubmissionOptions, reporter: Reporter) -> None:
        self._options = options
        self._datasets: list[Dataset] = [open_for_evaluation(path, root) for path in options.datasets]

    def read(self, folder: Path, answered: Answered, findings: Findings) -> TrackedDataset:
        run = run_beside(folder, RunRecord, folder.name, answered.fingerprint, findings)
        resolved = resolve(folder.name, answered.fingerprint, "" if run is None else run.question, self._datasets)
        check_blind_only(folder, self._options, is_blind=resolved.blind is not None)
        names = resolved.dataset.pair_set_names
        files = files_of_units(folder, "pair set", names, "predictions (PAIRSET.txt)", findings)
        for path in answer_files(folder, ".csv"):
            if path.stem not in files:
                findings.fault("has no predictions (.txt) of that name beside it", path)
        units = [
            read_answered(files[s.name], s, resolved, findings) if s.name in files else PairSetAnswers(s)
            for s in resolved.dataset.pair_sets()
        ]
        return TrackedDataset(folder, units, resolved)
