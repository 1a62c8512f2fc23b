"""Published rows of R@1 and AP: those that one positive a query allows, and those that it does not."""

from __future__ import annotations

import csv
import io
from decimal import Decimal
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused

from relocbench.errors import RelocbenchError
from relocbench.metrics import check_single_positive_tables, single_positive_fault
from relocbench.metrics.retrieval.tables import read_tables

PAGE = """\
# Drone to satellite

Some words | with a bar, and no table.

| system | R@1 | AP |
| --- | ---: | :---: |
| fine | 75.93 | 79.14 |
| **too high** | 75.93 | 81.96 |
| too low | **75.93** | 75.91 % |
| not run | - | – |
| a \\| b | 50 | 50 |
| scattered | 75.9 ± 0.3 | 79.1 (0.2) |
| a word | about 76 | 79 |
| too much | 101.2 | 99 |
| short | 75.93 |
|  | 10 | 40 |

```
| system | R@1 | AP |
| --- | --- | --- |
| an example | 1 | 99 |
```

| epoch | loss |
| --- | --- |
| 1 | 0.5 |

Method | Recall @1 (%) | mAP
---|---|---
second table | 20 | 45.1
"""


def lines_of(text: str, path: str = "table.md") -> list[str]:
    return [str(fault) for fault in check_single_positive_tables(text, path).faults]


def test_every_wrong_row_of_a_page_is_one_line_with_file_and_row() -> None:
    assert lines_of(PAGE) == [
        "table.md:8: too high: AP 81.96 is above 81.95, the most that R@1 75.93 allows with one positive",
        "table.md:9: too low: AP 75.91 is below R@1 75.93; with one positive it cannot be",
        "table.md:13: a word: R@1 'about 76' is not a number; expected percent such as 75.93",
        "table.md:14: too much: R@1 101.2 is above 100 percent",
        "table.md:15: short: 2 cells; expected 3, as in the header",
        "table.md:16: row 10: AP 40 is above 32.50, the most that R@1 10 allows with one positive",
        "table.md:30: second table: AP 45.1 is above 40.00, the most that R@1 20 allows with one positive",
    ]
    check = check_single_positive_tables(PAGE, "table.md")
    assert (check.checked, check.not_reported) == (9, 1)


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_csv_of_any_usual_delimiter_says_the_same(delimiter: str) -> None:
    table = io.StringIO()
    writer = csv.writer(table, delimiter=delimiter, lineterminator="\n")
    writer.writerow(["method", "R1", "R5", "AP"])
    writer.writerow([f"LPN{delimiter} 4 parts", "75.93", "90", "79.14"])
    table.write("\n")
    writer.writerow(["other", "75.93", "90", "90.5"])
    writer.writerow(["two\nlines", "10", "20", "5"])
    writer.writerow(["none", "", "", ""])
    text = "\ufeff# printed by somebody\n" + table.getvalue()
    assert lines_of(text, "table.csv") == [
        "table.csv:5: other: AP 90.5 is above 81.95, the most that R@1 75.93 allows with one positive",
        "table.csv:7: two lines: AP 5 is below R@1 10; with one positive it cannot be",
    ]
    check = check_single_positive_tables(text, "table.csv")
    assert (check.checked, check.not_reported) == (3, 1)


@pytest.mark.parametrize(
    ("recall", "ap", "fault"),
    [
        ("75.93", "75.93", None),
        ("75.93", "75.92", None),  # 75.925 and 75.925
        ("75.93", "75.91", "below"),
        ("76", "75.5", None),  # 75.5 and 75.5
        ("76", "75.4", "below"),
        ("75.93", "81.95", None),  # the bound is 81.9475
        ("75.93", "81.96", "above"),  # from 81.955, and 81.95125 at most
        ("75", "82", None),  # 75.5 allows 81.625, and 82 may be 81.5
        ("75", "83", "above"),
        ("100", "100", None),
        ("100.0", "99.9", None),
        ("100", "99", None),  # 99.5 and 99.5
        ("100", "98", "below"),
        ("99.99", "100.00", None),
        ("0", "25", None),
        ("0.0", "25.1", "above"),
        ("100.01", "100", "100 percent"),
        ("7593", "79.14", "100 percent"),
        ("75,93", "79.14", "not a number"),
        ("82-84", "79.14", "not a number"),
        ("nan", "79.14", "not a number"),
        ("-5", "79.14", "not a number"),
    ],
)
def test_bounds_allow_for_what_rounding_took(recall: str, ap: str, fault: str | None) -> None:
    found = single_positive_fault(recall, ap)
    assert found is None if fault is None else found is not None and fault in found


@given(
    st.lists(st.integers(0, 400), min_size=1, max_size=40),
    st.integers(0, 4),
    st.integers(0, 4),
)
@settings(deadline=None)
def test_true_rows_pass_however_they_are_rounded(places: list[int], of_recall: int, of_ap: int) -> None:
    n = len(places)
    recall = Decimal(100 * sum(place == 0 for place in places)) / n
    mrr = sum((Decimal(100) / (place + 1) for place in places), Decimal(0)) / n
    printed = f"{recall:.{of_recall}f}", f"{(recall + mrr) / 2:.{of_ap}f}"
    assert single_positive_fault(*printed) is None


@given(st.decimals(0, 100, places=2), st.decimals(0, 100, places=2))
@settings(deadline=None)
def test_a_row_fails_exactly_where_no_true_row_rounds_to_it(recall: Decimal, ap: Decimal) -> None:
    half = Decimal("0.005")
    possible = ap + half >= recall - half and ap - half <= min(Decimal(100), 25 + (recall + half) * 3 / 4)
    assert (single_positive_fault(str(recall), str(ap)) is None) == possible


def test_a_table_of_shares_is_told() -> None:
    shares = "name,R@1,AP\na,0.7593,0.7914\nb,0.5,0.55\n"
    assert lines_of(shares) == ["table.md:1: name | R@1 | AP: no number above 1; expected percent, not shares"]
    assert lines_of("name,R@1,AP\na,0,0\n") == []


def test_columns_can_be_named() -> None:
    text = "system,D2S R@1,D2S AP,S2D R@1,S2D AP\nLPN,75.93,90,86.45,74.79\n"
    with refused(RelocbenchError, "t.csv", None, "R@1", "AP"):
        check_single_positive_tables(text, Path("t.csv"))
    check = check_single_positive_tables(text, "t.csv", recall_column="d2s r@1", ap_column="D2S AP")
    assert [fault.line for fault in check.faults] == [2]
    with refused(RelocbenchError, "t.csv", None, "x", "AP"):
        check_single_positive_tables("system,R@1,AP\n", "t.csv", recall_column="x")


def test_two_columns_of_one_name_are_refused() -> None:
    text = "\n| system | R@1 | AP | Recall@1 | AP |\n|---|---|---|---|---|\n| a | 1 | 2 | 3 | 4 |\n"
    with refused(RelocbenchError, "t.md", 2, "R@1", "Recall@1"):
        check_single_positive_tables(text, "t.md")


@pytest.mark.parametrize("text", ["", "no table at all", "| system | AP |\n|---|---|\n| a | 2 |\n", "# a comment\n"])
def test_a_file_without_such_a_table_is_an_error_with_its_name(text: str) -> None:
    with refused(RelocbenchError, "empty.md", None, "R@1", "AP"):
        check_single_positive_tables(text, "empty.md")


def test_tables_are_read_with_their_lines_and_without_markup() -> None:
    first, second, third = read_tables(PAGE)
    assert (first.line, first.header) == (5, ("system", "R@1", "AP"))
    assert (first.rows[1].line, first.rows[1].cells) == (8, ("too high", "75.93", "81.96"))
    assert first.rows[4].cells == ("a | b", "50", "50")
    assert (second.header, second.rows[0].cells) == (("epoch", "loss"), ("1", "0.5"))
    assert (third.line, third.header, third.rows[0].line) == (28, ("Method", "Recall @1 (%)", "mAP"), 30)
