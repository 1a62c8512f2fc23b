"""``relocbench train lpn``: from a cross-view folder to weights that evaluate, and one line for each mistake."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from command_line import relocbench
from made_places import TINY, picture
from refusals import refused
from small_dataset import ACROSS, make_small_dataset

from baselines.lpn.retriever import Lpn
from baselines.lpn.weights import load_weights
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.learning.training_places import training_places
from relocbench.datasets.pairs.street_places import StreetPlaces
from relocbench.errors import ConfigError
from relocbench.methods import RETRIEVERS, installed_methods
from relocbench.methods.trainers import chosen_options, installed_trainers, trainer_named
from relocbench.progress import Silent

SETTINGS = [f"--set={key}={value}" for key, value in TINY.items() if not isinstance(value, dict)]
SETTINGS += [f"--set=network.{key}={value}" for key, value in TINY["network"].items()]
SETTINGS += ["--set=epochs.all=2"]


@pytest.fixture(scope="module")
def university(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six places to learn from, four others to be asked about, in University-1652's layout."""
    root = tmp_path_factory.mktemp("data") / "university"
    for place in range(10):
        folders = {"train/drone": 3, "train/satellite": 1}
        if place >= 6:
            folders = {
                "test/query_drone": 2,
                "test/gallery_satellite": 1,
                "test/query_satellite": 1,
                "test/gallery_drone": 2,
            }
        for folder, count in folders.items():
            for number in range(count):
                path = root / folder / f"{place:04d}" / f"{number}.png"
                path.parent.mkdir(parents=True, exist_ok=True)
                cv2.imwrite(str(path), picture(place, folder.rpartition("_")[2].rpartition("/")[2], number))
    return root


def train(dataset: Path, out: Path, *more: object) -> Any:
    return relocbench("train", "lpn", "-d", dataset, "-o", out, "-j", 0, "--device", "cpu", *SETTINGS, *more)


def test_it_is_found_by_entry_point() -> None:
    assert "lpn" in installed_trainers()
    floors = {"lpn", "global-average", "colour-histogram", "orb-bow", "random"}
    assert floors <= set(installed_methods(RETRIEVERS))


def test_a_configuration_is_named_or_stands_in_a_file(tmp_path: Path) -> None:
    trainer = trainer_named("baselines.lpn.training.trainer:LpnTrainer")
    usual = chosen_options(trainer, None, [])
    assert usual["configuration"] == "lpn"
    rpp = chosen_options(trainer, "lpn-rpp", ["epochs.refined=7", "size=64"])
    assert (rpp["epochs"]["refined"], rpp["network"]["partition"], rpp["size"]) == (7, "soft", 64)
    file = tmp_path / "mine.yaml"
    file.write_text("configuration: lpn-rpp\nepochs: {classifier: 5}\n")
    assert chosen_options(trainer, str(file), [])["epochs"] == {"uniform": 120, "classifier": 5, "refined": 50}
    assert chosen_options(trainer, None, ["configuration=lpn-rpp"])["network"]["partition"] == "soft"
    with refused(ConfigError, "", None, "lpn-rp", "lpn-rpp"):
        chosen_options(trainer, "lpn-rp", [])
    file.write_text("configuration: lpn-rp\n")
    with refused(ConfigError, "", None, "lpn-rp"):
        chosen_options(trainer, str(file), [])


def test_places_of_several_folders_are_numbered_one_after_the_other(university: Path, tmp_path: Path) -> None:
    data = training_places([university], Silent())
    assert (data.places, data.views, len(data.images)) == (6, ("drone", "satellite"), 24)
    for place in (0, 1):
        (tmp_path / "train" / "drone" / f"{place}").mkdir(parents=True)
        cv2.imwrite(str(tmp_path / "train" / "drone" / f"{place}" / "0.png"), np.zeros((8, 8, 3), np.uint8))
    both = training_places([university, tmp_path], Silent())
    assert (both.places, len(both.images), len(both.described)) == (8, 26, 2)
    assert [each.place for each in both.images[-2:]] == [6, 7]
    with refused(ConfigError, university, None, "twice"):
        training_places([university, university], Silent())


def test_mistakes_are_one_line_each(university: Path, tmp_path: Path) -> None:
    for more, words in (
        (("--config", "lpn-rp"), "did you mean 'lpn-rpp'"),
        (("--set", "sizes=3"), "unknown option 'sizes' (did you mean 'size'?)"),
        (("--set", "views=[drone,street]"), "no held-out image of view 'street' (there are drone, satellite)"),
        (("--set", "views=[drone,street]", "--no-validation"), "network.street is 'none', expected separate or shared"),
        (("--split", "test"), "--split is an option for trainers of trackers, and 'lpn' trains retrievers"),
        (("--validation-pairs", 4), "--validation-pairs is an option for trainers of trackers, and 'lpn' trains retr"),
        (("--no-validation", "--validation-places", 0.2), "--validation-places has no effect beside --no-validation"),
        (("--backbone-weights", tmp_path / "none.pth"), "none.pth: no such file of weights"),
    ):
        told = train(university, tmp_path / "out", *more)
        assert told.status == 2
        assert words in told.complaint
    assert "lies inside a dataset" in train(university, university / "out").complaint
    (tmp_path / "empty").mkdir()
    assert "expected University-1652's layout" in train(tmp_path / "empty", tmp_path / "out").complaint
    for option, value in (("--backbone-weights", "x"), ("--validation-places", 0.0)):
        other = relocbench("train", "gn-net", option, value, "--show-options")
        assert other.status == 2
        assert f"{option} is an option for trainers of retrievers, and 'gn-net' trains trackers" in other.complaint


@pytest.mark.thorough
def test_drives_become_weights_that_retrieve_along_streets(tmp_path: Path) -> None:
    """Each dataset is one place, since its drives are shorter than places are apart."""
    roots = [
        make_small_dataset(tmp_path / name, seed=seed, splits={"train": [ACROSS]}).root
        for seed, name in enumerate(("first", "second", "third"))
    ]
    out, more = tmp_path / "out", [word for root in roots[1:] for word in ("-d", root)]
    done = train(roots[0], out, *more, "--config", "street", "--no-validation")
    assert done.status == 0, done.err
    assert "3 places: 3 in street" in done.err
    _, about = load_weights(out / "weights.safetensors")
    assert (about.configuration, about.views) == ("street", ("street",))
    (task,) = StreetPlaces(Dataset(roots[0])).tasks()
    described = Lpn(weights=out / "weights.safetensors").describe(task.queries)
    assert np.allclose(np.linalg.norm(described, axis=1), 1)


@pytest.mark.thorough
def test_a_folder_becomes_weights_that_evaluate_runs(university: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = train(university, out, "--validation-places", 0.34, "--json")
    assert done.status == 0, done.err
    told = json.loads(done.out.splitlines()[-1])
    assert told["steps"] == 2
    assert set(told["validation"]) == {"all", "drone-satellite", "satellite-drone"}
    assert "4 places: 4 in drone, 4 in satellite, 4 in all of these views" in done.err  # two of six are held out
    assert "feature variance" in done.err
    assert "chance R@1 50.0 %" in done.err
    files = {"weights.safetensors", "checkpoint.pt", "log.csv", "validation.csv", "curves.png", "config.yaml"}
    assert {path.name for path in out.iterdir()} == {*files, "MODEL_CARD.md"}
    assert "relocbench train lpn --dataset=" in (out / "MODEL_CARD.md").read_text()
    ran = relocbench(
        "evaluate-retrieval", "-d", university, "-m", "lpn", "-m", "random", "-o", tmp_path / "results",
        "-j", 0, "--set", f"lpn.weights={out / 'weights.safetensors'}", "--json",
    )  # fmt: skip
    assert ran.status == 0, ran.err
    scores = json.loads(ran.out.splitlines()[-1])["methods"]["lpn"]
    assert set(scores) == {"drone-satellite", "satellite-drone"}
