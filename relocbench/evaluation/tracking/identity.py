"""The identity pose where there are no images: what the tracker `identity` would answer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PoseLine, write_pose_lines
from relocbench.datasets.core.writer import versions
from relocbench.errors import PredictionError
from relocbench.evaluation.common.results import DatasetResults, MethodResults, RunRecord, write_record
from relocbench.evaluation.tables.answers import Answer, write_answers
from relocbench.methods import MethodSpec

IDENTITY = "identity"
IDENTITY_TARGETS = (IDENTITY, "baselines.identity:Identity")
"""the names of the tracker that answers the identity pose"""


def is_identity(spec: MethodSpec) -> bool:
    """Whether a method answers the identity pose, whatever its label."""
    return spec.target in IDENTITY_TARGETS


def run_identity(
    dataset: Dataset, pair_sets: Sequence[PairSet], spec: MethodSpec, results: DatasetResults
) -> MethodResults:
    """Write the identity pose as the answer to every pair.

    Raises:
        PredictionError: the folder holds predictions of another method.
    """
    folder = results.method(spec.label)
    if folder.run_yaml.exists() and (target := folder.run_record().target) not in IDENTITY_TARGETS:
        raise PredictionError(f"holds predictions of '{target}'; choose another label", folder.run_yaml)
    for pair_set in pair_sets:
        folder.root.mkdir(parents=True, exist_ok=True)
        write_pose_lines(folder.predictions(pair_set.name), [PoseLine(*p.key, np.eye(4)) for p in pair_set.evaluated])
        write_answers(folder.answers(pair_set.name), [Answer(*p.key, "ok") for p in pair_set.evaluated])
    record = RunRecord(
        method=spec.label,
        target=spec.target,
        dataset=dataset.name,
        fingerprint=dataset.fingerprint,
        question=dataset.content_id,
        versions=versions(),
        isolated=True,  # no method ran, and so none beside the truth
    )
    write_record(folder.run_yaml, record)
    return folder
