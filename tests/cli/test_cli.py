"""The command line: quick help, one line and exit status 2 for a mistake, plain output without a terminal."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command_line import relocbench
from refusals import assert_names
from small_dataset import ACROSS, make_small_dataset

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.importers import KINDS
from relocbench.datasets.importers.marks import MARKS

HEAVY = ("torch", "open3d", "matplotlib", "pandas", "cv2", "numba", "scipy", "pydantic", "numpy")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("data") / "small")


def test_help_and_version_import_nothing_heavy() -> None:
    code = (
        "import sys; from relocbench.cli.app import app\n"
        "try: app(['--help'])\n"
        "except SystemExit: pass\n"
        f"print('heavy:', sorted(m for m in {HEAVY!r} if m in sys.modules))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert "build-dataset" in out
    assert out.splitlines()[-1] == "heavy: []"


@pytest.mark.parametrize(
    "command",
    [
        *("demo", "evaluate", "leaderboard", "inspect", "validate", "methods", "check-method", "export"),
        "view",
        *("build-dataset", "fetch-weights"),
    ],
)
def test_every_command_explains_itself(command: str) -> None:
    shown = relocbench(command, "--help")
    assert shown.status == 0
    assert len(shown.out.split()) > 20
    if command != "build-dataset":
        assert "Example: relocbench" in " ".join(shown.out.split())


@pytest.mark.parametrize(
    "command", [[], ["evaluate"], ["methods"], ["build-dataset"], ["build-dataset", "generic-lidar"]]
)
def test_flags_and_arguments_are_shown_without_types(command: list[str]) -> None:
    shown = " ".join(relocbench(*command, "--help").out.split())
    assert "--help" in shown
    for noise in ("<bool>", "<str>", "<list"):
        assert noise not in shown


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (["eval"], ["evaluate", "evaluate-retrieval", "evaluate-relocalization"]),
        (["build-dataset", "ki"], ["kitti", "kitti-lidar", "kitti-360"]),
        (["build-dataset", "kitti", "--pair-r"], ["--pair-rule"]),
        (["evaluate", "-m", "dso"], ["dso", "dso-multistart"]),
        (["evaluate-retrieval", "--method", "orb"], ["orb-bow"]),
        (["evaluate-relocalization", "--retriever", "orb"], ["orb-bow"]),
    ],
)
def test_a_shell_completes_commands_kinds_options_and_methods(
    monkeypatch: pytest.MonkeyPatch, words: list[str], offered: list[str]
) -> None:
    monkeypatch.setenv("_RELOCBENCH_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", " ".join(["relocbench", *words]))
    monkeypatch.setenv("COMP_CWORD", str(len(words)))
    done = relocbench()
    assert done.out.split() == offered
    assert done.err == ""


def test_a_name_is_completed_behind_a_label_where_the_shell_allows_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("_RELOCBENCH_COMPLETE", "complete_zsh")
    monkeypatch.setenv("_TYPER_COMPLETE_ARGS", "relocbench evaluate --method mine=orb")
    assert "mine=orb-pnp" in relocbench().out


@pytest.mark.parametrize("kind", list(KINDS))
def test_every_kind_of_dataset_explains_its_options(kind: str) -> None:
    shown = relocbench("build-dataset", kind, "--help")
    assert shown.status == 0
    assert "--out" in shown.out
    assert "--config" in shown.out
    assert "Example:" in shown.out


@pytest.mark.parametrize(
    ("arguments", "names"),
    [
        (["evaluate", "-d", "{d}", "-m", "orb-pmp"], ["orb-pmp", "orb-pnp"]),
        (["evaluate", "-d", "{d}", "-m", "dso", "--set", "pints=3"], ["pints", "points"]),
        (["evaluate", "-d", "{d}"], ["--method", "--predictions"]),
        (["evaluate", "-m", "identity"], ["--dataset"]),
        (["evaluate", "-d", "{d}/absent", "-m", "identity"], ["absent"]),
        (["evaluate", "-d", "{d}/pairs", "-m", "identity"], ["pairs", "dataset.yaml"]),
        (["evaluate", "-d", "{d}", "-m", "identity", "--split", "tset"], ["tset", "test", "all"]),
        (["evaluate", "-d", "{d}", "-m", "identity", "--pair-set", "a"], ["a"]),
        (["evaluate", "-d", "{d}", "--predictions", "{d}/absent"], ["absent"]),
        (["evaluate", "-d", "{d}", "-m", "identity", "--out", "{d}/pairs"], ["--out"]),
        (["evaluate", "-d", "{d}", "-m", "subprocess:"], ["subprocess:COMMAND"]),
        (
            ["evaluate", "-d", "{d}", "-m", "identity", "--memory-limit", "4Q"],
            ["--memory-limit", "4Q"],
        ),
        (
            ["evaluate", "-d", "{d}", "-m", "identity", "--overwrite", "now"],
            ["--overwrite", "now"],
        ),
        (["leaderboard", "{d}", "--out", "{t}/board"], ["{d}"]),
        (["export", "-d", "{d}", "-f", "tum", "--out", "{d}/e"], ["--out"]),
        (["inspect", "{d}", "--pictures", "{d}/traversals/p"], ["--pictures"]),
        (["build-dataset", "generic", "{d}", "{d}", "--out", "{t}/o"], ["{d}"]),
        (["methods", "absent"], ["absent", "identity"]),
        (["build-dataset", "tum", "{d}", "--out", "{t}/o"], ["tum", "tum-rgbd"]),
        (["leaderboard", "{d}/absent", "--out", "{t}/board"], ["absent"]),
        (["inspect", "{d}/absent"], ["absent"]),
        (["build-dataset", "kitti", "{d}/absent", "--sequence", "06", "--out", "{t}/o"], ["absent"]),
        (
            ["build-dataset", "kitti", "{d}", "--sequence", "06", "--pair-step", "1,x", "--out", "{t}/o"],
            ["--pair-step"],
        ),
        (["build-dataset", "kitti", "{d}", "--sequence", "06", "--pair-step", "0", "--out", "{t}/o"], ["pair_step"]),
    ],
)
def test_a_mistake_is_one_line_and_status_2(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], names: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = relocbench(*(a.format(d=dataset.root, t=tmp_path) for a in arguments))
    assert outcome.status == 2
    assert_names(outcome.complaint, "", None, *(name.format(d=dataset.root) for name in names))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.thorough
def test_quiet_hides_progress_and_not_the_results(dataset: Dataset, tmp_path: Path) -> None:
    asked = relocbench("evaluate", "-d", dataset.root, "-m", "identity", "-o", tmp_path / "results", "-j", 1, "-q")
    board = relocbench("leaderboard", tmp_path / "results", "-o", tmp_path / "board", "-q")
    for told in (asked, board):
        assert told.status == 0
        assert "identity" in told.out
        assert told.err == ""


def test_marks_are_those_of_kinds() -> None:
    assert set(MARKS) < set(KINDS)


def test_the_folder_that_was_meant_is_named(dataset: Dataset, tmp_path: Path) -> None:
    above = dataset.root.parent
    assert_names(relocbench("inspect", above).complaint, "", None, above, dataset.root)
    recording = tmp_path / "recordings" / "freiburg1"
    recording.mkdir(parents=True)
    (recording / "rgb.txt").touch()
    told = relocbench("build-dataset", "tum-rgbd", tmp_path / "recordings", "--out", tmp_path / "o")
    assert told.status == 2
    assert_names(told.complaint, "", None, "rgb.txt", recording)
    both = tmp_path / "both"
    for part in ("mapping", "query"):
        (both / part / "sensors").mkdir(parents=True)
        (both / part / "sensors" / "sensors.txt").touch()
    told = relocbench("build-dataset", "kapture", both, "--out", tmp_path / "o")
    assert_names(told.complaint, both / "mapping" / "sensors" / "sensors.txt", 1)
    told = relocbench("build-dataset", "kapture", tmp_path, "--out", tmp_path.with_name("elsewhere"))
    assert_names(told.complaint, "", None, both)
    (tmp_path / "work" / "results" / "town@0123").mkdir(parents=True)
    (tmp_path / "work" / "results" / "town@0123" / "dataset.yaml").touch()
    told = relocbench("leaderboard", tmp_path / "work", "--out", tmp_path / "o")
    assert_names(told.complaint, "", None, tmp_path / "work" / "results")


def test_an_unknown_key_in_a_configuration_is_named_with_its_line(dataset: Dataset, tmp_path: Path) -> None:
    config = tmp_path / "run.yaml"
    config.write_text(f"dataset: {dataset.root}\nmethods: [identity]\noverwirte: always\n")
    assert_names(relocbench("evaluate", "--config", config).complaint, config, 3, "overwirte")
    config.write_text("pair_step: [1]\n# comment\nmax_dist: 3\n")
    outcome = relocbench("build-dataset", "synthetic", "--config", config, "--out", tmp_path / "o")
    assert outcome.status == 2
    assert_names(outcome.complaint, config, 3, "max_dist")
    config.write_text("pair_step: [1, two]\n")
    outcome = relocbench("build-dataset", "synthetic", "--config", config, "--out", tmp_path / "o")
    assert_names(outcome.complaint, config, 1, "pair_step.1")
    config.write_text("conditions: {summer: {wether: rain}}\n")
    outcome = relocbench("build-dataset", "generic", tmp_path, "--config", config, "--out", tmp_path / "o")
    assert_names(outcome.complaint, config, 1, "conditions.summer.wether")
    config.write_text("methods: identity\ndataset: d\n")
    assert_names(relocbench("evaluate", "--config", config).err, config, 1, "methods", "identity")
    config.write_text("scheduler: 3\ndataset: d\n")
    assert_names(relocbench("evaluate", "--config", config).complaint, config, 1, "scheduler", 3)
    config.write_text("- 1\n")
    assert_names(relocbench("evaluate", "--config", config).complaint, config)
    config.write_text("a: [1\n")
    assert_names(relocbench("evaluate", "--config", config).complaint, config, 2)


def test_a_single_prediction_file_answers_its_pair_set(dataset: Dataset, tmp_path: Path) -> None:
    assert relocbench("evaluate", "-d", dataset.root, "-m", "identity", "-o", tmp_path / "r", "-j", "0").status == 0
    (kept,) = (tmp_path / "r").rglob(f"identity/{ACROSS}.txt")
    renamed = tmp_path / "mine.txt"
    renamed.write_bytes(kept.read_bytes())
    score = ("evaluate", "-d", dataset.root, "-o", tmp_path / "s", "--json", "--predictions")
    assert_names(relocbench(*score, kept).complaint, "", None, "--method")  # its name cannot be a label
    shown = json.loads(relocbench(*score, kept, "-m", "mine").out)
    assert shown["methods"]["mine"][ACROSS]["all"]["coverage"] == 1.0
    told = relocbench(*score, renamed).complaint
    assert_names(told, "mine.txt", None, ACROSS)
    shown = json.loads(relocbench(*score, renamed, "--pair-set", ACROSS, "-m", "theirs").out)
    assert shown["methods"]["theirs"][ACROSS]["all"]["coverage"] == 1.0


@pytest.mark.thorough
def test_a_configuration_file_sets_everything_and_the_command_line_wins(dataset: Dataset, tmp_path: Path) -> None:
    config = tmp_path / "run.yaml"
    config.write_text(
        f"dataset: {dataset.root}\nmethods: [identity, floor=identity]\nout: {tmp_path / 'a'}\nworkers: 1\n"
    )
    outcome = relocbench("evaluate", "--config", config, "--out", tmp_path / "b", "--json")
    assert outcome.status == 0, outcome.err
    assert sorted(json.loads(outcome.out)["methods"]) == ["floor", "identity"]
    assert (tmp_path / "b").is_dir()
    assert not (tmp_path / "a").exists()


def test_json_is_one_strict_object(dataset: Dataset, tmp_path: Path) -> None:
    common = ("evaluate", "-d", dataset.root, "-m", "identity", "--out", tmp_path, "-j", 0)
    shown = json.loads(relocbench(*common, "--json").out, parse_constant=pytest.fail)
    assert shown["methods"]["identity"][ACROSS]["all"]["coverage"] == 1.0


def test_output_without_a_terminal_is_plain(dataset: Dataset, tmp_path: Path) -> None:
    shown = relocbench("evaluate", "-d", dataset.root, "-m", "identity", "--out", tmp_path, "-j", 0)
    assert "\x1b" not in shown.out + shown.err
    assert "identity on small: " in shown.err
    assert "found, %" in shown.out


def test_a_bug_is_a_traceback(dataset: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("relocbench.evaluation.tracking.evaluate.evaluate_methods", broken)
    with pytest.raises(ZeroDivisionError):
        relocbench("evaluate", "-d", dataset.root, "-m", "identity")


def test_what_the_system_refuses_is_one_line_with_the_file(dataset: Dataset, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    outcome = relocbench("evaluate", "-d", dataset.root, "-m", "identity", "--out", tmp_path / "file" / "results")
    assert outcome.status == 2
    assert outcome.err.strip().endswith("Not a directory")
    assert str(tmp_path / "file") in outcome.err


@pytest.mark.parametrize(
    ("file", "old", "new", "line", "name"),
    [
        ("traversals/summer/poses.csv", "0.0", "nan", 2, "nan"),
        ("traversals/summer/traversal.yaml", "rate_hz", "rate_khz", None, "rate_khz"),
        (f"pairs/{ACROSS}.txt", " ", " x", 1, ""),
    ],
)
def test_a_damaged_dataset_is_named_with_file_and_line(
    tmp_path: Path, file: str, old: str, new: str, line: int | None, name: str
) -> None:
    made = make_small_dataset(tmp_path / "d")
    path = made.root / file
    path.write_text(path.read_text().replace(old, new, 1))
    outcome = relocbench("validate", made.root)
    assert outcome.status == 2
    assert_names(outcome.out + outcome.err, path.name, line, *filter(None, [name]))
    refused = relocbench("evaluate", "-d", made.root, "-m", "identity", "--out", tmp_path / "out")
    assert refused.status == 2
    assert path.name in refused.complaint
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("kind", ["tum", "kitti", "colmap", "kapture", "mlad"])
def test_predictions_and_truth_are_exported(dataset: Dataset, tmp_path: Path, kind: str) -> None:
    relocbench("evaluate", "-d", dataset.root, "-m", "identity", "--out", tmp_path / "r", "-j", 0, "-q")
    common = ("export", "-d", dataset.root, "-f", kind, "--pair-set", ACROSS)
    results = ("--results", tmp_path / "r")
    refused = relocbench(*common, "--out", tmp_path / "none", *results)  # the truth has no results
    assert refused.status == 2
    assert_names(refused.complaint, "", None, "--results", "--method", "--retriever")
    for number, method in enumerate([(), (*results, "--method", "identity")]):
        out = tmp_path / f"out-{number}"
        outcome = relocbench(*common, "--out", out, *method)
        assert outcome.status == 0, outcome.err
        written = [Path(line) for line in outcome.out.splitlines()]
        assert written
        assert all(p.exists() and p.stat().st_size for p in written)


def test_exported_truth_is_read_by_evo(dataset: Dataset, tmp_path: Path) -> None:
    from evo.tools import file_interface

    from relocbench.geometry import invert

    out = tmp_path / "tum"
    outcome = relocbench("export", "-d", dataset.root, "-f", "tum", "--out", out, "--pair-set", ACROSS)
    trajectory = file_interface.read_tum_trajectory_file(outcome.out.splitlines()[0])
    pair_set = dataset.pair_set(ACROSS)
    summer, winter = dataset.traversal("summer"), dataset.traversal("winter")
    for time, pose in zip(trajectory.timestamps, trajectory.poses_se3, strict=True):
        query = min((p.query_timestamp_ns for p in pair_set.pairs), key=lambda t: abs(t / 1e9 - time))
        assert np.allclose(pose, winter.T_world_cam("cam0", query), atol=1e-6)
    pair = pair_set.pairs[0]
    assert pair.T_query_ref is not None
    pipeline = summer.T_world_cam("cam0", pair.ref_timestamp_ns) @ invert(pair.T_query_ref)
    assert np.allclose(pipeline, winter.T_world_cam("cam0", pair.query_timestamp_ns), atol=1e-9)
