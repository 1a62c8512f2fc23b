"""Every fault of a submission is found and named with its place; what is only odd is named and not refused."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused
from small_dataset import ACROSS, WITHIN, make_small_dataset
from submissions import answer, blind_export, change_card, guess, salt, submit

from relocbench.datasets.core.dataset import Dataset
from relocbench.errors import ConfigError, PredictionError
from relocbench.evaluation.submission.check import Checked, check_submission
from relocbench.evaluation.submission.contract import SubmissionOptions
from relocbench.evaluation.submission.tracked import TrackedDataset
from relocbench.evaluation.tracking.blind_keys import BlindKeys
from relocbench.geometry import make_transform, so3_exp
from relocbench.progress import Silent


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("town") / "ds", frames=6, size=(24, 18))


@pytest.fixture(scope="module")
def blind(town: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return blind_export(town, tmp_path_factory.mktemp("blind") / "b")


def check(root: Path, *datasets: Dataset, blind_only: bool = False) -> Checked:
    options = SubmissionOptions(tuple(d.root for d in datasets), blind_only, salt=salt())
    return check_submission(root, options, Silent())


def faults(checked: Checked) -> list[str]:
    """Faults without the folder's path."""
    return [str(f).removeprefix(f"{checked.root}/") for f in checked.found.by_place().faults]


def tracked(checked: Checked) -> TrackedDataset:
    """The one dataset that was answered."""
    (one,) = checked.answered
    assert isinstance(one, TrackedDataset)
    return one


def test_a_sound_submission_has_no_fault_and_is_counted(town: Dataset, tmp_path: Path) -> None:
    checked = check(submit(tmp_path / "s", town), town)
    assert faults(checked) == []
    assert checked.suspicions == []
    assert [(r.asked, r.pairs, r.answered, r.missing) for r in checked.rows] == [
        (s.name, len(s.evaluated), len(s.evaluated), 0) for s in town.pair_sets()
    ]


def test_blind_keys_become_times(town: Dataset, blind: Dataset, tmp_path: Path) -> None:
    root = submit(tmp_path / "s", blind)
    alone = check(root, blind)  # by who has no truth
    assert faults(alone) == []
    for checked in (check(root, town), check(root, town, blind)):
        assert faults(checked) == []
        for of in tracked(checked).units:
            assert set(of.poses) == set(of.pair_set.by_key)
    assert faults(check(submit(tmp_path / "real", town), town, blind_only=True))[0].endswith("a blind export of it")


def _line(number: int, change: Callable[[list[str]], list[str]]) -> Callable[[Path], None]:
    """Changes the words of a line of a file."""

    def run(path: Path) -> None:
        lines = path.read_text().splitlines()
        lines[number - 1] = " ".join(change(lines[number - 1].split()))
        path.write_text("\n".join(lines) + "\n")

    return run


def _table(change: Callable[[list[str]], list[str]]) -> Callable[[Path], None]:
    """Changes the rows of the table beside a file of poses."""

    def run(path: Path) -> None:
        table = path.with_suffix(".csv")
        table.write_text("\n".join(change(table.read_text().splitlines())) + "\n")

    return run


def _long_info(rows: list[str]) -> list[str]:
    keys = [",".join(row.split(",")[:2]) for row in rows[:2]]
    return [f"{keys[0]},info", f"{keys[1]},{'x' * 8193}"]


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (_line(2, lambda w: [*w[:2], "nan", *w[3:]]), ":2: "),
        (_line(2, lambda w: [*w[:8], "2.0"]), ":2: quaternion qx qy qz qw has norm"),
        (_line(2, lambda w: [*w[:2], "1e9", *w[3:]]), ":2: the translation is 1e+09 m long"),
        (_line(2, lambda w: [*w[:2], "1e308", "1e308", *w[4:]]), ":2: the translation is 1.41e+308 m long"),
        (_line(2, lambda w: w[:5]), ":2: expected 2 or 9 columns"),
        (_line(2, lambda w: ["1", *w[1:]]), ":2: unknown pair 1 "),
        (_line(2, lambda w: [w[1], w[0], *w[2:]]), "keyframe and query are exchanged"),
        (_line(2, lambda w: ["٣", *w[1:]]), ":2: "),
        (
            lambda p: p.write_text(p.read_text() + p.read_text().splitlines()[0] + "\n"),
            "occurs again (first on line 1)",
        ),
        (lambda p: p.write_bytes(b"\xff\xfe" + p.read_bytes()), "not a text file"),
        (lambda p: p.write_text("1 2 3\n" * 2_000_000), "holds 12000000 bytes"),
        (lambda p: p.rename(p.with_name("summer__spring__cam0.txt")), "no pair set 'summer__spring__cam0'"),
        (lambda p: p.rename(p.with_name("..__a__b.txt")), ".csv: has no predictions (.txt)"),
        (lambda p: p.with_suffix(".csv").write_text("ref_timestamp_ns,query_timestamp_ns,speed\n"), "found 'speed'"),
        (lambda p: p.with_suffix(".csv").write_text("a,b\n1,2\n"), ":1: expected the header"),
        (_table(lambda rows: [*rows, "1,2"]), "columns, found 2"),
        (_table(lambda rows: [*rows, rows[1]]), "occurs again (first on line 2)"),
        (_table(_long_info), ":2: info has 8193 characters"),
        (_line(1, lambda w: w[:2]), f"is 'ok' but has no valid pose in {ACROSS}.txt"),
    ],
)
def test_a_fault_of_answers_is_named_with_its_line(
    town: Dataset, tmp_path: Path, damage: Callable[[Path], object], told: str
) -> None:
    root = submit(tmp_path / "s", town)
    path = root / town.name / f"{ACROSS}.txt"
    table = path.with_suffix(".csv")
    text = table.read_text().replace("confidence\n", "confidence,status\n", 1)
    table.write_text("".join(f"{row},ok\n" if row[0].isdigit() else f"{row}\n" for row in text.splitlines()))
    damage(path)
    found = faults(check(root, town))
    assert any(told in fault for fault in found), found


def test_every_fault_is_found_and_counted(town: Dataset, tmp_path: Path) -> None:
    root = submit(tmp_path / "s", town, weights={"file": "x"}, hardwear="laptop", authors=[])
    path = root / town.name / f"{ACROSS}.txt"
    assert [f.partition(":")[0] for f in faults(check(root, town))] == ["card.yaml"] * 6
    told = "\n".join(faults(check(root, town)))
    for words in (
        "unknown key 'hardwear' (did you mean 'hardware'?)",
        "unknown key 'weights.file' (did you mean 'files'?)",
    ):
        assert words in told
    assert "key 'authors': is empty, expected at least one" in told
    submit(root, town)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], lines[0], "x y", "3 4", *lines[2:]]) + "\n")
    checked = check(root, town)
    row = next(r for r in checked.rows if r.asked == ACROSS)
    assert (row.duplicate, row.unknown, row.invalid, row.missing) == (1, 1, 1, 1)
    assert sorted(f.line or 0 for f in checked.found.faults) == [2, 3, 4]


def test_line_ends_of_windows_are_no_fault(town: Dataset, tmp_path: Path) -> None:
    root = submit(tmp_path / "s", town)
    for path in root.rglob("*.*"):
        path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    assert faults(check(root, town)) == []


def test_another_dataset_version_or_export_is_refused(town: Dataset, blind: Dataset, tmp_path: Path) -> None:
    root = submit(tmp_path / "s", town)
    change_card(root, lambda card: card["datasets"][town.name].update(fingerprint="0" * 64))
    assert f"the fingerprint of '{town.name}' is 000000000000, the dataset given has" in faults(check(root, town))[0]
    assert faults(check(root, town))[0].startswith("card.yaml:")
    second = blind_export(town, tmp_path / "b2", 2)
    root = submit(tmp_path / "second", second)
    assert faults(check(root, town)) == []
    forged = second.name.replace("blind2", "blind1")  # keys of edition 2, said to be those of 1
    (root / second.name).rename(root / forged)
    change_card(root, lambda card: card.update(datasets={forged: {"fingerprint": "a" * 64, "asked_once": True}}))
    with refused(ConfigError, salt().path, None, forged, town.name):
        check(root, town)
    first, other = (BlindKeys(town, salt(), n).pair_set(town.pair_set(ACROSS)) for n in (1, 2))
    answers = (root / forged / f"{other}.txt").read_text()
    root = submit(tmp_path / "first", blind)
    (root / blind.name / f"{first}.txt").write_text(answers)
    assert f"not keys of the blind export {blind.name}" in faults(check(root, town))[0]
    change_card(root, lambda card: card["datasets"][blind.name].update(fingerprint="b" * 64))
    assert "is bbbbbbbbbbbb, the dataset given has" in faults(check(root, town, blind))[0]
    assert f"no dataset '{blind.name}' was given" in faults(check(root, second))[0]


def test_real_times_are_refused_where_blind_keys_are_due(town: Dataset, blind: Dataset, tmp_path: Path) -> None:
    root = submit(tmp_path / "s", blind)
    shown = BlindKeys(town, salt()).pair_set(town.pair_set(ACROSS))
    answer(root / blind.name, town.pair_set(ACROSS)).rename(root / blind.name / f"{shown}.txt")
    found = faults(check(root, town))
    assert f"{blind.name}/{shown}.txt:1" in found[0]
    assert "these are real timestamps, and the card names a blind export" in found[0]


def test_the_record_of_a_run_must_be_of_the_same_dataset(town: Dataset, tmp_path: Path) -> None:
    root = submit(tmp_path / "s", town)
    record = root / town.name / "run.yaml"
    record.write_text(f"method: m\ntarget: m\ndataset: {town.name}\nfingerprint: abc\n")
    assert f"is of {town.name}@abc, expected" in faults(check(root, town))[0]
    record.write_text("method: [\n")
    assert "not valid YAML" in faults(check(root, town))[0]


def test_a_copy_of_the_dataset_is_known_by_its_question(town: Dataset, tmp_path: Path) -> None:
    root = submit(tmp_path / "s", town)
    change_card(root, lambda card: card["datasets"][town.name].update(fingerprint="c" * 64))
    (root / town.name / "run.yaml").write_text(
        f"method: m\ntarget: m\ndataset: {town.name}\nfingerprint: {'c' * 64}\nquestion: {town.content_id}\n"
    )
    checked = check(root, town)
    assert faults(checked) == []
    assert tracked(checked).resolved.answered_on == "c" * 64


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("b0: &b0 [x]\n" + "".join(f"b{i}: &b{i} [*b{i - 1}, *b{i - 1}]\n" for i in range(1, 60)), "not valid YAML"),
        ("&r [*r]", "not valid YAML"),
        ("[" * 5000, "not valid YAML"),
        ("label: " + "x" * 70_000, "at most 65536 are read"),
        ("- a\n- b\n", "expected keys and values"),
        ("a: 1\na: 2\n", "not valid YAML"),
        ("", "expected keys and values"),
        ("!!python/object/apply:os.system ['true']", "not valid YAML"),
        ("1: 2\n", ""),
    ],
)
def test_a_hostile_card_is_refused_in_short_lines(town: Dataset, tmp_path: Path, text: str, told: str) -> None:
    root = submit(tmp_path / "s", town)
    (root / "card.yaml").write_text(text)
    found = faults(check(root, town))
    assert found
    assert any(told in fault for fault in found), found
    assert all(len(fault) < 2500 and fault.isprintable() for fault in found)


def test_a_card_of_50_megabytes_is_not_read(town: Dataset, tmp_path: Path) -> None:
    root = submit(tmp_path / "s", town)
    with (root / "card.yaml").open("r+b") as stream:
        stream.truncate(50 * 2**20)
    assert "holds 52428800 bytes" in faults(check(root, town))[0]


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"label": "identity"}, "is the label of a trivial baseline"),
        ({"label": "Clock"}, "is the label of a trivial baseline"),
        ({"label": "../x"}, "must be letters"),
        ({"label": "dsо"}, "must be letters a to z"),  # a Cyrillic letter
        ({"links": ["javascript:alert(1)"]}, "is not an address"),
        ({"links": ["https://a.b/<script>"]}, "is not an address"),
        ({"what": "a\nb"}, "without line ends"),
        ({"what": "  "}, "is blank"),
        ({"method": "x" * 1001}, "at most 1000"),
        ({"datasets": {}}, "key 'datasets'"),
        ({"datasets": {"../../etc": {"fingerprint": "a", "asked_once": True}}}, "must be letters"),
        ({"format_version": 2}, "key 'format_version'"),
        ({"task": "both"}, "key 'task'"),
        ({"uses_times": "maybe"}, "key 'uses_times'"),
    ],
)
def test_an_entry_of_the_card_that_cannot_be_is_refused(
    town: Dataset, tmp_path: Path, changes: dict[str, Any], told: str
) -> None:
    found = faults(check(submit(tmp_path / "s", town, **changes), town))
    assert any(told in fault and fault.startswith("card.yaml:") for fault in found), found


def test_a_date_need_not_be_quoted(town: Dataset, tmp_path: Path) -> None:
    root = submit(tmp_path / "s", town, date="DATE")
    (root / "card.yaml").write_text((root / "card.yaml").read_text().replace("DATE", "2026-11-25"))
    checked = check(root, town)
    assert checked.card is not None
    assert checked.card.date == "2026-11-25"


def test_links_pipes_and_strange_folders_are_refused_and_not_opened(town: Dataset, tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("private\n")
    root = submit(tmp_path / "s", town)
    target = root / town.name / f"{ACROSS}.txt"
    target.unlink()
    target.symlink_to(secret)
    assert faults(check(root, town)) == [f"{town.name}/{ACROSS}.txt: is a link; expected the file itself in its place"]
    target.unlink()
    os.mkfifo(target)
    assert "neither a file nor a folder" in faults(check(root, town))[0]
    target.unlink()
    (root / "card.yaml").rename(tmp_path / "card.yaml")
    (root / "card.yaml").symlink_to(tmp_path / "card.yaml")
    assert faults(check(root, town)) == ["card.yaml: is a link; expected the file itself in its place"]
    shutil.rmtree(root / town.name)
    (root / town.name).symlink_to(tmp_path)
    assert len(faults(check(root, town))) == 2
    with refused(PredictionError, tmp_path / "none", None, "no such folder"):
        check(tmp_path / "none", town)
    with refused(PredictionError, town.root, None, "card.yaml"):
        check(town.root, town)


def test_folders_and_datasets_must_match(town: Dataset, tmp_path: Path) -> None:
    root = submit(tmp_path / "s", town)
    (root / "other").mkdir()
    (root / town.name / "within").mkdir()
    (root / town.name / "notes.md").write_text("x")
    entry = {"fingerprint": "a", "asked_once": True}
    change_card(root, lambda card: card["datasets"].update(absent=entry))
    checked = check(root, town)
    assert "is a folder within a dataset's folder" in faults(checked)[0]
    assert [str(n.path) for n in checked.found.notes] == [str(root / town.name / "notes.md")]
    (root / town.name / "within").rmdir()
    found = faults(check(root, town))
    assert any("'absent' is answered by no folder" in fault for fault in found)
    assert any("is not among the datasets of card.yaml" in fault for fault in found)
    for path in (root / town.name).glob("*.*"):
        path.unlink()
    assert any("holds no predictions" in fault for fault in faults(check(root, town)))


def _noisy(scale: float) -> Callable[..., np.ndarray]:
    rng = np.random.default_rng(1)

    def pose(pair: object) -> np.ndarray:
        noise = make_transform(so3_exp(rng.normal(0, scale, 3)), rng.normal(0, scale, 3))
        return np.asarray(noise @ pair.T_query_ref)  # type: ignore[attr-defined]

    return pose


@pytest.mark.parametrize(
    ("pose", "told"),
    [
        (lambda pair: np.eye(4), "all answers are the identity, which is also the prior"),
        (lambda pair: make_transform(np.eye(3), [0, 0, -0.15]), "all answers are one pose"),
        (lambda pair: pair.T_query_ref, "answers are the truth to 1e-06"),
        (_noisy(1e-4), "as copies of it with noise are"),
        (_noisy(1e-3), "from a truth whose own sigma is"),
        (
            lambda pair: make_transform(np.eye(3), [0, 0, float(2000 + pair.query_timestamp_ns % 7)]),
            "farther than 1000",
        ),
    ],
)
def test_what_is_odd_about_poses_is_named_and_not_refused(
    town: Dataset, blind: Dataset, tmp_path: Path, pose: Callable[..., np.ndarray], told: str
) -> None:
    checked = check(submit(tmp_path / "s", town, pose), town)
    assert faults(checked) == []
    assert any(told in odd for odd in checked.suspicions), checked.suspicions


def test_what_is_odd_about_tables_and_cards_is_named(town: Dataset, tmp_path: Path) -> None:
    entry = {town.name: {"fingerprint": town.fingerprint, "asked_once": False}}
    weights = {"files": "w", "trained_on": "t", "splits_seen": [f"{town.name}, test"]}
    root = submit(tmp_path / "s", town, datasets=entry, weights=weights)
    for pair_set in town.pair_sets():
        answer(root / town.name, pair_set, guess, confidence=lambda pair: 0.5)
    assert [odd.partition(": ")[2] for odd in check(root, town).suspicions] == [
        "no answer has seconds",
        "all confidences are 0.5",
        "was evaluated more than once, as the card says",
        f"training or tuning has seen '{town.name}, test', as the card says",
    ]
    for pair_set in town.pair_sets():
        answer(root / town.name, pair_set, guess, seconds=lambda pair: 0, confidence=lambda pair: pair.key[0] % 7)
    assert check(root, town).suspicions[0].endswith("no answer took longer than 0 s")
    (root / town.name / f"{WITHIN}.txt").unlink()
    assert any("has no predictions (.txt)" in fault for fault in faults(check(root, town)))


@pytest.mark.parametrize(
    ("split", "named"),
    [("NAME", True), ("NAME, test", True), ("test of NAME.", True), ("NAMES, test", False), ("old-NAME-2", False)],
)
def test_a_split_of_a_dataset_whose_name_is_longer_is_not_held_against_anybody(
    town: Dataset, tmp_path: Path, split: str, named: bool
) -> None:
    weights = {"files": "w", "trained_on": "t", "splits_seen": [split.replace("NAME", town.name)]}
    odd = check(submit(tmp_path / "s", town, weights=weights), town).suspicions
    assert any("has seen" in told for told in odd) == named


def test_the_beginning_of_a_fingerprint_is_asked_for_in_full(town: Dataset, tmp_path: Path) -> None:
    root = submit(tmp_path / "s", town)
    change_card(root, lambda card: card["datasets"][town.name].update(fingerprint=town.fingerprint[:12]))
    (told,) = faults(check(root, town))
    assert f"is to be given in full, as its dataset.yaml has it: {town.fingerprint}" in told


def test_a_blind_export_has_no_times_to_use(town: Dataset, blind: Dataset, tmp_path: Path) -> None:
    found = faults(check(submit(tmp_path / "s", blind, uses_times=True), town))
    assert len(found) == 1
    assert found[0].startswith("card.yaml:")
    assert "a blind export has no times" in found[0]
