"""How long-running work tells where it is, without knowing who listens."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol

Advance = Callable[[int], None]


class Reporter(Protocol):
    """Receives progress and remarks. The command line draws bars; a library user may pass nothing."""

    def stage(self, description: str, total: int) -> AbstractContextManager[Advance]:
        """Begin a stage of ``total`` units; the value of the context is called with the units just done."""
        ...

    def note(self, message: str) -> None:
        """Something the user should know: an assumption that was made, a file that was left out."""
        ...


class Silent:
    """A reporter that drops everything."""

    @contextmanager
    def stage(self, description: str, total: int) -> Iterator[Advance]:
        yield lambda count: None

    def note(self, message: str) -> None:
        return None
