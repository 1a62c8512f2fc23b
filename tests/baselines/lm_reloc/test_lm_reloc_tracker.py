"""The trackers pose-net and lm-reloc: what they answer, from which start, and with which weights."""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from made_views import POSES, TINY_POSE_NET, keyframe, query, tiny_encoder
from refusals import refused
from repository import ROOT
from small_dataset import render, small_camera

from baselines.gn_net.tracker import LmNet, LmNetFromPrior
from baselines.gn_net.weights import load_weights as load_encoder
from baselines.lm_reloc.network import PoseNetwork
from baselines.lm_reloc.options import PoseNetOptions
from baselines.lm_reloc.tracker import SHIPPED, LmReloc, PoseNet
from baselines.lm_reloc.training.trainer import PoseNetTrainer
from baselines.lm_reloc.weights import read_card, save_weights
from baselines.options import options_from_dict, plain
from relocbench.errors import MethodError
from relocbench.geometry import Camera, invert
from relocbench.methods import parse_method
from relocbench.methods.lookup import load_dotted
from relocbench.tracking import Query, Tracker

LARGEST_BYTES = 10_000_000
CAMERA = small_camera(96, 72)
DOTTED = "baselines.lm_reloc.tracker:PoseNet"


def drawn_pose_net(folder: Path, depth: bool = False) -> Path:
    """A file of random weights whose predictions differ visibly from the identity."""
    encoder = load_encoder(tiny_encoder(folder))
    values = {**TINY_POSE_NET["network"], "depth": depth, "encoder": plain(encoder.options)}
    net = PoseNetwork(options_from_dict(PoseNetOptions, values), torch.Generator().manual_seed(1))
    net.encoder.load_state_dict(encoder.state_dict())
    path = folder / "pose.safetensors"
    save_weights(path, net, {})
    return path


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drawn_pose_net(tmp_path_factory.mktemp("pose"))


def answer(tracker: Any, **changed: Any) -> Any:
    reference = tracker.prepare(keyframe(changed.get("ref", CAMERA)))
    return tracker.track(reference, changed.get("query", query(CAMERA)), changed.get("prior"))


def test_it_answers_a_pose_without_confidence_whatever_the_prior(weights: Path) -> None:
    tracker = PoseNet(weights)
    assert isinstance(tracker, Tracker)
    assert not getattr(tracker, "uses_prior", False)
    found, again = answer(tracker), answer(tracker, prior=POSES[2])
    assert found.confidence is None
    assert np.array_equal(found.T_query_ref, again.T_query_ref)
    assert np.abs(found.T_query_ref @ invert(found.T_query_ref) - np.eye(4)).max() < 1e-9
    assert np.abs(found.T_query_ref - np.eye(4)).max() > 1e-4


def test_inverse_depth_is_used_only_where_the_weights_ask_for_it(tmp_path: Path, weights: Path) -> None:
    flat = replace(keyframe(CAMERA), depth=np.full((72, 96), 3.0, np.float32))
    for path, used in ((weights, False), (drawn_pose_net(tmp_path, depth=True), True)):
        tracker = PoseNet(path)
        first, second = (
            tracker.track(tracker.prepare(ref), query(CAMERA)).T_query_ref for ref in (keyframe(CAMERA), flat)
        )
        assert first is not None
        assert second is not None
        assert np.array_equal(first, second) is not used


def test_an_image_that_fills_next_to_nothing_of_the_view_is_a_failure_that_says_so(weights: Path) -> None:
    tracker = PoseNet(weights)
    far = Camera("pinhole", 96, 72, 2000.0, 2000.0, 47.5, 35.5)
    result = answer(tracker, query=Query("far", None, np.zeros((72, 96), np.uint8), far))
    assert not result.answered
    assert re.search(r"fill \d+% and 0% of the network's view of 67 degrees, at least 5% are needed", result.message)


def test_lm_reloc_is_lm_net_from_the_pose_of_pose_net(weights: Path) -> None:
    direct = answer(LmReloc(pose_weights=weights, min_agreement=0.0))
    label = "mine=baselines.gn_net.tracker:LmNetFromPrior"
    settings = [f"mine.start={DOTTED}", f"mine.start.weights={weights}", "mine.min_agreement=0"]
    spec = parse_method(label, settings)
    started = answer(spec.create())
    assert direct.answered
    assert started.info["start"] == "found"
    assert np.array_equal(direct.T_query_ref, started.T_query_ref)
    assert direct.info == {key: value for key, value in started.info.items() if key != "start"}
    assert direct.confidence is None
    alone = answer(LmNetFromPrior(min_agreement=0.0))
    assert alone.info["iterations"] != direct.info["iterations"] or alone.info["energy"] != direct.info["energy"]
    assert set(spec.files()) == {"weights", "start.weights"}


def test_lm_reloc_passes_pixels_and_features_on_to_lm_net(weights: Path) -> None:
    mine, net = LmReloc(pose_weights=weights), LmNet()
    uv = np.array([[30.0, 40.0], [50.0, 30.0]])
    ends = mine.match(mine.prepare(keyframe(CAMERA)), query(CAMERA), uv, uv)
    assert np.array_equal(ends, net.match(net.prepare(keyframe(CAMERA)), query(CAMERA), uv, uv), equal_nan=True)
    image = keyframe(CAMERA).image
    assert np.array_equal(mine.features(image, CAMERA).levels[1].map, net.features(image, CAMERA).levels[1].map)


def test_files_that_decide_the_answers_are_named(weights: Path) -> None:
    assert PoseNet.files() == {"weights": SHIPPED}
    assert LmReloc.files(pose_weights=weights)["pose_weights"] == weights
    assert LmReloc.files()["weights"].name == "lm-net.safetensors"


def test_wrong_weights_are_one_line(tmp_path: Path) -> None:
    path = tiny_encoder(tmp_path)
    with refused(MethodError, path, None, "pose-net"):
        LmReloc(pose_weights=path)
    with refused(MethodError, "none.safetensors"):
        PoseNet(tmp_path / "none.safetensors")


@pytest.mark.parametrize(
    ("group", "name", "found"),
    [
        ("methods", "pose-net", PoseNet),
        ("methods", "lm-reloc", LmReloc),
        ("methods", "lm-net-from-prior", LmNetFromPrior),
        ("trainers", "pose-net", PoseNetTrainer),
    ],
)
def test_the_names_of_the_package_lead_to_its_classes(group: str, name: str, found: type) -> None:
    """Read from the project's description: what is installed may be older."""
    points = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]
    assert load_dotted(points[f"relocbench.{group}"][name], "method") is found


def test_the_shipped_weights_are_small_and_their_card_says_how_to_make_them_again() -> None:
    assert SHIPPED.stat().st_size < LARGEST_BYTES
    inside, told = read_card(SHIPPED), SHIPPED.with_suffix(".md").read_text(encoding="utf-8")
    assert inside["name"] == "pose-net"
    assert told.startswith("# pose-net\n")
    for row in ("data", "seed", "steps", "time", "hardware", "versions", "command", "encoder"):
        assert re.search(rf"^\| {row} \| \S", told, re.MULTILINE), row
    assert "| reference -> query | pairs | t_auc@0.5m |" in told


@pytest.mark.parametrize("factor", [1.5, 2.0])
def test_a_scaled_copy_with_scaled_intrinsics_gets_almost_the_same_pose(factor: float) -> None:
    """The street is ray-cast anew at each size. With the intrinsics of the other size the pose is another one."""
    tracker = PoseNet()
    small = small_camera(288, 216)
    large = small.scaled(factor)
    reference = tracker.prepare(keyframe(small))

    def numbers(camera: Camera, told: Camera) -> Any:
        result = tracker.track(reference, Query("q", None, render(camera, POSES[1])[0], told))
        return result.T_query_ref

    usual = numbers(small, small)
    same = np.abs(numbers(large, large) - usual)
    wrong = np.abs(numbers(large, replace(large, fx=small.fx, fy=small.fy)) - usual)
    assert same[:3, :3].max() < 0.01
    assert same[:3, 3].max() < 0.1
    assert wrong.max() > 3 * same.max()
