"""What an answer costs: memory as the evaluator measures it, and seconds on one core."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from refusals import refused
from small_dataset import ACROSS, make_small_dataset

from relocbench.datasets.core.dataset import Dataset
from relocbench.evaluation.common.results import DatasetResults, MethodResults
from relocbench.evaluation.tables.answers import Answer, read_answers
from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods
from relocbench.execution.memory import peak_resident_bytes
from relocbench.progress import Silent

MIB = 2**20
COSTLY = "trackers_for_tests:Costly"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("data") / "small", frames=4)


def evaluate(dataset: Dataset, out: Path, *methods: str, **options: object) -> list[MethodResults]:
    chosen = EvaluateOptions(dataset=dataset.root, methods=methods, out=out, pair_sets=(ACROSS,), **options)
    report = evaluate_methods(chosen, Silent())
    return [DatasetResults(report.results).method(name.partition("=")[0]) for name in methods]


def answers_of(folder: MethodResults) -> list[Answer]:
    return list(read_answers(folder.answers(ACROSS)).values())


@pytest.mark.thorough
def test_memory_is_that_of_the_methods_own_process_and_on_one_core_it_has_one(dataset: Dataset, tmp_path: Path) -> None:
    cores = os.sched_getaffinity(0)
    settings = ("large.takes_mib=200",)
    small, large = evaluate(
        dataset, tmp_path, f"small={COSTLY}", f"large={COSTLY}", set=settings, one_core=True, workers=1
    )
    peaks = [[answer.peak_memory_bytes or 0 for answer in answers_of(folder)] for folder in (small, large)]
    assert min(peaks[0]) > 10 * MIB
    assert max(peaks[0]) < 2**31
    assert min(peaks[1]) - max(peaks[0]) == pytest.approx(200 * MIB, abs=40 * MIB)
    assert large.score_record().pair_sets[ACROSS]["all"]["peak_memory_bytes"] == max(peaks[1])
    assert {json.loads(answer.info)["cores"] for answer in answers_of(small)} == {1}
    record = small.run_record()
    assert (record.one_core, record.workers, record.machine["cores"]) == (True, 1, len(cores))
    assert os.sched_getaffinity(0) == cores


def test_without_a_process_of_its_own_nothing_is_measured(dataset: Dataset, tmp_path: Path) -> None:
    (folder,) = evaluate(dataset, tmp_path, f"here={COSTLY}", workers=0)
    assert {answer.peak_memory_bytes for answer in answers_of(folder)} == {None}
    assert folder.score_record().pair_sets[ACROSS]["all"]["peak_memory_bytes"] is None
    assert not folder.run_record().one_core
    assert peak_resident_bytes(2**22 + 1) is None


def test_one_core_takes_no_other_number_of_processes(dataset: Dataset) -> None:
    with refused(ValueError):
        EvaluateOptions(dataset=dataset.root, methods=("identity",), one_core=True, workers=2)
