"""The pose loss: its steps are those of Gauss-Newton on poses, and what it is told of a pair fits the pair's pixels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from made_pairs import TINY, MadePairs
from refusals import refused
from torch import Tensor

from baselines.gn_net.losses.pose import (
    PoseOptions,
    PoseTerms,
    SeenPoints,
    _exp,
    _pixel_by_pose,
    _projected,
    _rotation_vector,
    draw_start_poses,
    pose_terms,
)
from baselines.gn_net.losses.total import LossOptions, pose_loss
from baselines.gn_net.training.batches import Batches
from baselines.gn_net.training.options import TrainOptions
from baselines.gn_net.training.posed import inverse_depth_at
from baselines.gn_net.training.presets import gn_net
from baselines.gn_net.weights import load_weights
from baselines.options import filled, options_from_dict, plain
from relocbench.errors import ConfigError, MethodError
from relocbench.geometry import Camera, apply, invert, se3_exp, so3_log
from relocbench.tracking import KeyframePoints
from relocbench.training import PosedPair, TrainingPair, TrainingRun, TrainingView

SIDE, FOCAL = 64, 60.0
INTRINSICS = torch.tensor([[FOCAL, FOCAL, 31.5, 31.5]] * 2)
MOTIONS = np.array([[0.1, -0.05, 0.3, 0.01, -0.02, 0.015], [-0.2, 0.0, -0.2, -0.02, 0.03, 0.0]])


def scene() -> tuple[list[Tensor], list[Tensor], SeenPoints]:
    """Maps of two pairs: a feature of the query is its pixel, one of the keyframe is its point's pixel in the query."""
    rng = np.random.default_rng(3)
    pixels = np.stack(np.meshgrid(np.arange(8, 56, 4), np.arange(8, 56, 4)), axis=-1).reshape(-1, 2)
    features_ref, X_all, u_all, T_all = torch.zeros((2, 2, SIDE, SIDE)), [], [], []
    for pair, motion in enumerate(MOTIONS):
        depth = rng.uniform(2.0, 9.0, len(pixels))
        X = np.column_stack([(pixels - 31.5) / FOCAL, np.ones(len(pixels))]) * depth[:, None]
        T = se3_exp(motion)
        there = apply(T, X)
        u = FOCAL * there[:, :2] / there[:, 2:] + 31.5
        features_ref[pair, :, pixels[:, 1], pixels[:, 0]] = torch.tensor(u.T, dtype=torch.float32)
        X_all.append(X)
        u_all.append(u)
        T_all.append(T)
    v, u_map = torch.meshgrid(torch.arange(float(SIDE)), torch.arange(float(SIDE)), indexing="ij")
    features_query = torch.stack([u_map, v]).expand(2, 2, SIDE, SIDE).clone()
    arrays = (np.array(X_all), np.stack([pixels] * 2), np.array(u_all))
    X_ref, u_ref, u_query = (torch.tensor(each, dtype=torch.float32) for each in arrays)
    known = torch.ones(X_ref.shape[:2], dtype=torch.bool)
    true = torch.tensor(np.array(T_all), dtype=torch.float32)
    return [features_ref], [features_query], SeenPoints(X_ref, u_ref, u_query, known, INTRINSICS, true)


EASY = PoseOptions(weight=1.0, iterations=6, huber=50.0, damping=1e-3, reach=40.0)


def test_alignment_goes_from_the_keyframes_pose_to_the_true_one() -> None:
    ref, query, seen = scene()
    terms = pose_terms(ref, query, seen, torch.eye(4).expand(2, 4, 4), EASY, finest=0)
    assert terms.valid.all()
    assert float(terms.before.min()) > 1.0
    assert float(terms.after.max()) < 0.02
    from_truth = pose_terms(ref, query, seen, seen.T_query_ref, EASY, finest=0)
    assert float(from_truth.after.max()) < 0.02


def test_on_a_coarser_level_pixels_are_of_that_level() -> None:
    ref, query, seen = scene()
    halves = [torch.nn.functional.avg_pool2d(each[0], 2) for each in (ref, query)]
    terms = pose_terms([ref[0], halves[0]], [query[0], halves[1]], seen, seen.T_query_ref, EASY, finest=0)
    still = pose_terms([ref[0], halves[0]], [query[0], halves[1]], seen, torch.eye(4).expand(2, 4, 4), EASY, finest=0)
    assert torch.allclose(terms.before[1], torch.zeros(2), atol=1e-2)
    finest = pose_terms(ref, query, seen, torch.eye(4).expand(2, 4, 4), EASY, finest=0)
    assert torch.allclose(still.before[1], finest.before[0] / 2, rtol=1e-3)


def test_a_level_out_of_reach_costs_nothing_and_points_without_depth_have_no_say() -> None:
    ref, query, seen = scene()
    identity = torch.eye(4).expand(2, 4, 4)
    assert not pose_terms(ref, query, seen, identity, replace(EASY, reach=0.5), finest=0).valid.any()
    loss = LossOptions(pose=replace(EASY, reach=0.5, still=1.0), level_weights=(1.0,))
    assert float(pose_loss(ref, query, seen, loss, 0, torch.Generator().manual_seed(0)).total) == 0.0
    X_ref, known = seen.X_ref.clone(), seen.known.clone()
    X_ref[:, ::3], known[:, ::3] = 1.0, False
    some = pose_terms(ref, query, seen._replace(X_ref=X_ref, known=known), identity, EASY, finest=0)
    assert float(some.after.max()) < 0.02


def test_derivatives_reach_both_maps_and_are_finite_even_without_contrast() -> None:
    ref, query, seen = scene()
    loss = LossOptions(pose=replace(EASY, iterations=1, still=1.0), level_weights=(1.0,))
    for contrast in (1.0, 0.0):
        maps = [(contrast * each[0]).requires_grad_() for each in (ref, query)]
        pose_loss([maps[0]], [maps[1]], seen, loss, 0, torch.Generator().manual_seed(0)).total.backward()
        for each in maps:
            assert each.grad is not None
            assert bool(each.grad.isfinite().all())
            assert bool((each.grad != 0).any()) == (contrast > 0)


def test_the_derivative_of_the_loss_is_that_of_finite_differences() -> None:
    ref, query, seen = scene()
    ref, query = [ref[0].double()], [query[0].double()]
    seen = SeenPoints(*(each.double() if each.is_floating_point() else each for each in seen))
    options = replace(EASY, iterations=2)
    start = se3_exp(0.3 * MOTIONS)
    direction = torch.randn(query[0].shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)

    def cost(step: float) -> Tensor:
        return pose_terms(ref, [query[0] + step * direction], seen, torch.tensor(start), options, 0).cost.sum()

    step = torch.zeros((), dtype=torch.float64, requires_grad=True)
    value = pose_terms(ref, [query[0] + step * direction], seen, torch.tensor(start), options, 0).cost.sum()
    (slope,) = torch.autograd.grad(value, step)
    # The weights of the robust loss are constants of a step, here all one.
    assert float(slope) == pytest.approx(float(cost(1e-5) - cost(-1e-5)) / 2e-5, rel=1e-4)


def test_confidences_weigh_points_and_learn_which_are_wrong() -> None:
    ref, query, seen = scene()
    identity = torch.eye(4).expand(2, 4, 4)
    wrong = ref[0].clone()
    spoilt = seen.u_ref[0, ::3].long()
    wrong[:, :, spoilt[:, 1], spoilt[:, 0]] += torch.tensor([12.0, -9.0])[None, :, None]
    everywhere = torch.full((2, 1, SIDE, SIDE), 0.5)
    there = torch.zeros_like(everywhere, dtype=torch.bool)
    there[:, :, spoilt[:, 1], spoilt[:, 0]] = True

    def after(confidences: list[Tensor]) -> PoseTerms:
        return pose_terms([wrong], query, seen, identity, EASY, 0, confidences)

    misled = after([])
    assert torch.allclose(after([everywhere]).after, misled.after, rtol=1e-3)
    assert float(misled.after.min()) > 1.0
    assert float(after([torch.where(there, 1e-6, everywhere)]).after.max()) < 0.02
    learnt = everywhere.clone().requires_grad_()
    (slope,) = torch.autograd.grad(after([learnt]).cost.sum(), learnt)
    assert float(slope[there].mean()) > 0
    assert float(slope[~there].sum()) < 0


def test_motions_are_those_of_the_geometry() -> None:
    xi = np.random.default_rng(0).normal(size=(20, 6))
    assert np.allclose(_exp(torch.tensor(xi)).numpy(), se3_exp(xi), atol=1e-12)
    R = se3_exp(xi)[:, :3, :3]
    assert np.allclose(_rotation_vector(torch.tensor(R)).numpy(), so3_log(R), atol=1e-9)
    assert torch.equal(_rotation_vector(torch.eye(3)), torch.zeros(3))
    X = torch.tensor([[[0.4, -0.3, 2.0]]], dtype=torch.float64)
    K = torch.tensor([[50.0, 60.0, 3.0, 4.0]], dtype=torch.float64)
    steps = 1e-6 * torch.eye(6, dtype=torch.float64)
    moved = [torch.matmul(_exp(sign * steps)[:, :3], torch.cat([X[0, 0], torch.ones(1)])) for sign in (1, -1)]
    ahead, back = (_projected(each[None], K)[0] for each in moved)
    assert torch.allclose(((ahead - back) / 2e-6).T, _pixel_by_pose(X, K)[0, 0], atol=1e-5)


def test_starts_are_the_keyframes_pose_or_lie_on_the_way() -> None:
    true = torch.tensor(se3_exp(np.tile(MOTIONS[:1], (200, 1))), dtype=torch.float32)
    starts = draw_start_poses(true, PoseOptions(still=0.5, turn_deg=0.0, shift_m=0.0), torch.Generator().manual_seed(0))
    still = (starts == torch.eye(4)).all((-1, -2))
    assert 60 < int(still.sum()) < 140
    share = starts[~still, 2, 3] / true[0, 2, 3]
    assert float(share.min()) >= 0
    assert float(share.max()) <= 1
    assert torch.allclose(starts[~still, 0, 3] / true[0, 0, 3], share, atol=1e-4)
    again = draw_start_poses(true, PoseOptions(still=0.5, turn_deg=0.0, shift_m=0.0), torch.Generator().manual_seed(0))
    assert torch.equal(starts, again)


# What is known of a pair


class PosedPairs(MadePairs):
    """Pairs of made-up images whose correspondences are those of a pose and random depth."""

    camera_ref = Camera("pinhole", 64, 48, 50.0, 52.0, 31.0, 22.0)
    camera_query = Camera("pinhole", 64, 48, 55.0, 54.0, 33.0, 25.0)
    T_query_ref = se3_exp([0.2, 0.1, 0.4, 0.02, -0.03, 0.05])

    def load(self, index: int) -> TrainingPair:
        pixels = np.stack(np.meshgrid(np.arange(4, 60, 2), np.arange(4, 44, 2)), axis=-1).reshape(-1, 2)
        X = self.points(self.camera_ref, pixels)
        there = apply(self.T_query_ref, X)
        K = self.camera_query
        u = there[:, :2] / there[:, 2:] * [K.fx, K.fy] + [K.cx, K.cy]
        inside = np.all((u >= 0) & (u <= [63, 47]), axis=1)
        plain_pair = super().load(index)
        return replace(plain_pair, u_ref=pixels[inside].astype(np.float32), u_query=u[inside].astype(np.float32))

    @staticmethod
    def points(camera: Camera, pixels: np.ndarray) -> np.ndarray:
        """A slanted plane: depth 4 + u / 20."""
        depth = 4.0 + pixels[:, 0] / 20.0
        return (
            np.column_stack([(pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones(len(pixels))])
            * (depth[:, None])
        )

    def posed(self, index: int) -> PosedPair:
        return PosedPair(f"ref {index}", f"query {index}", self.T_query_ref)

    def view(self, name: str, *, depth: bool) -> TrainingView:
        of_ref = name.startswith("ref")
        pair = super().load(int(name.split()[1]))
        none = KeyframePoints(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
        if not of_ref:
            return TrainingView(pair.image_query, self.camera_query, none)
        pixels = np.stack(np.meshgrid(np.arange(64), np.arange(48)), axis=-1).reshape(-1, 2)
        inverse_depth = 1.0 / (4.0 + pixels[:, 0] / 20.0)
        points = KeyframePoints(pixels.astype(float), inverse_depth, np.full(len(pixels), 0.01))
        return TrainingView(pair.image_ref, self.camera_ref, points if depth else none)


def options(**changed: object) -> TrainOptions:
    tiny = {**TINY, "loss": {"level_weights": [1.0, 1.0], "pose": {"weight": 1.0}}, **changed}
    return options_from_dict(TrainOptions, filled(plain(TrainOptions()), tiny))


@pytest.mark.parametrize("changed", [{}, {"scale": [0.7, 1.3]}], ids=["whole", "scaled"])
@pytest.mark.parametrize("mirror", [0.0, 1.0])
def test_points_projected_by_the_true_pose_are_at_their_pixels_in_the_crop(
    mirror: float, changed: Mapping[str, object]
) -> None:
    batches = Batches(PosedPairs(), options(swap=0.0, mirror=mirror, **changed))
    for step in range(4):
        batch = batches[step]
        assert bool(batch.known.any())
        X = batch.X_ref @ batch.T_query_ref[:, :3, :3].transpose(-1, -2) + batch.T_query_ref[:, None, :3, 3]
        found = _projected(X, batch.intrinsics)
        assert torch.equal(batch.known, batch.mask)
        assert torch.allclose(found[batch.known], batch.u_query[batch.known], atol=0.02)


def test_of_a_query_that_is_no_keyframe_no_depth_is_known() -> None:
    batch = Batches(PosedPairs(), options(swap=1.0, mirror=0.0))[0]
    assert not batch.known.any()
    expected = torch.tensor(invert(PosedPairs.T_query_ref), dtype=torch.float32)
    assert torch.allclose(batch.T_query_ref, expected.expand(2, 4, 4), atol=1e-6)


def test_depth_is_that_of_the_pixel_and_zero_where_there_is_none() -> None:
    points = KeyframePoints(np.array([[2.0, 1.0], [3.2, 1.9], [99.0, 0.0]]), np.array([0.5, 0.25, 1.0]), np.ones(3))
    found = inverse_depth_at(points, np.array([[2.3, 0.8], [3.0, 2.0], [0.0, 0.0]], dtype=np.float32), (4, 5))
    assert found.tolist() == [0.5, 0.25, 0.0]


@pytest.mark.thorough
def test_a_training_with_the_pose_loss_logs_how_far_points_are_off(tmp_path: Path) -> None:
    loss = {"level_weights": [1.0, 1.0], "pose": {"weight": 0.1, "points": 64}}
    run = TrainingRun(tmp_path, "gn-net", "relocbench train gn-net", workers=0)
    gn_net().train(PosedPairs(), None, {**TINY, "loss": loss, "swap": 0.0}, run)
    header = (tmp_path / "log.csv").read_text().splitlines()[0]
    assert all(f"{level}/{part}" in header for level in (0, 1) for part in ("pose", "start_px", "end_px", "reached"))


@pytest.mark.thorough
def test_confidences_are_learnt_from_the_pose_loss(tmp_path: Path) -> None:
    changed = {"network": {**TINY["network"], "confidence": True}, "swap": 0.0, "ema": 0.0, "learning_rate": 0.01}
    loss = {"level_weights": [1.0, 1.0], "pose": {"weight": 1.0, "points": 64}}
    run = TrainingRun(tmp_path, "gn-net", "relocbench train gn-net", workers=0)
    gn_net().train(PosedPairs(), None, {**TINY, **changed, "loss": loss}, run)
    heads = load_weights(tmp_path / "weights.safetensors").confidences
    assert [bool(head.weight.detach().any()) for head in heads] == [True, True]  # type: ignore[operator]
    with refused(ConfigError, "", None, "network.confidence", "loss.pose.weight"):
        options(network={**TINY["network"], "confidence": True}, loss={"level_weights": [1.0, 1.0]})


def test_without_poses_the_loss_is_refused_in_one_line(tmp_path: Path) -> None:
    run = TrainingRun(tmp_path, "gn-net", "relocbench train gn-net", workers=0)
    loss = {"level_weights": [1.0, 1.0], "pose": {"weight": 0.1}}
    with refused(MethodError, "", None, "loss.pose.weight"):
        gn_net().train(MadePairs(), None, {**TINY, "loss": loss}, run)
    with refused(ConfigError, "", None, "still"):
        options(loss={"level_weights": [1.0, 1.0], "pose": {"still": 1.5}})
