"""A method that cannot be made is left out and named, and costs the others nothing."""

from __future__ import annotations

from contextvars import Context
from pathlib import Path

import pytest
from command_line import relocbench
from refusals import Notes, refused
from small_dataset import ACROSS, make_small_dataset

from relocbench.datasets.core.dataset import Dataset
from relocbench.errors import MethodError
from relocbench.evaluation.probe import ProbeOptions, probe_methods
from relocbench.evaluation.relocalization.evaluate import RelocalizationOptions, evaluate_pipelines
from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods
from relocbench.progress import Silent

pytestmark = pytest.mark.usefixtures("workers_kept")
UNMADE = "trackers_for_tests:Unmade"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("data") / "small", size=(64, 48))


def options(dataset: Dataset, out: Path, *methods: str, **more: object) -> dict[str, object]:
    return {"dataset": dataset.root, "out": out, "methods": methods, "workers": 1, "pair_sets": (ACROSS,), **more}


@pytest.mark.thorough
def test_trackers(dataset: Dataset, tmp_path: Path) -> None:
    methods = f"a={UNMADE}", f"b={UNMADE}", "identity"
    given = options(dataset, tmp_path, *methods, set=("b.interrupts=true",))
    report = evaluate_methods(EvaluateOptions.model_validate(given), Silent())
    assert [folder.label for folder in report.folders] == ["identity"]
    assert [label for label, _ in report.left_out] == ["a", "b"]
    for (label, message), raised in zip(report.left_out, ("RuntimeError: no luck", "KeyboardInterrupt"), strict=True):
        assert f"'{label}'" in message
        assert raised in message


@pytest.mark.thorough
def test_the_exit_status_says_so_and_a_removed_working_folder_is_there_again(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    words = ["evaluate", "-d", dataset.root, "--out", tmp_path / "out", "-j", 1, "--pair-set", ACROSS, "-q"]
    words += ["-m", f"a={UNMADE}", "-m", "identity", "--set", f"a.removes={here}", "--sandbox", "none"]
    done = Context().run(relocbench, *words)  # with workers of its own, which work in that folder
    assert done.status == 2
    assert "'a'" in done.err.splitlines()[-1]
    assert here.is_dir()
    assert next((tmp_path / "out").glob("*@*/identity/scores.yaml")).exists()


@pytest.mark.thorough
def test_a_single_method_is_refused(dataset: Dataset, tmp_path: Path) -> None:
    with refused(MethodError, "", None, "'a'", "no luck"):
        evaluate_methods(EvaluateOptions.model_validate(options(dataset, tmp_path, f"a={UNMADE}")), Silent())


@pytest.mark.thorough
def test_both_halves_of_a_pipeline(dataset: Dataset, tmp_path: Path) -> None:
    given = options(dataset, tmp_path, f"a={UNMADE}", "identity")
    given["retriever"] = ("oracle", "n=retrievers_for_tests:makes_nothing")
    report = evaluate_pipelines(RelocalizationOptions.model_validate(given), Silent())
    assert [label for label, _ in report.left_out] == ["n", "a"]
    assert {folder.run_record().retriever for folder in report.folders} == {"oracle"}
    assert "identity" in {folder.run_record().tracker for folder in report.folders}


@pytest.mark.thorough
def test_a_probe(dataset: Dataset, tmp_path: Path) -> None:
    notes = Notes()
    methods = f"a={UNMADE}", "f=trackers_for_tests:FromPrior"
    given = options(dataset, tmp_path, *methods, pairs=1, per_pair=1, pixels=False)
    report = probe_methods(ProbeOptions.model_validate(given), notes)
    assert {line.method for line in report.lines} == {"f"}
    assert any("a is left out" in note and "no luck" in note for note in notes.notes)
