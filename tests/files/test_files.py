"""Files appear whole or not at all; text says where it is wrong."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import ErrorData, refused

from relocbench.datasets.core.schema import Condition, Strict
from relocbench.errors import DatasetError, RelocbenchError
from relocbench.files import (
    atomic_write,
    dump_yaml,
    link_file,
    load_yaml,
    parse_floats,
    parse_timestamp,
    read_journal,
    read_rows,
    read_text,
    remove_parts,
    seconds_to_ns,
    sha256_file,
    write_bytes,
    write_text,
)


def test_an_interrupted_write_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    write_text(path, "old\n")

    def interrupted() -> None:
        with atomic_write(path) as stream:
            stream.write("new, but not all of it")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_text() == "old\n"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_is_not_there_before_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "sub" / "poses.csv"
    with atomic_write(path) as stream:
        stream.write("half")
        stream.flush()
        assert not path.exists()
        (part,) = path.parent.iterdir()
        assert part.name.startswith(".")
        assert part.suffix == ".csv"
    assert path.read_text() == "half"


def test_a_full_disk_leaves_no_part_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("relocbench.files.writing.os.fsync", full)
    with pytest.raises(OSError) as raised:  # noqa: PT011
        write_bytes(tmp_path / "image.png", b"1234")
    assert raised.value.filename == str(tmp_path / "image.png")
    assert list(tmp_path.iterdir()) == []


def test_a_missing_file_of_the_writing_code_keeps_its_own_name(tmp_path: Path) -> None:
    missing = tmp_path / "absent"
    with pytest.raises(FileNotFoundError) as told, atomic_write(tmp_path / "out.txt"):
        missing.read_text()
    assert told.value.filename == str(missing)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_in_the_files_place_is_named(tmp_path: Path) -> None:
    with pytest.raises(IsADirectoryError) as told, atomic_write(tmp_path):
        pass
    assert told.value.filename == str(tmp_path)


def test_parts_of_killed_writers_are_removed_and_only_they(tmp_path: Path) -> None:
    keep = tmp_path / "a" / "image.png"
    write_bytes(keep, b"1")
    (tmp_path / "a" / ".image.1a2b3c4d.part.png").write_bytes(b"ha")
    (tmp_path / ".pairs.1a2b3c4d.part.txt").write_text("ha")
    remove_parts(tmp_path)
    assert [p for p in tmp_path.rglob("*") if p.is_file()] == [keep]


def test_a_part_that_a_living_writer_holds_is_not_removed(tmp_path: Path) -> None:
    with atomic_write(tmp_path / "table.csv") as stream:
        stream.write("1")
        remove_parts(tmp_path)
    assert (tmp_path / "table.csv").read_text() == "1"
    assert len(list(tmp_path.iterdir())) == 1


def test_text_has_the_same_bytes_everywhere(tmp_path: Path) -> None:
    write_text(tmp_path / "a.txt", "Straße\nnächste\n")
    assert (tmp_path / "a.txt").read_bytes() == "Straße\nnächste\n".encode()


def test_a_link_replaces_what_was_there_and_follows_to_the_source(tmp_path: Path) -> None:
    source = tmp_path / "source.png"
    source.write_bytes(b"image")
    path = tmp_path / "dataset" / "1.png"
    write_bytes(path, b"old")
    link_file(source, path)
    assert path.is_symlink()
    assert path.read_bytes() == b"image"
    assert sha256_file(path) == sha256_file(source)


@pytest.mark.parametrize(
    ("text", "nanoseconds"),
    [
        ("1602074877.390449152", 1602074877390449152),
        ("1602074877.39045", 1602074877390450000),
        ("1311868164.363181", 1311868164363181000),
        ("0.0000000005", 1),
        ("0.0000000004999", 0),
        ("1.9999999999", 2_000_000_000),
        ("-1.5", -1_500_000_000),
        (".5", 500_000_000),
        ("7", 7_000_000_000),
        ("1.5e3", 1_500_000_000_000),
        ("1.602074877390449152e9", 1602074877390449152),
        ("1602074877390449152e-9", 1602074877390449152),
    ],
)
def test_decimal_seconds_become_exact_nanoseconds(text: str, nanoseconds: int) -> None:
    assert seconds_to_ns(text) == nanoseconds


@given(st.integers(0, 2**62))
def test_no_nanosecond_is_lost_on_the_way_through_seconds(time: int) -> None:
    assert seconds_to_ns(f"{time // 10**9}.{time % 10**9:09d}") == time


@pytest.mark.parametrize("text", ["", "abc", "1.2.3", "1,5", "1_0.0", "--1", "1.-5", "²", "1.x", "1e", "inf", " 1"])
def test_what_is_no_decimal_number_of_seconds_is_refused(text: str) -> None:
    with refused(ValueError, "", None, f"{text!r}"):
        seconds_to_ns(text)


@pytest.mark.parametrize("text", ["1e400", "-1e30", "9" * 40 + ".5", "1e99999999999"])
def test_seconds_that_no_clock_shows_are_refused(text: str) -> None:
    with refused(ValueError):
        seconds_to_ns(text)


def test_a_timestamp_beyond_64_bits_is_refused_with_its_line() -> None:
    for text in (str(2**63), "-" + "9" * 5000):
        with refused(RelocbenchError, "pairs.txt", 3):
            parse_timestamp(text, Path("pairs.txt"), 3)
    assert parse_timestamp(str(2**63 - 1), Path("pairs.txt"), 3) == 2**63 - 1


def test_a_byte_order_mark_is_no_part_of_the_first_word(tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    path.write_bytes(b"\xef\xbb\xbf1 2\r\n3 4\r\n")
    assert list(read_rows(path, "rows")) == [(1, ["1", "2"]), (2, ["3", "4"])]


def test_rows_carry_their_line_numbers_past_comments_and_blank_lines(tmp_path: Path) -> None:
    path = tmp_path / "t.txt"
    path.write_text("# header\n1, 2\n\n3\t4 # end\n")
    assert list(read_rows(path, "rows")) == [(2, ["1", "2"]), (4, ["3", "4"])]


def test_floats_are_counted_and_named() -> None:
    path = Path("calib.txt")
    assert parse_floats(["1", "-2e3"], path, 7, "fx fy") == [1.0, -2000.0]
    with refused(RelocbenchError, "calib.txt", 7, "2", "1"):
        parse_floats(["1"], path, 7, "fx fy")
    with refused(RelocbenchError, "calib.txt", 7, "two"):
        parse_floats(["1", "two"], path, 7, "fx fy")
    with refused(RelocbenchError, "calib.txt", 7):
        parse_floats(["inf", "2"], path, 7, "fx fy")


@pytest.mark.parametrize(("make", "why"), [("absent", ()), ("folder", ("folder",)), ("binary", ("UTF-8",))])
def test_text_that_cannot_be_read_says_why_and_what_was_expected(
    tmp_path: Path, make: str, why: tuple[str, ...]
) -> None:
    path = tmp_path / "calib.txt"
    if make == "folder":
        path.mkdir()
    elif make == "binary":
        path.write_bytes(b"ab\xff")
    with refused(DatasetError, "calib.txt", None, *why, "a calibration"):
        read_text(path, "a calibration", DatasetError)


class Inner(Strict):
    size: int


class Outer(Strict):
    name: str
    condition: Condition = Condition()
    parts: tuple[Inner, ...] = ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: a\nweather: rain\n", ("t.yaml", 2, "weather")),
        ("name: a\ncondition:\n  season: summer\n  whether: rain\n", ("t.yaml", 4, "condition.whether")),
        ("name: a\nparts:\n- size: 1\n- size: big\n", ("t.yaml", 4, "parts.1.size", "big")),
        ("condition: {}\n", ("t.yaml", 1, "name")),
        ("name: [\n", ("t.yaml",)),
        ("just words\n", ("t.yaml",)),
    ],
)
def test_yaml_faults_are_named_with_line_and_key(tmp_path: Path, text: str, message: ErrorData) -> None:
    path = tmp_path / "t.yaml"
    path.write_text(text)
    with refused(DatasetError, *message):
        load_yaml(path, Outer, "a thing", DatasetError)


def test_yaml_written_reads_back_in_the_order_given(tmp_path: Path) -> None:
    path = tmp_path / "t.yaml"
    whole = Outer(name="zebra", condition=Condition(tags=("a", "b")), parts=(Inner(size=3),))
    write_text(path, dump_yaml(whole.model_dump(mode="json")))
    assert load_yaml(path, Outer, "a thing") == whole
    assert path.read_text().startswith("name: zebra\ncondition:")


def test_a_torn_last_line_of_a_journal_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    path.write_text('{"a": 1}\n{"a": 2}\n{"a": ')
    assert read_journal(path) == [{"a": 1}, {"a": 2}]
    path.write_text('{"a": 1}\n{"a": 2}')
    assert read_journal(path) == [{"a": 1}]
