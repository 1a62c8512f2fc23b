"""The table of answers: read by columns where that is safe, and field by field to the same answers and faults."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused

from relocbench.errors import PredictionError
from relocbench.evaluation.retrieval import answers as retrieved
from relocbench.evaluation.tables.answers import ANSWERS, Answer, read_answers
from relocbench.evaluation.tables.schema import Schema
from relocbench.files import tables

times = st.integers(0, 2**63 - 1)
optional = st.none() | st.floats(0, 1e6, allow_nan=False).map(lambda value: round(value, 6))
answers = st.builds(
    Answer,
    times,
    times,
    st.sampled_from(["ok", "failed", "error"]),
    optional,
    optional,
    st.text(st.characters(blacklist_characters="\0\r", blacklist_categories=["Cs"]), max_size=20),
    st.just("") | st.just('{"points": 3}'),
    st.none() | st.integers(0, 2**40),
)


def write(path: Path, rows: str) -> Path:
    path.write_text(f"{','.join(ANSWERS.columns[:7])}\n{rows}")  # as it may come from elsewhere
    return path


@settings(max_examples=60)
@given(st.lists(answers, max_size=12, unique_by=lambda answer: answer.key), st.integers(1, 5))
def test_columns_and_fields_give_the_answers_that_were_written(
    tmp_path_factory: pytest.TempPathFactory, written: list[Answer], chunk: int
) -> None:
    path = tmp_path_factory.mktemp("answers") / "set.csv"
    ANSWERS.write(path, written)
    expected = {answer.key: answer for answer in written}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tables, "CHUNK_ROWS", chunk)
        assert read_answers(path) == expected
        some = set(list(expected)[::2])
        assert read_answers(path, some) == {key: expected[key] for key in some}
        patch.setattr(Schema, "together", lambda schema, rows: None)
        assert read_answers(path) == expected


@pytest.mark.parametrize(
    ("row", "names"),
    [
        ("1,2,ok,,,,", ("1 2",)),
        ("x,2,ok,,,,", ("x",)),
        ("3,9223372036854775808,ok,,,,", (9223372036854775808,)),
        ("3,4,fine,,,,", ("status", "fine")),
        ("3,4,ok,-1,,,", ("seconds", -1)),
        ("3,4,ok,nan,,,", ("seconds", "nan")),
        ("3,4,ok,1,1_0,,", ("confidence", "1_0")),
        ("3,4,ok,1", (7, 4)),
        ('3,4,ok,1,,"open,', ()),
    ],
)
@pytest.mark.parametrize("chunk", [1, 2, 100])
def test_a_bad_row_is_named_wherever_chunks_end(
    row: str, names: tuple[object, ...], chunk: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tables, "CHUNK_ROWS", chunk)
    path = write(tmp_path / "set.csv", f'1,2,ok,0.5,0.25,"two\nlines",\n7,8,failed,,,,\n{row}\n')
    with refused(PredictionError, "set.csv", 5, *names):
        read_answers(path)


def test_a_row_that_names_no_pair_is_read_whichever_are_asked_for(tmp_path: Path) -> None:
    path = write(tmp_path / "set.csv", "1,2,ok,,,,\nx,2,ok,,,,\n")
    with refused(PredictionError, "set.csv", 3, "x"):
        read_answers(path, {(1, 2)})


@pytest.mark.parametrize("ranks", ["", "1 4", " 1  4 ", "4 1", "2 2", "0 1", "1_0", "+1", "٣", "1\t2", str(2**63)])
def test_ranks_are_read_by_columns_as_they_are_by_fields(
    ranks: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "task.csv"
    path.write_text(f"{','.join(retrieved.ANSWERS.columns)}\nq0,,ok,3,1 2,,\nq1,,ok,3,{ranks},,\n", encoding="utf-8")

    def outcome() -> object:
        try:
            return retrieved.ANSWERS.read(path)
        except PredictionError as bad:
            return str(bad)

    by_columns = outcome()
    monkeypatch.setattr(Schema, "together", lambda schema, rows: None)
    assert outcome() == by_columns
