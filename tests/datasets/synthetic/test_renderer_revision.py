"""A renderer that shows something else has another revision, or old and new datasets would claim one question."""

from __future__ import annotations

import json

import numpy as np
import pytest
from rendered_summary import GOLDEN, summary

from relocbench.datasets.synthetic.renderer.revision import RENDERER_REVISION

HOW = "raise RENDERER_REVISION and write the golden values anew: python tests/support/rendered_summary.py"


@pytest.mark.thorough
def test_what_is_rendered_is_what_the_revision_says() -> None:
    """The renderer is asked; processors differ by a grey level here and there, which means of blocks hardly show."""
    golden = json.loads(GOLDEN.read_text())
    assert golden["revision"] == RENDERER_REVISION, f"the golden values are of another revision; {HOW}"
    found = summary()
    assert found["frames"].keys() == golden["frames"].keys()
    for name, frame in golden["frames"].items():
        for what, most, exceptions in (("pose", 1e-7, 0), ("colour", 1.0, 1), ("depth_m", 0.002, 1)):
            # A ray that passes an edge by a hair may fall on its other side elsewhere.
            apart = np.sort(np.abs(np.array(found["frames"][name][what]) - np.array(frame[what])))
            assert apart[-1 - exceptions] <= most, f"{what} of {name} is off by up to {apart[-1]:.3g}; {HOW}"
