"""How the seconds of a pipeline part into those of its two stages, by the rankings that lie beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.fingerprint import SHORT
from relocbench.evaluation.retrieval.answers import read_answers
from relocbench.evaluation.retrieval.records import RetrieverResults
from relocbench.leaderboard.relocalization.board import Pipeline


def retrieval_seconds(pipeline: Pipeline, task: str) -> Array | None:
    """(Q,) seconds of the pipeline's retriever for each query, NaN where they are not known.

    Returns:
        None where nothing took seconds (the oracle), or where the rankings do not lie in the results folder, or are
        others than those that the pipeline started from.
    """
    ran = pipeline.run.retriever_run
    if ran is None:
        return None
    of_set = pipeline.folder.root.parents[1] / f"{ran.dataset}@{ran.fingerprint[:SHORT]}"
    results = RetrieverResults(of_set / pipeline.run.retriever)
    if not results.run_yaml.exists() or not results.complete(task):
        return None
    now = results.run_record()
    if (now.target, now.parameters, now.files, now.seed) != (ran.target, ran.parameters, ran.files, ran.seed):
        return None
    seconds = {Path(answer.query).stem: answer.seconds for answer in read_answers(results.answers(task))}
    out = np.full(len(pipeline.answers[task]), np.nan)
    for row, answer in enumerate(pipeline.answers[task]):
        known = seconds.get(str(answer.query_timestamp_ns))
        if known is not None and answer.seconds is not None and known <= answer.seconds + 1e-6:
            out[row] = known
    return out
