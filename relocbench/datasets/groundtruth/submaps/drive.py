"""A drive as registration uses it: cut into blocks on disk, from which submaps are put together."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from relocbench.datasets.groundtruth.blocks.blocks import Nodes
from relocbench.datasets.groundtruth.blocks.making import BlockOptions
from relocbench.datasets.groundtruth.blocks.nodes import make_nodes
from relocbench.datasets.groundtruth.blocks.store import BlockStore, build_blocks
from relocbench.datasets.groundtruth.submaps.submaps import SubmapWindow
from relocbench.datasets.sensors.recording import FieldRecording
from relocbench.execution import Run
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

    def window(self, length_m: float) -> SubmapWindow:
        """Submaps of ``length_m`` of road."""
        return SubmapWindow(self.nodes, self.store(), length_m / 2)


def make_drive(
    recording: FieldRecording, folder: Path, block_m: float, options: BlockOptions, reporter: Reporter, run: Run
) -> Drive:
    """Cut a drive into blocks of ``block_m``; blocks that are in ``folder`` already are kept.

    Raises:
        DatasetError: a scan is damaged, the odometry does not cover the scans' times, or ``folder`` holds the blocks of
            another drive.
    """
    nodes = make_nodes(recording, block_m)
    build_blocks(recording, nodes, folder, run, reporter, options)
    return Drive(replace(recording, cameras={}), nodes, folder)
