"""Drives that the tests of several layouts write anew; none of them is changed."""

from __future__ import annotations

import pytest
from recorded_street import StreetDrive, record_street, street_scene

from relocbench.datasets.synthetic.lidar.lidar import LidarScene


@pytest.fixture(scope="session")
def drives(tmp_path_factory: pytest.TempPathFactory) -> list[StreetDrive]:
    """Two drives of 2.6 s along the fenced street, with a spinning lidar and a camera, in the Boreas layout."""
    out = tmp_path_factory.mktemp("boreas drives")
    return [record_street(out, number, azimuths=360) for number in range(2)]


@pytest.fixture(scope="session")
def scene() -> LidarScene:
    """The fenced street, for casting rays against it."""
    return street_scene()
