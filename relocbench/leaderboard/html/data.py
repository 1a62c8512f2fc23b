"""Payloads of the site: scripts that register their content, since pages opened from a disk cannot fetch files.

A payload with the key ``KEY`` lies in ``data/KEY.js``, which holds one call, ``relocbench_data("KEY", ...)``. A page
loads it with ``<script src>`` or, when it is needed, with ``relocbench.load("KEY")``, a promise of the content.
Large arrays are objects with the type of their little-endian numbers and these as base64, such as ``{":f4": "..."}``,
which the page decodes when it loads the payload: int64 becomes BigInt.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from relocbench.files import write_text
from relocbench.leaderboard.html.links import data_file


def write_data(site: Path, key: str, payload: object) -> Path:
    """Write ``data/KEY.js`` below the folder of the site; returns its path.

    Args:
        payload: what :func:`script_json` takes.
    """
    path = site / data_file(key)
    write_text(path, f"relocbench_data({script_json(key)},{script_json(payload)});\n")
    return path


def script_json(payload: object) -> str:
    """JSON that is harmless within a ``script`` element and as a script: no ``<``, ``>``, ``&`` and ASCII alone.

    Numbers that JSON lacks become texts that JavaScript's ``Number`` takes, ``"Infinity"``, or null where there is no
    number.
    """
    text = json.dumps(_plain(payload), ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def floats(values: ArrayLike) -> dict[str, str]:
    """Numbers as float32; NaN where there is none, infinite what is too large."""
    with np.errstate(over="ignore"):
        return _array(values, "f4")


def integers(values: ArrayLike) -> dict[str, str]:
    """Integers, such as timestamps, as int64."""
    return _array(values, "i8")


def bytes_of(values: ArrayLike) -> dict[str, str]:
    """Small integers 0..255, such as indices of a status."""
    return _array(values, "u1")


def _array(values: ArrayLike, kind: str) -> dict[str, str]:
    return {f":{kind}": base64.b64encode(np.ascontiguousarray(values, dtype=f"<{kind}").tobytes()).decode()}


def _plain(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else ("Infinity" if value > 0 else "-Infinity")
    if isinstance(value, Mapping):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(each) for each in value]
    return value
