"""Two recordings of one small street in the RobotCar layout, and the dataset built from them without their images."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from command_line import Outcome
from recording_reading import Truth
from robotcar_street import RobotCarStreet, build_robotcar_street

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.importers.robotcar.recording import read_robotcar_drives
from relocbench.geometry import invert
from relocbench.progress import Silent


@dataclass(frozen=True)
class RigDrives:
    """Two recordings, and what the builder made of them."""

    folders: tuple[Path, ...]
    truths: tuple[Truth, ...]
    T_car_rig: np.ndarray
    out: Path
    outcome: Outcome

    @property
    def pair_set(self) -> str:
        return f"{self.folders[0].name}__{self.folders[1].name}__rig"

    @property
    def dataset(self) -> Dataset:
        return Dataset(self.out)

    @property
    def pairs(self) -> list[Pair]:
        return list(self.dataset.pair_set(self.pair_set).all_pairs)

    def exact(self, pair: Pair) -> np.ndarray:
        """``T_query_ref`` of the rig as the importer defines it."""
        ref, query = self.truths
        T_world_ref = ref.rig(pair.ref_timestamp_ns) @ self.T_car_rig
        T_world_query = query.rig(pair.query_timestamp_ns) @ self.T_car_rig
        return np.asarray(invert(T_world_query) @ T_world_ref)


def rig_drives(street: RobotCarStreet, *options: object) -> RigDrives:
    """The dataset of poses of the rig that these options make of the street; nobody may change it."""
    built = build_robotcar_street.original(*options)
    truths = street.truth(street.reference), street.truth(street.query)
    # The recording states where sensors are on its car, the importer where they are on its rig.
    lidar = read_robotcar_drives(list(street.folders), cameras=(), reporter=Silent())[0].lidars[0]
    T_car_rig = truths[0].T_rig[lidar.name] @ invert(lidar.T_rig_lidar)
    return RigDrives(street.folders, truths, T_car_rig, built.root, built.outcome)
