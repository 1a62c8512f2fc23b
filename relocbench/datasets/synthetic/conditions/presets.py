"""Presets of builds, and the selection of conditions by name, sweep or factors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from relocbench.datasets.core.schema import Condition
from relocbench.datasets.synthetic.conditions.condition import (
    CONDITIONS,
    SEASONS,
    SWEEPS,
    Factors,
    NamedCondition,
    condition_named,
    sweep,
    value_of,
)
from relocbench.datasets.synthetic.conditions.imaging import draw_imaging
from relocbench.errors import ConfigError

ExtraKind = Literal["normals", "instance", "semantic", "changed"]
"""further images that can be written beside a dataset"""
References = Literal["first", "all", "others"]
"""which drives are maps, and of which others"""
RepeatingStreet = Literal["keep", "group", "avoid"]
"""what becomes of pairs on the street whose houses repeat themselves"""
SPLITS = ("train", "validation", "test")

PRESETS: dict[str, dict[str, Any]] = {
    "smoke": {
        "conditions": ("Neutral", "WetNoon"),
        "cameras": "front", "size": "96x96", "steps": 4, "extent": 190.0, "correspondences": 200,
    },
    "demo": {},
    "carla": {
        "conditions": ("WetNoon", "SoftRainNoon", "WetCloudySunset"),
        "cameras": "six", "size": "512x512", "steps": 500, "traversals": 3, "split": "all", "correspondences": 2000,
    },
    "oxford": {
        "conditions": ("Sunny", "Overcast", "Rain", "Snow"),
        "cameras": "stereo", "size": "640x480", "steps": 200, "split": "all", "distance": 0.84, "correspondences": 2000,
    },
}  # fmt: skip
"""Options that each preset changes; the options' defaults are those of ``demo``.

``carla`` has the size of the GN-Net benchmark's synthetic half: 3 conditions x 3 traversals x 3 splits, 500 steps,
6 cameras, 512 x 512, pairs about 1.6 m apart. ``oxford`` has the conditions and the mean distance, 0.84 m, of its
RobotCar half.
"""


def conditions_of(
    names: Sequence[str],
    factors: Mapping[str, Factors],
    swept: str | None,
    sweep_steps: int,
    traffic: float | None = None,
    months: float | None = None,
    people: float | None = None,
) -> dict[str, NamedCondition]:
    """The conditions of a build by name; the first is the reference's.

    Args:
        names: names in :data:`CONDITIONS` or in ``factors``.
        factors: the user's own conditions.
        swept: a sweep that replaces ``names``; its steps are called ``SWEEP-0``, ``SWEEP-1``, ...
        traffic: moving cars per 100 m of lane in all conditions, or None to keep each condition's own.
        people: people on foot per 100 m of pavement in all conditions, or None to keep each condition's own.
        months: time since the reference's condition in all others, or None to keep each condition's own.

    Raises:
        ConfigError: a name is unknown or occurs twice, or ``months`` are given but there is a single condition.
    """
    for name in factors:
        if name in CONDITIONS:
            raise ConfigError(f"factors: '{name}' is the name of a built-in condition; choose another name")
    if swept is not None:
        found = {f"{swept}-{i}": _labelled(f"{swept} {i}", f) for i, f in enumerate(sweep(swept, sweep_steps))}
    else:
        if len(set(names)) != len(names) or not names:
            raise ConfigError(f"conditions takes one or more different names, got {', '.join(names) or 'none'}")
        found = {n: _labelled(n, factors[n]) if n in factors else condition_named(n) for n in names}
    for factor, value in (("traffic", traffic), ("people", people)):
        if value is not None:
            found = {name: _with(condition, **{factor: value}) for name, condition in found.items()}
    if months is None:
        return found
    first, *others = found
    if not others:
        raise ConfigError(f"--months changes all conditions but the first, and there is no other than {first}")
    return {first: found[first], **{name: _with(found[name], months=months) for name in others}}


def _with(condition: NamedCondition, **values: float) -> NamedCondition:
    """The condition with other values for some factors."""
    return condition.model_copy(update={"factors": condition.factors.model_copy(update=values)})


def refuse_imaging(conditions: Mapping[str, NamedCondition], what: str) -> None:
    """Raise ConfigError if a condition has a camera of its own, which ``what`` do not have."""
    for name, condition in conditions.items():
        if condition.factors.imaging is not None:
            raise ConfigError(f"condition '{name}' sets imaging, which {what} do not have; only datasets of drives do")


def _labelled(name: str, factors: Factors) -> NamedCondition:
    return NamedCondition(label=Condition(tags=(name,)), factors=factors)


def previewed(
    names: Sequence[str], *, everything: bool, swept: str | None, steps: int, cameras: int = 0, seed: int = 0
) -> dict[str, Factors]:
    """The conditions that ``relocbench preview`` shows: label -> factors.

    Args:
        cameras: number of drawn cameras that each condition is shown by, beside the ideal one.
        seed: seed of these cameras.

    Raises:
        ConfigError: not exactly one of named conditions, all conditions and a sweep is chosen, a name is unknown, or
            cameras are drawn for a sweep.
    """
    if bool(names) + everything + (swept is not None) != 1:
        raise ConfigError("preview takes exactly one of --conditions NAME,..., --all and --sweep NAME")
    if swept is not None and cameras:
        raise ConfigError(
            "--drawn-cameras varies the camera, but in a --sweep a single factor varies; give one of them"
        )
    if swept is not None:
        return {_sweep_label(swept, f, i / (steps - 1)): f for i, f in enumerate(sweep(swept, steps))}
    shown = {}
    for k, name in enumerate(CONDITIONS if everything else names):
        shown[name] = factors = condition_named(name).factors
        for number in range(cameras):
            imaging = draw_imaging(np.random.default_rng([seed, 9, k, number]), dark=factors.dark)
            shown[f"{name}, camera {number + 1}"] = factors.model_copy(update={"imaging": imaging})
    return shown


def _sweep_label(swept: str, factors: Factors, part: float) -> str:
    """The values of what is swept, or the names of the seasons that a part, in [0, 1], of the year lies between."""
    if swept == "season":
        at, names = part * (len(SEASONS) - 1), list(SEASONS)
        return " to ".join(dict.fromkeys((names[math.floor(at)], names[math.ceil(at)])))
    values = [
        f"{key.removeprefix('imaging.').removesuffix('_deg')} {value_of(factors, key):.3g}" for key in SWEEPS[swept][0]
    ]
    return ", ".join(values).replace("_", " ")
