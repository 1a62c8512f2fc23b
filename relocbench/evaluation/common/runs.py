"""How the answers in a method's folder were made, and whether a run may add to them."""

from __future__ import annotations

import datetime
import json
import os
import platform
import shutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from relocbench.datasets.core.writer import versions
from relocbench.errors import MethodError, PredictionError
from relocbench.evaluation.common.options import Overwrite
from relocbench.evaluation.common.results import MethodResults, RunRecord
from relocbench.execution import Run, default_workers
from relocbench.files import json_text, remove_parts
from relocbench.methods import MethodSpec, distribution_version
from relocbench.progress import Reporter


@dataclass(frozen=True)
class Asking:
    """How methods are asked, whichever they are."""

    run: Run
    """where they run, and their limits"""
    reporter: Reporter
    overwrite: Overwrite = "never"
    """``never`` keeps all answers, ``failed`` asks again where a method failed or broke, ``always`` starts over"""
    seed: int = 0


def made_by(spec: MethodSpec, workers: int, seed: int) -> dict[str, Any]:
    """The fields of a run's record that describe the method and the machine; the run begins now."""
    return {
        "method": spec.label,
        "target": spec.target,
        "parameters": json.loads(json.dumps(dict(spec.parameters), default=str)),
        "files": spec.files(),
        "assumes": spec.assumes(),
        "seed": seed,
        "versions": {**versions(), "method": distribution_version(spec.target, spec.kind)},
        "machine": machine(),
        "workers": workers,
        "start": now(),
    }


Named = TypeVar("Named")
Result = TypeVar("Result")


def run_each(
    specs: Sequence[Named], run_one: Callable[[Named], Result]
) -> tuple[list[tuple[Named, Result]], list[tuple[str, str]]]:
    """Run methods one after the other. One that cannot be made is left out, and costs the others nothing.

    Returns:
        each method that ran with its result, and the label (or the text that names it) and message of each left out.

    Raises:
        MethodError: a single method, or each of them, cannot be made.
    """
    done: list[tuple[Named, Result]] = []
    left_out: list[tuple[str, str]] = []
    here = Path.cwd()
    for spec in specs:
        try:
            done.append((spec, run_one(spec)))
        except MethodError as bad:
            left_out.append((str(getattr(spec, "label", spec)), str(bad)))
            if len(left_out) == len(specs):
                raise
        finally:
            _return_to(here)
    return done, left_out


def _return_to(folder: Path) -> None:
    """Make the working folder again where a method without a sandbox has removed it: the rest of a run needs one."""
    try:
        Path.cwd()
    except FileNotFoundError:
        folder.mkdir(parents=True, exist_ok=True)
        os.chdir(folder)


def refuse_submitted(folder: MethodResults) -> None:
    """Raise PredictionError if the folder holds what was handed in with a card, which no run may replace."""
    if folder.run_yaml.exists() and folder.run_record().submitted:
        message = f"holds a submission, which no run replaces; give this run another label than '{folder.label}'"
        raise PredictionError(message, folder.run_yaml)


def refuse_mixture(folder: MethodResults, record: RunRecord, *, work_left: bool) -> None:
    """Raise PredictionError if the folder holds answers of another configuration, which must never be mixed."""
    if not folder.run_yaml.exists():
        return
    if not has_answers(folder):  # the record of a run that stopped before its first answer does not matter
        folder.run_yaml.unlink()
        return
    before = folder.run_record()
    if before.fingerprint != record.fingerprint:
        raise PredictionError(
            f"was made for a dataset with the fingerprint {before.fingerprint}, and this one has {record.fingerprint}",
            folder.run_yaml,
        )
    way_out = f"give this run a label (LABEL={record.target}) or use --overwrite always"
    if before.target != record.target:
        raise PredictionError(
            f"holds predictions of '{before.target}', this run is '{record.target}'; {way_out}", folder.run_yaml
        )
    changed = [
        f"{k}: {before.parameters.get(k)} there, {record.parameters.get(k)} now"
        for k in sorted(before.parameters.keys() | record.parameters.keys())
        if before.parameters.get(k) != record.parameters.get(k)
    ]
    changed += [
        f"{k}: another content of the file there, SHA-256 {before.files[k][:12]}, {record.files[k][:12]} now"
        for k in sorted(before.files.keys() & record.files.keys())
        if before.files[k] != record.files[k] and not any(line.startswith(f"{k}: ") for line in changed)
    ]
    if before.files and record.files and not changed:
        changed = [f"{k}: a file of one of the two only" for k in sorted(before.files.keys() ^ record.files.keys())][:3]
    if work_left and not changed:
        changed = [
            f"{k} {before.versions.get(k)} there, {v} now"
            for k, v in record.versions.items()
            if before.versions.get(k) != v
        ]
    if changed:
        raise PredictionError(
            f"holds predictions made with other settings ({'; '.join(changed)}); {way_out}", folder.run_yaml
        )


def has_answers(folder: MethodResults) -> bool:
    """Whether there are answers, finished or in the journal of a run that was stopped."""
    return any(folder.root.glob("*.txt")) or any(folder.root.glob(".journal*/*/*.jsonl"))


def clear(folder: MethodResults, units: Iterable[str]) -> None:
    """Remove the answers to pair sets or tasks, and their scores; with the last of them goes the record of the run."""
    for unit in units:
        for path in (folder.predictions, folder.answers, folder.errors, folder.matching):
            path(unit).unlink(missing_ok=True)
        for journal in (folder.journal, folder.matching_journal):
            shutil.rmtree(journal(unit), ignore_errors=True)
    # What stays keeps its record, so that a mixture is refused later.
    if folder.root.is_dir() and not any(folder.root.glob("*.txt")):
        folder.run_yaml.unlink(missing_ok=True)
        remove_parts(folder.root)


def labelled_target(label: str, run: RunRecord) -> str:
    """``LABEL=TARGET``, or the target alone if it is the label."""
    return label if run.target == label else f"{label}={run.target}"


def settings_of(label: str, run: RunRecord) -> list[str]:
    """The parameters of a method as ``LABEL.key=value``, without a seed that is the run's own."""
    return [
        f"{label}.{key}={value if isinstance(value, str) else json_text(value, ascii_only=True)}"
        for key, value in run.parameters.items()
        if key != "seed" or value != run.seed
    ]


def machine() -> dict[str, Any]:
    """A description of the machine that seconds are measured on."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if "model name" in line]
        model = names[0] if names else model
    return {"cpu": model, "cores": default_workers(), "system": f"{platform.system()} {platform.machine()}"}


def now() -> str:
    """The current time as records have it: UTC, to the second."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
