"""The blocks of a drive on disk, one file each: ``FOLDER/NODE.npz`` holds the arrays of a :class:`Block`.

``FOLDER/blocks.yaml`` says what drive they were made from and with which options.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from relocbench.datasets.core.npy import parse_npz
from relocbench.datasets.groundtruth.blocks.blocks import Block, Nodes
from relocbench.datasets.groundtruth.blocks.making import BlockOptions, make_blocks, reader_of, wheel_height
from relocbench.datasets.groundtruth.blocks.nodes import ArcLength, arc_length_along
from relocbench.datasets.sensors.recording import FieldRecording
from relocbench.errors import DatasetError
from relocbench.execution import Run, chunks, run_units
from relocbench.files import atomic_write, dump_yaml, load_yaml_values, read_bytes, remove_parts, write_text
from relocbench.progress import Reporter, Silent

_FORMAT = 2
_NODES_A_UNIT = 32
"""nodes of a unit of work; the scans of ``reach`` nodes at its ends are read by the neighbouring units as well"""
_MOST_BYTES = 2**28
"""largest file that is read: 5 million points, where a block has some thousand"""
_TYPES = {"points": (np.float32, 3), "normals": (np.float32, 3), "origins": (np.float32, 3),
          "surface": (np.uint8, 0), "steady": (np.float32, 0), "lidar": (np.uint8, 0)}  # fmt: skip


class BlockStore:
    """The blocks of a folder; those used last are kept in memory."""

    def __init__(self, folder: Path, capacity: int = 128) -> None:
        self.folder = folder
        self._read = lru_cache(maxsize=capacity)(lambda node: read_block(self.path(node)))

    def path(self, node: int) -> Path:
        return self.folder / f"{node:06d}.npz"

    def get(self, node: int) -> Block:
        """The block of a node. Raises DatasetError with the file if it is missing or damaged."""
        return self._read(node)

    def is_whole(self, node: int) -> bool:
        """Whether the file of a block exists and is undamaged."""
        try:
            read_block(self.path(node))
        except DatasetError:
            return False
        return True


@dataclass(frozen=True, eq=False)
class BlockUnit:
    """Blocks that a worker makes as one unit of work."""

    recording: FieldRecording
    arc_length: ArcLength
    nodes: Nodes
    wanted: tuple[int, ...]
    wheel_height_m: float
    options: BlockOptions
    folder: Path

    def __str__(self) -> str:
        return f"blocks {self.wanted[0]} to {self.wanted[-1]} of {self.recording.name}"


def build_blocks(
    recording: FieldRecording,
    nodes: Nodes,
    folder: Path,
    run: Run | None = None,
    reporter: Reporter | None = None,
    options: BlockOptions | None = None,
) -> BlockStore:
    """Make the blocks of a drive that are missing or damaged. The files are the same for any number of workers.

    Raises:
        DatasetError: the folder holds blocks of another drive or of other options, or a scan is damaged.
    """
    run, reporter, options = run or Run(), reporter or Silent(), options or BlockOptions()
    folder = folder.resolve()  # workers of a cluster run in other working directories
    folder.mkdir(parents=True, exist_ok=True)
    remove_parts(folder)
    arc_length = arc_length_along(recording)
    height = _claim(folder, recording, arc_length, nodes, options, reporter)
    store = BlockStore(folder)
    missing = [k for k in range(len(nodes)) if not store.is_whole(k)]
    small = replace(recording, cameras={}, prior=None)  # enough for blocks, and quickly sent to a worker
    units = [BlockUnit(small, arc_length, nodes, wanted, height, options, folder) for wanted in _runs(missing)]
    with reporter.stage(f"points of {recording.name}", len(missing)) as advance:
        repeats: set[tuple[str, int]] = set()
        for at, found in run_units(make_unit, units, run):
            advance(len(units[at].wanted))
            repeats |= found
    if repeats:
        lidar, index = min(repeats)
        time = int(next(one for one in recording.lidars if one.name == lidar).times_ns[index])
        reporter.note(
            f"{recording.name}: {len(repeats)} scans have the very points of the scan before, though the car moved "
            f"(the first of {lidar} at {time} ns); they are left out"
        )
    return store


def make_unit(unit: BlockUnit) -> set[tuple[str, int]]:
    """Make and write the blocks of a unit. Returns lidar and index of the scans that repeat the one before."""
    store, reader = BlockStore(unit.folder), reader_of(unit.recording, unit.arc_length, unit.options)
    for node, block in make_blocks(reader, unit.nodes, unit.wanted, unit.wheel_height_m, unit.options):
        write_block(store.path(node), block)
    return reader.repeats


def write_block(path: Path, block: Block) -> None:
    """Write a block. The same block gives the same bytes, since the entries of the archive carry no times."""
    arrays = {f.name: getattr(block, f.name) for f in fields(Block)}
    if arrays["lidar"] is None:
        arrays["lidar"] = np.zeros(len(block), dtype=np.uint8)
    with atomic_write(path, "wb") as stream:
        np.savez(stream, allow_pickle=False, **arrays)


def read_block(path: Path) -> Block:
    """The block in a file. Raises DatasetError with the file if it is missing or damaged."""
    data = read_bytes(path, "a block of points", DatasetError, _MOST_BYTES)
    try:
        arrays = parse_npz(data, _TYPES, path)
    except DatasetError as bad:
        raise DatasetError(f"is not a complete block of points ({bad.expected})", path) from None
    count = len(arrays["points"]) if arrays["points"].ndim else 0
    for name, (kind, width) in _TYPES.items():
        if arrays[name].dtype != kind or arrays[name].shape != ((count, width) if width else (count,)):
            raise DatasetError(f"'{name}' is {arrays[name].dtype} {arrays[name].shape}", path)
    return Block(**arrays)


def _runs(missing: Sequence[int]) -> list[tuple[int, ...]]:
    """The missing nodes by unit of work; units begin at multiples of :data:`_NODES_A_UNIT`."""
    groups: dict[int, list[int]] = {}
    for node in missing:
        groups.setdefault(node // _NODES_A_UNIT, []).append(node)
    return [tuple(part) for group in groups.values() for part in chunks(group, _NODES_A_UNIT)]


def _claim(
    folder: Path,
    recording: FieldRecording,
    arc_length: ArcLength,
    nodes: Nodes,
    options: BlockOptions,
    reporter: Reporter,
) -> float:
    """Write what the blocks of a folder are made from, or check that it agrees. Returns the height of the road."""
    path = folder / "blocks.yaml"
    made_of = {
        "format_version": _FORMAT,
        "drive": recording.name,
        "nodes_sha256": _digest(nodes),
        "options": asdict(options),
    }
    if path.exists():
        known, _ = load_yaml_values(path, "what blocks were made of", DatasetError)
        height = known.pop("wheel_height_m", None)
        if known != made_of or not isinstance(height, float):
            raise DatasetError("the folder holds blocks of another drive or other options; choose another folder", path)
        return height
    height = wheel_height(recording, arc_length, nodes, options)
    if not np.isfinite(height):
        reporter.note(f"{recording.name}: no road was found under the car, so no points are classified as ground")
    write_text(path, dump_yaml(made_of | {"wheel_height_m": height}))
    return height


def _digest(nodes: Nodes) -> str:
    """SHA-256 of the nodes that blocks depend on."""
    digest = hashlib.sha256(json.dumps(len(nodes)).encode())
    for part in (nodes.times_ns, nodes.T_odom_node, nodes.travelled_m, nodes.segments(), *nodes.begins_and_ends()):
        digest.update(np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()
