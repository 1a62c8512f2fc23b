"""Files that appear whole or not at all, and text that says where it is wrong."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from decimal import ROUND_HALF_UP, Decimal
from pathlib import Path
from typing import IO, Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from relocbench.errors import RelocbenchError

Model = TypeVar("Model", bound=BaseModel)
_INTEGER = re.compile(r"[+-]?[0-9]+")
_MOST_NS = 2**63 - 1
"""times are kept as 64-bit integers"""
_MOST_DIGITS = 30
_MOST_SECONDS = 9_000_000_000
_DECIMAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")


@contextmanager
def atomic_write(path: Path, mode: str = "w") -> Iterator[IO[Any]]:
    """Write a file beside ``path``, flush it to the disk and rename it; on an error nothing is left behind."""
    path.parent.mkdir(parents=True, exist_ok=True)
    # The part's name keeps the suffix, which image and table writers go by.
    part = path.with_name(f".{path.stem}.{secrets.token_hex(4)}.part{path.suffix}")
    newline = None if "b" in mode else "\n"
    encoding = None if "b" in mode else "utf-8"
    try:
        with part.open(mode, newline=newline, encoding=encoding) as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        part.replace(path)
    except OSError as bad:
        bad.filename = bad.filename or str(path)  # a full disk does not say which file did not fit
        raise
    finally:
        part.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write text whole or not at all."""
    with atomic_write(path) as stream:
        stream.write(text)


def write_bytes(path: Path, data: bytes) -> None:
    """Write bytes whole or not at all."""
    with atomic_write(path, "wb") as stream:
        stream.write(data)


def link_file(source: Path, path: Path) -> None:
    """Make ``path`` a symbolic link to ``source``; an existing link or file is replaced in one step."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.stem}.{secrets.token_hex(4)}.part")
    part.symlink_to(source.resolve())
    part.replace(path)


@contextmanager
def alone_in(folder: Path, error: type[RelocbenchError] = RelocbenchError) -> Iterator[None]:
    """Be the only process that works in a folder. The system lets go of it however the process ends.

    Raises:
        RelocbenchError: (as ``error``) another process is at it.
    """
    taken = "another process is at work here; wait for it to end"
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise error(taken, folder) from None
        except OSError:
            pass  # a file system without locks: as safe as before
        if not folder.exists() or not os.path.samestat(os.fstat(descriptor), folder.stat()):
            raise error(taken, folder)  # it ended, and took the folder away, just now
        yield
    finally:
        os.close(descriptor)


def remove_parts(folder: Path) -> None:
    """Remove what writers that were killed left behind."""
    for part in folder.rglob(".*.part*"):
        part.unlink(missing_ok=True)


def read_text(path: Path, what: str, error: type[RelocbenchError] = RelocbenchError) -> str:
    """The text of a UTF-8 file. Raises ``error`` naming the file and what it should have been."""
    try:
        # Editors on Windows begin a file with a byte order mark, which is no part of its first word.
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise error(f"missing; expected {what}", path) from None
    except IsADirectoryError:
        raise error(f"is a folder; expected {what}", path) from None
    except UnicodeDecodeError as bad:
        raise error(f"not a text file (byte {bad.start} is not UTF-8); expected {what}", path) from None
    except OSError as bad:
        raise error(f"cannot be read ({bad.strerror}); expected {what}", path) from None


def read_rows(path: Path, what: str, error: type[RelocbenchError] = RelocbenchError) -> Iterator[tuple[int, list[str]]]:
    """Line number and fields of each line of a text table; commas or spaces part fields, ``#`` starts a comment."""
    for number, line in enumerate(read_text(path, what, error).splitlines(), start=1):
        content = line.split("#", 1)[0].replace(",", " ").split()
        if content:
            yield number, content


def parse_floats(
    fields: list[str], path: Path, line: int, names: str, error: type[RelocbenchError] = RelocbenchError
) -> list[float]:
    """Finite floats of ``fields``, as many as ``names`` has words. Raises ``error`` with file and line."""
    wanted = names.split()
    if len(fields) != len(wanted):
        raise error(f"expected {len(wanted)} numbers ({names}), found {len(fields)}", path, line)
    out = []
    for name, text in zip(wanted, fields, strict=True):
        try:
            value = float(text)
        except ValueError:
            raise error(f"{name} is '{text}', expected a number", path, line) from None
        if value - value != 0.0:
            raise error(f"{name} is {text}, expected a finite number", path, line)
        out.append(value)
    return out


def parse_timestamp(
    text: str, path: Path, line: int | None = None, error: type[RelocbenchError] = RelocbenchError
) -> int:
    """Integer nanoseconds. Raises ``error`` with file and line."""
    if not _INTEGER.fullmatch(text):
        raise error(f"'{text}' is not a timestamp in integer nanoseconds", path, line)
    if len(text) > _MOST_DIGITS or abs(int(text)) > _MOST_NS:
        raise error(f"{text[:30]} is out of range; expected nanoseconds that fit 64 bits", path, line)
    return int(text)


def seconds_to_ns(text: str) -> int:
    """Decimal seconds as integer nanoseconds, digit by digit (a float would lose 128 ns today). Raises ValueError."""
    if not _DECIMAL.fullmatch(text):
        raise ValueError(f"'{text}' is not a decimal number")
    seconds = Decimal(text)
    if not -_MOST_SECONDS < seconds < _MOST_SECONDS:
        raise ValueError(f"'{text}' is out of range")
    return int((seconds * 1_000_000_000).to_integral_value(ROUND_HALF_UP))


def sha256_file(path: Path) -> str:
    """Hex digest of a file's content (links are followed)."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def dump_yaml(values: Any) -> str:
    """YAML in the order given, short lists on one line."""
    return str(yaml.safe_dump(values, sort_keys=False, allow_unicode=True, default_flow_style=None, width=110))


def load_yaml(path: Path, model: type[Model], what: str, error: type[RelocbenchError] = RelocbenchError) -> Model:
    """A YAML file checked against a pydantic model.

    Raises:
        RelocbenchError: (as ``error``) with file, line and key: no YAML, an unknown key, a wrong type.
    """
    values, node = load_yaml_values(path, what, error)
    try:
        return model.model_validate(values)
    except ValidationError as bad:
        message, location = first_fault(bad)
        raise error(message, path, yaml_line(node, location)) from None


def load_yaml_values(
    path: Path, what: str, error: type[RelocbenchError] = RelocbenchError
) -> tuple[dict[str, Any], yaml.Node | None]:
    """The mapping that a YAML file holds, and its tree, which knows lines. Raises ``error`` with file and line."""
    text = read_text(path, what, error)
    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
        values = yaml.safe_load(text)
    except yaml.MarkedYAMLError as bad:
        line = bad.problem_mark.line + 1 if bad.problem_mark else None
        raise error(f"not valid YAML ({bad.problem}); expected {what}", path, line) from None
    except yaml.YAMLError:
        raise error(f"not valid YAML; expected {what}", path) from None
    if not isinstance(values, dict):
        raise error(f"expected {what} with keys and values", path)
    return values, node


def first_fault(bad: ValidationError) -> tuple[str, tuple[str | int, ...]]:
    """One line about a pydantic error (the first, and how many more), and where it is."""
    faults = bad.errors()
    first = faults[0]
    location = tuple(first["loc"])
    key = ".".join(str(part) for part in location)
    if first["type"] == "extra_forbidden":
        message = f"unknown key '{key}'"
    elif first["type"] == "missing":
        message = f"key '{key}' is missing"
    else:
        message = f"key '{key}': {first['msg']}, got {first.get('input')!r}" if key else str(first["msg"])
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return message + more, location


def yaml_line(node: yaml.Node | None, location: tuple[str | int, ...]) -> int | None:
    """1-based line of the innermost part of ``location`` that exists in the YAML tree."""
    line = None
    for part in location:
        if isinstance(node, yaml.MappingNode):
            found = [(k, v) for k, v in node.value if k.value == str(part)]
            if not found:
                break
            key, node = found[0]
            line = key.start_mark.line + 1
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
            node = node.value[part]
            line = node.start_mark.line + 1
        else:
            break
    return line if line is not None else (node.start_mark.line + 1 if node else None)


def read_journal(path: Path) -> list[dict[str, Any]]:
    """The whole lines of a JSON-lines journal; a last line that a kill tore is left out."""
    out = []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines(keepends=True):
        if not line.endswith("\n"):
            break
        try:
            out.append(json.loads(line))
        except json.JSONDecodeError:
            break
    return out
