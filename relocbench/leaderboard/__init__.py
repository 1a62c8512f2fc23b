"""Leaderboards: tables and pages from a results folder alone; the datasets are not needed."""

from relocbench.leaderboard.tracking.load import DatasetEntry, Method, load_results
from relocbench.leaderboard.tracking.model import Board, DatasetBoard, Row, SeedRow, Table
from relocbench.leaderboard.tracking.tables import RANKING, make_board
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
