"""``relocbench train``: from a dataset to weights that track, and one line for each mistake."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import relocbench
from killing import Fault, run_until_killed
from made_pairs import SETTINGS
from refusals import refused
from small_dataset import ACROSS, CAMERA, WITHIN, make_small_dataset, time_of

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.learning.training_pairs import DatasetPairs, without_only_validation
from relocbench.datasets.pairs.correspondence_file import read_correspondences
from relocbench.errors import ConfigError, DatasetError, MethodError
from relocbench.evaluation.tracking.training_validation import TrackerValidation
from relocbench.methods.trainers import installed_trainers, trainer_named, trainer_options
from relocbench.progress import Silent
from relocbench.tracking import Query, Reference, TrackResult

SPLITS = {"train": [ACROSS, WITHIN], "validation": [ACROSS]}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("data") / "d"
    return make_small_dataset(folder, frames=5, correspondences=300, splits=SPLITS, rejected=1)


def train(dataset: Path, out: Path, *more: object) -> Any:
    return relocbench("train", "gn-net", "-d", dataset, "-o", out, "-j", 0, "--device", "cpu", *SETTINGS, *more)


def test_trainers_are_found_by_entry_point() -> None:
    assert {"gn-net", "gn-net-contrastive", "lm-net"} <= set(installed_trainers())
    with refused(MethodError, "", None, "gn-net"):
        trainer_named("gn-nett")
    with refused(MethodError, "", None, "train"):
        trainer_named("trackers_for_tests:Shift")


def test_options_come_from_defaults_then_file_then_settings(tmp_path: Path) -> None:
    usual = {"rate": 0.1, "steps": 5, "loss": {"weight": 1.0, "form": "a"}}
    config = tmp_path / "c.yaml"
    config.write_text("steps: 7\nloss: {weight: 2}\n")
    chosen = trainer_options(usual, config, ["loss.weight=3", "rate=1e-3"])
    assert chosen == {"rate": 0.001, "steps": 7, "loss": {"weight": 3, "form": "a"}}
    assert usual["loss"] == {"weight": 1.0, "form": "a"}
    config.write_text("losss: {weight: 2}\n")
    with refused(ConfigError, "c.yaml", None, "losss", "loss"):
        trainer_options(usual, config, [])
    with refused(ConfigError, "", None, "loss", "weight", "form"):
        trainer_options(usual, None, ["loss=3"])


def test_a_group_without_defaults_takes_any_names() -> None:
    usual: dict[str, Any] = {"shares": {}}
    chosen = trainer_options(usual, None, ["shares.town=0.2", "shares.walk=0.1", "shares.town=0.3"])
    assert chosen == {"shares": {"town": 0.3, "walk": 0.1}}
    assert usual == {"shares": {}}
    deeper = trainer_options(usual, None, ["shares.town.a=1", "shares.town.b=2"])
    assert deeper == {"shares": {"town": {"a": 1, "b": 2}}}  # which the options refuse, with one line
    with refused(ConfigError, "", None, "shares"):
        trainer_options(usual, None, ["shares=3"])


@pytest.mark.thorough
def test_pairs_of_a_split_hold_what_both_images_see(dataset: Dataset) -> None:
    data = DatasetPairs([dataset.root])
    accepted = {name: dataset.pair_set(name).pairs for name in (ACROSS, WITHIN)}
    assert len(data) == sum(map(len, accepted.values()))
    first = data.load(0)
    label = data.label(0)
    assert (label.traversal_ref, label.traversal_query, label.camera) == ("summer", "winter", CAMERA)
    assert (label.condition_ref, label.condition_query) == ("sunny, summer, day", "snow, winter, day")
    pair = accepted[ACROSS][0]
    stored = read_correspondences(dataset.layout.correspondence_file(ACROSS), pair.key)
    assert np.array_equal(first.u_ref, stored.uv_ref[stored.visible].astype(np.float32))
    assert np.array_equal(first.u_query, stored.uv_query[stored.visible].astype(np.float32))
    assert first.sigma_px is not None
    assert len(first.sigma_px) == len(first.u_ref) > 50
    grey = dataset.traversal("summer").image(CAMERA, pair.ref_timestamp_ns)
    assert all(np.array_equal(first.image_ref[..., channel], grey) for channel in range(3))
    assert list(data.describe().values()) == [dataset.fingerprint]


def test_poses_and_single_images_are_told_to_trainers_that_ask_for_them(dataset: Dataset) -> None:
    data = DatasetPairs([dataset.root])
    pair_set = dataset.pair_set(ACROSS)
    first, again = data.posed(0), data.posed(1)
    truth = pair_set.pairs[0].T_query_ref
    assert truth is not None
    assert np.array_equal(first.T_query_ref, truth)
    assert first.image_ref != first.image_query
    within = [data.posed(index) for index in range(len(data)) if data.label(index).traversal_query == "summer"]
    assert {first.image_ref, again.image_ref} & {name for pair in within for name in (pair.image_ref, pair.image_query)}
    view, loaded = data.view(first.image_query, depth=False), data.load(0)
    assert np.array_equal(view.image, loaded.image_query)
    assert len(view.points) == 0
    reference = dataset.reference(pair_set, pair_set.pairs[0])
    keyframe = data.view(first.image_ref, depth=True)
    assert keyframe.camera == reference.camera
    assert np.array_equal(keyframe.points.inverse_depth, reference.points.inverse_depth)
    assert len(keyframe.points) > 1000


def test_who_learns_from_poses_needs_no_correspondences(tmp_path: Path) -> None:
    bare = make_small_dataset(tmp_path / "d", splits={"train": [ACROSS]})
    with refused(DatasetError, "", None, "correspondences"):
        DatasetPairs([bare.root])
    data = DatasetPairs([bare.root], correspondences=False)
    assert len(data) == len(bare.pair_set(ACROSS).pairs)
    assert data.load(0).u_ref.shape == (0, 2)
    withheld = make_small_dataset(tmp_path / "withheld", splits={"train": [ACROSS]}, truth=False)
    with refused(ConfigError, "", None, "train"):
        DatasetPairs([withheld.root], correspondences=False)


def test_withheld_poses_are_named(dataset: Dataset) -> None:
    data = DatasetPairs([dataset.root])
    number, pair = data._entries[0]
    data._entries[0] = number, replace(pair, T_query_ref=None)
    with refused(DatasetError, dataset.root, None, "withheld"):
        data.posed(0)


def test_the_test_split_is_never_learnt_from(tmp_path: Path) -> None:
    both = make_small_dataset(tmp_path / "d", correspondences=50, splits={"train": [WITHIN], "test": [ACROSS]})
    with refused(ConfigError, "", None, "test"):
        DatasetPairs([both.root], "test")
    with refused(ConfigError, "", None, "train", "summer"):
        DatasetPairs([both.root])
    for split in ("test", "train"):
        told = train(both.root, tmp_path / "out", "--split", split)
        assert told.status == 2
        assert "test split" in told.complaint
    assert not (tmp_path / "out").exists()


@pytest.mark.thorough
def test_missing_parts_of_a_dataset_are_one_line_each(tmp_path: Path, dataset: Dataset) -> None:
    bare = make_small_dataset(tmp_path / "bare", splits={"train": [ACROSS], "validation": [WITHIN]})
    unsplit = make_small_dataset(tmp_path / "unsplit", correspondences=50, splits={"train": [ACROSS]})
    for folder, more, words in (
        (bare.root, (), "missing; expected correspondences (build-dataset --correspondences N)"),
        (unsplit.root, (), "no dataset has a split 'validation' to choose weights by"),
        (unsplit.root, ("--split", "training"), "no split 'training' (did you mean 'train'?); available: train"),
        (tmp_path / "none", (), "no such folder; expected a dataset"),
        (dataset.root, ("--set", "crap=3"), "unknown option 'crap' (did you mean 'crop'?)"),
        (dataset.root, ("--set", "batch=none"), "batch"),
        (dataset.root, ("-d", dataset.root), "given twice"),
    ):
        told = train(folder, tmp_path / "out", *more)
        assert told.status == 2
        assert words in told.complaint
    assert "lies inside a dataset" in train(dataset.root, dataset.root / "out").complaint
    path = bare.layout.pair_file(ACROSS)
    path.write_text(path.read_text() + "\n")
    with refused(DatasetError, "", None, "manifest.csv"):
        DatasetPairs([bare.root])


def test_a_dataset_with_a_validation_split_alone_serves_for_validation(tmp_path: Path) -> None:
    learnt = make_small_dataset(tmp_path / "learnt", correspondences=50, splits={"train": [ACROSS]})
    checked = make_small_dataset(tmp_path / "checked", splits={"validation": [ACROSS]})
    both = [learnt.root, checked.root]
    assert without_only_validation(both, "train") == [learnt.root]
    assert without_only_validation([checked.root], "train") == [checked.root]  # refused later, in words
    assert len(TrackerValidation(both, 4, 0, Silent())) == 4


class Truth:
    """Answers what it was told, pair by pair."""

    uses_times = True  # it knows the pairs by them

    def __init__(self, dataset: Dataset, broken: str = "") -> None:
        self._poses = {p.key: p.T_query_ref for name in (ACROSS, WITHIN) for p in dataset.pair_set(name).pairs}
        self._broken = broken

    def track(self, reference: Reference, query: Query, prior: Any = None) -> TrackResult:
        if self._broken:
            raise ValueError(self._broken)
        return TrackResult(self._poses[time_of(reference), time_of(query)])


@pytest.mark.thorough
def test_a_trial_asks_evenly_and_scores_as_evaluate_does(tmp_path: Path) -> None:
    data = make_small_dataset(tmp_path / "d", frames=6, splits={"validation": [ACROSS, WITHIN]})
    trial = TrackerValidation([data.root], pairs=8, seed=0, reporter=Silent())
    scores = trial(Truth(data))
    assert scores.together == {"t_auc@0.5m": 1.0, "r_auc@0.5deg": 1.0, "recall@(0.25m,2deg)": 1.0}
    assert scores.pairs == {"sunny, summer, day -> snow, winter, day": 4, "sunny, summer, day -> sunny, summer, day": 4}
    broken = trial(Truth(data, broken="no luck"))
    assert set(broken.together.values()) == {0.0}
    assert broken.messages == ("ValueError: no luck",)
    whole = TrackerValidation([data.root], pairs=1000, seed=0, reporter=Silent())
    assert len(whole) == sum(len(data.pair_set(name).pairs) for name in (ACROSS, WITHIN))
    again = TrackerValidation([data.root], pairs=8, seed=0, reporter=Silent())
    assert [a.pair.key for a in trial._asked] == [a.pair.key for a in again._asked]


def test_options_are_shown_as_a_file_that_config_takes(tmp_path: Path, dataset: Dataset) -> None:
    shown = relocbench("train", "gn-net", "--show-options", "--set", "crop=64")
    assert "crop: 64" in shown.out
    (tmp_path / "c.yaml").write_text(shown.out)
    again = relocbench("train", "gn-net", "--show-options", "--config", tmp_path / "c.yaml")
    assert again.out == shown.out


@pytest.mark.thorough
def test_a_dataset_becomes_weights_that_evaluate_runs(tmp_path: Path, dataset: Dataset) -> None:
    out = tmp_path / "out"
    done = train(dataset.root, out, "--validation-pairs", 2)
    assert done.status == 0, done.err
    names = {"weights.safetensors", "checkpoint.pt", "log.csv", "validation.csv", "curves.png", "config.yaml"}
    assert {path.name for path in out.iterdir()} == {*names, "MODEL_CARD.md"}
    card = (out / "MODEL_CARD.md").read_text()
    assert dataset.fingerprint in card
    assert "relocbench train gn-net --dataset=" in card
    assert "sunny, summer, day -> snow, winter, day" in card
    ran = relocbench(
        "evaluate", "-d", dataset.root, "-m", "gn-net", "--set", f"weights={out / 'weights.safetensors'}",
        "--split", "validation", "-o", tmp_path / "results", "-j", 1, "--json",
    )  # fmt: skip
    assert ran.status == 0, ran.err
    assert '"gn-net"' in ran.out


@pytest.mark.thorough
def test_a_training_killed_outright_ends_with_the_bytes_of_one_that_was_not(tmp_path: Path, dataset: Dataset) -> None:
    more = ("--validation-pairs", 2, "--set", "steps=4", "--set", "validate_every=2", "--set", "checkpoint_every=1")
    command = [
        *("train", "gn-net", "-d", dataset.root, "-o", tmp_path / "cut", "-j", 0, "--device", "cpu"),
        *SETTINGS,
        *more,
    ]
    third = Fault(r"checkpoint\.pt$", 3)
    run_until_killed(["python", "-m", "relocbench", *command], third, tmp_path / "trace")
    assert (tmp_path / "cut" / "checkpoint.pt").exists()
    assert not (tmp_path / "cut" / "MODEL_CARD.md").exists()  # it was not done
    assert train(dataset.root, tmp_path / "cut", *more).status == 0
    assert train(dataset.root, tmp_path / "whole", *more).status == 0
    cut, whole = ((tmp_path / name / "weights.safetensors").read_bytes() for name in ("cut", "whole"))
    assert cut == whole
