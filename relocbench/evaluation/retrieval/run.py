"""Phase one: run a retriever on every task and keep what it retrieved.

The unit of work is a task: its two files appear whole when it is done, and a killed run loses the task in progress.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from relocbench.errors import DatasetError, PredictionError
from relocbench.evaluation.common.options import Overwrite
from relocbench.evaluation.common.results import write_record
from relocbench.evaluation.common.runs import Asking, clear, made_by, now, refuse_mixture, refuse_submitted
from relocbench.evaluation.retrieval.answers import ANSWERS, QueryAnswer, write_lists
from relocbench.evaluation.retrieval.describe import (
    AnonymousViews,
    Describer,
    descriptor_variance,
    nothing,
    shared_images,
)
from relocbench.evaluation.retrieval.handles import RetrieverHandle, retriever_handle
from relocbench.evaluation.retrieval.ranking import rank_task
from relocbench.evaluation.retrieval.records import (
    RetrievalRun,
    RetrieverResults,
    SetResults,
    TaskRun,
    write_set_record,
)
from relocbench.evaluation.tables.schema import STATUSES
from relocbench.execution import default_workers
from relocbench.files import locked_folder
from relocbench.methods import MethodSpec
from relocbench.retrieval import RetrievalSet, RetrievalTask, Retriever

BROKEN = STATUSES[2]


@dataclass(frozen=True, eq=False)
class TaskAnswers:
    """A retriever's answers to one task."""

    answers: list[QueryAnswer]
    lists: dict[str, list[str]]
    """query -> retrieved images, best first"""
    run: TaskRun


def run_retriever(
    retrieval_set: RetrievalSet,
    tasks: Sequence[RetrievalTask],
    spec: MethodSpec,
    results: SetResults,
    keep: int | None,
    asking: Asking,
) -> RetrieverResults:
    """Run the tasks that a retriever has not answered yet.

    Args:
        keep: number of retrieved images that are kept of each query; None for all.
        asking: ``failed`` repeats whole tasks. The method runs in a worker process or, with 0 workers, in this one.

    Raises:
        MethodError: the retriever cannot be made, or reports that it cannot go on.
        PredictionError: the folder holds answers of this label that were made differently, or is in use.
        DatasetError: an image cannot be read.
    """
    folder = results.method(spec.label)
    record = RetrievalRun.on(retrieval_set, keep=keep, **made_by(spec, default_workers(), asking.seed))
    refuse_submitted(folder)
    run, anew = asking.run.hiding(results.root), asking.overwrite == "always"
    todo = [task for task in tasks if anew or _open(folder, task, asking.overwrite)]

    def new_session() -> RetrieverSession:
        return RetrieverSession(lambda: retriever_handle(spec, run), todo, asking.seed, retrieval_set.fingerprint)

    session = None
    if anew:
        session = new_session()  # a method that cannot be made must not cost answers
        clear(folder, [task.name for task in tasks])
    refuse_mixture(folder, record, work_left=bool(todo))
    _refuse_other_lists(folder, record)
    if not todo:
        return folder
    session = session or new_session()  # before a folder is made, which a method that cannot be made would leave empty
    folder.root.mkdir(parents=True, exist_ok=True)
    write_set_record(results, retrieval_set, tasks)
    with locked_folder(folder.root, PredictionError):
        if not folder.run_yaml.exists():
            write_record(folder.run_yaml, record)
        # Each query counts twice: when it is described, and when it is ranked.
        steps = sum(2 * len(task.queries) + len(task.gallery) for task in todo)
        with asking.reporter.stage(f"{spec.label} on {retrieval_set.name}", steps) as advance:
            for task in todo:
                done = session.ask(task, keep, advance)
                write_lists(folder.predictions(task.name), done.lists)
                ANSWERS.write(folder.answers(task.name), done.answers)
                so_far = folder.run_record()
                tasks_done = {**so_far.tasks, task.name: done.run}
                so_far = so_far.model_copy(update={"tasks": dict(sorted(tasks_done.items())), "info": session.info})
                write_record(folder.run_yaml, so_far.model_copy(update={"end": now()}))
    return folder


class RetrieverSession:
    """Runs one retriever on several tasks; images that they share are described once, unless the retriever is fitted.

    Args:
        make: returns the retriever, constructed; called again for each gallery that it is fitted to.
        tasks: all tasks that it will run on.
        seed: for ``fit``.
        salt: of the digests that the retriever sees in place of keys; no method knows it.
    """

    def __init__(
        self, make: Callable[[], Retriever | RetrieverHandle], tasks: Sequence[RetrievalTask], seed: int, salt: str = ""
    ) -> None:
        self._make = make
        self._seed = seed
        self._salt = salt
        self._shared = shared_images(tasks)
        self._describer = self._new()
        self._fitted_on: list[str] | None = None
        """keys of the gallery that the retriever is fitted to"""

    @property
    def info(self) -> dict[str, Any]:
        """The retriever's own ``info`` as plain values; empty if it has none."""
        return self._describer.handle.info

    def _new(self) -> Describer:
        return Describer(self._make(), self._shared, self._salt)

    def ask(
        self, task: RetrievalTask, keep: int | None, advance: Callable[[int], None] = lambda count: None
    ) -> TaskAnswers:
        """Fit the retriever if it can be fitted, describe both sides, and rank. Raises MethodError and DatasetError."""
        fit_seconds, crash = None, ""
        keys = [image.key for image in task.gallery]
        if self._describer.handle.fits and self._fitted_on != keys:
            if self._fitted_on is not None:
                self._describer = self._new()
            _, seconds, crash = self._describer.handle.fit(AnonymousViews(task.gallery, self._salt), self._seed)
            fit_seconds, crash = round(seconds, 3), f"fit: {crash}" if crash else ""
            self._fitted_on = keys
        describer = self._describer
        again = describer.knows(task.gallery)
        if crash:
            self._fitted_on = []  # so that it is fitted again for the next task
            queries, gallery = nothing(len(task.queries), crash), nothing(len(task.gallery), crash)
            advance(len(task.queries) + len(task.gallery))
        else:
            gallery = describer(task.gallery, advance)
            queries = describer(task.queries, advance)
        rows = list(rank_task(task, queries, gallery, describer.handle, keep, advance))
        variance = descriptor_variance(queries, gallery)
        run = TaskRun(
            dimensions=None if variance is None else gallery.values.shape[1],
            descriptor_bytes=None if variance is None else gallery.values[0].nbytes,
            queries_described=int(queries.finite.sum()),
            gallery_described=int(gallery.finite.sum()),
            descriptor_variance=None if variance is None else round(variance, 6),
            rerank_top=describer.handle.rerank_top,
            gallery_seconds=None if again else round(float(gallery.seconds.sum()), 3),
            fit_seconds=fit_seconds,
            peak_memory_bytes=describer.handle.peak_memory_bytes,
        )
        answers = [_with_gallery_failure(answer, gallery.messages) for answer, _ in rows]
        return TaskAnswers(answers, {answer.query: kept for answer, kept in rows}, run)


def check_task(task: RetrievalTask) -> None:
    """Raise DatasetError for a task that cannot be run: no image, a key that occurs twice or holds a blank, ..."""
    for side, images in (("query", task.queries), ("gallery image", task.gallery)):
        keys = [image.key for image in images]
        if not keys:
            raise DatasetError(f"task '{task.name}' has no {side}")
        if len(set(keys)) < len(keys):
            twice = next(key for key in keys if keys.count(key) > 1)
            raise DatasetError(f"task '{task.name}': {side} '{twice}' occurs twice")
        blank = next((key for key in keys if key.split() != [key] or key.startswith("#")), None)
        if blank is not None:
            raise DatasetError(
                f"task '{task.name}': {side} '{blank}' has a blank in its name, but blanks separate the names in lists"
            )
    sizes = (task.relevance.queries, task.relevance.gallery)
    if sizes != (len(task.queries), len(task.gallery)) or (task.groups and len(task.groups) != len(task.queries)):
        raise DatasetError(f"task '{task.name}': relevance or groups do not fit its {len(task.queries)} queries")


def _with_gallery_failure(answer: QueryAnswer, of_gallery: Sequence[str]) -> QueryAnswer:
    """The answer of a query that found nothing because the method crashed on the whole gallery becomes an error."""
    if answer.status == "failed" and of_gallery and all(of_gallery):
        return QueryAnswer(
            answer.query, answer.group, BROKEN, answer.positives, (), answer.seconds, f"on the gallery: {of_gallery[0]}"
        )
    return answer


def _open(folder: RetrieverResults, task: RetrievalTask, overwrite: Overwrite) -> bool:
    """Whether a task is still to be run."""
    if not folder.complete(task.name):
        return True
    answers = ANSWERS.read(folder.answers(task.name))
    if [a.query for a in answers] != [q.key for q in task.queries]:
        raise PredictionError(f"holds other queries than task '{task.name}'", folder.answers(task.name))
    return overwrite == "failed" and any(a.status != "ok" for a in answers)


def _refuse_other_lists(folder: RetrieverResults, record: RetrievalRun) -> None:
    if folder.run_yaml.exists() and (before := folder.run_record().keep) != record.keep:
        raise PredictionError(
            f"keeps {before or 'all'} images of each query, --keep is {record.keep or 'all'}; "
            f"give this run a label (LABEL={record.target}) or use --overwrite always",
            folder.run_yaml,
        )
