"""The one exception family for mistakes that a user can mend."""

from __future__ import annotations

from pathlib import Path


class RelocbenchError(Exception):
    """Bad input or bad use. The command line prints it as one line and exits with 2.

    Args:
        expected: what is wrong and what was expected.
        path: the file or folder in question, if any.
        line: 1-based line number in ``path``, if any.
    """

    def __init__(self, expected: str, path: Path | str | None = None, line: int | None = None) -> None:
        self.expected = expected
        self.path = None if path is None else Path(path)
        self.line = line
        super().__init__(str(self))

    def __reduce__(self) -> tuple[type, tuple[str, Path | None, int | None]]:
        return type(self), (
            self.expected,
            self.path,
            self.line,
        )  # survives the way back from a worker process

    def __str__(self) -> str:
        if self.path is None:
            return self.expected
        place = str(self.path) if self.line is None else f"{self.path}:{self.line}"
        return f"{place}: {self.expected}"


class DatasetError(RelocbenchError):
    """A recording or dataset on disk is missing something or holds something impossible."""


class PredictionError(RelocbenchError):
    """A predictions file or a results folder does not fit the dataset it claims to answer."""


class MethodError(RelocbenchError):
    """A method cannot be found, cannot be configured, or breaks the contract."""


class ConfigError(RelocbenchError):
    """A configuration file or a command-line value is not understood."""
