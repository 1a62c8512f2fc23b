"""Parsing the retrievers and trackers of a command, each with its settings."""

from __future__ import annotations

from collections.abc import Sequence

from relocbench.errors import ConfigError, available, cut
from relocbench.evaluation.common.results import PREDICTIONS
from relocbench.evaluation.relocalization.rankings import label_of
from relocbench.evaluation.relocalization.records import KEYFRAME, ORACLE
from relocbench.files import check_label
from relocbench.methods import RETRIEVERS, TRACKERS, MethodSpec
from relocbench.methods.discovery import parse_method, setting_label


def parse_pipeline(
    retrievers: Sequence[str], trackers: Sequence[str], settings: Sequence[str], seed: int
) -> tuple[list[MethodSpec | str], list[MethodSpec]]:
    """Parse retrievers and trackers, in the order given.

    The oracle, and rankings made elsewhere, stay strings.

    Raises:
        MethodError: an unknown method, one of another kind, or a wrong parameter.
        ConfigError: a repeated label, the name of a trivial baseline, or a setting without the label of its method.
    """
    for setting in settings:
        if setting_label(setting) is None:
            raise ConfigError(f"--set {cut(setting)}: say for which method, as LABEL.key=value")
    of_retrievers = [_retriever(text, settings, seed) for text in retrievers]
    of_trackers = [parse_method(text, settings, seed, TRACKERS) for text in trackers]
    labels = [*map(label_of, of_retrievers), *(spec.label for spec in of_trackers)]
    floors = [one for one in of_retrievers if one == ORACLE]
    for label in labels:
        if "+" in label:
            raise ConfigError(f"label '{label}': '+' joins the two halves of a pipeline; choose another")
        if label == KEYFRAME or (label == ORACLE and not floors):
            raise ConfigError(
                f"'{label}' is the name of a trivial baseline; give the method another label: LABEL=METHOD"
            )
        if labels.count(label) > 1:
            raise ConfigError(f"two methods are called '{label}'; give one a label of its own: LABEL=METHOD")
    for setting in settings:
        wanted = setting_label(setting)
        if wanted not in labels:
            raise ConfigError(f"--set {cut(setting)}: no method '{wanted}' in this run{available(str(wanted), labels)}")
    return of_retrievers, of_trackers


def _retriever(text: str, settings: Sequence[str], seed: int) -> MethodSpec | str:
    label, separator, target = text.partition("=")
    if text == ORACLE:
        return text
    if not target.startswith(PREDICTIONS) and not text.startswith(PREDICTIONS):
        return parse_method(text, settings, seed, RETRIEVERS)
    try:
        if not separator or text.startswith(PREDICTIONS):
            raise ValueError("rankings made elsewhere need a label")
        check_label(label, "retriever label")
    except ValueError as bad:
        raise ConfigError(f"--retriever {cut(text)}: {bad}; give one: LABEL={PREDICTIONS}PATH") from None
    return text
