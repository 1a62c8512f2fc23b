"""Ready-made builds, and the conditions that a build drives in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from relocbench.datasets.core.schema import Condition
from relocbench.datasets.synthetic.conditions.condition import (
    CONDITIONS,
    SWEEPS,
    Factors,
    NamedCondition,
    condition_named,
    sweep,
)
from relocbench.errors import ConfigError

ExtraKind = Literal["normals", "instance", "semantic", "changed"]
"""pictures beside the dataset"""
SPLITS = ("train", "validation", "test")

PRESETS: dict[str, dict[str, Any]] = {
    "smoke": {
        "conditions": ("Neutral", "WetNoon"),
        "cameras": "front",
        "size": "96x96",
        "steps": 4,
        "extent": 190.0,
        "correspondences": 200,
    },
    "demo": {},
    "carla": {
        "conditions": ("WetNoon", "SoftRainNoon", "WetCloudySunset"),
        "cameras": "six",
        "size": "512x512",
        "steps": 500,
        "traversals": 3,
        "split": "all",
        "correspondences": 2000,
    },
    "oxford": {
        "conditions": ("Sunny", "Overcast", "Rain", "Snow"),
        "cameras": "stereo",
        "size": "640x480",
        "steps": 200,
        "split": "all",
        "distance": 0.84,
        "correspondences": 2000,
    },
}
"""What each preset sets apart from the options' defaults, which are those of ``demo``.

``carla`` has the proportions of the GN-Net benchmark's synthetic half: 3 conditions x 3 traversals x 3 splits, 500
steps, 6 cameras, 512 x 512, pairs about 1.6 m apart. ``oxford`` has the conditions and the mean distance, 0.84 m, of
its RobotCar half.
"""


def conditions_of(
    names: Sequence[str],
    factors: Mapping[str, Factors],
    swept: str | None,
    sweep_steps: int,
    traffic: float | None = None,
) -> dict[str, NamedCondition]:
    """name -> condition of each that a build drives in; the first is the reference's.

    Args:
        names: of :data:`CONDITIONS` or of ``factors``.
        factors: conditions of the user's own.
        swept: a sweep that takes the place of ``names``; its steps are called ``SWEEP-0``, ``SWEEP-1``, ...
        traffic: moving cars per 100 m of lane in all of them.

    Raises:
        ConfigError: an unknown name, or one named twice.
    """
    for name in factors:
        if name in CONDITIONS:
            raise ConfigError(f"factors: '{name}' is the name of a ready-made condition; choose another")
    if swept is not None:
        found = {f"{swept}-{i}": _labelled(f"{swept} {i}", f) for i, f in enumerate(sweep(swept, sweep_steps))}
    else:
        if len(set(names)) != len(names) or not names:
            raise ConfigError(f"conditions must be at least one, each named once, got {', '.join(names) or 'none'}")
        found = {n: _labelled(n, factors[n]) if n in factors else condition_named(n) for n in names}
    if traffic is None:
        return found
    return {
        name: c.model_copy(update={"factors": c.factors.model_copy(update={"traffic": traffic})})
        for name, c in found.items()
    }


def _labelled(name: str, factors: Factors) -> NamedCondition:
    return NamedCondition(label=Condition(tags=(name,)), factors=factors)


def previewed(names: Sequence[str], *, everything: bool, swept: str | None, steps: int) -> dict[str, Factors]:
    """label -> factors of what ``relocbench preview`` shows.

    Raises:
        ConfigError: not exactly one of named conditions, all of them and a sweep was asked for, or an unknown name.
    """
    if bool(names) + everything + (swept is not None) != 1:
        raise ConfigError(
            "preview shows --condition NAME (repeat for several), --all or --sweep NAME: give one of them"
        )
    if swept is not None:
        return {_sweep_label(swept, f): f for f in sweep(swept, steps)}
    return {name: condition_named(name).factors for name in (CONDITIONS if everything else names)}


def _sweep_label(swept: str, factors: Factors) -> str:
    values = [f"{key.removesuffix('_deg')} {getattr(factors, key):.3g}" for key in SWEEPS[swept][0]]
    return ", ".join(values).replace("_", " ")
