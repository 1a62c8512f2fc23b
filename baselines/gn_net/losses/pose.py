"""Pose loss: alignment itself, from where it starts in practice, must move points to their true pixels.

The pixel losses see one point at a time, at offsets that are drawn around the true pixel. Alignment moves all points
with one pose, and starts at a prior. Here some of its steps are computed on each level, coarsest first, in a way that
can be differentiated, and the loss is how far the points are from their true pixels then (PixLoc, Sarlin et al., CVPR
2021, which learned features and alignment end to end in this way):

    r_i = F_b(pi(T X_i)) - f_i      J_i = dF_b/du  du/dxi      w_i = c_i min(1, k / ||r_i||)
    H = sum w_i J_i^T J_i           g = sum w_i J_i^T r_i
    T <- exp(-(H + lambda diag H)^-1 g) T                                K times on a level
    E = mean_i rho(||pi(T X_i) - u_i||)      rho(d) = sqrt(1 + d^2) - 1      in pixels of the level

c_i is the network's confidence in the point, where it tells one, and 1 otherwise; this loss alone teaches it.

The pose is handed from level to level without its derivative. A level whose start is farther off than alignment could
reach there is left out, since nothing can be learned from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from baselines.gn_net.sampling import level_coordinates, sample, sample_with_gradient
from baselines.options import Options, above_0, at_least, share

_NEAREST_M = 0.1
"""points nearer to the query's camera do not count, as in alignment"""
_FARTHEST = 50.0
"""pixels of the level beyond which an error has no derivative"""


@dataclass(frozen=True)
class PoseOptions(Options):
    """Weight, steps and starts."""

    weight: float = 0.0
    """weight relative to the contrastive loss; 0 disables the loss (GN-Net)"""
    iterations: int = 3
    """K, steps on each level"""
    damping: float = 0.01
    """lambda; DSO's first one"""
    huber: float = 0.3
    """k, as a share of the standard deviation of the reference's features"""
    points: int = 512
    """largest number of a pair's points that take part, in their order"""
    still: float = 0.5
    """probability that a pair starts at the keyframe's own pose; others start at a random share of the way to the truth
    and up to ``turn_deg`` and ``shift_m`` beside it"""
    turn_deg: float = 3.0
    """degrees about each axis"""
    shift_m: float = 0.5
    """metres along each axis"""
    reach: float = 8.0
    """pixels of the level; where the mean error at the start of a level is larger, the level is left out"""

    def __post_init__(self) -> None:
        at_least(self, 0, "weight turn_deg shift_m")
        above_0(self, "damping huber reach")
        at_least(self, 1, "iterations")
        at_least(self, 8, "points")
        share(self, "still")


class SeenPoints(NamedTuple):
    """Points of B keyframes with their true pixels and poses in the queries."""

    X_ref: Tensor
    """(B, N, 3) metres, in the keyframe's camera"""
    u_ref: Tensor
    """(B, N, 2) pixels of level 0"""
    u_query: Tensor
    """(B, N, 2)"""
    known: Tensor
    """(B, N) bool: points that count"""
    intrinsics: Tensor
    """(B, 4) fx, fy, cx, cy of the queries, pixels of level 0"""
    T_query_ref: Tensor
    """(B, 4, 4) true poses"""


class PoseTerms(NamedTuple):
    """The loss of each level."""

    cost: Tensor
    """(L, B) after the level's steps, finest first"""
    valid: Tensor
    """(L, B) bool: the level was in reach"""
    before: Tensor
    """(L, B) mean error at the level's start, pixels of the level, without derivative"""
    after: Tensor
    """(L, B) the same after its steps"""


def draw_start_poses(T_query_ref: Tensor, options: PoseOptions, generator: torch.Generator) -> Tensor:
    """Starts (B, 4, 4): the identity, or a random share of the true motion with some noise.

    Args:
        T_query_ref: (B, 4, 4).
        generator: on the CPU.
    """
    batch = len(T_query_ref)
    still = torch.rand((batch, 1, 1), generator=generator) < options.still
    share_of_way = torch.rand((batch, 1), generator=generator)
    noise = torch.rand((batch, 6), generator=generator) * 2 - 1
    units = torch.tensor([options.shift_m] * 3 + [options.turn_deg * torch.pi / 180.0] * 3)
    true = T_query_ref.cpu().double()
    # Rotations between keyframe and query are far from 180 degrees, where the matrix logarithm would not be unique.
    turn = _rotation_vector(true[:, :3, :3]) * share_of_way
    way = _exp(torch.cat([torch.zeros_like(turn), turn], dim=-1))
    way[:, :3, 3] = true[:, :3, 3] * share_of_way
    started = _exp(noise.double() * units.double()) @ way
    identity = torch.eye(4, dtype=torch.float64).expand(batch, 4, 4)
    return torch.where(still, identity, started).to(T_query_ref)


def pose_terms(
    features_ref: Sequence[Tensor],
    features_query: Sequence[Tensor],
    seen: SeenPoints,
    start: Tensor,
    options: PoseOptions,
    finest: int,
    confidences_ref: Sequence[Tensor] = (),
) -> PoseTerms:
    """The costs of alignment from given starts.

    Args:
        features_ref, features_query: (B, D, H_l, W_l) for each level, finest first.
        seen: points, in the images' own pixels.
        start: (B, 4, 4) first ``T_query_ref``.
        finest: level of the first map, of which the images' own resolution is 0.
        confidences_ref: (B, 1, H_l, W_l) for each level, or none.
    """
    T = start
    n = options.points
    seen = seen._replace(X_ref=seen.X_ref[:, :n], u_ref=seen.u_ref[:, :n], u_query=seen.u_query[:, :n],
                         known=seen.known[:, :n])  # fmt: skip
    rows = []
    for number in reversed(range(len(features_ref))):
        level = finest + number
        on_level = level_coordinates(seen.u_ref, level)
        f_ref, on_ref = sample(features_ref[number], on_level)
        confidence = (
            sample(confidences_ref[number], on_level)[0][..., 0] if confidences_ref else torch.ones_like(on_ref)
        )
        one = _Level(
            features_query[number],
            f_ref,
            confidence,
            level_coordinates(seen.u_query, level),
            seen.known & on_ref,
            _intrinsics_of(seen.intrinsics, level),
        )
        T = T.detach()
        before = _mean(_error(one, seen.X_ref, T), one.counted)
        valid = (before <= options.reach) & (one.counted.sum(-1) >= options.points // 32 + 4)
        for _ in range(options.iterations):
            T = _stepped(one, seen.X_ref, T, options)
        error = _error(one, seen.X_ref, T)
        cost = _mean(torch.sqrt(1 + error**2) - 1, one.counted)
        rows.append((cost, valid, before.detach(), _mean(error, one.counted).detach()))
        # A level out of reach must not send the next one farther away.
        T = torch.where(valid[:, None, None], T, start)
    return PoseTerms(*(torch.stack(each) for each in zip(*reversed(rows), strict=True)))


class _Level(NamedTuple):
    features_query: Tensor
    f_ref: Tensor
    confidence: Tensor
    u_query: Tensor
    counted: Tensor
    intrinsics: Tensor


def _stepped(one: _Level, X_ref: Tensor, T: Tensor, options: PoseOptions) -> Tensor:
    """The poses after one step of damped Gauss-Newton."""
    X = X_ref @ T[:, :3, :3].transpose(-1, -2) + T[:, None, :3, 3]
    in_front = X[..., 2] > _NEAREST_M
    X = torch.where(in_front[..., None], X, torch.ones_like(X))
    values, jacobian, on_map = sample_with_gradient(one.features_query, _projected(X, one.intrinsics))
    counted = (one.counted & in_front & on_map) * one.confidence.double()
    r = (values - one.f_ref).double()
    size = torch.linalg.vector_norm(r.detach(), dim=-1)
    k = options.huber * one.f_ref.detach().double().std(dim=-2).square().sum(-1, keepdim=True).sqrt()
    weight = counted * (k / size.clamp(min=1e-12)).clamp(max=1.0)
    J = jacobian.double() @ _pixel_by_pose(X, one.intrinsics).double()  # (B, N, D, 6)
    weighted = J * weight[..., None, None]
    H = torch.einsum("bndi,bndj->bij", weighted, J)
    g = torch.einsum("bndi,bnd->bi", weighted, r)
    diagonal = H.diagonal(dim1=-2, dim2=-1)
    # Maps without contrast give no step rather than a division by zero.
    damped = H + torch.diag_embed(options.damping * diagonal + 1e-6 * diagonal.detach().amax(-1, True) + 1e-9)
    step = -torch.linalg.solve(damped, g)
    return (_exp(step) @ T.double()).to(T)


def _error(one: _Level, X_ref: Tensor, T: Tensor) -> Tensor:
    """The distances (B, N) from the true pixels, in pixels of the level; at most ``_FARTHEST``."""
    X = X_ref @ T[:, :3, :3].transpose(-1, -2) + T[:, None, :3, 3]
    in_front = X[..., 2] > _NEAREST_M
    X = torch.where(in_front[..., None], X, torch.ones_like(X))
    squared = (_projected(X, one.intrinsics) - one.u_query).square().sum(-1)
    # The clamp inside the root keeps its derivative finite.
    error = squared.clamp(min=1e-12, max=_FARTHEST**2).sqrt()
    return torch.where(in_front, error, torch.full_like(error, _FARTHEST))


def _projected(X: Tensor, intrinsics: Tensor) -> Tensor:
    fx, fy, cx, cy = intrinsics[:, None].unbind(-1)
    return torch.stack([fx * X[..., 0] / X[..., 2] + cx, fy * X[..., 1] / X[..., 2] + cy], dim=-1)


def _pixel_by_pose(X: Tensor, intrinsics: Tensor) -> Tensor:
    """Derivatives (B, N, 2, 6) of pixels by xi, where X(xi) = exp(xi) X; translation first."""
    fx, fy = intrinsics[:, None, 0], intrinsics[:, None, 1]
    x, y, iz = X[..., 0] / X[..., 2], X[..., 1] / X[..., 2], 1 / X[..., 2]
    zero = torch.zeros_like(x)
    return torch.stack(
        [
            torch.stack([fx * iz, zero, -fx * x * iz, -fx * x * y, fx * (1 + x * x), -fx * y], dim=-1),
            torch.stack([zero, fy * iz, -fy * y * iz, -fy * (1 + y * y), fy * x * y, fy * x], dim=-1),
        ],
        dim=-2,
    )


def _intrinsics_of(intrinsics: Tensor, level: int) -> Tensor:
    return torch.cat([intrinsics[:, :2] / float(1 << level), level_coordinates(intrinsics[:, 2:], level)], dim=-1)


def _exp(xi: Tensor) -> Tensor:
    """(..., 4, 4) of xi (..., 6), translation first."""
    v, (a, b, c) = xi[..., :3], xi[..., 3:].unbind(-1)
    zero = torch.zeros_like(a)
    hat = torch.stack([torch.stack(row, dim=-1) for row in ((zero, -c, b), (c, zero, -a), (-b, a, zero))], dim=-2)
    top = torch.cat([hat, v[..., None]], dim=-1)
    return torch.matrix_exp(torch.cat([top, torch.zeros_like(top[..., :1, :])], dim=-2))


def _rotation_vector(R: Tensor) -> Tensor:
    """(..., 3) axis times angle of rotations (..., 3, 3) of less than 180 degrees."""
    axis = torch.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], dim=-1)
    sine = 0.5 * torch.linalg.vector_norm(axis, dim=-1, keepdim=True)
    cosine = 0.5 * (R.diagonal(dim1=-2, dim2=-1).sum(-1, keepdim=True) - 1)
    angle = torch.atan2(sine, cosine)
    return torch.where(sine > 1e-9, 0.5 * axis * angle / sine.clamp(min=1e-12), 0.5 * axis)


def _mean(values: Tensor, counted: Tensor) -> Tensor:
    """The mean (B,) over the points that count; 0 where none does."""
    return (values * counted).sum(-1) / counted.sum(-1).clamp(min=1)
