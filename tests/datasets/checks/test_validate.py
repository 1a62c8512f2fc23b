"""``relocbench validate``: every fault, with file and line."""

from __future__ import annotations

import csv
import json
import re
import shlex
from pathlib import Path

import pytest
from small_dataset import ACROSS, CAMERA, START_NS, STEP_NS, WITHIN, make_small_dataset
from typer.testing import CliRunner

from relocbench.cli.app import app
from relocbench.datasets.checks.faults import Findings
from relocbench.datasets.checks.validation import validate_dataset
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import PoseLine, write_pose_lines
from relocbench.errors import RelocbenchError
from relocbench.evaluation.isolation.handles import TrackerHandle
from relocbench.evaluation.isolation.worker import Unit, show_keyframe
from relocbench.evaluation.tracking import run as run_module
from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods
from relocbench.evaluation.tracking.validation import validate_prediction_files, validate_results
from relocbench.geometry import make_transform, so3_exp
from relocbench.progress import Silent

IDENTITY = "identity=baselines.identity:Identity"


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    return make_small_dataset(tmp_path / "D", correspondences=20, rejected=1)


def places(found: Findings, root: Path) -> list[tuple[str, int | None]]:
    """(path below root, line) of the faults."""
    return sorted(
        ((f.path.relative_to(root).as_posix() if f.path else "", f.line) for f in found.faults),
        key=lambda place: (place[0], place[1] or 0),
    )


def edit(path: Path, line: int, pattern: str, replacement: str) -> None:
    """Replace in one line of a text file; the pattern must be there."""
    lines = path.read_text().splitlines()
    changed = re.sub(pattern, replacement, lines[line - 1], count=1)
    assert changed != lines[line - 1]
    lines[line - 1] = changed
    path.write_text("\n".join(lines) + "\n")


def check(root: Path, *, quick: bool = False) -> Findings:
    return validate_dataset(root, Silent(), quick=quick)


@pytest.mark.parametrize("kind", [{}, {"sparse": True}, {"truth": False}, {"query_depth": False}, {"rejected": 2}])
def test_a_sound_dataset_has_no_fault(tmp_path: Path, kind: dict[str, bool]) -> None:
    made = make_small_dataset(tmp_path / "D", correspondences=10, **kind)  # type: ignore[arg-type]
    found = check(made.root)
    assert (found.faults, found.notes) == ([], [])


@pytest.mark.thorough
def test_every_faulty_line_of_the_poses_is_named(dataset: Dataset) -> None:
    poses = dataset.layout.traversal("summer").poses
    edit(poses, 2, r",0\.0,", ",nan,")
    edit(poses, 3, r"1\.0$", "2.0")
    edit(poses, 4, r",", ",x,")
    edit(poses, 5, r"^\d+", str(START_NS))
    assert places(check(dataset.root), dataset.root) == [("traversals/summer/poses.csv", n) for n in (2, 3, 4, 5)]


def test_unknown_and_missing_keys_of_a_description_are_named_with_their_line(dataset: Dataset) -> None:
    path = dataset.layout.traversal("winter").traversal_yaml
    path.write_text("colour: red\n" + path.read_text().replace("fx:", "focal:"))
    found = check(dataset.root, quick=True)
    messages = {f.message: f.line for f in found.faults if f.path == path}
    assert messages["unknown key 'colour'"] == 1
    text = path.read_text().splitlines()
    assert "focal" in text[(messages["unknown key 'cameras.cam0.focal'"] or 0) - 1]
    assert any("'cameras.cam0.fx' is missing" in message for message in messages)


def test_a_truncated_image_is_named_once(dataset: Dataset) -> None:
    path = dataset.layout.traversal("summer").image(CAMERA, START_NS)
    path.write_bytes(path.read_bytes()[:-100])
    found = check(dataset.root)
    assert [f.path for f in found.faults] == [path]
    assert "truncated" in found.faults[0].message


def test_an_image_whose_middle_was_overwritten_is_named(dataset: Dataset) -> None:
    path = dataset.layout.traversal("winter").depth(CAMERA, START_NS + 10**15)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(bytes(data))
    assert [f.path for f in check(dataset.root).faults] == [path]
    assert not check(dataset.root, quick=True).faults, "--quick does not read images"


@pytest.mark.thorough
def test_an_image_of_another_size_than_its_camera_is_named(dataset: Dataset) -> None:
    other = make_small_dataset(dataset.root.parent / "other", size=(80, 60))
    path = dataset.layout.traversal("summer").image(CAMERA, START_NS)
    path.write_bytes(other.layout.traversal("summer").image(CAMERA, START_NS).read_bytes())
    found = check(dataset.root)
    assert [f.path for f in found.faults] == [path]
    assert "80x60" in found.faults[0].message
    assert "96x72" in found.faults[0].message


def test_a_missing_image_is_named_and_so_is_each_pair_that_needs_it(dataset: Dataset) -> None:
    path = dataset.layout.traversal("winter").image(CAMERA, START_NS + 10**15 + STEP_NS)
    path.unlink()
    lines = dataset.layout.pair_file(ACROSS).read_text().splitlines()
    needed = [n for n, line in enumerate(lines, start=1) if line.split()[1] == path.stem]
    expected = [(f"pairs/{ACROSS}.txt", n) for n in needed] + [(path.relative_to(dataset.root).as_posix(), None)]
    assert needed
    assert places(check(dataset.root), dataset.root) == sorted(expected)


def test_a_keyframe_without_depth_is_a_fault_of_its_pairs(dataset: Dataset) -> None:
    dataset.layout.traversal("summer").depth(CAMERA, START_NS).unlink()
    faults = [f for f in check(dataset.root).faults if "neither depth nor points" in f.message]
    assert {f.path for f in faults} == {dataset.layout.pair_file(ACROSS), dataset.layout.pair_file(WITHIN)}


def test_every_faulty_sparse_point_is_named(tmp_path: Path) -> None:
    made = make_small_dataset(tmp_path / "D", sparse=True)
    path = made.layout.traversal("summer").points(CAMERA, START_NS)
    edit(path, 3, r"^[^,]*", "1000")
    edit(path, 5, r"^([^,]*),([^,]*),", r"\1,\2,-")
    edit(path, 9, r"^", "nan,")
    relative = path.relative_to(made.root).as_posix()
    assert places(check(made.root), made.root) == [(relative, 3), (relative, 5), (relative, 9)]


def test_every_faulty_pair_is_named(dataset: Dataset) -> None:
    path = dataset.layout.pair_file(WITHIN)
    edit(path, 1, r" \S+$", " 2.0")
    edit(path, 2, r" \S+$", " nan")
    edit(path, 3, r" \S+$", "")
    path.write_text(path.read_text() + path.read_text().splitlines()[3] + "\n")
    assert places(check(dataset.root), dataset.root) == [(f"pairs/{WITHIN}.txt", n) for n in (1, 2, 3, 6)]


def test_a_pair_file_and_its_table_must_say_the_same(dataset: Dataset) -> None:
    table = dataset.layout.pair_table(ACROSS)
    rejected = next(n for n, row in enumerate(table.read_text().splitlines(), start=1) if ",false," in row)
    edit(table, rejected, ",false,", ",true,")
    edit(table, rejected + 1, r"^(\d+,\d+,[^,]*),[^,]*", r"\1,9.5")
    faults = {f.line: f.message for f in check(dataset.root).faults if f.path == table}
    assert "is missing from" in faults[rejected]
    assert "distance_m is 9.5" in faults[rejected + 1]


def test_a_measure_that_no_pair_has_is_a_fault(dataset: Dataset) -> None:
    wrong = {
        "overlap": ("7", "expected 0 to 1"),
        "overlap_query": ("-0.1", "expected 0 to 1"),
        "scale_change": ("0.9", "expected at least 1"),
        "depth_error": ("-1", "expected at least 0"),
        "similarity": ("1.5", "expected -1 to 1"),
    }
    table = dataset.layout.pair_table(ACROSS)
    rows = list(csv.DictReader(table.read_text().splitlines()))
    for row, (name, (value, _)) in zip(rows, wrong.items(), strict=False):
        row[name] = value
    table.write_text("\n".join([",".join(rows[0]), *(",".join(row.values()) for row in rows)]) + "\n")
    faults = {f.line: f.message for f in check(dataset.root).faults if f.path == table and f.line is not None}
    assert faults == {
        line: f"{name} is {value}, {expected}" for line, (name, (value, expected)) in enumerate(wrong.items(), start=2)
    }


@pytest.mark.thorough
def test_truth_that_disagrees_with_its_stated_source_is_a_fault(tmp_path: Path) -> None:
    wrong = make_small_dataset(tmp_path / "D", pose_fault=make_transform(so3_exp([0, 0.01, 0]), [0.05, 0, 0]))
    found = check(wrong.root)
    count = len(wrong.pair_set(ACROSS).pairs)
    assert places(found, wrong.root) == [(f"pairs/{ACROSS}.txt", n) for n in range(1, count + 1)]
    assert "0.573 deg" in found.faults[0].message  # 0.01 rad


@pytest.mark.thorough
def test_truth_from_elsewhere_may_differ_from_the_poses(tmp_path: Path) -> None:
    made = make_small_dataset(tmp_path / "D", pose_fault=make_transform(so3_exp([0, 0.01, 0]), [0, 0, 0]))
    table = made.layout.pair_table(ACROSS)
    table.write_text(table.read_text().replace("poses of the traversals", "lidar registration"))
    found = check(made.root)
    assert [f.path for f in found.faults] == [table], "its content was changed"
    assert "0.573 deg" in found.notes[0].message


def test_a_split_that_names_no_pair_set_is_named_with_its_line(dataset: Dataset) -> None:
    path = dataset.layout.dataset_yaml
    path.write_text(path.read_text().replace(f"test: [{ACROSS}]", "test: [autumn__winter__cam0]"))
    faults = [f for f in check(dataset.root, quick=True).faults if "autumn" in f.message]
    assert len(faults) == 1
    assert "autumn" in path.read_text().splitlines()[(faults[0].line or 0) - 1]


def test_half_a_correspondence_file_is_named(dataset: Dataset) -> None:
    path = dataset.layout.correspondence_file(ACROSS)
    path.write_bytes(path.read_bytes()[:-30])
    for quick in (False, True):
        assert [f.path for f in check(dataset.root, quick=quick).faults] == [path]


def test_files_that_came_later_are_named(dataset: Dataset) -> None:
    stray = dataset.layout.traversal("summer").image(CAMERA, START_NS + 1)
    stray.write_bytes(dataset.layout.traversal("summer").image(CAMERA, START_NS).read_bytes())
    assert [f.path for f in check(dataset.root).faults] == [stray]


def test_an_unfinished_build_says_so_and_no_more(dataset: Dataset) -> None:
    dataset.layout.dataset_yaml.unlink()
    found = check(dataset.root)
    assert len(found.faults) == 1
    assert "not finished" in found.faults[0].message


def predictions(dataset: Dataset, folder: Path) -> Path:
    """The truth, as a prediction file."""
    folder.mkdir()
    path = folder / f"{ACROSS}.txt"
    pairs = dataset.pair_set(ACROSS).pairs
    write_pose_lines(path, [PoseLine(*p.key, p.T_query_ref) for p in pairs])
    return path


def test_every_faulty_line_of_a_prediction_file_is_named(dataset: Dataset, tmp_path: Path) -> None:
    path = predictions(dataset, tmp_path / "P")
    edit(path, 1, r" \S+$", " nan")
    edit(path, 2, r" \S+$", " 3")
    edit(path, 3, r" \S+$", "")
    edit(path, 4, r"^\d+", "7")
    path.write_text(path.read_text() + path.read_text().splitlines()[4] + "\n")
    alone = validate_prediction_files(path, None)
    assert [f.line for f in alone.by_place().faults] == [1, 2, 3, 7]
    against = validate_prediction_files(path.parent, dataset)
    assert [f.line for f in against.by_place().faults] == [1, 2, 3, 4, 7]
    assert [n.message for n in against.notes] == ["1 of 6 pairs are not answered and count as failures"]


def test_a_prediction_file_for_no_pair_set_is_named(dataset: Dataset, tmp_path: Path) -> None:
    path = predictions(dataset, tmp_path / "P")
    other = path.rename(path.with_name("spring__winter__cam0.txt"))
    found = validate_prediction_files(other, dataset)
    assert ACROSS in found.faults[0].message
    assert "spring__winter__cam0" in found.faults[0].message


@pytest.fixture
def results(dataset: Dataset, tmp_path: Path) -> Path:
    """The folder of one method with scores."""
    evaluate_methods(
        EvaluateOptions(
            dataset=dataset.root, predictions=predictions(dataset, tmp_path / "P").parent, out=tmp_path / "R"
        ),
        Silent(),
    )
    return next((tmp_path / "R").glob("*@*/P"))


def test_sound_results_have_no_fault_at_any_level(dataset: Dataset, results: Path) -> None:
    for root in (results, results.parent, results.parent.parent):
        for against in (None, dataset):
            assert validate_results(root, against, Silent()).faults == []


def test_stale_scores_are_a_fault(results: Path) -> None:
    path = results / f"{ACROSS}.txt"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))
    found = validate_results(results, None, Silent())
    assert any("changed since it was scored" in f.message and f.path == results / f"{ACROSS}.txt" for f in found.faults)
    assert any("'ok' but has no pose" in f.message for f in found.faults)


@pytest.mark.thorough
def test_results_of_another_dataset_are_a_fault(results: Path, tmp_path: Path) -> None:
    other = make_small_dataset(tmp_path / "E", seed=5)
    found = validate_results(results, other, Silent())
    assert found.faults[0].path == results / "run.yaml"
    assert other.fingerprint[:12] in found.faults[0].message


@pytest.mark.thorough
def test_a_run_that_was_killed_is_unfinished_and_its_command_ends_it(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    def killed_within(unit: Unit, tracker: TrackerHandle) -> str | None:
        if unit.pair_set == WITHIN:
            raise KeyboardInterrupt
        return show_keyframe(unit, tracker)

    # A method with parameters, one of which is unset.
    options = EvaluateOptions(dataset=dataset.root, methods=("orb-pnp",), out=tmp_path / "R", workers=0)
    with monkeypatch.context() as patch:
        patch.setattr(run_module, "show_keyframe", killed_within)
        patch.setattr(run_module, "_collect", killed)
        with pytest.raises(KeyboardInterrupt):
            evaluate_methods(options, Silent())
    found = validate_results(tmp_path / "R", dataset, Silent())
    assert found.faults == []
    assert any(f"of {ACROSS} are answered" in n.message for n in found.notes)
    assert any(f"not begun with {WITHIN}" in n.message for n in found.notes)
    command = shlex.split(found.notes[0].message.split("to go on: ")[1])
    assert command[0] == "relocbench"
    assert CliRunner().invoke(app, [*command[1:], "--workers", "1"]).exit_code == 0
    after = validate_results(tmp_path / "R", dataset, Silent())
    assert (after.faults, after.notes) == ([], [])


@pytest.mark.thorough
def test_the_command_prints_each_fault_on_a_line_with_the_count_and_exits_with_2(dataset: Dataset) -> None:
    runner = CliRunner()
    assert runner.invoke(app, ["validate", str(dataset.root), "-q"]).exit_code == 0
    poses = dataset.layout.traversal("summer").poses
    edit(poses, 2, r",0\.0,", ",nan,")
    edit(poses, 4, r"1\.0$", "2.0")
    result = runner.invoke(app, ["validate", str(dataset.root), "-q"])
    assert result.exit_code == 2
    lines = result.stdout.splitlines()
    assert [line.split(": ")[0] for line in lines] == [f"{poses}:2", f"{poses}:4", str(dataset.root)]
    assert "2 faults" in lines[-1]
    plain = json.loads(runner.invoke(app, ["validate", str(dataset.root), "-q", "--json"]).stdout)
    assert [(f["path"], f["line"]) for f in plain["faults"]] == [(str(poses), 2), (str(poses), 4)]
    assert plain["valid"] is False


def test_a_path_that_is_nothing_of_ours_is_refused(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "absent"):
        result = CliRunner().invoke(app, ["validate", str(path)])
        assert isinstance(result.exception, RelocbenchError)
