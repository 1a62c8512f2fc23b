"""Solved pose graphs on disk: the poses of the nodes of two drives in one frame, for people and for pictures.

``REF__QUERY.csv`` has the reference's nodes first, then those of the query.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from relocbench.arrays import Array, Mask, Times
from relocbench.datasets.core.pairfile import parse_pose
from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.errors import DatasetError
from relocbench.files import parse_timestamp, read_csv, write_table
from relocbench.geometry import interpolate, path_lengths, transform_to_tq

GRAPH_COLUMNS = (
    *("traversal", "node", "timestamp_ns", "tx", "ty", "tz", "qx", "qy", "qz", "qw"),
    *("m_since_trusted", "m_to_trusted", "registered", "verdict"),
)


@dataclass(frozen=True, eq=False)
class PlacedDrive:
    """The nodes of one drive with their poses by the pose graph."""

    name: str
    times_ns: Times
    """(K,)"""
    T_world_node: Array
    """(K, 4, 4)"""
    arc_length_to_trusted: Array
    """(K, 2) arc length back to the last and on to the next trusted registration, metres; inf where there is none"""
    verdicts: Mapping[int, str]
    """node -> why its registration is not part of the graph, or an empty string if it is; for nodes that were tried"""

    def __len__(self) -> int:
        return len(self.times_ns)

    @property
    def travelled_m(self) -> Array:
        """(K,) arc length along the nodes, metres."""
        return path_lengths(self.T_world_node[:, :3, 3])

    @property
    def connected(self) -> Mask:
        """(K,) whether trusted registrations tie each node to the other drive."""
        return np.asarray(np.isfinite(self.arc_length_to_trusted).any(axis=1))

    def nodes(self) -> Nodes:
        """The nodes with poses by the graph, as submaps are put together from them."""
        return Nodes(self.times_ns, self.T_world_node, self.travelled_m)

    def nearest(self, time_ns: int) -> int:
        """The node that is nearest in time."""
        return int(np.argmin(np.abs(self.times_ns - time_ns)))

    def arc_length_at(self, time_ns: int) -> float:
        """Arc length at a time, metres."""
        start = int(self.times_ns[0])
        return float(np.interp((time_ns - start) / 1e9, (self.times_ns - start) / 1e9, self.travelled_m))

    def at(self, time_ns: int) -> Array:
        """(4, 4) ``T_world_rig`` at a time, interpolated between nodes: good to centimetres, enough for pictures."""
        after = int(np.clip(np.searchsorted(self.times_ns, time_ns), 1, max(len(self) - 1, 1)))
        if len(self) == 1:
            return np.asarray(self.T_world_node[0])
        begin, end = int(self.times_ns[after - 1]), int(self.times_ns[after])
        share = min(max((time_ns - begin) / max(end - begin, 1), 0.0), 1.0)
        return interpolate(self.T_world_node[after - 1], self.T_world_node[after], share)


def write_graph(path: Path, reference: PlacedDrive, query: PlacedDrive) -> None:
    """Write the poses of both drives' nodes, and the distances along the road to trusted registrations."""
    rows = []
    for drive in (reference, query):
        poses = np.hstack(transform_to_tq(drive.T_world_node)).tolist()
        for node, (pose, lengths) in enumerate(zip(poses, drive.arc_length_to_trusted.tolist(), strict=True)):
            verdict = drive.verdicts.get(node)
            to_trusted = ("" if np.isinf(length) else f"{length:.3f}" for length in lengths)
            place = (drive.name, node, int(drive.times_ns[node]))
            rows.append([*place, *pose, *to_trusted, int(verdict == ""), verdict or ""])
    write_table(path, GRAPH_COLUMNS, rows)


def read_graph(path: Path, reference: str, query: str) -> tuple[PlacedDrive, PlacedDrive]:
    """Read both drives as :func:`write_graph` wrote them; arc lengths are rounded to millimetres.

    Raises:
        DatasetError: the file is not such a table, or not of these drives; names the line.
    """
    rows = read_csv(path, "a solved pose graph", DatasetError)
    if next(rows, (1, []))[1] != list(GRAPH_COLUMNS):
        raise DatasetError("expected a solved pose graph; remove the file and build again", path, 1)
    lines: dict[str, list[tuple[int, dict[str, str]]]] = {reference: [], query: []}
    for number, row in rows:
        if len(row) != len(GRAPH_COLUMNS) or row[0] not in lines:
            raise DatasetError(f"expected a node of {reference} or {query}", path, number)
        lines[row[0]].append((number, dict(zip(GRAPH_COLUMNS, row, strict=True))))
    first, second = (_drive(name, lines[name], path) for name in (reference, query))
    return first, second


def _drive(name: str, lines: list[tuple[int, dict[str, str]]], path: Path) -> PlacedDrive:
    if not lines:
        raise DatasetError(f"holds no node of {name}", path)
    times, poses, lengths, verdicts = [], [], [], {}
    for node, (number, row) in enumerate(lines):
        if row["node"] != str(node):
            raise DatasetError(f"node is '{row['node']}', expected {node}", path, number)
        times.append(parse_timestamp(row["timestamp_ns"], path, number, DatasetError))
        poses.append(parse_pose([row[c] for c in ("tx", "ty", "tz", "qx", "qy", "qz", "qw")], path, number))
        try:
            lengths.append([float(row[c]) if row[c] else np.inf for c in ("m_since_trusted", "m_to_trusted")])
        except ValueError:
            raise DatasetError("m_since_trusted and m_to_trusted must be numbers or empty", path, number) from None
        if row["registered"] == "1" or row["verdict"]:
            verdicts[node] = row["verdict"]
    return PlacedDrive(name, np.array(times, dtype=np.int64), np.array(poses), np.array(lengths), verdicts)
