"""What single blocks say of each other: how sure a fit may be, and what a bare wall must not claim to know."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.blocks.blocks import Surface
from relocbench.datasets.groundtruth.pose_graph.block_fits import BlockFits, Matches, match_points, weights_of_patches
from relocbench.datasets.groundtruth.pose_graph.edge_information import (
    minimum,
    nearest_semidefinite,
    sandwich_information,
    scatter_by_patch,
    with_block_distortion,
)
from relocbench.datasets.groundtruth.submaps.planes import PlaneMap, PlaneOptions
from relocbench.datasets.groundtruth.submaps.submaps import Submap
from relocbench.geometry import se3_exp

OPTIONS = PlaneOptions(thinning_m=(0.0,), reach_m=(0.3,), samples=(4000,), near_m=(1e9,))


def walls(seed: int, flanks: float, noise_m: float = 0.01, tilt: float = 0.05) -> Submap:
    """Walls 9 m to both sides, a road, and flanks that face along the street, so many metres deep; noisy normals."""
    rng = np.random.default_rng(seed)
    parts = []
    for sign in (1.0, -1.0):
        p = np.column_stack([rng.uniform(-3, 3, 1500), np.full(1500, sign * 9.0), rng.uniform(0, 6, 1500)])
        parts.append((p, np.tile([0.0, -sign, 0.0], (1500, 1))))
        count = round(100 * flanks)
        p = np.column_stack([np.full(count, 1.0), sign * (9 - rng.uniform(0, flanks, count)), rng.uniform(0, 6, count)])
        parts.append((p, np.tile([-1.0, 0.0, 0.0], (count, 1))))
    p = np.column_stack([rng.uniform(-3, 3, 800), rng.uniform(-8, 8, 800), np.zeros(800)])
    parts.append((p, np.tile([0.0, 0.0, 1.0], (800, 1))))
    points, normals = (np.concatenate([part[i] for part in parts]) for i in range(2))
    points = points + noise_m * rng.normal(size=(len(points), 1)) * normals
    normals = normals + tilt * rng.normal(size=normals.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    n = len(points)
    kind = np.full(n, Surface.STRUCTURE, np.uint8)
    origins = np.tile(np.array([0, 0, 1.8], np.float32), (n, 1))
    ones, block = np.ones(n, np.float32), np.zeros(n, np.int32)
    return Submap(points.astype(np.float32), normals.astype(np.float32), origins, kind, ones, block)


def contacts(seed: int, flanks: float, T: Array | None = None) -> Matches:
    ref, query = (PlaneMap(walls(seed + k, flanks), OPTIONS) for k in (0, 100))
    return match_points(ref.level(0), query.sample(0), np.eye(4) if T is None else T)


@pytest.mark.thorough
def test_a_bare_wall_does_not_claim_to_know_the_way_along_it() -> None:
    met = contacts(1, flanks=0.0)
    plain = met.by_planes.T @ (met.weights[:, None] * met.by_planes)
    instrumented = met.by_points.T @ (met.weights[:, None] * met.by_planes)
    # A thousand normals 3 degrees off look like a few points that face along the street.
    assert plain[0, 0] > 3.0
    assert abs(instrumented[0, 0]) < 0.1 * plain[0, 0]
    np.testing.assert_allclose(instrumented[1, 1], plain[1, 1], rtol=0.02)


def test_what_faces_along_the_street_still_counts_in_full() -> None:
    met = contacts(2, flanks=1.0)
    instrumented = met.by_points.T @ (met.weights[:, None] * met.by_planes)
    facing = np.abs(met.by_planes[:, 0]) > 0.9
    assert facing.sum() > 100
    assert instrumented[0, 0] == pytest.approx(met.weights[facing].sum(), rel=0.05)


@pytest.mark.thorough
def test_the_step_leads_back_along_the_street() -> None:
    off = 0.03
    met = contacts(3, 1.0, se3_exp([off, 0.01, 0, 0, 0, 0]))
    H = nearest_semidefinite(met.by_points.T @ (met.weights[:, None] * met.by_planes))
    step = minimum(H, met.by_points.T @ (met.weights * met.residuals))
    assert step[0] == pytest.approx(-off, abs=0.01)
    assert step[1] == pytest.approx(-0.01, abs=0.003)


@pytest.mark.thorough
def test_information_promises_what_the_steps_show() -> None:
    steps, variances = [], []
    for seed in range(40):
        met = contacts(1000 + seed, 1.0)
        H = nearest_semidefinite(met.by_points.T @ (met.weights[:, None] * met.by_planes))
        gradients = (met.weights * met.residuals)[:, None] * met.by_points
        step = minimum(H, gradients.sum(axis=0))
        left = met.residuals + met.by_planes @ step
        scatter = scatter_by_patch((met.weights * left)[:, None] * met.by_points, met.patches)
        steps.append(step)
        variances.append(np.diag(np.linalg.inv(sandwich_information(H, scatter, 0.0))))
    # The noise of the planes' own normals, which all points of a plane share, is not in the scatter.
    ratio = np.mean(np.square(steps), axis=0) / np.mean(variances, axis=0)
    assert 0.3 < ratio[0] < 3.0
    assert np.all(ratio < 2.0)


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1))
def test_nothing_is_held_less_than_not_at_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    H = rng.normal(size=(6, 6)) * np.outer(*[np.array([1, 1, 1, 10, 10, 10])] * 2)
    out = nearest_semidefinite(H)
    np.testing.assert_allclose(out, out.T)
    assert np.linalg.eigvalsh(out).min() > -1e-9 * np.abs(H).max()
    positive = H @ H.T
    np.testing.assert_allclose(nearest_semidefinite(positive), positive, rtol=1e-9, atol=1e-9 * np.abs(positive).max())


def test_the_odometry_inside_blocks_bounds_what_an_edge_is_worth() -> None:
    variance = np.array([1e-4, 4e-6, 4e-6, 1e-7, 1e-7, 1e-7])
    worth = np.linalg.inv(with_block_distortion(1e12 * np.eye(6), variance))
    np.testing.assert_allclose(np.diag(worth), variance, rtol=1e-3)
    np.testing.assert_allclose(with_block_distortion(np.eye(6), np.zeros(6)), np.eye(6))


def windscreens(seed: int, moved_m: float, noise_m: float = 0.02) -> Submap:
    """Windscreens of four parked cars beside the road; all have moved forward."""
    rng, street = np.random.default_rng(seed), walls(seed, 1.5, noise_m)
    normal = np.array([-0.6, 0.0, 0.8])
    parts = [
        np.array([x + moved_m, 5.0, 1.2]) + rng.uniform(-0.6, 0.6, (100, 2)) @ np.array([[0.8, 0, 0.6], [0, 1, 0]])
        for x in (-4.5, -1.5, 1.5, 4.5)
    ]
    points = np.concatenate(parts) + noise_m * rng.normal(size=(400, 1)) * normal
    kept = (street.normals[:, 2] < 0.8) | (rng.uniform(size=len(street.points)) < 0.6)
    more, few = len(points), street.points[kept]
    return Submap(
        np.concatenate([few, points.astype(np.float32)]),
        np.concatenate([street.normals[kept], np.tile(normal, (more, 1)).astype(np.float32)]),
        np.concatenate([street.origins[kept], street.origins[:more]]),
        np.concatenate([street.surface[kept], street.surface[:more]]),
        np.concatenate([street.steady[kept], street.steady[:more]]),
        np.concatenate([street.block[kept], street.block[:more]]),
    )


class Kept:
    """A store of one block."""

    def __init__(self, block: Submap) -> None:
        self.block = block

    def get(self, node: int) -> Submap:
        return self.block


@pytest.mark.thorough
def test_parked_cars_that_moved_together_do_not_lift_a_block() -> None:
    fits = BlockFits(Kept(windscreens(0, 0.0)), Kept(windscreens(100, 0.11)))  # type: ignore[arg-type]
    T = np.eye(4)
    for _ in range(6):
        fit = fits(0, 0, T)
        T = T @ se3_exp(minimum(fit.H, fit.g))
    # With the points' weights alone the block is lifted by 14 to 25 mm.
    assert abs(T[2, 3]) < 0.01


def test_a_step_is_whole_where_all_patches_are_off() -> None:
    off, steps = 0.02, []
    for seed in range(3):
        fits = BlockFits(Kept(walls(seed, 1.0)), Kept(walls(100 + seed, 1.0)))  # type: ignore[arg-type]
        fit = fits(0, 0, se3_exp([0, off, off, 0, 0, 0]))
        steps.append(minimum(fit.H, fit.g)[1:3])
    # With patches that weigh little in the gradient but in full in H, it is 0.6 of this.
    np.testing.assert_allclose(np.mean(steps, axis=0), -off, rtol=0.25)


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1), st.integers(1, 300), st.integers(1, 20))
def test_patches_weigh_by_their_mean_distance(seed: int, points: int, patches: int) -> None:
    rng = np.random.default_rng(seed)
    patch, residuals = rng.integers(0, patches, points), rng.normal(0, 0.03, points)
    weights = weights_of_patches(residuals, patch)
    assert np.all((weights > 0) & (weights <= 1))
    order = rng.permutation(points)
    np.testing.assert_allclose(weights_of_patches(residuals[order], patch[order]), weights[order])
    for one in np.unique(patch):
        assert len(set(weights[patch == one])) == 1


def test_noise_leaves_patches_their_weight_and_a_shift_does_not() -> None:
    noise = np.random.default_rng(0).normal(0, 0.02, 4000)
    patch = np.repeat([0, 1], 2000)
    still, moved = weights_of_patches(noise + np.where(patch == 1, 0.06, 0.0), patch)[[0, -1]]
    assert still > 0.99
    assert moved == pytest.approx(1 / (1 + 16) ** 2, rel=0.1)
    alone = weights_of_patches(np.array([0.02]), np.array([7]))
    assert alone > 0.75
    assert len(weights_of_patches(np.zeros(0), np.zeros(0, dtype=np.int64))) == 0


def test_points_face_their_planes_only() -> None:
    ref, query = walls(5, 0.0), walls(105, 0.0)
    turned = replace(query, normals=-query.normals)
    assert len(match_points(PlaneMap(ref, OPTIONS).level(0), PlaneMap(turned, OPTIONS).sample(0), np.eye(4))) == 0
