"""A drive as registration uses it: cut into blocks on disk, from which submaps are put together."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.blocks.nodes import make_nodes, nearest_nodes
from relocbench.datasets.groundtruth.blocks.store import BlockStore, build_blocks
from relocbench.datasets.groundtruth.submaps.submaps import SubmapWindow
from relocbench.datasets.sensors.recording import FieldRecording
from relocbench.execution import Run
from relocbench.geometry import invert
from relocbench.progress import Reporter


@dataclass(frozen=True, eq=False)
class Drive:
    """One drive, cut into blocks on disk."""

    recording: FieldRecording
    """without its cameras"""
    nodes: Nodes
    blocks: Path

    @property
    def name(self) -> str:
        return self.recording.name

    def store(self) -> BlockStore:
        return BlockStore(self.blocks)

    def nearest_node(self, time_ns: int) -> int:
        """The node nearest to a time on the same piece of the odometry, or of all for a time whose piece has none."""
        node = int(nearest_nodes(self.nodes, self.recording.odometry, np.array([time_ns], dtype=np.int64))[0])
        return node if node >= 0 else int(np.argmin(np.abs(self.nodes.times_ns - time_ns)))

    def from_node(self, node: int, time_ns: int) -> Array:
        """(4, 4) ``T_node_rig`` at a time that the odometry covers."""
        T_odom_rig = self.recording.odometry.at(np.array([time_ns], dtype=np.int64))[0]
        return np.asarray(invert(self.nodes.T_odom_node[node]) @ T_odom_rig)

    def window(self, length_m: float) -> SubmapWindow:
        """Submaps of ``length_m`` of road."""
        return SubmapWindow(self.nodes, self.store(), length_m / 2)


def make_drive(recording: FieldRecording, folder: Path, block_m: float, reporter: Reporter, run: Run) -> Drive:
    """Cut a drive into blocks of ``block_m``; blocks that are in ``folder`` already are kept.

    Raises:
        DatasetError: a scan is damaged, the odometry does not cover the scans' times, or ``folder`` holds the blocks of
            another drive.
    """
    nodes = make_nodes(recording, block_m)
    build_blocks(recording, nodes, folder, run, reporter)
    return Drive(replace(recording, cameras={}), nodes, folder)
