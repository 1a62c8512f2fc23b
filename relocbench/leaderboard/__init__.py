"""Leaderboards: tables and pages from a results folder alone; the datasets are not needed."""

from relocbench.leaderboard.tracking.load import load_results
from relocbench.leaderboard.tracking.method import Method
from relocbench.leaderboard.tracking.model import RANKING, Board, DatasetBoard, DatasetEntry, Row, SeedRow, Table
from relocbench.leaderboard.tracking.tables import make_board
from relocbench.leaderboard.tracking.write import write_leaderboard

__all__ = [
    "RANKING",
    "Board",
    "DatasetBoard",
    "DatasetEntry",
    "Method",
    "Row",
    "SeedRow",
    "Table",
    "load_results",
    "make_board",
    "write_leaderboard",
]
