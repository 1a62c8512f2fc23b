"""The salt of a challenge: random text that only its organiser has.

It enters the seeds of what is rendered and the keys of blind exports, so that neither follows from a recipe, from
public recordings or from the truth. It is written nowhere.
"""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, Self, TypeVar

from relocbench.errors import ConfigError
from relocbench.files import read_text
from relocbench.progress import Reporter

SALT_KEY = "salt"
"""of :attr:`Salt.check` in ``made_by`` of a rendered dataset"""
SALT_FILE = (
    "file with random text that only you have (openssl rand -hex 32), which enters the seed, so that nobody else can "
    "make this dataset again; for blind exports"
)
"""help of the option of kinds whose truth follows from a seed"""
_SHORTEST, _LONGEST_BYTES = 32, 4096
_SEED_BITS = 64
_READ_BY_OTHERS = 0o004
_WHAT = "a salt: at least 32 random characters that only the organiser has"


@dataclass(frozen=True)
class Salt:
    """What a salt file holds."""

    path: Path
    _secret: bytes = field(repr=False)

    def digest(self, words: str) -> bytes:
        """(32,) bytes that stand for some words, which nobody can compute without the salt."""
        return hmac.new(self._secret, words.encode(), hashlib.sha256).digest()

    def seed(self, split: str, seed: int) -> int:
        """The seed that takes the place of one that can be guessed: 128 secret bits above it, others for each split."""
        return (int.from_bytes(self.digest(f"seed {split} {seed}")[:16], "big") << _SEED_BITS) + seed

    @property
    def check(self) -> str:
        """What a dataset keeps, so that another salt is noticed; it tells nothing of a random salt."""
        return self.digest("check").hex()[:16]


class SeededOptions(Protocol):
    """Options of a kind whose truth follows from a seed."""

    @property
    def seed(self) -> int: ...
    @property
    def salt_file(self) -> Path | None: ...
    def model_copy(self, *, update: dict[str, Any]) -> Self: ...


Options = TypeVar("Options", bound=SeededOptions)


def salted(options: Options, split: str, record: dict[str, Any], out: Path, reporter: Reporter) -> Options:
    """The options of a build, with a seed that nobody can guess where they name a salt file.

    Args:
        split: what is built with others has other seeds, so that a published split tells nothing of one that is asked.
        record: how the dataset is made, where a check of the salt is added.
        out: the folder of the dataset.

    Raises:
        ConfigError: as :func:`read_salt`.
    """
    if options.salt_file is None:
        return options
    salt = read_salt(options.salt_file, [out], reporter)
    record[SALT_KEY] = salt.check
    return options.model_copy(update={"seed": salt.seed(split, options.seed)})


def without_salt(seed: int) -> int:
    """The seed that a user gave, of one that may be salted."""
    return seed % (1 << _SEED_BITS)


def read_salt(path: Path, apart_from: Sequence[Path], reporter: Reporter) -> Salt:
    """Read a salt file; white space around the salt does not count.

    Args:
        apart_from: folders that others may be given, which the file must not lie in.

    Raises:
        ConfigError: the file is missing, is not text, holds fewer than 32 characters, or lies in one of the folders.
    """
    text = read_text(path, _WHAT, ConfigError, _LONGEST_BYTES).strip()
    if len(text) < _SHORTEST:
        raise ConfigError(f"holds {len(text)} characters; expected {_WHAT} (openssl rand -hex 32)", path)
    for folder in apart_from:
        if path.resolve().is_relative_to(folder.resolve()):
            raise ConfigError(f"lies in {folder}, and whoever is given that has the salt; keep it elsewhere", path)
    if path.stat().st_mode & _READ_BY_OTHERS:
        reporter.note(f"{path} can be read by every user of this machine (chmod 600 closes it)")
    return Salt(path, text.encode())
