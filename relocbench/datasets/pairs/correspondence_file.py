"""Files of ground-truth correspondences, as Parquet: one row group a pair."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from relocbench.arrays import Floats
from relocbench.datasets.core.pairfile import PairKey
from relocbench.datasets.pairs.correspondences import Correspondences, PairCorrespondences
from relocbench.datasets.pairs.visibility import CHECKS
from relocbench.errors import DatasetError
from relocbench.files import atomic_write, plain_file

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
MOST_ROWS = 2**20
"""rows of a pair: one for each of a million pixels; files written here have at most 60,000"""


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
