"""Writing the files of one pipeline: poses, rows, run record and scores."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from relocbench import version
from relocbench.datasets.core.pairfile import write_pose_lines
from relocbench.errors import PredictionError
from relocbench.evaluation.common.results import first_crash, write_record
from relocbench.evaluation.relocalization.answers import PIPELINE
from relocbench.evaluation.relocalization.basin import Basins
from relocbench.evaluation.relocalization.pipeline import Retrieved, Tracked, pipeline_answers
from relocbench.evaluation.relocalization.records import (
    PipelineResults,
    PipelineRun,
    PipelineScores,
)
from relocbench.evaluation.relocalization.score import summary
from relocbench.evaluation.relocalization.tasks import PipelineTasks
from relocbench.files import sha256_file


def write_pipeline_results(
    folder: PipelineResults,
    run: PipelineRun,
    tasks: PipelineTasks,
    retrieved: Mapping[str, Sequence[Retrieved]],
    tracked: Mapping[str, Tracked],
    basins: Basins,
) -> PipelineResults:
    """Choose, judge and score answers and write the results; tasks of earlier runs are kept.

    No method runs here: the same rankings and answers give the same bytes.

    Args:
        retrieved, tracked: by task.

    Raises:
        PredictionError: the folder holds a pipeline on another set.
    """
    _drop_other(folder, run, tasks)
    before = folder.scores() if folder.scores_yaml.exists() else None
    hashes, scores = (dict(before.answers), dict(before.tasks)) if before else ({}, {})
    used = dict(before.basins) if before else {}
    for name in tasks.names:
        truth, record = tasks.truth[name], tasks.record.tasks[name]
        conditions = record.condition_gallery, record.condition_query
        basin = basins.of(run.tracker, *conditions, truth.reach)
        rows, lines = pipeline_answers(truth, retrieved[name], tracked[name], run.top, basin)
        write_pose_lines(folder.predictions(name), lines)
        PIPELINE.write(folder.answers(name), rows)
        hashes[name] = sha256_file(folder.answers(name))
        used[name] = basin
        scores[name] = summary(rows, run.top)
    write_record(folder.run_yaml, run)
    record_of_scores = PipelineScores(
        relocbench=version.__version__,
        run=sha256_file(folder.run_yaml),
        answers=dict(sorted(hashes.items())),
        basins=dict(sorted(used.items())),
        tasks=dict(sorted(scores.items())),
    )
    write_record(folder.scores_yaml, record_of_scores)
    return folder


def crashed_queries(folder: PipelineResults, names: Sequence[str]) -> list[tuple[str, str]]:
    """The label and a message if a method broke, rather than failed, on any query; else nothing."""
    rows = [row for name in names for row in PIPELINE.read(folder.answers(name))]
    crashed = [(row.query_timestamp_ns, row.message) for row in rows if row.status == "error"]
    return first_crash(folder.label, f"no answer to {len(crashed)} of {len(rows)} queries for an error", crashed)


def _drop_other(folder: PipelineResults, run: PipelineRun, tasks: PipelineTasks) -> None:
    """Remove the results of a pipeline of the same labels that was made differently: results are never mixed.

    Mixed answers of either half are refused elsewhere; what remains is a half that was made anew
    (``--overwrite always``) under the same label since.
    """
    if not folder.run_yaml.exists():
        return
    before = folder.run_record()
    if before.fingerprint != run.fingerprint:
        raise PredictionError(
            f"was made for a set with the fingerprint {before.fingerprint}, and this one has {run.fingerprint}",
            folder.run_yaml,
        )
    if _made(before) == _made(run):
        return
    for path in [*folder.root.glob("*.csv"), *folder.root.glob("*.txt"), folder.scores_yaml]:
        path.unlink(missing_ok=True)


def _made(run: PipelineRun) -> list[object]:
    return [
        None if half is None else (half.target, half.parameters, half.files)
        for half in (run.retriever_run, run.tracker_run)
    ]
