"""What is put to the test: a reader, the valid files it starts from, and what of them is damaged."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

Read = Callable[["Place"], Iterable[str] | None]
"""reads ``Place.target`` or what stands around it; may return what it would tell a user"""


class RefusedError(Exception):
    """A command told its user, in one line, why it does not do what it was asked; the text is that line."""


@dataclass(frozen=True)
class Place:
    """Where a reader works. Nothing outside ``out`` may change."""

    root: Path
    """of the input: a copy of the parser's valid files, one of them damaged"""
    target: Path
    """the damaged file"""
    out: Path
    """an empty folder for what is written"""


@dataclass(frozen=True)
class Parser:
    """One reader of foreign input."""

    name: str
    seed: str
    """of :data:`fuzz.catalogue.SEEDS`: what writes its valid files"""
    files: tuple[str, ...]
    """patterns below the input's root: what is damaged"""
    read: Read
    text: bool = False
    """whether the files are text, so that texts of their words are tried as well"""
    names: bool = False
    """whether names of files carry a meaning and are damaged as well"""
    resumes: bool = False
    """whether it is to go on in the input's folder, and may change it"""
    brief: bool = True
    """whether it is quick enough for the run of the test suite"""
