"""Pair files: read what others write, write what reads back to the same numbers, name every fault by its line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import ErrorData, refused

from relocbench.datasets.checks.faults import Findings, read_pair_table
from relocbench.datasets.core import pairfile
from relocbench.datasets.core.pair_table import AXIS_COLUMNS, MEASURE_COLUMNS, TABLE_COLUMNS, read_pairs, write_pairs
from relocbench.datasets.core.pairfile import (
    UNCALIBRATED,
    Pair,
    PoseLine,
    pose_fields,
    read_pose_lines,
    write_pose_lines,
)
from relocbench.errors import DatasetError, PredictionError
from relocbench.geometry import make_transform, so3_exp

QUARTER_TURN = make_transform(so3_exp([0.0, np.pi / 2, 0.0]), [1.0, -2.0, 0.5])
finite = st.floats(-1e6, 1e6, allow_nan=False)
angles = st.floats(-3.0, 3.0, allow_nan=False)
times = st.integers(0, 2**63 - 1)


@settings(max_examples=100, deadline=None)
@given(times, times, st.tuples(finite, finite, finite), st.tuples(angles, angles, angles))
def test_what_is_written_reads_back_to_the_same_pose_and_exact_nanoseconds(
    tmp_path_factory: pytest.TempPathFactory,
    ref: int,
    query: int,
    translation: tuple[float, float, float],
    rotation: tuple[float, float, float],
) -> None:
    path = tmp_path_factory.mktemp("pairs") / "pairs.txt"
    T_query_ref = make_transform(so3_exp(rotation), translation)
    write_pose_lines(path, [PoseLine(ref, query, T_query_ref)])
    (line,) = read_pose_lines(path)
    assert line.key == (ref, query)
    assert line.T_query_ref is not None
    np.testing.assert_array_equal(line.T_query_ref[:3, 3], translation)
    np.testing.assert_allclose(line.T_query_ref[:3, :3], T_query_ref[:3, :3], atol=1e-14)


def test_columns_are_translation_then_quaternion_with_qw_last() -> None:
    half = np.sqrt(0.5)
    np.testing.assert_allclose(
        [float(f) for f in pose_fields(QUARTER_TURN)], [1, -2, 0.5, 0, half, 0, half], atol=1e-15
    )


def test_comments_commas_and_blank_lines_are_understood(tmp_path: Path) -> None:
    path = tmp_path / "pairs.txt"
    path.write_text("# ref query\n\n1,2\n3, 4, 1,-2,0.5, 0,0.7071067811865476,0,0.7071067811865476 # comment\n 5\t6\n")
    lines = read_pose_lines(path)
    assert [line.key for line in lines] == [(1, 2), (3, 4), (5, 6)]
    assert [line.line for line in lines] == [3, 4, 5]
    assert lines[0].T_query_ref is None
    assert lines[1].T_query_ref is not None
    np.testing.assert_allclose(lines[1].T_query_ref, QUARTER_TURN, atol=1e-15)


@pytest.mark.parametrize(
    ("text", "line", "names"),
    [
        ("1 2\n1 2 3\n", 2, (2, 9)),
        ("1 2\n3 4\n1 2\n", 3, ("pair 1 2", 1)),
        ("1.5 2\n", 1, ("1.5",)),
        ("1_0 2\n", 1, ("1_0",)),
        ("1 2 0 0 x 0 0 0 1\n", 1, ("tz", "x")),
        ("1 2 0 nan 0 0 0 0 1\n", 1, ("ty", "nan")),
        ("1 2 0 0 0 0 0 0 2\n", 1, ("qx qy qz qw", 2)),
        ("1 2 0 0 0 0 0 0 0\n", 1, ("qx qy qz qw", 0)),
    ],
)
def test_faults_are_named_with_file_and_line(tmp_path: Path, text: str, line: int, names: tuple[object, ...]) -> None:
    path = tmp_path / "pairs.txt"
    path.write_text(text)
    with refused(DatasetError, "pairs.txt", line, *names):
        read_pose_lines(path)


def test_predictions_may_hold_poses_that_are_not_finite_and_they_are_no_poses(tmp_path: Path) -> None:
    path = tmp_path / "predictions.txt"
    path.write_text("1 2 nan 0 0 0 0 0 1\n3 4 0 0 0 0 0 0 1\n")
    first, second = read_pose_lines(path, PredictionError, allow_non_finite=True)
    assert first.T_query_ref is None
    np.testing.assert_array_equal(second.T_query_ref, np.eye(4))


@pytest.mark.parametrize("odd", ["", "# a comment\n", "-5 6\n", "7 8 nan 0 0 0 0 0 1\n"])
def test_lines_are_the_same_read_by_columns_and_one_by_one(
    odd: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "predictions.txt"
    write_pose_lines(path, [PoseLine(1, 2, QUARTER_TURN), PoseLine(3, 4, None), PoseLine(5, 6, np.eye(4))])
    path.write_text(path.read_text() + odd + "9 10\n")
    by_columns = read_pose_lines(path, allow_non_finite=True)
    some = read_pose_lines(path, allow_non_finite=True, only={(5, 6), (9, 10)})
    monkeypatch.setattr(pairfile, "_fast", lambda rows: None)
    one_by_one = read_pose_lines(path, allow_non_finite=True)
    assert [(line.key, line.line) for line in by_columns] == [(line.key, line.line) for line in one_by_one]
    for line, other in zip(by_columns, one_by_one, strict=True):
        np.testing.assert_array_equal(line.T_query_ref, other.T_query_ref)
    assert [(line.key, line.line) for line in some] == [
        (line.key, line.line) for line in one_by_one if line.key in {(5, 6), (9, 10)}
    ]


def test_missing_file_is_named(tmp_path: Path) -> None:
    with refused(PredictionError, "absent.txt"):
        read_pose_lines(tmp_path / "absent.txt", PredictionError)


PAIRS = [
    Pair(1, 10, QUARTER_TURN, "step_1", 0.75, 0.02, 0.1, "poses"),
    Pair(2, 20, None, source="submap", accepted=False, reason="too few points, all of them flat"),
    Pair(3, 30, None),
]


def write(folder: Path, pairs: list[Pair] = PAIRS) -> tuple[Path, Path]:
    files = folder / "pairs.txt", folder / "pairs.csv"
    write_pairs(*files, pairs)
    return files


def test_a_table_keeps_what_nine_columns_cannot_and_rejected_pairs_stay_out_of_the_pair_file(tmp_path: Path) -> None:
    pair_file, table = write(tmp_path)
    assert [line.key for line in read_pose_lines(pair_file)] == [(1, 10), (3, 30)]
    assert table.read_text().splitlines()[0] == ",".join(TABLE_COLUMNS)
    back = read_pairs(pair_file, table)
    for before, after in zip(PAIRS, back, strict=True):
        bare = replace(before, T_query_ref=None)
        assert replace(after, T_query_ref=None).__dict__ == bare.__dict__
    assert back[0].T_query_ref is not None
    np.testing.assert_allclose(back[0].T_query_ref, QUARTER_TURN, atol=1e-15)
    assert back[0].distance_m == pytest.approx(np.sqrt(5.25))
    assert back[0].angle_deg == pytest.approx(90.0)
    assert back[2].distance_m is None


def test_measures_are_kept_where_they_are_known_and_hidden_with_the_truth(tmp_path: Path) -> None:
    measures: dict[str, Any] = {"scale_change": 1.25, "overlap_query": 0.75, "depth_error": 0.02, "similarity": -0.25}
    known = [replace(p, overlap=0.5, **measures) for p in PAIRS]
    pair_file, table = write(tmp_path, known)
    assert table.read_text().splitlines()[0] == ",".join(TABLE_COLUMNS + MEASURE_COLUMNS)
    values = [tuple(getattr(p, name) for name in MEASURE_COLUMNS) for p in read_pairs(pair_file, table)]
    assert values == [tuple(measures.values()), tuple(measures.values()), (None,) * 4]
    found = Findings()
    read_pair_table(table, found)
    assert not found.faults
    both = [replace(p, sigma_along_m=0.03) for p in known]
    assert [(p.sigma_along_m, p.scale_change) for p in read_pairs(*write(tmp_path, both))][:2] == [(0.03, 1.25)] * 2
    withheld = [replace(p, T_query_ref=None) for p in known]
    assert [p.similarity for p in read_pairs(*write(tmp_path, withheld)) if p.accepted] == [None, None]


def test_a_table_of_an_earlier_version_has_fewer_measures(tmp_path: Path) -> None:
    pair_file, table = write(tmp_path, [replace(p, scale_change=1.25) for p in PAIRS])
    assert table.read_text().splitlines()[0] == ",".join((*TABLE_COLUMNS, "scale_change"))
    assert [p.scale_change for p in read_pairs(pair_file, table)] == [1.25, 1.25, None]
    table.write_text(table.read_text().replace("scale_change", "sigma_along_m"))
    with refused(DatasetError, "pairs.csv", 1, "sigma_along_m,sigma_across_m,sigma_height_m"):
        read_pairs(pair_file, table)


def test_sigmas_that_are_not_calibrated_are_kept_and_used_by_no_score(tmp_path: Path) -> None:
    stated = replace(PAIRS[0], sigma_translation_m=0.003, sigma_rotation_deg=0.01)
    pairs = [stated, *(replace(stated, query_timestamp_ns=k, source=f"a recipe, {UNCALIBRATED}") for k in (20, 30))]
    first, second, _ = read_pairs(*write(tmp_path, pairs))
    assert first.calibrated_sigmas == (0.003, 0.01)
    assert second.calibrated_sigmas == (None, None)
    assert second.sigma_translation_m == 0.003


def test_sigmas_by_axis_are_kept_where_they_are_known(tmp_path: Path) -> None:
    known = replace(PAIRS[0], sigma_along_m=0.03, sigma_across_m=0.01, sigma_height_m=0.012)
    pair_file, table = write(tmp_path, [known, *PAIRS[1:]])
    assert table.read_text().splitlines()[0] == ",".join(TABLE_COLUMNS + AXIS_COLUMNS)
    back = read_pairs(pair_file, table)
    assert back[0].axis_sigmas == (0.03, 0.01, 0.012)
    assert back[1].axis_sigmas == (None, None, None)
    found = Findings()
    assert len(read_pair_table(table, found)) == 3
    assert not found.faults
    table.write_text(table.read_text().replace("0.012", "high"))
    with refused(DatasetError, "pairs.csv", 2, "high", "sigma_height_m"):
        read_pairs(pair_file, table)
    read_pair_table(table, found)
    assert len(found.faults) == 1


def test_a_pair_file_from_elsewhere_needs_no_table(tmp_path: Path) -> None:
    pair_file, table = write(tmp_path)
    table.unlink()
    assert [p.key for p in read_pairs(pair_file, table)] == [(1, 10), (3, 30)]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("2,20,,,,,,,submap,false", "2,20,,,,,,,submap,true", ("pairs.csv", 3, "2", "20", "pairs.txt")),
        ("1,10,step_1", "1,11,step_1", ("pairs.csv", 2, "1", "11")),
        ("poses,true", "poses,false", ("pairs.csv", 2, "1", "10", "pairs.txt")),
        ("0.75", "much", ("pairs.csv", 2, "much")),
        ("submap,false", "submap,no", ("pairs.csv", 3, "no")),
        ("group", "kind", ("pairs.csv", 1)),
        ("3,30,", "1,10,", ("pairs.csv", 4, "1", "10")),
    ],
)
def test_a_table_that_does_not_fit_its_pair_file_is_refused(
    tmp_path: Path, old: str, new: str, message: ErrorData
) -> None:
    pair_file, table = write(tmp_path)
    text = table.read_text()
    assert old in text
    table.write_text(text.replace(old, new, 1))
    with refused(DatasetError, *message):
        read_pairs(pair_file, table)


def test_a_pair_that_the_table_lacks_is_refused(tmp_path: Path) -> None:
    pair_file, table = write(tmp_path)
    table.write_text("\n".join(table.read_text().splitlines()[:-1]) + "\n")
    with refused(DatasetError, "pairs.txt", None, "3", "30", "pairs.csv"):
        read_pairs(pair_file, table)


def test_minus_zero_is_written_as_zero(tmp_path: Path) -> None:
    path = tmp_path / "pairs.txt"
    write_pose_lines(path, [PoseLine(1, 2, make_transform(np.eye(3), [-0.0, 0.0, 0.0]))])
    assert path.read_text() == "1 2 0.0 0.0 0.0 0.0 0.0 0.0 1.0\n"
