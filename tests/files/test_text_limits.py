"""Tables, numbers, times, JSON and messages: whatever stands in a file, the outcome is a value or one line."""

from __future__ import annotations

import csv
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from relocbench.datasets.core import fingerprint
from relocbench.datasets.core.images import read_points
from relocbench.datasets.core.layout import DatasetLayout
from relocbench.datasets.core.pair_table import read_pairs
from relocbench.datasets.core.traversal import read_poses
from relocbench.datasets.groundtruth.pose_graph.files import read_graph
from relocbench.datasets.groundtruth.registration.files import read_registrations
from relocbench.datasets.importers.four_seasons import files as four_seasons_files
from relocbench.datasets.importers.four_seasons.receiver import read_gga
from relocbench.datasets.importers.kitti.files import KittiSequence
from relocbench.datasets.importers.robotcar import files as robotcar_files
from relocbench.datasets.sensors.pose_tables import read_trajectory
from relocbench.errors import DatasetError, RelocbenchError, quoted
from relocbench.evaluation.relocalization.answers import PIPELINE
from relocbench.evaluation.relocalization.basin import read_basins
from relocbench.evaluation.retrieval.answers import ANSWERS as RETRIEVED
from relocbench.evaluation.tables.answers import ANSWERS
from relocbench.evaluation.tables.answers import read_answers as read_pair_answers
from relocbench.evaluation.tables.errors import read_errors
from relocbench.evaluation.tables.matching import MATCHING
from relocbench.files import (
    parse_count,
    parse_floats,
    parse_json,
    read_csv,
    read_journal,
    read_rows,
    read_table,
    read_text,
    seconds_to_ns,
    whole_number,
)
from relocbench.files.plain import MAX_BYTES
from relocbench.metrics.retrieval.plausibility import check_single_positive_tables
from relocbench.progress import Silent

LONG = "x" * (csv.field_size_limit() + 1)
READERS: dict[str, Callable[[Path], Any]] = {
    "answers of a tracker": read_pair_answers,
    "errors": read_errors,
    "matching": MATCHING.read,
    "a chain": PIPELINE.read,
    "answers of a retriever": RETRIEVED.read,
    "radii": read_basins,
    "poses": read_poses,
    "registrations": read_registrations,
    "a graph": lambda path: read_graph(path, "a", "b"),
    "a manifest": lambda path: fingerprint.read_manifest(DatasetLayout(path.parent)),
    "a pair set": lambda path: read_pairs(path.parent / "pairs.txt", path),
    "points": read_points,
    "KITTI times": lambda path: KittiSequence(path.parent, "00").times(10.0, 1, Silent()),
    "a trajectory": read_trajectory,
    "GNSS poses": four_seasons_files.read_gnss_poses,
    "4Seasons times": four_seasons_files.read_times,
    "RobotCar times": robotcar_files.read_timestamps,
}
FOREIGN = {
    "a field over the limit": f"a,{LONG}\n".encode(),
    "a quotation mark that is not closed": b'a,"b\n1,2\n',
    "a NUL character": b"a,b\n1,\0\n",
    "no UTF-8": b"a,b\n\xff\xfe\n",
    "superscript digits": "²²,²²\n".encode(),
    "5,000 digits": b"1" * 5000 + b" 2\n",
    "an overflow": b"1e400 2 3\n",
    "line separators": "a\x0bb\x0cc\x1cd\x85e\u2028f\n".encode(),
    "escape sequences": b"\x1b]0;title\x07,\x1b[31m\n",
}


@pytest.mark.parametrize("read", READERS.values(), ids=READERS.keys())
def test_foreign_text_in_any_table_is_one_short_printable_line(read: Callable[[Path], Any], tmp_path: Path) -> None:
    (tmp_path / "pairs.txt").touch()
    (tmp_path / "sequences" / "00").mkdir(parents=True)
    for name, data in FOREIGN.items():
        path = tmp_path / "manifest.csv"
        path.write_bytes(data)
        (tmp_path / "sequences" / "00" / "times.txt").write_bytes(data)
        with pytest.raises(RelocbenchError) as raised:
            read(path)
        assert str(raised.value).isprintable(), name
        assert len(raised.value.expected) < 1000, name


@pytest.mark.parametrize(
    ("row", "names"), [(LONG, ("131,072",)), ('"open', ("quotation",)), ('"a"b', ("quotation",)), ("\0", ("NUL",))]
)
def test_what_is_no_csv_is_told_with_the_line_it_begins_on(row: str, names: tuple[str, ...], tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text(f'a\n"two\nlines"\n{row}\n')
    with refused(DatasetError, "t.csv", 4, *names):
        list(read_csv(path, "a table", DatasetError))


def test_rows_are_counted_by_the_lines_of_the_file_and_keep_their_characters(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text('a,b\r\n"1\n1",x\x0by\u2028z\n\n2,3\n', newline="")
    assert list(read_csv(path, "a table")) == [
        (1, ["a", "b"]),
        (2, ["1\n1", "x\x0by\u2028z"]),
        (4, []),
        (5, ["2", "3"]),
    ]
    with refused(RelocbenchError, "t.csv", 4, "2", "0"):
        list(read_table(path, ("a", "b")))


def test_a_message_with_any_line_break_comes_back_from_a_table_of_answers(tmp_path: Path) -> None:
    path = tmp_path / "set.csv"
    message = "first\x0bsecond\x85third\u2028fourth\nfifth"
    path.write_text(f'{",".join(ANSWERS.columns[:7])}\n1,2,error,,,"{message}",\n')
    assert read_pair_answers(path)[1, 2].message == message


def test_lines_of_text_tables_are_those_that_an_editor_counts(tmp_path: Path) -> None:
    path = tmp_path / "t.txt"
    path.write_bytes("1\x0b\u20282\r\n3\r4\n".encode())
    assert list(read_rows(path, "rows")) == [(1, ["1", "2"]), (2, ["3"]), (3, ["4"])]


def test_a_text_over_the_limit_is_not_read_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with (tmp_path / "big").open("wb") as stream:
        stream.truncate(2**20 + 1)
    assert MAX_BYTES == 512 * 2**20
    with refused(RelocbenchError, "", None, "1048577", "1048576"):
        read_text(tmp_path / "big", "poses", most_bytes=2**20)


@pytest.mark.parametrize("word", ["1_0", "infinity", "nan", "-inf", "0x10", "1e400", "٣", "²", "", "1" * 5000])
def test_only_finite_ascii_numbers_are_floats(word: str) -> None:
    with refused(DatasetError, "t.txt", 3) as raised:
        parse_floats([word], Path("t.txt"), 3, "x", DatasetError)
    assert len(str(raised.value)) < 260


@pytest.mark.parametrize("word", ["", "²", "٣", "-1", "+1", "1.0", "1_0", str(2**63), "1" * 5000])
def test_only_ascii_digits_of_64_bits_are_counts(word: str) -> None:
    assert whole_number(word) is None
    with refused(DatasetError, "t.txt", 3) as raised:
        parse_count(word, "rank", Path("t.txt"), 3, DatasetError)
    assert len(str(raised.value)) < 260
    assert whole_number(str(2**63 - 1)) == 2**63 - 1


@pytest.mark.parametrize("word", ["1e400", "1e-99999999999999999999", "9" * 5000, "1e99999999999999999999"])
def test_seconds_beyond_all_clocks_are_a_value_error(word: str) -> None:
    with refused(ValueError) as raised:
        seconds_to_ns(word)
    assert len(str(raised.value)) < 260


def test_times_of_4seasons_out_of_range_are_told_with_their_line(tmp_path: Path) -> None:
    path = tmp_path / "times.txt"
    for seconds in ("1e400", "9" * 30, "1e12", "²²", "x"):
        path.write_text(f"1602074877390449152 1602074877.390449152 1\n1602074877390449153 {seconds} 1\n")
        with refused(DatasetError, "times.txt", 2):
            four_seasons_files.read_times(path)


def test_a_sentence_of_a_receiver_with_wrong_fields_is_told_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "track.nmea"
    for fields in ("1e400,1,N,2,E,4,0,0,1,M,1,M,,", "120000,x,N,2,E,4,0,0,1,M,1,M,,", "120000,1,N"):
        body = f"GPGGA,{fields}"
        checksum = 0
        for byte in body.encode():
            checksum ^= byte
        path.write_text(f"$GPRMC\n${body}*{checksum:02X}\n")
        with refused(DatasetError, "track.nmea", 2):
            read_gga(path)


def test_frames_of_kitti_are_named_by_ascii_digits(tmp_path: Path) -> None:
    folder = tmp_path / "sequences" / "00" / "image_2"
    folder.mkdir(parents=True)
    for name in ("000001.png", "²².png", "٣.png", "9" * 30 + ".png"):
        (folder / name).touch()
    assert list(KittiSequence(tmp_path, "00").frames("image_2", ".png")) == [1]


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        ("[" * 100_000, "nested"),
        ("1" * 5000, "digits"),
        ('{"a": 1, "a": 2}', "'a'"),
        ('{"a": "\\ud800"}', "surrogate"),
        (b'{"a": "\xff"}', "utf-8"),
        ("{", "Expecting"),
    ],
)
def test_json_that_cannot_be_taken_is_a_value_error(words: str | bytes, fault: str) -> None:
    with pytest.raises(ValueError, match=fault) as raised:
        parse_json(words)
    assert len(str(raised.value)) < 300
    assert parse_json('{"a": "\\ud83d\\ude00"}') == {"a": "😀"}


@pytest.mark.parametrize(
    "torn", ['{"key": [3, 4], "m": "é'.encode()[:-1], b'{"key": [3', b"[" * 100_000 + b"\n", b"5\n"]
)
def test_a_journal_ends_before_the_line_that_is_none(torn: bytes, tmp_path: Path) -> None:
    path = tmp_path / "1.jsonl"
    path.write_bytes('{"key": [1, 2], "m": "a\u2028b\x85"}\n'.encode() + torn)
    assert read_journal(path) == [{"key": [1, 2], "m": "a\u2028b\x85"}]


def test_a_key_that_is_none_ends_a_journal(tmp_path: Path) -> None:
    for key in ("null", "5", "[[1], 2]", "[null]"):
        (tmp_path / "1.jsonl").write_text(f'{{"key": [1, 2]}}\n{{"key": {key}}}\n')
        assert [entry["key"] for entry in read_journal(tmp_path / "1.jsonl")] == [[1, 2]]


def test_a_published_table_with_an_endless_cell_is_one_line() -> None:
    with refused(RelocbenchError, "page.csv", None, "131,072"):
        check_single_positive_tables(f"R@1,AP\n1,{LONG}\n", Path("page.csv"))


@given(st.text(), st.none() | st.text(alphabet=st.characters(exclude_characters="\0")), st.none() | st.integers(1, 9))
def test_a_message_is_one_printable_line_for_any_input(expected: str, path: str | None, line: int | None) -> None:
    error = RelocbenchError(expected, path, line)
    assert str(error).isprintable()
    assert len(error.expected) <= 2000
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


@given(st.text())
def test_quoted_text_is_short_and_printable(text: str) -> None:
    assert quoted(text).isprintable()
    assert len(quoted(text)) <= 202


def test_a_message_cuts_foreign_words_and_keeps_paths() -> None:
    path = "/".join(["a long folder's name"] * 100)
    error = RelocbenchError(f"'{'x' * 5000}' is no number", path, 3)
    assert str(error) == f"{path}:3: '{'x' * 199}…' is no number"
    assert str(RelocbenchError("red \x1b[31m\nline")) == "red \\x1b[31m\\nline"


@pytest.mark.parametrize("foreign", ["images/cam0/" * 100, "2.5, ../../x, " * 100, "it's a pair's " * 100, LONG])
def test_a_message_cuts_what_stands_between_its_quotation_marks_whatever_it_holds(foreign: str) -> None:
    error = RelocbenchError(f"the method's parameter '{foreign}' is none; expected one of 'a', 'b', or the users' own")
    assert error.expected == (
        f"the method's parameter '{foreign[:199]}…' is none; expected one of 'a', 'b', or the users' own"
    )
    short = "the method's parameter 'it's x/y' is none of 'a', 'b'"
    assert str(RelocbenchError(short)) == short


def test_an_endless_path_in_a_manifest_is_cut(tmp_path: Path) -> None:
    (tmp_path / "manifest.csv").write_text(f"path,bytes,sha256\n{'a/' * 2000},1,{'0' * 64}\n")
    (fault,) = fingerprint.faults(DatasetLayout(tmp_path))
    assert str(fault).startswith(f"{tmp_path}/a/a/")
    assert "manifest.csv" in str(fault)
    assert len(str(fault)) < len(str(tmp_path)) + 300


@pytest.mark.parametrize(
    ("make", "names"),
    [
        (os.mkfifo, ("pipe",)),
        (lambda path: path.symlink_to("/dev/zero"), ("device",)),
        (lambda path: path.symlink_to("nowhere"), ()),
        (Path.mkdir, ("folder",)),
    ],
    ids=["pipe", "endless", "dangling", "folder"],
)
@pytest.mark.parametrize("read", [read_journal, read_gga, lambda path: read_text(path, "a text")])
def test_what_is_no_plain_file_is_one_line_and_not_waited_for(
    read: Callable[[Path], Any], make: Callable[[Path], None], names: tuple[str, ...], tmp_path: Path
) -> None:
    make(tmp_path / "1.jsonl")
    with refused(RelocbenchError, "1.jsonl", None, *names):
        read(tmp_path / "1.jsonl")
