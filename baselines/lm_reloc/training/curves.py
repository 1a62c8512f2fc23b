"""``curves.png`` of a training of the pose network."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from baselines.training.curves import column, finish_panel, marker_for, new_figure, save_figure
from baselines.training.log import Row

_PANELS = {
    "loss": "loss of both directions",
    "rotation_rad": "error of the angles, radians",
    "translation_m": "error of the translation, metres",
}


def draw_curves(path: Path, log: Sequence[Row], validation: Sequence[Row]) -> None:
    """Draw the loss, its parts and the validation scores against the step.

    Args:
        path: the picture; nothing is written where the log is empty.
        log: rows of ``log.csv``.
        validation: rows of ``validation.csv``.
    """
    if not log:
        return
    figure = new_figure(16, 4)
    panels = figure.subplots(1, len(_PANELS) + 1)
    for axes, (name, title) in zip(panels, _PANELS.items(), strict=False):
        axes.plot(*column(log, name), marker=marker_for(log), label=name)
        axes.set_yscale("log")
        finish_panel(axes, title)
    together = [row for row in validation if row["conditions"] == "all"]
    for name in [name for name in (together[-1] if together else {}) if "@" in name]:
        panels[-1].plot(*column(together, name), marker=".", label=name)
    finish_panel(panels[-1], "validation as the start of lm-reloc", if_empty="no validation")
    save_figure(figure, path)
