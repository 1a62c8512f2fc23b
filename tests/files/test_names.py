"""Every name that becomes part of a path keeps to one rule, wherever it comes from."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from refusals import refused

from relocbench.datasets.core.layout import DatasetLayout, TraversalLayout
from relocbench.datasets.core.schema import Condition, DatasetFile, Strict, TraversalFile
from relocbench.datasets.core.writer import DatasetWriter
from relocbench.datasets.cross_view.content import read_conditions
from relocbench.datasets.sensors.trajectories import timed_files, traversal_names
from relocbench.errors import ConfigError, DatasetError, MethodError, PredictionError
from relocbench.evaluation.common.results import DatasetRecord, DatasetResults, MethodResults, RunRecord, ScoreRecord
from relocbench.evaluation.relocalization.records import PipelineRun, PipelineSet
from relocbench.evaluation.retrieval.records import SetRecord
from relocbench.files import (
    check_distinct,
    check_joined_name,
    check_label,
    check_name,
    fitting_name,
    load_yaml,
    plain_name,
)
from relocbench.methods.specs import parse_method, parse_methods

BAD = {
    "nothing": "",
    "a way up": "../../escaped",
    "two dots": "..",
    "an absolute path": "/etc/passwd",
    "a folder": "a/b",
    "a folder of Windows": "a\\b",
    "a NUL character": "a\0b",
    "a new line": "a\nb",
    "an escape sequence": "a\x1b[31m",
    "a blank": "a b",
    "a blank at the end": "a ",
    "half of a surrogate pair": "a\udcff",
    "a hidden file": ".hidden",
    "a journal": ".journal",
    "an option": "-rf",
    "a full stop at the end": "a.",
    "a line at the end": "a_",
    "a device of Windows": "NUL",
    "a device with an ending": "com1.log",
    "the project's record of a dataset": "dataset.yaml",
    "in capital letters": "Scores.YAML",
    "the project's record of a run": "run.yaml",
    "a table of errors": "cam.errors",
    "a table of matching": "cam.matching",
    "a table": "poses.csv",
    "101 bytes": "x" * 101,
    "a raised digit": "dso²",
    "a wide letter": "ｄso",
    "a digit of another script": "dso٢",
    "51 letters of two bytes": "é" * 51,
}
GOOD = ("a", "cam0", "2014-12-16-09-14-09", "resnet50+pnp", "v1.2", "Straße", "x" * 100, "console", "null")


@pytest.mark.parametrize("name", BAD.values(), ids=BAD.keys())
def test_a_name_that_is_no_part_of_a_path_is_refused_in_one_line(name: str) -> None:
    with refused(ValueError, "", None, "camera name") as raised:
        check_name(name, "camera name")
    assert str(raised.value).isprintable()
    assert len(str(raised.value)) < 400


@pytest.mark.parametrize("label", ["dsо", "größe", "dso²", "a b", "a|b", "*a*", "a\nb"])  # the first has a Cyrillic o
def test_a_label_has_ascii_letters_alone(label: str) -> None:
    with refused(ValueError, "", None, "method label"):
        check_label(label, "method label")
    with refused(MethodError, "", None, "LABEL"):
        parse_method(f"{label}=identity")
    assert check_label("ORB-pnp_v1.2+x", "method label") == "ORB-pnp_v1.2+x"


@pytest.mark.thorough
@given(st.text(max_size=20))
def test_any_label_that_is_taken_is_plain(label: str) -> None:
    try:
        check_label(label, "method label")
    except ValueError:
        return
    assert re.fullmatch(r"[0-9A-Za-z+][0-9A-Za-z._+-]*", label)


@given(st.text(max_size=20))
def test_a_condition_is_one_printable_line(text: str) -> None:
    if text.isprintable():
        assert str(Condition(weather=text)).isprintable()
    else:
        with refused(ValidationError, "", None, "weather"):
            Condition(weather=text)


@pytest.mark.parametrize("name", GOOD)
def test_a_plain_name_is_taken(name: str) -> None:
    assert check_name(name, "name") == name


@given(st.text(max_size=30))
def test_whatever_is_taken_stays_in_its_folder(name: str) -> None:
    try:
        check_joined_name(name, "name")
    except ValueError:
        return
    path = Path("/some/folder") / name
    assert path.parent == Path("/some/folder")
    assert path.name == name
    assert name.isprintable()


def test_each_part_of_a_joined_name_is_a_name() -> None:
    assert check_joined_name("a__b__cam0", "pair set") == "a__b__cam0"
    for name in ("a__..__c", "a__b__", "a____c", "__".join(["x" * 90] * 3)):
        with refused(ValueError):
            check_joined_name(name, "pair set")


def test_names_that_differ_in_capital_letters_only_are_refused() -> None:
    check_distinct(["a", "b"], "labels")
    with refused(ValueError, "", None, "ICP", "icp"):
        check_distinct(["ICP", "icp"], "labels")
    with refused(MethodError, "", None, "A", "a"):
        parse_methods(["A=identity", "a=identity"])


def test_a_long_name_is_made_to_fit_and_stays_its_own() -> None:
    one, other = fitting_name("x" * 300), fitting_name("x" * 301)
    assert one != other
    assert len(one) <= 200
    assert check_joined_name(one, "name") == one
    assert fitting_name("short") == "short"


def test_a_folder_gives_a_plain_name_or_none(tmp_path: Path) -> None:
    assert plain_name("my drive (2)", "name") == "my-drive--2-"
    assert plain_name("..hidden__x.", "name") == "hidden_x"
    for name in ("dataset.yaml", "nul", "..."):
        (tmp_path / name).mkdir()
        with refused(DatasetError, tmp_path / name):
            traversal_names([tmp_path / name])


TRAVERSAL = "name: NAME\ncameras: {}\n"
DATASET = "format_version: 1\nname: NAME\nfingerprint: abc\n"
RESULTS = "name: NAME\nfingerprint: abc\nlicence: x\npair_sets: {}\n"
SPLITS = "name: a\nfingerprint: abc\nlicence: x\npair_sets: {}\nsplits: {test: [NAME]}\n"
PAIR_SETS = (
    "name: a\nfingerprint: abc\nlicence: x\npair_sets:\n  NAME:\n    {reference: a, query: b, camera: c, "
    "reference_condition: x, query_condition: x, pairs: 1, rejected: 0, has_truth: true}\n"
)
RUN = "method: NAME\ntarget: identity\ndataset: a\nfingerprint: abc\n"
OF_DATASET = "method: a\ntarget: identity\ndataset: NAME\nfingerprint: abc\n"
SCORES = "relocbench: '1'\npredictions: {NAME: abc}\npair_sets: {}\n"
SET = "name: NAME\nfingerprint: abc\ntasks: {}\n"
CHAINS = "name: NAME\ndataset: a\ndataset_fingerprint: abc\nfingerprint: abc\ntasks: {}\n"
CHAIN = "retriever: NAME\ntracker: a\ntop: 1\ndataset: a\nfingerprint: abc\n"
READ = {
    "traversal.yaml": (TraversalFile, TRAVERSAL),
    "dataset.yaml of a dataset": (DatasetFile, DATASET),
    "dataset.yaml of results": (DatasetRecord, RESULTS),
    "a split of results": (DatasetRecord, SPLITS),
    "a pair set of results": (DatasetRecord, PAIR_SETS),
    "the method of run.yaml": (RunRecord, RUN),
    "the dataset of run.yaml": (RunRecord, OF_DATASET),
    "scores.yaml": (ScoreRecord, SCORES),
    "retrieval.yaml": (SetRecord, SET),
    "relocalization.yaml": (PipelineSet, CHAINS),
    "run.yaml of a chain": (PipelineRun, CHAIN),
}


@pytest.mark.parametrize(("model", "text"), READ.values(), ids=READ.keys())
def test_a_name_in_a_foreign_file_is_checked_with_its_line(model: type[Strict], text: str, tmp_path: Path) -> None:
    path = tmp_path / "foreign.yaml"
    path.write_text(text.replace("NAME", "plain"))
    load_yaml(path, model, "a record", DatasetError)
    for name in ("../../escaped", "/etc/passwd", "a\\0b", "dataset.yaml"):
        path.write_text(text.replace("NAME", f'"{name}"'))
        with refused(DatasetError, "foreign.yaml") as raised:
            load_yaml(path, model, "a record", DatasetError)
        assert str(raised.value).isprintable()


@pytest.mark.parametrize("fingerprint", ["../../x", "", "a/b", "x" * 129])
def test_a_fingerprint_that_is_no_part_of_a_path_is_refused(fingerprint: str, tmp_path: Path) -> None:
    (tmp_path / "dataset.yaml").write_text(RESULTS.replace("NAME", "a").replace("abc", f"'{fingerprint}'"))
    with refused(PredictionError, "dataset.yaml", 2, "fingerprint"):
        _ = DatasetResults(tmp_path).record


def test_a_dataset_is_not_written_under_a_name_that_leads_out_of_it(tmp_path: Path) -> None:
    for name in ("../../escaped", "/escaped", "a\0b", "dataset.yaml", "x" * 201):
        with refused(ConfigError, "", None, "--name"):
            DatasetWriter(tmp_path / "out", name, {"kind": "test"})
    assert list(tmp_path.iterdir()) == []


def test_no_path_is_made_of_a_name_that_leads_out_of_the_folder(tmp_path: Path) -> None:
    layout, method = DatasetLayout(tmp_path), MethodResults(tmp_path)
    makers = (layout.pair_file, layout.pair_table, layout.correspondence_file, layout.traversal)
    for make in (*makers, method.predictions, method.answers, method.errors, method.matching, method.journal):
        with pytest.raises((DatasetError, PredictionError)):
            make("../../escaped")


def test_a_folder_of_results_whose_name_is_no_label_is_told(tmp_path: Path) -> None:
    folder = tmp_path / "\x1b[31mred"
    folder.mkdir()
    (folder / "run.yaml").touch()
    with refused(PredictionError, folder, None, "\\x1b[31mred") as raised:
        DatasetResults(tmp_path).methods()
    assert str(raised.value).isprintable()


@pytest.mark.parametrize("label", ["dataset.yaml", "..", "con", "x" * 101])
def test_a_label_that_the_project_needs_itself_is_refused(label: str) -> None:
    with refused(MethodError, "", None, "LABEL"):
        parse_method(f"{label}=identity")


def test_a_condition_that_names_a_task_is_checked_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "poses.csv").write_text("image,condition\na.jpg,rain\nb.jpg,../../x\n")
    with refused(DatasetError, "poses.csv", 3, "../../x"):
        read_conditions(tmp_path)


@pytest.mark.parametrize("stem", ["²²", "٣", "1_0", "9" * 20, "-5", "1e3"])
def test_only_ascii_digits_of_64_bits_are_the_time_of_an_image(stem: str, tmp_path: Path) -> None:
    folder = tmp_path / "images" / "cam0"
    folder.mkdir(parents=True)
    (folder / f"{stem}.png").touch()
    (folder / "7.png").touch()
    assert TraversalLayout(tmp_path).timestamps("images", "cam0") == [7]
    if stem != "1e3":
        with refused(DatasetError, folder / f"{stem}.png"):
            timed_files(folder)
