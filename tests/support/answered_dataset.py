"""Results of a method on a dataset, without running any: ``from answered_dataset import add_answers``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import Pair, PoseLine, write_pose_lines
from relocbench.evaluation.common.results import RunRecord, dataset_results
from relocbench.evaluation.tables.answers import ANSWERS, Answer
from relocbench.evaluation.tracking.score import score_method
from relocbench.files import dump_yaml, write_text

Answering = Callable[[Pair], Array | None]


def add_answers(
    results: Path, dataset: Dataset, label: str, target: str, answer: Answering, *, message: str = "", info: str = ""
) -> None:
    """Write predictions, answers and scores of a method that gives ``answer`` to each pair, None where it fails.

    Args:
        message: what it says where it fails.
        info: what it says of every answer, JSON.
    """
    folder = dataset_results(results, dataset).method(label)
    record = RunRecord(method=label, target=target, dataset=dataset.name, fingerprint=dataset.fingerprint)
    write_text(folder.run_yaml, dump_yaml(record.model_dump(mode="json")))
    for pair_set in dataset.pair_sets():
        poses = {pair.key: answer(pair) for pair in pair_set.evaluated}
        lines = [PoseLine(*key, pose) for key, pose in poses.items() if pose is not None]
        write_pose_lines(folder.predictions(pair_set.name), lines)
        failed = [Answer(*key, "failed", 0.5, None, message, info) for key, pose in poses.items() if pose is None]
        answered = [Answer(*key, "ok", 0.5, 0.9, "", info) for key, pose in poses.items() if pose is not None]
        ANSWERS.write(folder.answers(pair_set.name), sorted([*failed, *answered], key=lambda one: one.key))
    score_method(dataset, dataset.pair_sets(), folder)
