"""The tasks of pipelines on a dataset: place recognition by pairs, with the true poses that answers are judged by."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.pairs.street_places import time_of_key
from relocbench.errors import ConfigError
from relocbench.evaluation.common.results import rounded_median
from relocbench.evaluation.relocalization.records import PipelineSet, PipelineTask
from relocbench.evaluation.relocalization.truth import MapTruth
from relocbench.evaluation.retrieval.opening import OpenedSet
from relocbench.progress import Reporter
from relocbench.retrieval import RetrievalTask

_VERSION = 1
"""to be incremented when the task of the same dataset changes"""


@dataclass(frozen=True, eq=False)
class PipelineTasks:
    """The chosen tasks of pipelines on one dataset."""

    asked: OpenedSet
    """the tasks as retrievers see them"""
    truth: Mapping[str, MapTruth]
    record: PipelineSet

    @property
    def names(self) -> list[str]:
        return [task.name for task in self.asked.chosen]


def pipeline_tasks(dataset: Dataset, opened: OpenedSet, reporter: Reporter) -> PipelineTasks:
    """The tasks whose pairs have true poses; the others are reported.

    Args:
        opened: place recognition by pairs on the dataset.

    Raises:
        ConfigError: no task is left.
    """
    known = tuple(task for task in opened.chosen if dataset.pair_set(task.name).has_truth)
    for task in opened.chosen:
        if task not in known:
            reporter.note(f"{task.name}: ground truth is withheld, poses cannot be judged; left out")
    if not known:
        raise ConfigError("no pair set with ground truth is left to evaluate", dataset.root)
    truth = {task.name: _truth(dataset, task) for task in known}
    text = json.dumps({"dataset": dataset.fingerprint, "version": _VERSION, "task": "relocalization"}, sort_keys=True)
    record = PipelineSet(
        name=f"{dataset.name}.relocalization",
        dataset=dataset.name,
        dataset_fingerprint=dataset.fingerprint,
        fingerprint=hashlib.sha256(text.encode()).hexdigest(),
        splits=dict(dataset.splits),
        tasks={task.name: _record(dataset, task, truth[task.name]) for task in known},
    )
    return PipelineTasks(replace(opened, chosen=known), truth, record)


def _truth(dataset: Dataset, task: RetrievalTask) -> MapTruth:
    times = ([time_of_key(image.key) for image in side] for side in (task.queries, task.gallery))
    return MapTruth(dataset, dataset.pair_set(task.name), *times)


def _record(dataset: Dataset, task: RetrievalTask, truth: MapTruth) -> PipelineTask:
    pair_set = truth.pair_set
    traversal = dataset.traversal(pair_set.reference)
    images = len(dataset.traversal(pair_set.query).timestamps(pair_set.query_camera))
    metres, degrees = truth.reach
    return PipelineTask(
        queries=len(task.queries),
        gallery=len(task.gallery),
        pairs=len(pair_set.pairs),
        rejected=len(pair_set.rejected),
        images_without_pair=images - len(task.queries),
        condition_query=task.condition_query,
        condition_gallery=task.condition_gallery,
        reach_m=round(metres, 6),
        reach_deg=round(degrees, 6),
        unposed_keyframes=sum(time not in traversal.poses for time in truth.keyframe_times),
        truth_spread_m=rounded_median(truth.spread),
        median_sigma_translation_m=rounded_median([p.calibrated_sigmas[0] for p in pair_set.pairs]),
        median_sigma_rotation_deg=rounded_median([p.calibrated_sigmas[1] for p in pair_set.pairs]),
    )
