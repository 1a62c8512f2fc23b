"""Recordings and datasets that the tests of several files share; none of them is changed."""

from __future__ import annotations

from pathlib import Path

import pytest
from kitti_street import record_kitti_street
from robotcar_street import Built, RobotCarStreet, build_robotcar, record_robotcar_street


@pytest.fixture(scope="session")
def robotcar_street(tmp_path_factory: pytest.TempPathFactory) -> RobotCarStreet:
    return record_robotcar_street(tmp_path_factory.mktemp("robotcar"))


@pytest.fixture(scope="session")
def robotcar_built(robotcar_street: RobotCarStreet, tmp_path_factory: pytest.TempPathFactory) -> Built:
    """The dataset of the left stereo camera, by the command a user types."""
    out = tmp_path_factory.mktemp("built") / "dataset"
    outcome = build_robotcar(out, *robotcar_street.folders)
    assert outcome.status == 0, outcome.err
    return Built(out, outcome)


@pytest.fixture(scope="session")
def kitti_street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sequences along the fenced street."""
    return record_kitti_street(tmp_path_factory.mktemp("kitti"))
