"""An index of a correspondence file's row groups by pair, so that single pairs can be read in any order."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from relocbench.arrays import Floats
from relocbench.datasets.core.pairfile import PairKey
from relocbench.datasets.pairs.correspondence_file import SIGMA, key_of, open_correspondences, read_group
from relocbench.errors import DatasetError


class CorrespondenceIndex:
    """A correspondence file whose footer is read once.

    Raises:
        DatasetError: the file is missing, not a whole Parquet file, or has other columns.
    """

    def __init__(self, path: Path) -> None:
        if not path.exists():
            raise DatasetError("missing; expected correspondences (build-dataset --correspondences N)", path)
        self.path = path
        with open_correspondences(path) as file:
            self._has_sigma = SIGMA.name in file.schema_arrow.names
            self._groups = {key_of(file.metadata.row_group(g), path): g for g in range(file.metadata.num_row_groups)}

    def __contains__(self, key: PairKey) -> bool:
        return key in self._groups

    def read_visible(self, key: PairKey) -> tuple[Floats, Floats, Floats | None]:
        """Pixels (N, 2) of reference and query that are visible in both, and their sigma (N,) if the file has it.

        Raises:
            DatasetError: the file has changed since it was opened.
        """
        columns = ["u_ref", "v_ref", "u_query", "v_query", "visible", *([SIGMA.name] if self._has_sigma else [])]
        with open_correspondences(self.path) as file:
            if self._groups[key] >= file.num_row_groups:
                raise DatasetError("has fewer row groups than when it was opened", self.path)
            table = read_group(file, self._groups[key], self.path, columns)
        seen = table["visible"].to_numpy()
        value = {name: table[name].to_numpy()[seen] for name in columns if name != "visible"}
        u_ref, u_query = (np.column_stack([value[f"u_{side}"], value[f"v_{side}"]]) for side in ("ref", "query"))
        return u_ref, u_query, value.get(SIGMA.name)
