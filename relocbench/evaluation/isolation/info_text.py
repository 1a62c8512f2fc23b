"""The ``info`` of a method's answer, as JSON of bounded length."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from relocbench.errors import one_line, raised

INFO_CHARACTERS = 8192
"""characters of JSON that are kept of one ``info``; fields of a table may have up to 131,072"""
_MOST_COUNTED = 2**20
_MOST_DEPTH = 32
_MOST_BITS = 1024


class _TooMuch(Exception):
    """The value is too large to be counted."""


def info_text(info: object) -> str:
    """``info`` as one JSON object of at most :data:`INFO_CHARACTERS` characters. Raises nothing of its own.

    What JSON cannot hold (NaN and infinity, objects, integers of hundreds of digits) is replaced by text, and so is
    what is nested deeper than 32 levels. An object that would be longer is replaced by
    ``{"cut": true, "characters": ITS_LENGTH}``, or by ``{"cut": true, "characters_at_least": 1048576}`` where
    counting stopped there.
    """
    try:
        text = _text(info)
    except _TooMuch:
        return json.dumps({"cut": True, "characters_at_least": _MOST_COUNTED})
    except BaseException as bad:  # noqa: BLE001  an object of the method's own that raises when it is looked at
        return json.dumps({"info": f"cannot be read: {raised(bad)}"})
    return text if len(text) <= INFO_CHARACTERS else json.dumps({"cut": True, "characters": len(text)})


def _text(info: object) -> str:
    if info is None:
        return "{}"
    plain = _Plain().of(info, 0) if isinstance(info, Mapping) else {"info": one_line(info)}
    return json.dumps(plain, allow_nan=False)


class _Plain:
    """Copies a value into types that JSON can hold, and stops when the copy grows too large."""

    def __init__(self) -> None:
        self._count = 0

    def of(self, value: Any, depth: int) -> Any:
        self._spend(2)
        if depth > _MOST_DEPTH:
            return f"(nested deeper than {_MOST_DEPTH} levels)"
        if value is None or isinstance(value, bool | int | float | str):
            return self._scalar(value)
        if isinstance(value, Mapping):
            return {self._key(key): self.of(each, depth + 1) for key, each in value.items()}
        if isinstance(value, list | tuple):
            return [self.of(each, depth + 1) for each in value]
        if isinstance(value, np.ndarray | np.generic):
            array = np.asarray(value)
            if 2 * array.size > _MOST_COUNTED:
                raise _TooMuch
            return self._listed(array.tolist(), depth)
        if hasattr(value, "tolist"):  # arrays and tensors of other libraries
            return self._listed(value.tolist(), depth)
        return self._words(value)

    def _listed(self, values: Any, depth: int) -> Any:
        known = values is None or isinstance(values, bool | int | float | str | list)
        return self.of(values, depth) if known else self._words(values)

    def _scalar(self, value: Any) -> Any:
        """A value of exactly one of the plain types: JSON could encode a subclass as something else."""
        if value is None or isinstance(value, bool):
            return value
        if isinstance(value, str):
            text = str.__str__(value)
            self._spend(len(text))
            return text
        if isinstance(value, int):
            number = int.__int__(value)
            bits = number.bit_length()
            return number if bits <= _MOST_BITS else f"an integer of {bits} bits"
        real = float.__float__(value)
        return real if math.isfinite(real) else repr(real)

    def _key(self, key: Any) -> str:
        """A mapping's key as JSON writes it, or as text where JSON cannot."""
        if key is None or isinstance(key, bool | int | float):
            return json.dumps(self._scalar(key)).strip('"')
        return str(self._scalar(key)) if isinstance(key, str) else str(self._words(key))

    def _words(self, value: Any) -> str:
        text = one_line(value)
        self._spend(len(text))
        return text

    def _spend(self, characters: int) -> None:
        self._count += characters
        if self._count > _MOST_COUNTED:
            raise _TooMuch
