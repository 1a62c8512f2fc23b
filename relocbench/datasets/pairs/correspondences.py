"""Ground-truth correspondences: which query pixel sees the surface point of a reference pixel, stored as Parquet.

How visibility is decided, and with which tolerances, is described in :mod:`relocbench.datasets.pairs.visibility`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from relocbench.arrays import Array, Mask
from relocbench.datasets.core import pairfile
from relocbench.datasets.core.build import Build
from relocbench.datasets.core.build_options import ImportOptions
from relocbench.datasets.core.layout import DatasetLayout, pair_set_name
from relocbench.datasets.core.pairfile import Pair, PairKey
from relocbench.datasets.core.traversal import Traversal
from relocbench.datasets.pairs.pixel_sigma import pixel_sigma
from relocbench.datasets.pairs.visibility import CHECKS, DepthView, ReferencePoints, see
from relocbench.errors import DatasetError
from relocbench.execution import run_units
from relocbench.files import atomic_write, plain_file
from relocbench.geometry import Camera
from relocbench.tracking import Reference

SCHEMA = pa.schema(
    [
        ("ref_timestamp_ns", pa.int64()),
        ("query_timestamp_ns", pa.int64()),
        ("u_ref", pa.float32()),
        ("v_ref", pa.float32()),
        ("depth_ref", pa.float32()),
        ("u_query", pa.float32()),
        ("v_query", pa.float32()),
        ("visible", pa.bool_()),
        ("check", pa.dictionary(pa.int8(), pa.string())),
    ]
)
SIGMA = pa.field("sigma_px", pa.float32())
"""a last column, in files of pairs whose true poses have a sigma"""
_CELLS = 24
"""cells along the longer side of the image, over which samples are spread"""
MOST_ROWS = 2**20
"""rows of a pair: one for each of a million pixels; files written here have at most 60,000"""
_WORTH_WORKERS = 40
"""pairs; fewer are finished before worker processes have started"""
_OVERLAP_PIXELS = 60_000
"""pixels of a keyframe that are sampled for the overlap, which is then accurate to 0.002 (one sigma)"""


@dataclass(frozen=True, eq=False)
class Correspondences:
    """Rows of a correspondence file as arrays of equal length."""

    ref_timestamp_ns: NDArray[np.int64]
    query_timestamp_ns: NDArray[np.int64]
    uv_ref: Array
    """(N, 2) pixels"""
    depth_ref: Array
    """(N,) metres along z"""
    uv_query: Array
    """(N, 2) pixels, within the query's image"""
    visible: Mask
    """(N,) whether the query sees the point; otherwise something hides it"""
    check: tuple[str, ...]
    """how that was decided: both, self or none"""
    sigma_px: Array | None = None
    """(N,) one standard deviation of the query's pixel; None if the file has no such column"""

    def __len__(self) -> int:
        return len(self.depth_ref)


@dataclass(frozen=True, eq=False)
class PairCorrespondences:
    """The correspondences of one pair, in raster order of the reference pixels."""

    uv_ref: Array
    """(N, 2)"""
    depth_ref: Array
    """(N,) metres"""
    uv_query: Array
    """(N, 2)"""
    visible: Mask
    check: NDArray[np.int8]
    """(N,) index into CHECKS"""
    overlap: float
    """share of the reference's pixels with depth that the query sees"""
    sigma_px: Array | None = None
    """(N,) one standard deviation of the query's pixel, if that of the pose is known"""

    def __len__(self) -> int:
        return len(self.depth_ref)


def pair_correspondences(
    reference: Reference,
    T_query_ref: Array,
    query: DepthView,
    count: int,
    rng: np.random.Generator,
    sigma_pose: tuple[float, float] | None = None,
) -> PairCorrespondences:
    """Up to ``count`` correspondences of a pair, spread over the reference image, and the pair's overlap.

    They are sampled from the reference pixels whose points project into the query's image, visible there or hidden.

    Args:
        count: greatest number of correspondences.
        sigma_pose: one standard deviation of the pose per direction, metres and radians; gives pixels a sigma too.
    """
    points = ReferencePoints.of(reference)
    if len(points) > _OVERLAP_PIXELS:
        points = points.take(np.sort(rng.choice(len(points), _OVERLAP_PIXELS, replace=False)))
    seen = see(points, T_query_ref, DepthView(reference.camera, reference.depth, reference.depth_sigma), query)
    overlap = float(np.mean(seen.visible)) if len(points) else 0.0
    inside = np.nonzero(seen.inside)[0]
    rows = inside[spread_sample(points.uv[inside], reference.camera, count, rng)]
    chosen, sigma = points.take(rows), None
    if sigma_pose is not None:
        sigma = pixel_sigma(chosen, reference.camera, query.camera, T_query_ref, *sigma_pose)
    return PairCorrespondences(
        chosen.uv, chosen.depth, seen.uv_query[rows], seen.visible[rows], seen.check[rows], overlap, sigma
    )


def spread_sample(pixels: Array, camera: Camera, count: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Rows of up to ``count`` of the pixels (N, 2), sampled evenly over cells of the image, in increasing order.

    No cell gives a second pixel before every cell has given one.
    """
    if len(pixels) <= count:
        return np.arange(len(pixels))
    side = max(camera.size) / _CELLS
    row, column = np.floor(pixels[:, 1] / side).astype(int), np.floor(pixels[:, 0] / side).astype(int)
    cell = row * (_CELLS + 1) + column
    shuffled = rng.permutation(len(pixels))
    by_cell = shuffled[np.argsort(cell[shuffled], kind="stable")]
    counts = np.unique(cell, return_counts=True)[1]
    turn = np.empty(len(pixels), dtype=np.int64)
    turn[by_cell] = np.arange(len(pixels)) - np.repeat(np.cumsum(counts) - counts, counts)
    first = shuffled[np.argsort(turn[shuffled], kind="stable")[:count]]
    return np.sort(first)


@dataclass(frozen=True, eq=False)
class _Unit:
    """One pair to process."""

    reference: Traversal
    query: Traversal
    camera: str
    pair: Pair
    count: int
    seed: int


def _work(unit: _Unit) -> PairCorrespondences:
    pair, camera = unit.pair, unit.camera
    assert pair.T_query_ref is not None
    entry = unit.query.file.cameras[camera]
    query = DepthView(entry.camera, unit.query.depth(camera, pair.query_timestamp_ns), entry.depth_sigma)
    rng = np.random.default_rng([unit.seed, *(time % 2**64 for time in pair.key)])
    reference = unit.reference.reference(camera, pair.ref_timestamp_ns)
    return pair_correspondences(reference, pair.T_query_ref, query, unit.count, rng, _sigma_pose(pair))


def _sigma_pose(pair: Pair) -> tuple[float, float] | None:
    """Sigma of the pose in metres and radians; None if unknown."""
    if pair.sigma_translation_m is None or pair.sigma_rotation_deg is None:
        return None
    return pair.sigma_translation_m, float(np.radians(pair.sigma_rotation_deg))


def write_pair_set(job: Build[ImportOptions], reference: str, query: str, camera: str, pairs: Sequence[Pair]) -> None:
    """Write a pair set with the overlap of each pair and, if the options want any, a file of correspondences.

    The traversals must have been written before. Pairs that are rejected or have no pose get neither overlap nor
    correspondences. A set that an earlier run of the same build has finished is kept unchanged.
    """
    layout, count = job.writer.layout, job.options.correspondences
    name = pair_set_name(reference, query, camera)
    ordered = sorted(pairs, key=lambda p: p.key)
    if is_finished(layout, name, ordered, with_correspondences=count > 0):
        return
    traversals = [Traversal(layout.traversal(t)) for t in (reference, query)]
    measured = [p for p in ordered if p.accepted and p.T_query_ref is not None]
    units = [_Unit(traversals[0], traversals[1], camera, pair, count, job.options.seed) for pair in measured]
    run = job.run if len(units) >= _WORTH_WORKERS else job.run.alone()
    with job.reporter.stage(f"correspondences of {name}", len(units)) as advance:

        def results() -> Iterator[tuple[PairKey, PairCorrespondences]]:
            for index, found in _in_order(run_units(_work, units, run)):
                yield measured[index].key, found
                advance(1)

        sigma = any(_sigma_pose(p) is not None for p in measured)
        write_measured(layout, name, ordered, results(), with_correspondences=count > 0, sigma=sigma)


def write_measured(
    layout: DatasetLayout,
    name: str,
    pairs: Sequence[Pair],
    measured: Iterable[tuple[PairKey, PairCorrespondences]],
    *,
    with_correspondences: bool,
    sigma: bool = False,
) -> None:
    """Write a pair set: first its correspondences, if wanted, and last its pairs with the measured overlaps.

    Args:
        pairs: all pairs of the set, sorted by their keys.
        measured: results for some or all of the pairs, which are consumed one at a time.
        sigma: as in :func:`write_correspondences`.
    """
    overlaps: dict[PairKey, float] = {}

    def noted() -> Iterator[tuple[PairKey, PairCorrespondences]]:
        for key, found in measured:
            overlaps[key] = found.overlap
            yield key, found

    if with_correspondences:
        write_correspondences(layout.correspondence_file(name), noted(), sigma=sigma)
    else:
        for _ in noted():
            pass
    complete = [replace(p, overlap=overlaps.get(p.key, p.overlap)) for p in pairs]
    pairfile.write_pairs(layout.pair_file(name), layout.pair_table(name), complete)


def write_correspondences(
    path: Path, pairs: Iterable[tuple[PairKey, PairCorrespondences]], *, sigma: bool = False
) -> None:
    """Write a correspondence file, one row group per pair. Only one pair is in memory at a time.

    Args:
        sigma: add the column ``sigma_px``, with nan for pairs without sigma.
    """
    schema = SCHEMA.append(SIGMA) if sigma else SCHEMA
    with atomic_write(path, "wb") as stream, pq.ParquetWriter(stream, schema, compression="zstd") as table:
        for key, found in pairs:
            if len(found):
                table.write_table(_table(key, found, schema), row_group_size=len(found))


@contextmanager
def open_correspondences(path: Path) -> Iterator[pq.ParquetFile]:
    """Open a correspondence file and check its footer.

    Raises:
        DatasetError: the file is missing, not a Parquet file or has other columns or types, or reading it fails later.
    """
    if not plain_file(path, "correspondences (Parquet)", DatasetError).is_file():
        raise DatasetError("missing; expected correspondences (Parquet)", path)
    try:
        with pq.ParquetFile(path) as file:
            _check_schema(file.schema_arrow, path)
            yield file
    except (pa.ArrowException, OSError, ValueError, MemoryError) as bad:
        reason = " ".join(str(bad).split())[:160]
        raise DatasetError(f"not a whole Parquet file ({reason}); expected correspondences", path) from None


def _check_schema(schema: pa.Schema, path: Path) -> None:
    if schema.names not in (SCHEMA.names, [*SCHEMA.names, SIGMA.name]):
        raise DatasetError(f"expected the columns {','.join(SCHEMA.names)}[,{SIGMA.name}]", path)
    for wanted in [*SCHEMA, SIGMA][: len(schema)]:
        found = schema.field(wanted.name).type
        if wanted.name == "check":
            values = found.value_type if pa.types.is_dictionary(found) else found
            known = pa.types.is_string(values) or pa.types.is_large_string(values)
        elif pa.types.is_floating(wanted.type):
            known = found in (pa.float32(), pa.float64())
        else:
            known = found == wanted.type
        if not known:
            kind = str(found).split("<")[0][:40]
            raise DatasetError(f"column '{wanted.name}' is {kind}, expected {wanted.type}", path)


def read_group(file: pq.ParquetFile, group: int, path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """The rows of one row group, which are those of one pair.

    Raises:
        DatasetError: there are too many rows (compressed, equal rows take hardly any space), or values are missing.
    """
    check_rows(file, group, path)
    table = file.read_row_group(group, columns=columns, use_threads=False)
    for name in table.column_names:
        if table[name].null_count:
            raise DatasetError(f"column '{name}' has {table[name].null_count} rows without a value", path)
    return table


def check_rows(file: pq.ParquetFile, group: int, path: Path) -> None:
    """Raise DatasetError if a row group has more rows than a pair can have."""
    rows = file.metadata.row_group(group).num_rows
    if not 0 <= rows <= MOST_ROWS:
        raise DatasetError(f"row group {group} has {rows} rows; a pair has at most {MOST_ROWS}", path)


def key_of(group: pq.RowGroupMetaData, path: Path) -> PairKey:
    """The pair of a row group, from its statistics: a group holds one pair, so the least timestamp is the only one.

    Raises:
        DatasetError: the file has no such statistics.
    """
    times = []
    for column in (0, 1):
        known = group.column(column).statistics
        if known is None or not known.has_min_max or not isinstance(known.min, int):
            raise DatasetError("has no Parquet statistics of the timestamps, which name each row group's pair", path)
        times.append(known.min)
    return times[0], times[1]


def read_correspondences(path: Path, key: PairKey | None = None) -> Correspondences:
    """Read all rows of a correspondence file, or only those of one pair.

    Raises:
        DatasetError: the file is missing, not a Parquet file, or has other columns.
    """
    with open_correspondences(path) as file:
        groups = range(file.num_row_groups)
        wanted = [g for g in groups if key is None or key_of(file.metadata.row_group(g), path) == key]
        tables = [read_group(file, group, path) for group in wanted]
        empty = file.schema_arrow.empty_table()
        return _as_arrays(pa.concat_tables([empty, *tables], promote_options="permissive"))


def iterate_correspondences(path: Path) -> Iterator[Correspondences]:
    """The rows of a correspondence file, one pair at a time.

    Raises:
        DatasetError: like :func:`read_correspondences`.
    """
    with open_correspondences(path) as file:
        for group in range(file.num_row_groups):
            yield _as_arrays(read_group(file, group, path))


def _as_arrays(table: pa.Table) -> Correspondences:
    names = table.column_names
    column: dict[str, Any] = {name: table[name].to_numpy() for name in names if name != "check"}
    return Correspondences(
        column["ref_timestamp_ns"],
        column["query_timestamp_ns"],
        np.column_stack([column["u_ref"], column["v_ref"]]).astype(np.float64),
        column["depth_ref"].astype(np.float64),
        np.column_stack([column["u_query"], column["v_query"]]).astype(np.float64),
        column["visible"],
        tuple(table["check"].to_pylist()),
        column[SIGMA.name].astype(np.float64) if SIGMA.name in column else None,
    )


def _table(key: PairKey, found: PairCorrespondences, schema: pa.Schema) -> pa.Table:
    columns = [
        np.full(len(found), key[0], dtype=np.int64),
        np.full(len(found), key[1], dtype=np.int64),
        *(v.astype(np.float32) for v in (*found.uv_ref.T, found.depth_ref, *found.uv_query.T)),
        found.visible,
        pa.DictionaryArray.from_arrays(pa.array(found.check), pa.array(CHECKS)),
    ]
    if SIGMA.name in schema.names:
        columns.append(
            np.full(len(found), np.nan, np.float32) if found.sigma_px is None else found.sigma_px.astype(np.float32)
        )
    return pa.Table.from_arrays([pa.array(c) if isinstance(c, np.ndarray) else c for c in columns], schema=schema)


def is_finished(layout: DatasetLayout, name: str, pairs: Sequence[Pair], *, with_correspondences: bool) -> bool:
    """Whether an earlier run has written this pair set; its pairs are written after the correspondences."""
    if not (layout.pair_file(name).exists() and layout.pair_table(name).exists()):
        return False
    try:
        if with_correspondences:
            with open_correspondences(layout.correspondence_file(name)):
                pass
        known = pairfile.read_pairs(layout.pair_file(name), layout.pair_table(name))
    except DatasetError:
        return False
    return [p.key for p in known] == [p.key for p in pairs]


def _in_order(results: Iterable[tuple[int, PairCorrespondences]]) -> Iterator[tuple[int, PairCorrespondences]]:
    """The results in order of their indices; early ones wait for those before them."""
    waiting: dict[int, PairCorrespondences] = {}
    due = 0
    for index, result in results:
        waiting[index] = result
        while due in waiting:
            yield due, waiting.pop(due)
            due += 1
