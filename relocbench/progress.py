"""The interface by which long-running work reports progress, whoever receives it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol

Advance = Callable[[int], None]


class Reporter(Protocol):
    """Receives progress and notes. The command line shows bars; a library user may pass :class:`Silent`."""

    def stage(self, description: str, total: int) -> AbstractContextManager[Advance]:
        """Begin a stage of ``total`` units; the context's value is called with the number of units just done."""
        ...

    def note(self, message: str) -> None:
        """Tell the user something: an assumption that was made, or a file that was left out."""
        ...


class Silent:
    """A reporter that ignores everything."""

    @contextmanager
    def stage(self, description: str, total: int) -> Iterator[Advance]:
        yield lambda count: None

    def note(self, message: str) -> None:
        return None


SILENT: Reporter = Silent()
"""the reporter of library users who name none"""
