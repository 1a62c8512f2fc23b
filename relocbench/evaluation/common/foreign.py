"""Methods of other packages: configured without importing them where answers are scored.

Whatever a module does when it is imported, it could do to the evaluator: read the truth, or replace the functions that
score. Modules of others are therefore imported in a process of a method only, which reports the parameters and what
else has to be known before a run.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from yaml import YAMLError

from relocbench.errors import MethodError, one_line
from relocbench.evaluation.common.blindness import check_blind
from relocbench.evaluation.isolation.foreign_process import Configuration, Reported
from relocbench.evaluation.isolation.method_process import FORGED, MethodProcess
from relocbench.execution import MANY_TIMES, Loss, Run, run_limited, step
from relocbench.files import dump_yaml, parse_yaml
from relocbench.methods import TRACKERS, MethodKind, MethodSpec, parse_method, parse_methods
from relocbench.methods.discovery import is_ours
from relocbench.methods.specs import MOST_ASSUMED, START, split_label

_MODULE = "relocbench.evaluation.isolation.foreign_process"
_MOST_CHARACTERS = 2**17
"""of the parameters and names of files that a method may report"""


@dataclass(frozen=True)
class ForeignSpec(MethodSpec):
    """A method whose module this process never imports; its parameters are plain values, to be shown."""

    configuration: Configuration | None = None
    times: bool = False
    assumed: str = ""
    digests: Mapping[str, str] = field(default_factory=dict)

    def create(self) -> Any:
        assert self.configuration is not None
        return self.configuration.parse().create()

    def uses_times(self) -> bool:
        return self.times

    def assumes(self) -> str:
        return self.assumed

    def files(self) -> dict[str, str]:
        return dict(self.digests)


def blind_methods(
    root: Path, texts: Sequence[str], settings: Sequence[str], seed: int, run: Run, kind: MethodKind = TRACKERS
) -> list[MethodSpec]:
    """The methods that a user names, with their parameters, none of which names the dataset.

    Args:
        root: the dataset's folder.
        run: where the methods will run, and what is hidden from them.

    Raises:
        MethodError: as :func:`~relocbench.methods.parse_methods` and
            :func:`~relocbench.evaluation.common.blindness.check_blind`.
        ConfigError: there must be a sandbox, and this system has none.
    """
    specs = parse_methods(texts, settings, seed, kind, partial(parse_apart, run=run))
    check_blind(specs, root)
    return specs


def parse_apart(text: str, settings: Sequence[str], seed: int, kind: MethodKind, *, run: Run) -> MethodSpec:
    """As :func:`~relocbench.methods.parse_method`, but what is not ours is imported in a process of its own.

    Raises:
        MethodError: as there; also a module that ends its process or exceeds a limit when it is imported.
        ConfigError: there must be a sandbox, and this system has none.
    """
    starts = [value for key, _, value in (s.partition("=") for s in settings) if key.rpartition(".")[2] == START]
    label, target = split_label(text, kind)
    sandbox = run.sandbox_of_methods()
    if not run.in_subprocess or all(is_ours(each, kind) for each in (target, *starts)):
        return parse_method(text, settings, seed, kind)
    configuration = Configuration(text, tuple(settings), seed, kind, sandbox)
    one = Run(1, limits=run.limits)
    found: Reported | Loss
    ((_, found),) = run_limited(_reported, [[configuration]], one, on_loss=_loss)
    if isinstance(found, Loss):
        raise MethodError(f"{kind.noun} '{text}' cannot be imported: {found.words}")
    facts = found.uses_times, one_line(found.assumes, MOST_ASSUMED), found.files
    return ForeignSpec(label, target, found.parameters, kind, configuration, *facts)


def _loss(configuration: Configuration, loss: Loss) -> Reported | Loss:
    return loss


def _reported(configuration: Configuration) -> Reported | Loss:
    """Ask a process of the method, from a worker."""
    with step("import", times=MANY_TIMES):
        process = MethodProcess(configuration, _MODULE, configuration.sandbox)
    process.close()
    try:
        reported = Reported(**process.declared)
    except TypeError:
        raise MethodError(f"{configuration.kind.noun} '{configuration.label}': {FORGED}") from None
    right = isinstance(reported.parameters, dict) and isinstance(reported.files, dict)
    if (
        not right
        or not _can_be_recorded({"parameters": reported.parameters, "files": reported.files})
        or type(reported.uses_times) is not bool
        or type(reported.assumes) is not str
        or {*map(type, reported.files.values())} - {str}
    ):
        raise MethodError(f"{configuration.kind.noun} '{configuration.label}': {FORGED}")
    return reported


def _can_be_recorded(values: Any) -> bool:
    """Whether a record that holds these values, which came as JSON, is short and can be read again."""
    try:
        return len(json.dumps(values)) <= _MOST_CHARACTERS and parse_yaml(dump_yaml(values)) is not None
    except (ValueError, RecursionError, YAMLError):
        return False
