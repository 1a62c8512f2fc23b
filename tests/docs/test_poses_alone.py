"""The page of poses alone does what it says on the public trajectories that it speaks of."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import tutorial_pages
from repository import DOCS, ROOT

PAGE = DOCS / "poses-alone.md"
REAL = Path(os.environ.get("RELOCBENCH_REAL_DATA", ROOT.parent / "shared" / "data")) / "fourseasons_trajectories"


@pytest.mark.thorough
@pytest.mark.skipif(not REAL.is_dir(), reason=f"no real trajectories at {REAL}")
def test_the_page_shows_what_its_commands_print(tmp_path: Path) -> None:
    (tmp_path / "trajectories").symlink_to(REAL)
    steps = tutorial_pages.steps(PAGE)
    assert sum(bool(step.shown) for step in steps) >= 7
    for step, lines in zip(steps, tutorial_pages.run(PAGE, tmp_path), strict=True):
        missing = tutorial_pages.missing_lines(step.shown, lines)
        assert not missing, f"{PAGE.name}:{step.block.line} shows\n{missing[0]}\nbut printed\n" + "\n".join(lines)
