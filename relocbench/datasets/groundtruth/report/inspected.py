"""The ground truth of a dataset, read from its files, as pictures and tables are made from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.groundtruth.blocks.store import BlockStore
from relocbench.datasets.groundtruth.calibration.files import read_calibration
from relocbench.datasets.groundtruth.pairs.reasons import by_kind, common, kind_of
from relocbench.datasets.groundtruth.pose_graph.files import PlacedDrive, read_graph
from relocbench.datasets.groundtruth.pose_graph.selection import evenly_spaced
from relocbench.datasets.groundtruth.registration.files import read_registrations
from relocbench.datasets.groundtruth.registration.scene_scale import read_scale
from relocbench.datasets.groundtruth.submaps.submaps import SubmapWindow
from relocbench.datasets.groundtruth.verification.evidence import Registration
from relocbench.errors import DatasetError
from relocbench.geometry import invert

_KINDS = 4
"""number of kinds of rejection that are drawn; the table has all"""
FOLDER = "groundtruth"


@dataclass(frozen=True, eq=False)
class InspectedSet:
    """One pair set with the solved drives and registrations that it came from."""

    pair_set: PairSet
    conditions: str
    """``reference → query``"""
    reference: PlacedDrive
    query: PlacedDrive
    registrations: Sequence[Registration]
    """one for each query node that was tried"""
    stores: tuple[BlockStore, BlockStore]
    """blocks of the reference and the query"""
    limit_m: float | None
    """limit on sigmas of positions above which a pair was rejected; None if the dataset does not state it"""
    limit_deg: float | None
    """the same on sigmas of rotations"""
    enlarged: float = 1.0
    """how many times the metres of drives, registrations and blocks are enlarged; pairs and limits are in metres"""

    @property
    def name(self) -> str:
        return self.pair_set.name

    def window(self, side: int, half_length_m: float) -> SubmapWindow:
        """Submaps, put together by the graph with all points kept, of the reference (0) or the query (1)."""
        drive = (self.reference, self.query)[side]
        return SubmapWindow(drive.nodes(), self.stores[side], half_length_m, voxel_m=0.0)

    def connected(self, pair: Pair) -> bool:
        """Whether the graph connects the nodes of a pair, so that their relative pose is known."""
        i, j = self.reference.nearest(pair.ref_timestamp_ns), self.query.nearest(pair.query_timestamp_ns)
        return bool(self.reference.connected[i] and self.query.connected[j])


@dataclass(frozen=True, eq=False)
class Spot:
    """A pair that is drawn, and the reason for choosing it."""

    pair: Pair
    why: str


def inspected_sets(dataset: Dataset, pair_sets: Sequence[PairSet]) -> list[InspectedSet]:
    """The pair sets whose ground truth is from lidar, with their graphs and registrations.

    Raises:
        DatasetError: there are none, or a file of the ground truth is missing or damaged.
    """
    folder = dataset.root / FOLDER
    if not folder.is_dir():
        sources = sorted({p.source for s in pair_sets for p in s.pairs if p.source})
        message = f"; its truth is of '{', '.join(sources)}'" if sources else ""
        raise DatasetError(f"no ground truth from lidar (there is no folder {FOLDER}){message}", dataset.root)
    inspected = [s for s in pair_sets if _graph_file(folder, s).exists()]
    if not inspected:
        names = ", ".join(s.name for s in pair_sets) or "any pair set"
        raise DatasetError(f"no pose graph of {names}", folder / "graph")
    return [_inspect(dataset, folder, pair_set) for pair_set in inspected]


def _graph_file(folder: Path, pair_set: PairSet) -> Path:
    return folder / "graph" / f"{pair_set.reference}__{pair_set.query}.csv"


def _inspect(dataset: Dataset, folder: Path, pair_set: PairSet) -> InspectedSet:
    names = pair_set.reference, pair_set.query
    drives = read_graph(_graph_file(folder, pair_set), *names)
    kept = read_calibration(folder)
    blocks = [folder / kept.blocks.get(name, f"blocks/{name}") for name in names]
    registrations = folder / kept.registrations.get(names[1], "registrations")
    conditions = [str(dataset.traversal(name).condition) for name in names]
    options = dataset.file.made_by.get("options", {})
    limits = [options.get(key) for key in ("max_sigma", "max_sigma_rotation")] if isinstance(options, dict) else []
    known = [float(v) if isinstance(v, int | float) else None for v in limits] or [None, None]
    scale = read_scale(folder)
    known[0] = known[0] if scale.max_sigma_m is None else scale.max_sigma_m
    return InspectedSet(
        pair_set,
        " → ".join(conditions),
        *drives,
        read_registrations(registrations / f"{names[0]}__{names[1]}.csv"),
        (BlockStore(blocks[0]), BlockStore(blocks[1])),
        known[0],
        known[1],
        scale.factor,
    )


def chosen_spots(pairs: Sequence[Pair], count: int) -> list[Spot]:
    """The pairs to draw: the least certain accepted one, ``count`` accepted ones evenly along the drive, and one of
    each of the most frequent kinds of rejection."""
    accepted = [p for p in pairs if p.accepted]
    spots: list[Spot] = []
    known = [p for p in accepted if p.sigma_translation_m is not None]
    if known:
        worst = max(known, key=lambda p: p.sigma_translation_m or 0.0)
        spots.append(Spot(worst, "the least certain accepted pair"))
    even = [accepted[row] for row in evenly_spaced(len(accepted), count)]
    spots += [Spot(p, "evenly along the drive") for p in even if not spots or p.key != spots[0].pair.key]
    rejected = [p for p in pairs if not p.accepted]
    for kind, same in list(by_kind(reason_of(p) for p in rejected).items())[:_KINDS]:
        members = [p for p in rejected if kind_of(reason_of(p)) == kind]
        spots.append(Spot(members[len(members) // 2], f"one of {len(members)} rejected: {common(same)}"))
    return spots


def reason_of(pair: Pair) -> str:
    """Why a pair was rejected."""
    return pair.reason or "no reason given"


@dataclass(frozen=True, eq=False)
class Relative:
    """The relative pose of two nodes and its source."""

    ref: int
    query: int
    T_ref_query: Array | None
    """(4, 4) node to node; None if it is unknown"""
    source: str


def relative_pose(inspected: InspectedSet, pair: Pair) -> Relative:
    """The relative pose of the nodes of a pair: by the graph if it connects them, else by a refused one nearby.

    If it is by the graph, the reference node is the one nearest to the query node, not to the keyframe.
    """
    j = inspected.query.nearest(pair.query_timestamp_ns)
    i = inspected.reference.nearest(pair.ref_timestamp_ns)
    if inspected.connected(pair):
        apart = np.linalg.norm((inspected.reference.T_world_node - inspected.query.T_world_node[j])[:, :3, 3], axis=1)
        i = int(np.argmin(np.where(inspected.reference.connected, apart, np.inf)))
        return Relative(
            i, j, invert(inspected.reference.T_world_node[i]) @ inspected.query.T_world_node[j], "pose graph"
        )
    tried = [
        r for r in inspected.registrations if np.isfinite(r.T_ref_query).all() and 0 <= r.ref < len(inspected.reference)
    ]
    if tried:
        near = min(tried, key=lambda r: abs(r.query - j))
        if abs(near.query - j) <= 3:
            return Relative(near.ref, near.query, near.T_ref_query, f"a refused registration ({near.reason})")
    return Relative(i, j, None, "")
