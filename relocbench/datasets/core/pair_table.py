"""The pairs of a set on disk: the pair file, and beside it the table of what its nine columns cannot hold."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from relocbench.datasets.core.pairfile import (
    TRUTH_DECIMALS,
    Pair,
    PairKey,
    distances_and_angles,
    pose_text,
    read_pose_lines,
)
from relocbench.errors import DatasetError
from relocbench.files import parse_floats, parse_timestamp, read_csv, write_table, write_text

TABLE_COLUMNS = (
    "ref_timestamp_ns", "query_timestamp_ns", "group", "distance_m", "angle_deg", "overlap",
    "sigma_translation_m", "sigma_rotation_deg", "source", "accepted", "reason",
)  # fmt: skip
AXIS_COLUMNS = ("sigma_along_m", "sigma_across_m", "sigma_height_m")
"""further columns, present if known for any pair"""
MEASURE_COLUMNS = ("scale_change", "overlap_query", "depth_error", "similarity")
"""the same; each is there if it is known for any pair"""
FURTHER_COLUMNS = AXIS_COLUMNS + MEASURE_COLUMNS
MEASURES = ("overlap", *MEASURE_COLUMNS)
"""what is measured by rays or in images, of which copies of a dataset may have other pixels"""
_NUMBERS = ("overlap", "sigma_translation_m", "sigma_rotation_deg", *FURTHER_COLUMNS)


def write_pairs(pair_file: Path, pair_table: Path, pairs: Sequence[Pair]) -> None:
    """Write the accepted pairs to the nine-column file and all pairs, with everything known, to the table.

    Where the truth of a pair is withheld, so are its measures. Where that of a pair of different places is, all of the
    set's are left blank, and its groups: they would tell which pairs these are.
    """
    hidden = any(p.is_negative and p.T_query_ref is None for p in pairs)
    blank = Pair(0, 0, None)
    seen = [blank if hidden or (p.accepted and p.T_query_ref is None) else p for p in pairs]
    further = (AXIS_COLUMNS if any(s is not None for p in pairs for s in p.axis_sigmas) else ()) + tuple(
        name for name in MEASURE_COLUMNS if any(getattr(p, name) is not None for p in seen)
    )
    rows = (
        [
            *p.key,
            "" if hidden else p.group,
            *map(_written, (distance_m, angle_deg, measured.overlap)),
            *map(_written, (p.sigma_translation_m, p.sigma_rotation_deg)),
            p.source,
            "true" if p.accepted else "false",
            p.reason,
            *(_written(getattr(p if name in AXIS_COLUMNS else measured, name)) for name in further),
        ]
        for p, (distance_m, angle_deg), measured in zip(pairs, distances_and_angles(pairs), seen, strict=True)
    )
    write_table(pair_table, TABLE_COLUMNS + further, rows)
    write_text(pair_file, pose_text([p for p in pairs if p.accepted], TRUTH_DECIMALS))


def read_pairs(pair_file: Path, pair_table: Path, *, allow_non_finite: bool = False) -> list[Pair]:
    """All pairs of a set, in the table's order; rejected ones have no pose.

    A pair file from elsewhere has no table; then only the poses are known.

    Args:
        allow_non_finite: a pose that is not finite is withheld.

    Raises:
        DatasetError: with file and line, also if the file and the table do not hold the same pairs.
    """
    lines = {line.key: line for line in read_pose_lines(pair_file, allow_non_finite=allow_non_finite)}
    if not pair_table.exists():
        return [Pair(*key, line.T_query_ref) for key, line in lines.items()]
    pairs: dict[PairKey, Pair] = {}
    for number, key, field in pair_rows(pair_table):
        if field["accepted"] not in ("true", "false"):
            raise DatasetError(f"accepted is '{field['accepted']}', expected true or false", pair_table, number)
        accepted = field["accepted"] == "true"
        if accepted != (key in lines):
            where = "is missing from" if accepted else "was rejected but is listed in"
            raise DatasetError(f"pair {key[0]} {key[1]} {where} {pair_file.name}", pair_table, number)
        pairs[key] = Pair(
            key[0],
            key[1],
            lines[key].T_query_ref if accepted else None,
            group=field["group"],
            source=field["source"],
            accepted=accepted,
            reason=field["reason"],
            **{name: known_number(field.get(name, ""), name, pair_table, number) for name in _NUMBERS},
        )
    for key in lines:
        if key not in pairs:
            raise DatasetError(f"pair {key[0]} {key[1]} is missing from {pair_table.name}", pair_file)
    return list(pairs.values())


def pair_rows(
    path: Path, each: Callable[[], AbstractContextManager[None]] = nullcontext
) -> Iterator[tuple[int, PairKey, dict[str, str]]]:
    """Line number, pair and fields by column of each row of a table, the first of each pair.

    Args:
        each: entered for the table and for every row; what raises an error that it catches is left out.

    Raises:
        DatasetError: with file and line: columns that no table has, another number of fields than columns, a time that
            is none, or a pair that occurs again.
    """
    seen: set[PairKey] = set()
    with each():
        rows = read_csv(path, "the table of a pair set", DatasetError)
        columns = _columns(next(rows, (1, []))[1], path)
        for number, row in rows:
            with each():
                if len(row) != len(columns):
                    raise DatasetError(f"expected {len(columns)} columns, found {len(row)}", path, number)
                ref, query = (parse_timestamp(text, path, number, DatasetError) for text in row[:2])
                if (ref, query) in seen:
                    raise DatasetError(f"pair {ref} {query} occurs again", path, number)
                seen.add((ref, query))
                yield number, (ref, query), dict(zip(columns, row, strict=True))


def _columns(header: Sequence[str], pair_table: Path) -> tuple[str, ...]:
    """The columns named by a table's first line. Raises DatasetError if they are none of the known sets."""
    columns = tuple(header)
    further = columns[len(TABLE_COLUMNS) :]
    known = tuple(name for name in FURTHER_COLUMNS if name in further)
    by_axis = set(AXIS_COLUMNS).isdisjoint(known) or set(AXIS_COLUMNS) <= set(known)
    if columns == TABLE_COLUMNS + known and by_axis:
        return columns
    optional = "".join(f"[,{name}]" for name in (",".join(AXIS_COLUMNS), *MEASURE_COLUMNS))
    raise DatasetError(f"expected the columns {','.join(TABLE_COLUMNS)}{optional}", pair_table, 1)


def known_number(text: str, name: str, path: Path, line: int) -> float | None:
    """The number of a field, None where it is blank. Raises DatasetError with file and line."""
    return parse_floats([text], path, line, name, DatasetError)[0] if text else None


def _written(value: float | None) -> str:
    return "" if value is None else repr(round(float(value), 9))
