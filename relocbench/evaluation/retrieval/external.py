"""Importing rankings made elsewhere, as files of hloc's pairs (a line ``query db`` each), into a results folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from relocbench.errors import PredictionError
from relocbench.evaluation.common.predictions import adopted_run, prediction_files
from relocbench.evaluation.common.results import PREDICTIONS, write_record
from relocbench.evaluation.retrieval.answers import ANSWERS, QueryAnswer, read_task_lists, write_lists
from relocbench.evaluation.retrieval.records import RetrievalRun, RetrieverResults, SetResults
from relocbench.metrics import NEVER, rank_lists
from relocbench.retrieval import RetrievalSet, RetrievalTask


def import_rankings(
    retrieval_set: RetrievalSet, tasks: Sequence[RetrievalTask], source: Path, label: str, results: SetResults
) -> RetrieverResults:
    """Check a file for a single task, or a folder of ``TASK.txt``, and copy it to the results under ``label``.

    Images that a list leaves out are not retrieved; a query without a line has failed. A ``run.yaml`` in the folder
    must name this set's fingerprint.

    Raises:
        PredictionError: with file and line: no such file, a file for an unknown task, an unknown query or image, an
            image twice for one query, another set's fingerprint, or a label that other predictions have.
    """
    chosen, names = {task.name: task for task in tasks}, [task.name for task in retrieval_set.tasks()]
    files = prediction_files(source, chosen, names, unit="task", name=retrieval_set.name)
    known = RetrievalRun.on(retrieval_set, method=label, target=f"{PREDICTIONS}{source.resolve().name}")
    folder = results.method(label)
    record = adopted_run(folder, source / "run.yaml", known, "the record of a retrieval run")
    if source.resolve() == folder.root.resolve():
        raise PredictionError("is where the predictions of this label are kept; choose another label", source)
    checked = [(task, *answers_to(task, read_task_lists(path, task))) for task, path in files]
    for task, lists, answers in checked:
        write_lists(folder.predictions(task.name), lists)
        ANSWERS.write(folder.answers(task.name), answers)
    write_record(folder.run_yaml, record)
    return folder


def answers_to(
    task: RetrievalTask, lists: Mapping[str, Sequence[int]]
) -> tuple[dict[str, list[str]], list[QueryAnswer]]:
    """The retrieved images by name, and the row of each query.

    Args:
        lists: indices of the gallery, best first, of every query in the task's order; empty where it failed.
    """
    ranking = rank_lists(list(map(list, lists.values())), task.relevance)
    answers = [
        QueryAnswer(
            query=key,
            group=task.groups[q] if task.groups else "",
            status="ok" if ranking.answered[q] else "failed",
            positives=len(ranking.of(q)),
            ranks=tuple(int(r) + 1 for r in ranking.of(q) if r != NEVER),
            message="" if ranking.answered[q] else "not in the list",
        )
        for q, key in enumerate(lists)
    ]
    return {key: [task.gallery[i].key for i in kept] for key, kept in lists.items()}, answers
