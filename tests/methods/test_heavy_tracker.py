"""The example of a large model in an environment of its own, run as its pages say, with its stand-in for a model."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import relocbench
from repository import DOCS, ROOT
from small_dataset import ACROSS, make_small_dataset, render, small_camera, small_pose

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import Pair
from relocbench.evaluation.common.results import MethodResults
from relocbench.evaluation.tables.answers import read_answers
from relocbench.evaluation.tables.errors import read_errors
from relocbench.evaluation.tracking.check import check
from relocbench.geometry import invert, make_transform
from relocbench.methods import parse_method
from relocbench.methods.subprocess_tracker import SubprocessTracker
from relocbench.tracking import TrackResult

EXAMPLE = DOCS / "examples" / "heavy_tracker"
WATCHED = """

class Model(Model):
    def __init__(self, device):
        super().__init__(device)
        open({log!r}, "a").write("loaded ")
        print("a model prints what it likes")

    def track(self, keyframe, of_keyframe, views, of_views):
        open({log!r}, "a").write(str(len(views)) + " ")
        print("and again")
        for view in views:
            pair = int(keyframe.image.sum()), int(view.image.sum())
            {at_each}
        return super().track(keyframe, of_keyframe, views, of_views)
"""


def example(tmp_path: Path, at_each: str = "pass", options: str = "") -> tuple[str, Path]:
    """The command of a copy of the example, whose model keeps a log; and the log."""
    folder, log = tmp_path / "copy", tmp_path / "log"
    shutil.copytree(EXAMPLE, folder)
    with (folder / "model.py").open("a") as stream:
        stream.write(WATCHED.format(log=str(log), at_each=at_each))
    return f"subprocess:{sys.executable} {folder / 'tracker.py'} --device cpu {options}", log


def evaluate(dataset: Dataset, command: str, out: Path) -> MethodResults:
    words = ("evaluate", "-d", dataset.root, "-m", f"heavy={command}", "-o", out, "--split", "test", "--workers", 1)
    done = relocbench(*words)
    assert done.status == 0, done.err
    return MethodResults(next(out.glob("*/heavy")))


def sums(dataset: Dataset, pair_set: PairSet, pair: Pair) -> tuple[int, int]:
    """What the watched model knows a pair by."""
    reference, query = dataset.reference(pair_set, pair), dataset.query(pair_set, pair)
    return int(reference.image.sum()), int(query.image.sum())


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Twenty pairs of six keyframes."""
    return make_small_dataset(tmp_path_factory.mktemp("data") / "few", frames=6, keyframes_a_query=5)


@pytest.mark.thorough
def test_pairs_are_answered_in_metres_by_a_model_that_is_loaded_once(tmp_path: Path) -> None:
    dataset = make_small_dataset(tmp_path / "data", frames=8, keyframes_a_query=5, size=(128, 96))
    command, log = example(tmp_path)
    results = evaluate(dataset, command, tmp_path / "results")
    first, *sizes = log.read_text().split()
    assert (first, sizes.count("loaded")) == ("loaded", 0)
    assert sum(map(int, sizes)) == 30
    assert max(map(int, sizes)) == 5, "all queries of a keyframe at once"
    errors = [row.translation_error_m for row in read_errors(results.errors(ACROSS))]
    assert len(errors) == 30
    assert np.median(errors) < 0.03
    assert np.mean(np.array(errors) < 0.1) > 0.95
    answers = read_answers(results.answers(ACROSS))
    true = {pair.key: pair.T_query_ref for pair in dataset.pair_set(ACROSS).pairs}
    ratios = [
        json.loads(answer.info)["length_m"] / np.linalg.norm(pose[:3, 3])
        for key, answer in answers.items()
        if (pose := true[key]) is not None
    ]
    assert np.median(ratios) == pytest.approx(1.0, abs=0.03)


@pytest.mark.thorough
def test_a_crash_of_the_model_costs_its_pair_alone(tmp_path: Path, dataset: Dataset) -> None:
    pair_set = dataset.pair_set(ACROSS)
    lost = pair_set.pairs[-1]
    bad = sums(dataset, pair_set, lost)
    command, log = example(tmp_path, f"import os; pair == {bad} and os._exit(9)")
    results = evaluate(dataset, command, tmp_path / "results")
    answers = read_answers(results.answers(ACROSS))
    assert [key for key, answer in answers.items() if answer.status != "ok"] == [lost.key]
    assert "the program ended (exit status 9) when asked 'query'" in answers[lost.key].message
    assert answers[lost.key].status == "error"
    words = log.read_text().split()
    assert words.count("loaded") <= 3, "once, and again after it died with a batch and with the pair alone"


@pytest.mark.thorough
def test_what_a_model_raises_costs_its_pair_and_loads_nothing_again(tmp_path: Path, dataset: Dataset) -> None:
    pair_set = dataset.pair_set(ACROSS)
    asked = [pair for pair in pair_set.pairs if pair.key[0] == pair_set.pairs[0].key[0]]
    bad = sums(dataset, pair_set, asked[2])
    alone, log = ask(tmp_path, dataset, asked, f"if pair == {bad}: raise ValueError('out of memory')")
    assert [result.answered for result in alone] == [True, True, False, True, True]
    assert alone[2].message == "ValueError: out of memory"
    assert alone[2].info == {"status": "error"}
    assert log.count("loaded") == 1


@pytest.mark.thorough
def test_answers_are_the_same_for_any_batch(tmp_path: Path, dataset: Dataset) -> None:
    pair_set = dataset.pair_set(ACROSS)
    asked = [pair for pair in pair_set.pairs if pair.key[0] == pair_set.pairs[0].key[0]]
    found = []
    for batch in (1, 2, 8):
        folder = tmp_path / str(batch)
        folder.mkdir()
        results, log = ask(folder, dataset, asked, "pass", options=f"--batch {batch}")
        found.append([result.T_query_ref.tolist() for result in results if result.T_query_ref is not None])
        assert max(int(word) for word in log if word != "loaded") == min(batch, 4)
    assert len(found[0]) == 5
    assert found[0] == found[1] == found[2]


def ask(
    tmp_path: Path, dataset: Dataset, pairs: list[Pair], at_each: str, options: str = ""
) -> tuple[list[TrackResult], list[str]]:
    """Answers about pairs of one keyframe, the first alone; and the words of the log."""
    command, log = example(tmp_path, at_each, options)
    tracker = SubprocessTracker(command.removeprefix("subprocess:"))
    pair_set = dataset.pair_set(ACROSS)
    prepared = tracker.prepare(dataset.reference(pair_set, pairs[0]))
    queries = [dataset.query(pair_set, pair) for pair in pairs]
    first = tracker.track(prepared, queries[0])
    results = [first, *tracker.track_batch(prepared, queries[1:], [None] * len(queries[1:]))]
    tracker.close()
    return results, log.read_text().split()


@pytest.mark.thorough
def test_the_example_keeps_the_contract() -> None:
    spec = parse_method(f"heavy=subprocess:{sys.executable} {EXAMPLE / 'tracker.py'} --device cpu")
    assert [finding for finding in check(spec) if not finding.passed] == []


def test_the_example_needs_numpy_and_pillow_alone() -> None:
    names = "print(*sorted({name.split('.')[0] for name in sys.modules} - sys.stdlib_module_names))"
    code = f"import sys; sys.path.insert(0, {str(EXAMPLE)!r}); import tracker; {names}"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    own = {path.stem for path in EXAMPLE.glob("*.py")}
    heavy = {"cv2", "torch", "scipy", "pandas", "pydantic", "yaml", "numba", "matplotlib"}
    loaded = set(done.stdout.split())
    assert own - {"tracker"} <= loaded | {"tracker"}
    assert {"numpy", "PIL", "relocbench"} <= loaded
    assert not loaded & heavy


@pytest.fixture
def adapters(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The example's modules, which are imported by plain names from their own folder."""
    monkeypatch.syspath_prepend(str(EXAMPLE))
    names = [path.stem for path in EXAMPLE.glob("*.py")]
    import adapters  # type: ignore[import-not-found]

    yield adapters
    for name in names:
        sys.modules.pop(name, None)


def views(adapters: Any, sparse: bool = False) -> tuple[Any, Any, np.ndarray[Any, Any]]:
    """A keyframe and a query of the corner of planes, and the true pose."""
    camera = small_camera(160, 120)
    here, there = small_pose(2), small_pose(4, lateral_m=0.12, yaw_deg=2.0)
    image, depth = render(camera, here)
    v, u = np.nonzero(depth)
    if sparse:
        v, u = (each[np.random.default_rng(0).choice(len(v), 4000, replace=False)] for each in (v, u))
    z = depth[v, u].astype(np.float64)
    uv = np.stack([u, v], axis=-1).astype(np.float64)
    keyframe = adapters.Keyframe("k", image, camera, uv, z, np.full(len(z), 0.01))
    return keyframe, adapters.View("q", render(camera, there)[0], camera), invert(there) @ here


@pytest.mark.parametrize("sparse", [False, True])
def test_the_adapters_of_matches_and_of_a_direction_find_the_metric_pose(adapters: Any, sparse: bool) -> None:
    keyframe, view, true = views(adapters, sparse)
    rng = np.random.default_rng(1)
    uv_ref = keyframe.uv[rng.choice(len(keyframe.uv), 300, replace=False)]
    uv_query, _ = view.camera.project(adapters.points_at(keyframe, uv_ref) @ true[:3, :3].T + true[:3, 3])
    uv_query += rng.normal(scale=0.3, size=uv_query.shape)
    uv_query[:60] = rng.uniform(0, 100, size=(60, 2))
    matched = adapters.from_matches(keyframe, view, uv_ref, uv_query)
    directed = adapters.from_direction(keyframe, view, uv_ref, uv_query, true[:3, :3], 7.0 * true[:3, 3])
    for answer in (matched, directed):
        assert np.linalg.norm(answer.T_query_ref[:3, 3] - true[:3, 3]) < 0.03
        assert 0.7 < answer.confidence <= 0.85
    nothing = np.full((300, 2), np.nan)
    assert "matches with depth" in adapters.from_matches(keyframe, view, nothing, uv_query).message
    refused = adapters.from_direction(keyframe, view, nothing, uv_query, true[:3, :3], true[:3, 3])
    assert (refused.T_query_ref, refused.message[:25]) == (None, "0 matches have depth, at ")


def test_the_adapter_of_model_depth_finds_the_metric_pose(adapters: Any) -> None:
    keyframe, _, true = views(adapters, sparse=True)
    depth = render(keyframe.camera, small_pose(2))[1] / 3.7
    depth[:20] *= 5
    model_pose = make_transform(true[:3, :3], true[:3, 3] / 3.7)
    answer = adapters.from_model_depth(keyframe, model_pose, depth)
    assert np.abs(answer.T_query_ref - true).max() < 1e-3
    assert answer.info["scale"] == pytest.approx(3.7, rel=1e-3)
    refused = adapters.from_model_depth(keyframe, model_pose, np.zeros_like(depth))
    assert refused.message == "0 pixels have both depths, at least 5 are needed for a metric scale"


def test_a_pixel_takes_the_depth_of_the_nearest_pixel_that_has_one(adapters: Any) -> None:
    keyframe, _, _ = views(adapters)
    few = adapters.Keyframe(
        "k", keyframe.image, keyframe.camera, np.array([[10.0, 10.0], [12.0, 10.0]]), np.array([2.0, 4.0]), np.ones(2)
    )
    asked = np.array([[10.4, 9.6], [11.2, 10.0], [14.0, 10.0], [-3.0, 5.0], [np.nan, 1.0], [10.0, 119.0]])
    assert adapters.points_at(few, asked)[:, 2].tolist()[:1] == [2.0]
    assert adapters.points_at(few, asked)[1, 2] in (2.0, 4.0)
    assert np.isnan(adapters.points_at(few, asked)[2:]).all()
    assert adapters.points_at(few, asked, reach=2)[2, 2] == 4.0
