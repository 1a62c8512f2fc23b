"""Matching quality on the leaderboard: how often a method's per-pixel Gauss-Newton finds the true pixel."""

from __future__ import annotations

from collections.abc import Sequence

from relocbench.evaluation.tables.matching import OFFSETS_PX, Summary, summarize_matching
from relocbench.evaluation.tables.schema import ALL
from relocbench.evaluation.tracking.score import groups_of
from relocbench.leaderboard.common.text import Value, number
from relocbench.leaderboard.tracking.method import Method
from relocbench.leaderboard.tracking.model import Board, DatasetBoard
from relocbench.pages.markdown import escaped, table_text


def matching_lines(dataset: DatasetBoard, pair_set: str) -> list[tuple[Method, Summary]]:
    """The methods measured on a pair set, best first by the share found within 3 px from all starts."""
    known = [(m, summarize_matching(m.matching[pair_set])) for m in dataset.entry.methods if pair_set in m.matching]
    known = [(method, summary) for method, summary in known if summary[ALL]["count"]]
    return sorted(known, key=lambda line: (-(line[1][ALL]["match@3px"] or 0.0), line[0].label))


def matching_numbers(lines: Sequence[tuple[Method, Summary]]) -> str:
    """The page's table of methods that :func:`matching_lines` gives; one at least."""
    asked = (ALL, *(f"{offset}px" for offset in OFFSETS_PX))
    rows = [[escaped(method.label), *(_cell(summary, o, "match") for o in asked)] for method, summary in lines]
    rows.append(["*the starts themselves*", *(_cell(lines[0][1], o, "start") for o in asked)])
    return table_text(["method", "all starts", *(f"{offset} px off" for offset in OFFSETS_PX)], rows, left=1)


def matching_rows(board: Board) -> list[dict[str, Value]]:
    """The rows of ``matching.csv``: one for each pair set, group, method and start offset; shares 0..1."""
    return [
        {
            "dataset": dataset.entry.record.name,
            "fingerprint": dataset.entry.record.fingerprint,
            "pair_set": pair_set,
            "group": group,
            "method": method.label,
            "start": start,
            **values,
        }
        for dataset in board.datasets
        for pair_set in dataset.entry.pair_sets
        for method, _ in matching_lines(dataset, pair_set)
        for group in groups_of(method.matching[pair_set])
        for start, values in summarize_matching(method.matching[pair_set], group).items()
    ]


def _cell(summary: Summary, offset: str, what: str) -> str:
    return f"{number(summary[offset][f'{what}@1px'], 'share')} / {number(summary[offset][f'{what}@3px'], 'share')}"
