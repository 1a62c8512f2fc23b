"""Predictions that were made elsewhere: which files answer what, and the folder that takes them over."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeVar

from relocbench.errors import ConfigError, PredictionError, available
from relocbench.evaluation.common.results import MethodResults, RunRecord, check_made_for
from relocbench.files import check_label, load_yaml

T = TypeVar("T")
R = TypeVar("R", bound=RunRecord)


def predictions_label(predictions: Path, methods: Sequence[str]) -> str:
    """The label of predictions made elsewhere: the given one, else the name of their file or folder.

    Raises:
        ConfigError: the name cannot be a label.
    """
    source = predictions.resolve()
    label = methods[0] if methods else source.stem if source.is_file() else source.name
    try:
        return check_label(label, "method label")
    except ValueError as bad:
        raise ConfigError(f"{bad}; give one: --method LABEL") from None


def prediction_files(
    source: Path, chosen: Mapping[str, T], known: Sequence[str], *, unit: str, name: str
) -> list[tuple[T, Path]]:
    """What a file, or each file of a folder, answers.

    A file answers what it is named after, or else the only thing that is chosen.

    Args:
        source: a file, or a folder of files that are named after what they answer.
        chosen: what is to be evaluated, by name.
        known: the names of all that the dataset asks.
        unit: what has such a name, in words.
        name: of the dataset.

    Raises:
        PredictionError: no file, one of an unknown name, or none of what is chosen.
    """
    if source.is_file():
        answered = [source.stem] if source.stem in chosen else list(chosen)
        if len(answered) != 1:
            names = ", ".join(answered)
            raise PredictionError(f"one file answers one {unit}, and there are {names}; choose one: --pair-set", source)
        return [(chosen[answered[0]], source)]
    if not source.is_dir():
        raise PredictionError(f"no such file or folder; expected a file for a {unit}, or a folder of NAME.txt", source)
    files = sorted(source.glob("*.txt"))
    if not files:
        raise PredictionError(f"holds no predictions; expected NAME.txt for each {unit}", source)
    for path in files:
        if path.stem not in known:
            raise PredictionError(f"no {unit} '{path.stem}' in {name}{available(path.stem, known)}", path)
    matching = [(chosen[path.stem], path) for path in files if path.stem in chosen]
    if not matching:
        raise PredictionError(f"answers none of {', '.join(chosen)}", source)
    return matching


def adopted_run(folder: MethodResults, theirs: Path, run: R, what: str) -> R:
    """The record of a run made elsewhere, for results that are imported on this dataset.

    Args:
        folder: that takes them over.
        theirs: the ``run.yaml`` that came with the results, if there is one.
        run: what is known of the run without it: method, target, dataset, fingerprint and question.
        what: the kind of record, for messages.

    Raises:
        PredictionError: the record is bad, or of another dataset than this one or a copy of it; or the folder holds
            other predictions.
    """
    record = run.model_copy(update={"made_elsewhere": True})
    if theirs.is_file():
        record = _of_this_dataset(load_yaml(theirs, type(run), what, PredictionError), run, theirs)
    if folder.run_yaml.exists() and (before := folder.run_record().target) != record.target:
        raise PredictionError(f"holds predictions of '{before}'; choose another label", folder.run_yaml)
    return record


def _of_this_dataset(record: R, run: R, path: Path) -> R:
    changed: dict[str, object] = {"method": run.method, "made_elsewhere": True}
    changed |= {"submitted": {}, "remarks": (), "answered_blind": ""}  # only a submission that was checked has these
    if record.fingerprint != run.fingerprint and run.question and record.question == run.question:
        # Another machine's copy: the content id is the same, and images differ in last digits only.
        changed |= {"fingerprint": run.fingerprint, "answered_on": record.fingerprint}
    else:
        check_made_for(record, run.dataset, run.fingerprint, path)
    return record.model_copy(update=changed)
