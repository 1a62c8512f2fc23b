"""Importing rankings made elsewhere, as files of hloc's pairs (a line ``query db`` each), into a results folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from relocbench.errors import PredictionError, available
from relocbench.evaluation.common.results import PREDICTIONS, adopted_run, write_record
from relocbench.evaluation.retrieval.answers import QueryAnswer, read_lists, write_answers, write_lists
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
    files = _files(retrieval_set, tasks, source)
    known = RetrievalRun(
        method=label,
        target=f"{PREDICTIONS}{source.resolve().name}",
        dataset=retrieval_set.name,
        fingerprint=retrieval_set.fingerprint,
        question=getattr(retrieval_set, "content_id", ""),
    )
    record = adopted_run(source / "run.yaml", known, "the record of a retrieval run")
    folder = results.method(label)
    if source.resolve() == folder.root.resolve():
        raise PredictionError("is where the predictions of this label are kept; choose another label", source)
    if folder.run_yaml.exists() and folder.run_record().target != record.target:
        before = folder.run_record().target
        raise PredictionError(f"holds predictions of '{before}'; choose another label", folder.run_yaml)
    checked = [(task, *_checked(task, path)) for task, path in files]
    for task, lists, answers in checked:
        write_lists(folder.predictions(task.name), lists)
        write_answers(folder.answers(task.name), answers)
    write_record(folder.run_yaml, record)
    return folder


def _files(
    retrieval_set: RetrievalSet, tasks: Sequence[RetrievalTask], source: Path
) -> list[tuple[RetrievalTask, Path]]:
    """The tasks that are answered, each with its file."""
    if source.is_file():
        if len(tasks) != 1:
            names = ", ".join(task.name for task in tasks)
            raise PredictionError(f"one file answers one task, and there are {names}; choose one: --pair-set", source)
        return [(tasks[0], source)]
    if not source.is_dir():
        raise PredictionError("no such file or folder; expected lines 'query db', or a folder of TASK.txt", source)
    files = {path.stem: path for path in sorted(source.glob("*.txt"))}
    if not files:
        raise PredictionError("holds no list of retrieved images (TASK.txt)", source)
    known = [task.name for task in retrieval_set.tasks()]
    for name, path in files.items():
        if name not in known:
            raise PredictionError(f"no task '{name}' in {retrieval_set.name}{available(name, known)}", path)
    chosen = [(task, files[task.name]) for task in tasks if task.name in files]
    if not chosen:
        raise PredictionError(f"answers none of {', '.join(task.name for task in tasks)}", source)
    return chosen


def _checked(task: RetrievalTask, path: Path) -> tuple[dict[str, list[str]], list[QueryAnswer]]:
    queries = {image.key: index for index, image in enumerate(task.queries)}
    gallery = {image.key: index for index, image in enumerate(task.gallery)}
    return answers_to(task, read_lists(path, queries, gallery))


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
