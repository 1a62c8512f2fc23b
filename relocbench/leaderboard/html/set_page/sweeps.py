"""Sweeps: pair sets whose queries differ in one factor of the rendering, and the value of the factor in each.

Results name conditions and no factors: the ``dataset.yaml`` of a dataset that is at hand holds those of all conditions.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.synthetic.conditions.condition import SWEEPS
from relocbench.evaluation.common.results import PairSetRecord

_FEWEST = 3
"""different values from which on pair sets are a sweep"""
_ENDS = 2
"""stations of a sweep that goes one way"""
_LEFT_OUT = {"months": 0.0}
"""factors that datasets do not record where they have no effect"""
_UNITS = {"_deg": "°", "_mm_h": "mm/h", "_ms": "ms", "_px": "px", "_ev": "EV"}


def sweep_of(pair_sets: Mapping[str, PairSetRecord], dataset: Dataset | None) -> dict[str, Any] | None:
    """The sweep that the pair sets of two drives form; None where they form none, or the dataset is not at hand.

    Returns:
        ``name`` of the sweep or factor, ``axis``: what the values are, in words, ``values`` by pair set, and
        ``reference``: the value of the keyframes' condition.
    """
    if dataset is None:
        return None
    across = {name: record for name, record in pair_sets.items() if record.reference != record.query}
    made_by = dataset.file.made_by
    recorded, options = made_by.get("factors"), made_by.get("options")
    if not isinstance(recorded, dict) or not isinstance(options, dict):
        return None
    factors = {
        str(name): {**_LEFT_OUT, **_flat(values)} for name, values in recorded.items() if isinstance(values, dict)
    }
    sides = {name: (_factors(r.reference, factors), _factors(r.query, factors)) for name, r in across.items()}
    known = [values for both in sides.values() for values in both]
    if not known or None in known:
        return None
    keys = {key for values in known if values is not None for key in values}
    changing = {key for key in keys if len({str(v.get(key)) for v in known if v is not None}) > 1}
    name = str(options.get("sweep"))
    if len(SWEEPS.get(name, ())) > _ENDS:
        return None  # no single factor goes one way through all stations
    if name not in SWEEPS or not changing <= set(SWEEPS[name][0]):
        if len(changing) != 1:
            return None
        (name,) = changing
    key = next(iter(SWEEPS[name][0])) if name in SWEEPS else name
    values = {pair_set: _number(query, key) for pair_set, (_, query) in sides.items()}
    references = {_number(reference, key) for reference, _ in sides.values()}
    if None in values.values() or len(set(values.values())) < _FEWEST or len(references) != 1:
        return None
    return {"name": name, "axis": axis_of(key), "values": values, "reference": references.pop()}


def axis_of(key: str) -> str:
    """The name of a factor, in words with its unit."""
    name = key.removeprefix("imaging.")
    unit = next((unit for end, unit in _UNITS.items() if name.endswith(end)), "")
    words = name.removesuffix(next((end for end in _UNITS if name.endswith(end)), "")).replace("_", " ")
    return f"{words}, {unit}" if unit else words


def _factors(traversal: str, factors: Mapping[str, dict[str, Any]]) -> dict[str, Any] | None:
    """The factors of a traversal, which is named SPLIT-CONDITION-NUMBER."""
    split_and_condition = traversal.rpartition("-")[0]
    fitting = [name for name in factors if split_and_condition.endswith(f"-{name}")]
    return factors[max(fitting, key=len)] if fitting else None


def _flat(values: dict[str, Any]) -> dict[str, Any]:
    """Factors with those of the camera beside the others, as the names of sweeps have them."""
    camera = values.get("imaging")
    out = {str(key): value for key, value in values.items() if key != "imaging"}
    return out | ({f"imaging.{key}": value for key, value in camera.items()} if isinstance(camera, dict) else {})


def _number(values: dict[str, Any] | None, key: str) -> float | None:
    value = None if values is None else values.get(key)
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None
