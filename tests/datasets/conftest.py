"""Recordings and datasets that the tests of several files share; none of them is changed."""

from __future__ import annotations

from pathlib import Path

import pytest
from kitti_street import record_kitti_street
from robotcar_street import SMALL, Built, RobotCarStreet, build_robotcar_street, record_robotcar_street


@pytest.fixture(scope="session")
def robotcar_street() -> RobotCarStreet:
    return record_robotcar_street.original()


@pytest.fixture(scope="session")
def robotcar_built() -> Built:
    """The dataset of the left stereo camera."""
    return build_robotcar_street.original(*SMALL)


@pytest.fixture(scope="session")
def kitti_street() -> Path:
    """Two sequences along the fenced street."""
    return record_kitti_street.original()
