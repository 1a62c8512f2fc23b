"""Fixtures of the tests of the procedural town."""

from __future__ import annotations

from collections.abc import Iterator

import pytest


@pytest.fixture(scope="module", autouse=True)
def towns(towns_kept: None) -> None:
    """Every module here renders streets."""


@pytest.fixture(scope="module")
def renderer_kept() -> Iterator[None]:
    """Builds of one street in one condition share a renderer, as the images of one build do; to make it takes seconds.

    Worker processes make their own.
    """
    from relocbench.datasets.synthetic.jobs import latest, pair_sets

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pair_sets, "forget_renderer", lambda: None)
        yield
    latest.forget_renderer()
