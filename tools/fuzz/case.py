"""One input: which file of a parser's valid files is damaged, and how. It follows from parser, seed and number."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random

from fuzz.mutations import CANARY, mutated
from fuzz.parser import Parser

PLACES = ("missing", "folder", "loop", "pipe", "dangling", "endless")
"""what may stand where a file is expected"""
_NAMES = (
    "²²", "٣٣", "1e400", "-1", "9" * 40, "9" * 240, "nan", "0", "a b", "new\nline", "\x1b[31m", "\udcff", ".hidden",
    "x" * 200, "1.5", "1_0", "+1", "a__b", "=1+1", "1" * 19, "0000000", "é", "-o",
)  # fmt: skip
_TEXTS_IN = 3
"""every third input of a text format is drawn by hypothesis"""


@dataclass(frozen=True)
class Case:
    """One input."""

    parser: str
    seed: int
    number: int


def damage(parser: Parser, case: Case, root: Path, valid: Path, others: Sequence[bytes], canary: Path) -> Path:
    """Damage the copy of the valid files in ``root``; the file that was damaged.

    Args:
        valid: the valid files.
        others: content of files of other formats.
        canary: the path that stands for :data:`fuzz.mutations.CANARY`.
    """
    rng = Random(f"{case.seed}/{case.parser}/{case.number}")
    path = rng.choice(targets(parser, valid))
    target = root / path
    content = (valid / path).read_bytes()
    if rng.random() < 0.06:
        _place(rng.choice(PLACES), target)
    elif parser.names and rng.random() < 0.25:
        _rename(rng, target)
    else:
        if parser.text and case.number % _TEXTS_IN == 0 and b"\0" not in content:
            from fuzz.grammar import BATCH, texts_of  # hypothesis takes a while to load

            drawn = texts_of(content.decode("utf-8", "replace"), case.seed, case.number // (BATCH * _TEXTS_IN))
            new = drawn[case.number // _TEXTS_IN % len(drawn)].encode("utf-8", "surrogatepass")
        else:
            new = mutated(rng, content, others)
        _write(target, new.replace(CANARY, os.fsencode(canary)))
    return target


def targets(parser: Parser, valid: Path) -> list[Path]:
    """What may be damaged, relative to the valid files, in order."""
    found = {path.relative_to(valid) for pattern in parser.files for path in valid.glob(pattern) if path.is_file()}
    return sorted(found)


def _write(target: Path, content: bytes) -> None:
    target.unlink()
    target.write_bytes(content)


def _place(kind: str, target: Path) -> None:
    target.unlink()
    if kind == "folder":
        target.mkdir()
    elif kind == "loop":
        target.symlink_to(target.name)
    elif kind == "pipe":
        os.mkfifo(target)
    elif kind == "dangling":
        target.symlink_to("nowhere")
    elif kind == "endless":
        target.symlink_to("/dev/zero")


def _rename(rng: Random, target: Path) -> None:
    stem = rng.choice(_NAMES)
    new = target.with_name(stem + target.suffix)
    if rng.random() < 0.3:  # a second file of a strange name beside it
        new.write_bytes(target.read_bytes())
    else:
        target.rename(new)
