"""The work of a leaderboard grows with its results, not with their square; a stranger's folder gets one clear line."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from forgery import reseal
from made_results import TITLE, WINTER, MadeResults, made

import relocbench.evaluation.common.folders as folders_module
import relocbench.evaluation.common.results as results_module
from relocbench.errors import PredictionError
from relocbench.evaluation.common.results import MethodResults
from relocbench.evaluation.tables.errors import NUMBERS, ErrorTable, PairErrors, read_errors, write_errors
from relocbench.files import load_yaml, write_text
from relocbench.leaderboard import load_results, make_board, write_leaderboard
from relocbench.leaderboard.common import loading as loading_module
from relocbench.metrics import mean_interval, rank_descriptors, relevance_from_labels


def made_results(root: Path, sets: int, methods: int = 2) -> MadeResults:
    results = MadeResults(root, {f"summer__drive{i}__cam0": 12 for i in range(sets)})
    results.write_dataset()
    for number in range(methods):
        results.add(f"m{number}", {name: made(number, 12, 0.2) for name in results.pair_sets})
    return results


def test_each_record_of_a_results_folder_is_parsed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parsed: Counter[str] = Counter()

    def counted(path: Path, *rest: Any) -> Any:
        parsed[str(path.relative_to(tmp_path))] += 1
        return load_yaml(path, *rest)

    made_results(tmp_path, sets=7)
    for module in (folders_module, results_module):
        monkeypatch.setattr(module, "load_yaml", counted)
    write_leaderboard(tmp_path, tmp_path / "board")
    records = [f"{TITLE}/{method}/{name}.yaml" for method in ("m0", "m1") for name in ("run", "scores")]
    assert parsed == Counter([f"{TITLE}/dataset.yaml", *records])


def test_tables_are_computed_as_often_as_there_are_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def calls(sets: int) -> int:
        computed = 0
        real = mean_interval

        def counted(*arguments: Any, **options: Any) -> Any:
            nonlocal computed
            computed += 1
            return real(*arguments, **options)

        made_results(tmp_path / str(sets), sets)
        with monkeypatch.context() as patch:
            patch.setattr(loading_module, "mean_interval", counted)
            make_board(load_results(tmp_path / str(sets)))
        return computed

    two, four = calls(2), calls(4)
    # Each pair set has a table, and all of them one total.
    assert (two, four) == (3 * 2 * 5, 5 * 2 * 5)


def test_rows_by_column_read_back_as_they_were_written(tmp_path: Path) -> None:
    rows = [
        PairErrors(i, 5 * i, "step" * (i % 2), "ok", 0.1 * i, 1e-300, 0.3, None, 2.0 * i, None, 1.5, 0.02, None)
        for i in range(50)
    ]
    rows[7] = PairErrors(-7, 3, "a,\u2028b", "error", np.inf, np.inf, np.inf, -0.5, None, 1.0, None, None, 0.1)
    rows[8:10] = replace(rows[8], vcre=0.25), replace(rows[9], vcre=np.inf)
    write_errors(tmp_path / "x.errors.csv", rows)
    table = read_errors(tmp_path / "x.errors.csv")
    assert list(table) == rows
    assert list(table.of_group("step")) == [row for row in rows if row.group == "step"]
    assert list(ErrorTable.of(rows).by_time()) == sorted(rows, key=lambda row: row.key)


def test_a_table_of_errors_without_a_row_is_read_and_written(tmp_path: Path) -> None:
    write_errors(tmp_path / "x.errors.csv", [])
    table = read_errors(tmp_path / "x.errors.csv")
    assert list(table) == list(table.by_time()) == []
    assert table.numbers.shape == (len(NUMBERS), 0)
    write_errors(tmp_path / "y.errors.csv", table)
    assert (tmp_path / "y.errors.csv").read_bytes() == (tmp_path / "x.errors.csv").read_bytes()


def test_a_float32_product_and_exact_near_ties_give_the_exact_ranks() -> None:
    rng = np.random.default_rng(0)
    for size, dtype in ((3, np.float32), (40, np.float64), (40, np.float16)):
        # Few distinct vectors, and copies that differ by less than float32 can tell.
        base = rng.standard_normal((12, size))
        gallery = (np.repeat(base, 9, axis=0) * (1 + 1e-9 * rng.standard_normal((108, 1)))).astype(dtype)
        query = (base + 0.3 * rng.standard_normal(base.shape)).astype(dtype)
        relevance = relevance_from_labels(np.arange(12), np.arange(108) % 13)
        ranking = rank_descriptors(query, gallery, relevance)
        whole = rank_descriptors(query, gallery, relevance, query_block=1, gallery_block=5)
        assert np.array_equal(ranking.position, whole.position)
        for q in range(12):
            exact = _exact(query[q], gallery)
            of = relevance.of(q)
            others = np.setdiff1d(np.arange(108), of)
            scores = sorted((exact[i] for i in of), reverse=True)
            assert ranking.of(q).tolist() == [
                place + sum(exact[i] >= score for i in others) for place, score in enumerate(scores)
            ]


def _exact(query: Any, gallery: Any) -> list[int]:
    """Dot products of integer vectors by the rule of :mod:`relocbench.metrics.retrieval.descriptors`, in Python."""

    def scale(norm: float) -> int:
        return 26 - int(np.frexp(0.75 * norm)[1])

    longest = max(float(np.linalg.norm(row.astype(np.float64))) for row in gallery)
    a = [round(float(x) * 2.0 ** scale(float(np.linalg.norm(query.astype(np.float64))))) for x in query]
    rows = [[round(float(x) * 2.0 ** scale(longest)) for x in row] for row in gallery]
    return [sum(x * y for x, y in zip(a, row, strict=True)) for row in rows]


Attack = Callable[[Path], None]


def _replaced(name: str, old: str, new: str) -> Attack:
    def attack(folder: Path) -> None:
        text = (folder / name).read_text(encoding="utf-8")
        assert old in text
        write_text(folder / name, text.replace(old, new, 1))

    return attack


def _sealed(attack: Attack) -> Attack:
    """The attack of somebody who computes the digests again."""

    def sealed(folder: Path) -> None:
        attack(folder)
        reseal(MethodResults(folder / "m0"))

    return sealed


def _outward_link(folder: Path) -> None:
    (folder.parent.parent / "secret.txt").write_text("secret", encoding="utf-8")
    path = folder / "m0" / f"{WINTER}.errors.csv"
    path.unlink()
    path.symlink_to(folder.parent.parent / "secret.txt")


def _circle(folder: Path) -> None:
    (folder / "m0" / "again").symlink_to(folder)


def _pipe(folder: Path) -> None:
    path = folder / "m0" / f"{WINTER}.errors.csv"
    path.unlink()
    os.mkfifo(path)


def _twice(folder: Path) -> None:
    other = folder.with_name("another@folder")
    other.mkdir()
    write_text(other / "dataset.yaml", (folder / "dataset.yaml").read_text(encoding="utf-8"))


ERRORS = f"m0/{WINTER}.errors.csv"
ATTACKS: dict[str, tuple[Attack, str]] = {
    "a link out of the folder": (_outward_link, "leads out of the results folder"),
    "a link in a circle": (_circle, "a link to a folder that holds it"),
    "a pipe": (_pipe, "neither a file nor a folder"),
    "a name that climbs": (_replaced("dataset.yaml", "name: town", "name: ../../town"), "must be letters"),
    "a fingerprint that climbs": (
        _replaced("dataset.yaml", "fingerprint: ", "fingerprint: ../x"),
        "should match pattern",
    ),
    "a pair set that climbs": (_replaced("dataset.yaml", f"{WINTER}:", "../../x:"), "must be letters"),
    "a huge count": (_replaced("dataset.yaml", "pairs: 12", "pairs: 1000000000000"), "12 rows, expected one for"),
    "a negative count": (_replaced("dataset.yaml", "pairs: 12", "pairs: -12"), "greater than or equal to 0"),
    "a NaN among the scores": (
        _replaced("m0/scores.yaml", "t_auc@0.5m: ", "t_auc@0.5m: .nan, was: "),
        "nan in scores.yaml",
    ),
    "an infinite score": (_replaced("m0/scores.yaml", "t_auc@0.5m: ", "t_auc@0.5m: .inf, was: "), "inf in scores.yaml"),
    "a group without scores": (_replaced("m0/scores.yaml", " all:", " most:"), "no scores of"),
    "an error below 0": (_sealed(_replaced(ERRORS, ",ok,", ",ok,-")), "at least 0"),
    "an unknown status": (_sealed(_replaced(ERRORS, ",ok,", ",fine,")), "status is 'fine'"),
    "an endless field": (_sealed(_replaced(ERRORS, ",ok,", f",{'o' * 200_000},")), "a field has more than"),
    "one dataset twice": (_twice, "is the same set as"),
}


@pytest.mark.parametrize("attack", ATTACKS)
def test_a_strangers_results_folder_gets_one_clear_line_and_nothing_is_written(attack: str, tmp_path: Path) -> None:
    results = MadeResults(tmp_path / "results", {WINTER: 12})
    results.write_dataset()
    results.add("m0", {WINTER: made(0, 12, 0.2)})
    change, expected = ATTACKS[attack]
    change(results.folder)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(PredictionError, match=expected) as told:
        write_leaderboard(tmp_path / "results", tmp_path / "board")
    assert "\n" not in str(told.value)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_link_to_the_results_folder_and_links_within_it_are_followed(tmp_path: Path) -> None:
    results = MadeResults(tmp_path / "results", {WINTER: 12})
    results.write_dataset()
    results.add("m0", {WINTER: made(0, 12, 0.2)})
    (results.folder / "m1").symlink_to(results.folder / "m0")
    (tmp_path / "link").symlink_to(tmp_path / "results")
    assert [m.label for m in load_results(tmp_path / "link")[0].methods] == ["m0", "m1"]


def test_an_unreadable_journal_is_counted_as_far_as_it_goes(tmp_path: Path) -> None:
    results = MadeResults(tmp_path, {WINTER: 12})
    results.write_dataset()
    folder = results.add("m0", {})
    lines = ['{"key": [1, 2]}', '{"key": {"a": 1}}', "[3]", '{"other": 1}', '{"key": [1, 2]}']
    write_text(folder.journal(WINTER) / "0.jsonl", "".join(f"{line}\n" for line in lines))
    assert load_results(tmp_path)[0].methods[0].missing == {WINTER: "the run was stopped after 1 of 12 pairs"}
