"""The boards of all tasks of one results folder."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from relocbench.leaderboard.displays import RELOCALIZATION, RETRIEVAL, Display
from relocbench.leaderboard.relocalization.board import PipelineBoard
from relocbench.leaderboard.retrieval.board import RetrievalBoard
from relocbench.leaderboard.tracking.model import Board


@dataclass(frozen=True)
class Boards:
    """What results hold, one board a task; None where there is nothing of it."""

    tracking: Board | None = None
    retrieval: RetrievalBoard | None = None
    relocalization: PipelineBoard | None = None

    @property
    def sets(self) -> int:
        """How many datasets and retrieval sets have a page."""
        tracked = len(self.tracking.datasets) if self.tracking is not None else 0
        return tracked + sum(len(board.sets) for board in (self.retrieval, self.relocalization) if board is not None)

    @property
    def methods(self) -> frozenset[str]:
        """The labels of all trackers and retrievers, which have a page each."""
        trackers = self.tracking.methods if self.tracking else ()
        return frozenset({*(method.label for method in trackers), *self.retrievers})

    @property
    def retrievers(self) -> list[str]:
        """The labels of all retrievers, sorted."""
        return sorted({m.label for of in (self.retrieval.sets if self.retrieval else ()) for m in of.methods})

    @property
    def by_query(self) -> list[tuple[Display[Any, Any], Any]]:
        """The boards of retrievers and of pipelines, with how they are shown."""
        both = ((RETRIEVAL, self.retrieval), (RELOCALIZATION, self.relocalization))
        return [(display, board) for display, board in both if board is not None]
