"""JSON that others wrote, and journals of JSON lines."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from relocbench.errors import quoted
from relocbench.files.plain import read_bytes

_DEEPEST = 20


def parse_json(text: str | bytes) -> Any:
    """The value of a JSON text.

    Raises:
        ValueError: with one line of why: no JSON, no UTF-8, a key twice, nested too deep, a number of more digits than
            Python reads, half of a surrogate pair, which no file could be written with.
    """
    try:
        value = json.loads(text, object_pairs_hook=_distinct)
        if "\\u" in text if isinstance(text, str) else b"\\u" in text:
            json.dumps(value, ensure_ascii=False).encode()
    except RecursionError:
        raise ValueError("is nested too deep") from None
    except UnicodeEncodeError:
        raise ValueError("holds half of a surrogate pair") from None
    return value


def strict_json(values: Any) -> Any:
    """Plain values as strict JSON has them: a number that is not finite becomes None, and keys text."""
    if isinstance(values, dict):
        return {str(key): strict_json(value) for key, value in values.items()}
    if isinstance(values, list | tuple):
        return [strict_json(value) for value in values]
    return None if isinstance(values, float) and not math.isfinite(values) else values


def _distinct(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        seen: set[str] = set()
        again = next(key for key, _ in pairs if key in seen or seen.add(key))  # type: ignore[func-returns-value]
        raise ValueError(f"the key {quoted(again)} occurs twice")
    return found


def read_journal(path: Path) -> list[dict[str, Any]]:
    """The whole lines of a journal of JSON objects; their ``key``, where they have one, is a list of words or numbers.

    The first line that is none ends it: a kill tore the last one, wherever in a character that was.

    Raises:
        RelocbenchError: there is no file to be read, such as a pipe, a folder, or a link to a file that is gone.
    """
    out = []
    for line in read_bytes(path, "a journal").split(b"\n")[:-1]:
        try:
            entry = parse_json(line)
        except ValueError:
            break
        if not isinstance(entry, dict) or not _is_key(entry.get("key", [])):
            break
        out.append(entry)
    return out


def _is_key(key: Any) -> bool:
    return isinstance(key, list) and all(isinstance(part, str | int) for part in key)


def json_text(value: object, *, sort_keys: bool = False, ascii_only: bool = False) -> str:
    """A value from a YAML file as JSON; types that JSON lacks, such as dates, become strings."""
    return json.dumps(_shown(value, _DEEPEST), sort_keys=sort_keys, ensure_ascii=ascii_only)


def _shown(value: Any, deepest: int) -> Any:
    if value is None or isinstance(value, str | bool | float):
        return value
    if isinstance(value, int):
        return value if value.bit_length() < 256 else hex(value)  # decimal digits of a huge integer take minutes
    if isinstance(value, Mapping | list | tuple) and deepest == 0:
        return "..."
    if isinstance(value, Mapping):
        return {k if isinstance(k, str) else str(_shown(k, 0)): _shown(v, deepest - 1) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_shown(v, deepest - 1) for v in value]
    return str(value)
