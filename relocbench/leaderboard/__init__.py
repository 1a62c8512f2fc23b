"""Tables, plots and pages from a results folder alone; the datasets need not be at hand."""

from relocbench.leaderboard.load import DatasetEntry, Method, load_results
from relocbench.leaderboard.model import Board, DatasetBoard, Row, SeedRow, Table
from relocbench.leaderboard.tables import RANKING, make_board
from relocbench.leaderboard.write import write_board, write_leaderboard

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
    "write_board",
    "write_leaderboard",
]
