"""The short run: every reader of foreign files stands some damaged ones, and the harness sees those that do not."""

from __future__ import annotations

from pathlib import Path

import pytest
from fuzz.catalogue import catalogue_of
from fuzz.run import Outcome, fuzz

KNOWN = catalogue_of()
QUICK = [name for name, parser in KNOWN.parsers.items() if parser.brief]
INPUTS, FIRST = 2, 1
"""of each parser; the number 0 is a text that is drawn, which takes a while for each format"""


def told(outcome: Outcome) -> str:
    """What failed, for whoever has to mend it."""
    lines = [f"{f.kind}: {f.where}\n{f.cases[0]}\n{f.detail[-1500:]}" for f in outcome.faults.values()]
    return "\n\n".join(lines)


@pytest.mark.thorough
def test_no_damaged_file_gives_a_traceback_a_hang_or_takes_a_gibibyte(tmp_path: Path) -> None:
    outcome = fuzz(
        KNOWN, tmp_path / "seeds", tmp_path / "work", QUICK, inputs=INPUTS, first=FIRST, keep=tmp_path / "kept"
    )
    assert not outcome.failed, told(outcome)
    assert outcome.total == INPUTS * len(QUICK)
    counts = outcome.summary()
    assert counts["refused"] > 0.3 * outcome.total
    assert counts["accepted"] > 0.1 * outcome.total
