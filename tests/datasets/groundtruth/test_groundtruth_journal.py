"""A registration that was killed goes on from its journal, and progress is read from it."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from relocbench.datasets.groundtruth.registration.hypotheses import SearchResult
from relocbench.datasets.groundtruth.registration.journal import Journal, journal_progress
from relocbench.datasets.groundtruth.verification.evidence import Evidence, Registration


def outcome(node: int) -> SearchResult:
    """With numbers that few digits do not hold, and some that are unknown."""
    rng = np.random.default_rng(node)
    pose = np.eye(4) if node % 2 else np.full((4, 4), np.nan)
    pose[:3, 3] = rng.normal(size=3) / 3
    a, b, c, d, e, f = rng.random(6).tolist()
    evidence = Evidence(a, b, c, d, e, f, float("nan"), (0.1, 0.2, 1 / 3), 0.3, 0.4, 0.5)
    found = Registration(node, node + 1, pose, rng.normal(size=(6, 6)), evidence, "" if node % 2 else "too far")
    return SearchResult(found if node != 3 else None, "" if node != 3 else "nothing there")


class Work:
    """Counts how often it is done."""

    def __init__(self) -> None:
        self.done: list[int] = []

    def __call__(self, node: int) -> Callable[[], SearchResult]:
        def do() -> SearchResult:
            self.done.append(node)
            return outcome(node)

        return do


def same(a: SearchResult, b: SearchResult) -> bool:
    if a.best is None or b.best is None:
        return a.best is b.best and a.reason == b.reason
    return (
        repr(a.best.evidence) == repr(b.best.evidence)
        and np.array_equal(a.best.T_ref_query, b.best.T_ref_query, equal_nan=True)
        and np.array_equal(a.best.information, b.best.information)
        and (a.reason, a.best.reason, a.best.ref, a.best.query) == (b.reason, b.best.reason, b.best.ref, b.best.query)
    )


def run(path: Path, work: Work, nodes: range, prefix: str = "node") -> list[SearchResult]:
    journal = Journal(path)
    try:
        return [journal.remember(f"{prefix} {node}", work(node)) for node in nodes]
    finally:
        journal.close()


@pytest.mark.parametrize("torn", [b"", b'["node 4", {"rea', b"no json\n", b'["node 4"]\n'])
def test_what_was_found_is_not_found_again(tmp_path: Path, torn: bytes) -> None:
    path, whole = tmp_path / "a.journal", tmp_path / "whole.journal"
    run(path, Work(), range(4))
    path.write_bytes(path.read_bytes() + torn)
    work = Work()
    found = run(path, work, range(7))
    assert work.done == [4, 5, 6]
    assert all(same(one, outcome(node)) for node, one in enumerate(found))
    run(whole, Work(), range(7))
    assert path.read_bytes() == whole.read_bytes()


def test_a_journal_of_other_questions_is_not_believed(tmp_path: Path) -> None:
    path = tmp_path / "a.journal"
    journal = Journal(path)
    for node in range(2):
        journal.remember(f"node {node}", Work()(node))
    for node in range(2, 5):
        journal.remember(f"search {node}", Work()(node))
    journal.close()
    work = Work()
    run(path, work, range(5))
    assert work.done == [2, 3, 4]
    assert path.read_bytes().count(b"node") == 5
    again = Work()
    run(path, again, range(5))
    assert not again.done


def test_progress_is_counted_from_journals_and_ends_at_the_total(tmp_path: Path) -> None:
    paths = [tmp_path / "a.journal", tmp_path / "b.journal"]
    steps: list[int] = []
    with journal_progress(paths, [5, 3], steps.append) as complete:
        run(paths[0], Work(), range(4))
        until = time.monotonic() + 600
        while sum(steps) < 4 and time.monotonic() < until:
            time.sleep(0.02)
        assert sum(steps) == 4
        run(paths[1], Work(), range(6))  # searches are no nodes, and count no further than there are
        complete(0)
        complete(1)
    assert sum(steps) == 8
