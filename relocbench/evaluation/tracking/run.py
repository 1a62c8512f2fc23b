"""Phase one: run a method on every pair and keep its answers.

Every answer goes to a journal at once, so that a killed run loses only the pair in progress; the files of a complete
pair set are written whole and its journal is removed. Workers get no ground truth, only timestamps.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from typing import Any

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import PairKey, number_fields, parse_pose_numbers
from relocbench.errors import PredictionError
from relocbench.evaluation.common.options import Overwrite
from relocbench.evaluation.common.results import DatasetResults, MethodResults, RunRecord, write_record
from relocbench.evaluation.common.runs import (
    Asking,
    clear,
    has_answers,
    made_by,
    now,
    refuse_mixture,
    refuse_submitted,
)
from relocbench.evaluation.isolation.answers import CheckedAnswer, error_answer
from relocbench.evaluation.isolation.capabilities import construction_fault
from relocbench.evaluation.isolation.handles import TrackerHandle
from relocbench.evaluation.isolation.journal import (
    answered_keys,
    append_entry,
    journal_entries,
    open_journal,
    remove_journal,
    write_entry,
)
from relocbench.evaluation.isolation.losses import LossHandler, run_until_answered
from relocbench.evaluation.isolation.worker import (
    Assignment,
    Unit,
    is_first_call,
    query_of,
    show_keyframe,
    time_factor,
    tracker_of,
)
from relocbench.evaluation.tables.answers import ANSWERS, Answer, read_answers
from relocbench.execution import MANY_TIMES, step
from relocbench.files import locked_folder, read_rows, write_text
from relocbench.methods import SUBPROCESS, MethodSpec
from relocbench.tracking import Query

_TRACK = "track"


def run_method(
    dataset: Dataset,
    pair_sets: Sequence[PairSet],
    spec: MethodSpec,
    results: DatasetResults,
    asking: Asking,
) -> MethodResults:
    """Run a method on the pairs that it has not answered yet.

    A method that exceeds the limits or ends its process breaks on the pair in progress; one that does so in its
    constructor breaks on all pairs.

    Raises:
        PredictionError: the folder holds answers of this label that were submitted, or were made with other parameters
            or versions, or another process is writing to it.
        MethodError: answers are to be replaced, but the method cannot be made.
        DatasetError: an image, depth or description of the dataset is bad.
    """
    folder = results.method(spec.label)
    overwrite, reporter = asking.overwrite, asking.reporter
    assigned = Assignment.of(dataset, spec, asking.run.hiding(dataset.root, results.root), asking.seed)
    record = new_record(assigned)
    refuse_submitted(folder)
    if overwrite == "always":
        # A method that cannot be made, say because of a mistyped path of weights, must not cost earlier answers.
        if has_answers(folder) and (fault := construction_fault(spec, assigned.run)):
            reporter.note(f"{spec.label} keeps its earlier answers: {fault}")
            return folder
        clear(folder, [s.name for s in pair_sets])
    if overwrite == "failed" and (matched := [s.name for s in pair_sets if folder.matching(s.name).exists()]):
        raise PredictionError(
            "matching quality was measured after these answers, with starts around the true pixels; running the failed "
            "pairs again would mix answers from before and after: use --overwrite always",
            folder.matching(matched[0]),
        )
    todo = {s.name: _open_pairs(folder, s, overwrite) for s in pair_sets}
    refuse_mixture(folder, record, work_left=any(todo.values()))
    if not any(todo.values()) and all(folder.complete(s.name) for s in pair_sets):
        return folder
    folder.root.mkdir(parents=True, exist_ok=True)
    if not folder.run_yaml.exists():
        write_record(folder.run_yaml, record)
    stage = reporter.stage(f"{spec.label} on {dataset.name}", sum(map(len, todo.values())))
    left = [s for s in pair_sets if todo[s.name] or not folder.complete(s.name)]

    def unanswered(pair_set: PairSet) -> list[PairKey]:
        answered = answered_keys(folder.journal(pair_set.name))
        return [key for key in todo[pair_set.name] if key not in answered]

    def open_units() -> list[Unit]:
        return [unit for s in left for unit in assigned.units(s, folder.journal(s.name), unanswered(s))]

    with stage as advance, ExitStack() as alone:
        for journal in (folder.journal(s.name) for s in left):
            journal.mkdir(parents=True, exist_ok=True)
            alone.enter_context(locked_folder(journal, PredictionError))
        try:
            run_until_answered(_run_unit, open_units, LossHandler(_write_crash), assigned.run, advance)
        finally:
            for pair_set in (s for s in left if not unanswered(s)):
                _collect(pair_set, folder)
    begun = folder.run_record()
    sandbox = record.sandbox if begun.sandbox == record.sandbox else ""
    of_all = {
        "start": begun.start,
        "end": now(),
        "isolated": bool(begun.isolated and record.isolated),
        "sandbox": sandbox,
        "one_core": begun.one_core and record.one_core,
    }
    write_record(folder.run_yaml, record.model_copy(update=of_all))
    return folder


def _run_unit(unit: Unit) -> int:
    """Answer the pairs of a unit in a worker; returns their number."""
    tracker = tracker_of(unit)
    crash = show_keyframe(unit, tracker)
    with open_journal(unit.journal) as stream:
        for batch in _batches(unit.keys, tracker):
            views = [query_of(unit, key) for key in batch]
            seconds: float | None
            memory = None
            if crash is not None:
                answered, seconds = [error_answer(crash)] * len(batch), None
            else:
                _warm_up(tracker, views[0], unit, batch)
                with step("", tuple(batch), time_factor(_TRACK, unit, len(batch))):
                    answered, seconds = tracker.ask(views)
                memory = tracker.peak_memory_bytes
            each = None if seconds is None else seconds / len(batch)
            for key, answer in zip(batch, answered, strict=True):
                write_entry(stream, _entry(key, answer, each, memory))
    return len(unit.keys)


def _batches(keys: Sequence[PairKey], tracker: TrackerHandle) -> Iterator[Sequence[PairKey]]:
    """Yield the keys in order, as many at once as the tracker answers in one call when their turn comes."""
    asked = 0
    while asked < len(keys):
        batch = keys[asked : asked + tracker.declared.batch]
        asked += len(batch)
        yield batch


def _warm_up(tracker: TrackerHandle, view: Query, unit: Unit, keys: Sequence[PairKey]) -> None:
    """Make one untimed call in each process: compilation and first allocations are not the method's speed."""
    if unit.spec.target.startswith(SUBPROCESS) or not is_first_call(_TRACK, unit.spec):
        return
    with step("", tuple(keys), MANY_TIMES if unit.patient else 1.0):
        tracker.ask([view])


def _entry(key: PairKey, answer: CheckedAnswer, seconds: float | None, memory: int | None) -> dict[str, Any]:
    return {
        "key": list(key),
        "pose": answer.pose,
        "status": answer.status,
        "seconds": seconds,
        "confidence": answer.confidence,
        "message": answer.message,
        "info": answer.info,
        "memory": memory,
    }


def _write_crash(unit: Unit, key: PairKey, message: str) -> None:
    """Write the entry of a lost pair."""
    append_entry(unit.journal, _entry(key, error_answer(message), None, None))


def _collect(pair_set: PairSet, folder: MethodResults) -> None:
    """Turn the journal, and earlier answers that are kept, into prediction file and table, in the pair set's order."""
    journal = folder.journal(pair_set.name)
    entries = {entry["key"]: entry for entry in _kept_entries(folder, pair_set)}
    entries |= {entry["key"]: entry for entry in journal_entries(journal)}
    lines, answers = [], []
    for pair in pair_set.evaluated:
        entry = entries[pair.key]
        if entry["pose"] is not None:
            lines.append(" ".join([*map(str, pair.key), *number_fields(entry["pose"])]) + "\n")
        answers.append(
            Answer(
                *pair.key,
                entry["status"],
                entry["seconds"],
                entry["confidence"],
                entry["message"],
                entry["info"],
                entry["memory"],
            )
        )
    write_text(folder.predictions(pair_set.name), "".join(lines))
    ANSWERS.write(folder.answers(pair_set.name), answers)
    remove_journal(journal)


def _open_pairs(folder: MethodResults, pair_set: PairSet, overwrite: Overwrite) -> list[PairKey]:
    """The pairs of a set that the method has not answered yet."""
    done = {e["key"] for e in _kept_entries(folder, pair_set)} if folder.complete(pair_set.name) else set()
    if overwrite == "failed" and done:
        answers = read_answers(folder.answers(pair_set.name))
        done = {key for key in done if answers[key].status == "ok"}
    done |= answered_keys(folder.journal(pair_set.name))
    return [p.key for p in pair_set.evaluated if p.key not in done]


def _kept_entries(folder: MethodResults, pair_set: PairSet) -> Iterator[dict[str, Any]]:
    """The answers of a complete pair set, as journal entries."""
    from relocbench.evaluation.tracking.score import read_predictions

    if not folder.complete(pair_set.name):
        return
    path = folder.predictions(pair_set.name)
    read_predictions(path, pair_set)
    # The numbers as they are in the file, so that writing them again gives the same bytes.
    poses = {
        (int(fields[0]), int(fields[1])): parse_pose_numbers(fields[2:], path, number, PredictionError)
        for number, fields in read_rows(path, "predictions", PredictionError)
    }
    for key, answer in read_answers(folder.answers(pair_set.name)).items():
        if key not in pair_set.by_key:
            raise PredictionError(f"unknown pair {key[0]} {key[1]}", folder.answers(pair_set.name))
        yield {
            "key": key,
            "pose": poses.get(key),
            "status": answer.status,
            "seconds": answer.seconds,
            "confidence": answer.confidence,
            "message": answer.message,
            "info": answer.info,
            "memory": answer.peak_memory_bytes,
        }


def new_record(assigned: Assignment) -> RunRecord:
    """The record of a run that begins now."""
    return RunRecord.on(
        assigned.dataset,
        isolated=assigned.visibility.isolated,
        sandbox=assigned.visibility.sandbox.kind,
        uses_times=assigned.visibility.times,
        one_core=assigned.visibility.one_core,
        **made_by(assigned.spec, assigned.run.workers, assigned.seed),
    )
