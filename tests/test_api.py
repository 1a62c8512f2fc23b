"""What a notebook is given: datasets, pairs, methods and numbers as DataFrames."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from repository import ROOT
from small_dataset import ACROSS, WITHIN, make_small_dataset

import relocbench as rb
from relocbench.errors import ConfigError, DatasetError, MethodError, PredictionError
from relocbench.leaderboard.tracking.write import write_leaderboard


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_small_dataset(tmp_path_factory.mktemp("data") / "small", splits={"test": [ACROSS]}).root


@pytest.fixture(scope="module")
def results(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("results")
    rb.evaluate(dataset, ["identity", "trackers_for_tests:Shift"], out=out, workers=0)
    return out


def test_importing_it_loads_nothing() -> None:
    code = "import sys, relocbench; print([m for m in ('numpy', 'pandas', 'pydantic', 'yaml') if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_what_it_offers_is_there_and_nothing_else() -> None:
    for name in rb.__all__:
        assert getattr(rb, name) is not None, name
        assert name in dir(rb)
    with pytest.raises(AttributeError, match="has no attribute 'leader_board'"):
        rb.leader_board  # noqa: B018


def test_pairs_come_with_images_depth_and_truth(dataset: Path) -> None:
    opened = rb.open_dataset(dataset)
    views = list(rb.iterate_pairs(opened))
    assert {view.pair_set for view in views} == {ACROSS, WITHIN}
    first = views[0]
    assert first.reference.image.shape[:2] == first.reference.depth.shape  # type: ignore[union-attr]
    assert first.T_query_ref is not None
    assert first.T_query_ref.shape == (4, 4)
    assert [view.pair.key for view in rb.iterate_pairs(opened, split="test")] == [
        view.pair.key for view in rb.iterate_pairs(opened, pair_set=ACROSS)
    ]
    with pytest.raises(DatasetError, match="no pair set 'summer'"):
        next(rb.iterate_pairs(opened, pair_set="summer"))


@pytest.mark.thorough
def test_tables_are_those_of_the_commands(results: Path, tmp_path: Path) -> None:
    write_leaderboard(results, tmp_path)
    table = rb.read_leaderboard(results)
    written = pd.read_csv(tmp_path / "leaderboard.csv")
    assert list(table.columns) == list(written.columns)
    assert len(table) == len(written)
    for name in ("t_auc@0.5m", "median_translation_error_m", "rank", "pairs"):
        assert np.allclose(table[name].astype(float), written[name].astype(float), equal_nan=True), name
    errors, of_file = rb.read_errors(results), pd.read_csv(tmp_path / "errors.csv")
    assert len(errors) == len(of_file) > 0
    assert np.allclose(errors["translation_error_m"], of_file["translation_error_m"].astype(float))
    assert list(errors["status"]) == list(of_file["status"])


def test_evaluate_gives_the_board_of_its_dataset_and_takes_settings(dataset: Path, tmp_path: Path) -> None:
    table = rb.evaluate(
        rb.open_dataset(dataset), "orb=orb-pnp", out=tmp_path, settings={"orb.features": 200}, split="test", workers=0
    )
    assert set(table["method"]) == {"orb"}
    assert set(table["split"]) == {"test"}
    assert '"features":200' in table["parameters"].iloc[0].replace(" ", "")


@pytest.mark.thorough
def test_a_mistake_is_one_of_the_errors_that_the_commands_print(dataset: Path, results: Path, tmp_path: Path) -> None:
    with pytest.raises(MethodError, match="orb-pmp"):
        rb.evaluate(dataset, "orb-pmp", out=tmp_path / "r")
    with pytest.raises(PredictionError):
        rb.read_leaderboard(tmp_path)
    with pytest.raises(ConfigError, match="metric"):
        rb.read_leaderboard(results, metric="beauty")
    assert not (tmp_path / "r").exists()


def test_registries_name_the_installed_methods() -> None:
    assert rb.trackers()["orb-pnp"].startswith("baselines.feature_pnp:")
    assert {"lpn", "orb-bow"} <= set(rb.retrievers())


@pytest.mark.thorough
def test_the_lines_of_the_readme_run(dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    section = (ROOT / "README.md").read_text().split("## In Python")[1]
    lines = section.split("```python\n")[1].split("```")[0].replace('"demo/dataset"', repr(str(dataset)))
    monkeypatch.chdir(tmp_path)
    known: dict[str, Any] = {}
    exec(lines, known)
    assert set(known["scores"]["method"]) == {"identity", "orb-pnp", "dso"}
    assert len(known["errors"]) == 3 * sum(1 for _ in rb.iterate_pairs(known["dataset"]))
