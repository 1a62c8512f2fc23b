"""The total loss of a batch of pairs, over all losses and levels, and its parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor

from baselines.gn_net.losses.ascent import AscentOptions, ascent_terms
from baselines.gn_net.losses.contrastive import ContrastiveOptions, negative_terms
from baselines.gn_net.losses.descent import DescentOptions, descent_terms
from baselines.gn_net.losses.gauss_newton import GaussNewtonOptions, draw_starts, gauss_newton_terms
from baselines.gn_net.losses.negatives import hard_negatives, random_negatives
from baselines.gn_net.losses.pose import PoseOptions, SeenPoints, draw_start_poses, pose_terms
from baselines.gn_net.sampling import level_coordinates, sample
from baselines.options import OptionError, Options, require

_LOSSES = ("contrastive", "gauss_newton", "descent", "ascent", "pose")


@dataclass(frozen=True)
class LossOptions(Options):
    """The losses and their weights on each level; a weight of 0 disables a loss.

    Raises:
        OptionError: all weights are 0, or a value is out of range.
    """

    contrastive: ContrastiveOptions = field(default_factory=ContrastiveOptions)
    gauss_newton: GaussNewtonOptions = field(default_factory=GaussNewtonOptions)
    descent: DescentOptions = field(default_factory=DescentOptions)
    ascent: AscentOptions = field(default_factory=AscentOptions)
    pose: PoseOptions = field(default_factory=PoseOptions)
    level_weights: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)
    """one weight for each level of the network, finest first"""

    def __post_init__(self) -> None:
        require(
            self,
            "level_weights",
            lambda weights: weights and min(weights) >= 0 and max(weights) > 0,
            "weights of 0 or more, at least one above 0",
        )
        weights = {name: getattr(self, name).weight for name in _LOSSES}
        if max(weights.values()) == 0:
            others = ", ".join(f"{name}.weight" for name in list(weights)[1:])
            raise OptionError("contrastive.weight", 0.0, f"more than 0, since {others} are 0 too")


class LossValue(NamedTuple):
    """The loss to be minimised, and its parts for the log."""

    total: Tensor
    """scalar"""
    parts: dict[str, Tensor]
    """scalars without derivatives and before weighting, by ``level/part``: ``positive``, ``negative``, ``e1``, ``e2``,
    ``near_singular`` (share of points), ``descent``, ``nearer`` (share of points), ``ascent``, ``higher`` (share of
    positions), ``points`` (number that counted)"""


def total_loss(
    features_ref: Sequence[Tensor],
    features_query: Sequence[Tensor],
    u_ref: Tensor,
    u_query: Tensor,
    mask: Tensor,
    options: LossOptions,
    generator: torch.Generator,
    u_still: Tensor | None = None,
) -> LossValue:
    """The weighted sum over levels and losses; each loss is a mean over the points that are on the maps.

    Args:
        features_ref, features_query: (B, D, H_l, W_l) for each level, finest first.
        u_ref, u_query: (B, N, 2) pixels of level 0 that see the same surface points.
        mask: (B, N) bool: which of them count, as pairs differ in their numbers of correspondences; those that are not
            finite never count.
        generator: on the CPU; the source of starts and negatives.
        u_still: (B, N, 2) pixels of level 0 where the query would show the points if its camera had not moved, on the
            maps or off them; needed by the ascent loss.

    Raises:
        ValueError: the numbers of levels disagree, or ``u_still`` is missing.
    """
    if not len(features_ref) == len(features_query) == len(options.level_weights):
        raise ValueError(
            f"{len(features_ref)} and {len(features_query)} levels of features, "
            f"{len(options.level_weights)} level weights: they must agree"
        )
    if u_still is None:
        if options.ascent.weight > 0:
            raise ValueError("the ascent loss needs u_still")
        u_still = u_query
    # Values that do not count must be finite too, since 0 times NaN would reach the derivatives.
    mask = mask & torch.isfinite(u_ref).all(-1) & torch.isfinite(u_query).all(-1)
    u_ref, u_query, u_still = (torch.where(mask[..., None], u, torch.zeros_like(u)) for u in (u_ref, u_query, u_still))
    total = torch.zeros((), dtype=torch.float64, device=u_ref.device)
    parts: dict[str, Tensor] = {}
    for level, weight in enumerate(options.level_weights):
        if weight == 0:
            continue
        one = _Level(
            features_ref[level],
            features_query[level],
            level_coordinates(u_ref, level),
            level_coordinates(u_query, level),
            level_coordinates(u_still, level),
            mask,
        )
        cost, named = _level_loss(one, options, generator)
        total = total + weight * cost
        parts.update({f"{level}/{name}": value.detach() for name, value in named.items()})
    return LossValue(total, parts)


class _Level(NamedTuple):
    """The maps of one level, and the correspondences in its pixels."""

    features_ref: Tensor
    features_query: Tensor
    u_ref: Tensor
    u_query: Tensor
    u_still: Tensor
    mask: Tensor


def pose_loss(
    features_ref: Sequence[Tensor],
    features_query: Sequence[Tensor],
    seen: SeenPoints,
    options: LossOptions,
    finest: int,
    generator: torch.Generator,
    confidences_ref: Sequence[Tensor] = (),
) -> LossValue:
    """The weighted pose loss over levels, which comes on top of :func:`total_loss`.

    Args:
        features_ref, features_query, finest: as of :func:`baselines.gn_net.losses.pose.pose_terms`.
        seen: points, cameras and true poses of the batch.
        generator: on the CPU; the source of starts.
        confidences_ref: (B, 1, H_l, W_l) for each level, or none.

    Returns:
        The loss, and its parts by ``level/part``: ``pose``, ``start_px`` and ``end_px`` (mean errors of the points
        before and after the level's steps, in its pixels), all over pairs for which the level is in reach; ``reached``
        (the share of such pairs).
    """
    start = draw_start_poses(seen.T_query_ref, options.pose, generator)
    terms = pose_terms(features_ref, features_query, seen, start, options.pose, finest, confidences_ref)
    total = torch.zeros((), dtype=torch.float64, device=start.device)
    parts: dict[str, Tensor] = {}
    for level, weight in enumerate(options.level_weights):
        cost, valid = terms.cost[level], terms.valid[level]
        mean = masked_mean(cost, valid)
        total = total + weight * options.pose.weight * mean
        named = {"pose": mean, "start_px": terms.before[level], "end_px": terms.after[level], "reached": valid.double()}
        for name, value in named.items():
            each = value if value.ndim == 0 else value.mean() if name == "reached" else masked_mean(value, valid)
            parts[f"{level}/{name}"] = each.detach()
    return LossValue(total, parts)


def _level_loss(one: _Level, options: LossOptions, generator: torch.Generator) -> tuple[Tensor, dict[str, Tensor]]:
    f_ref, on_ref = sample(one.features_ref, one.u_ref)
    counted = on_ref & one.mask
    total = torch.zeros((), dtype=torch.float64, device=f_ref.device)
    parts: dict[str, Tensor] = {"points": counted.sum()}
    if options.contrastive.weight > 0:
        positive, negative = _contrastive(one, f_ref, counted, options.contrastive, generator)
        total = total + options.contrastive.weight * (positive + options.contrastive.negative_weight * negative)
        parts.update(positive=positive, negative=negative)
    if options.gauss_newton.weight > 0:
        start = draw_starts(one.u_query, options.gauss_newton.vicinity, generator)
        terms = gauss_newton_terms(one.features_query, f_ref, one.u_query, start, options.gauss_newton.eps)
        valid = counted & terms.valid
        e1, e2 = masked_mean(terms.e1, valid), masked_mean(terms.e2, valid)
        total = total + options.gauss_newton.weight * (options.gauss_newton.e1 * e1 + options.gauss_newton.e2 * e2)
        parts.update(e1=e1, e2=e2, near_singular=masked_mean(terms.near_singular, valid))
    if options.descent.weight > 0:
        start = draw_starts(one.u_query, options.descent.vicinity, generator)
        cost, on_query, nearer = descent_terms(one.features_query, f_ref, one.u_query, start, options.descent)
        descent = masked_mean(cost, counted & on_query)
        total = total + options.descent.weight * descent
        parts.update(descent=descent, nearer=masked_mean(nearer.double(), counted & on_query))
    if options.ascent.weight > 0:
        cost, valid, higher = ascent_terms(
            one.features_query, f_ref, one.u_query, one.u_still, options.ascent, generator
        )
        valid = valid & counted[..., None]
        ascent = masked_mean(cost, valid)
        total = total + options.ascent.weight * ascent
        parts.update(ascent=ascent, higher=masked_mean(higher.double(), valid))
    return total, parts


def _contrastive(
    one: _Level, f_ref: Tensor, counted: Tensor, options: ContrastiveOptions, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """The means over positives and over negatives."""
    f_query, on_query = sample(one.features_query, one.u_query)
    positive = masked_mean(((f_ref - f_query) ** 2).sum(-1), counted & on_query)
    wrong: list[tuple[Tensor, Tensor]] = []
    if options.negatives in ("random", "both"):
        height, width = one.features_query.shape[-2:]
        wrong.append(random_negatives((height, width), one.u_query, options.away, generator))
    if options.negatives in ("hard", "both"):
        wrong.append(
            hard_negatives(one.features_query, f_ref, one.u_query, options.away, options.candidates, generator)
        )
    means = []
    for u_wrong, found in wrong:
        f_wrong, _ = sample(one.features_query, u_wrong)
        means.append(masked_mean(negative_terms(f_ref, f_wrong, options.form, options.margin), counted & found))
    return positive, torch.stack(means).mean()


def masked_mean(values: Tensor, mask: Tensor) -> Tensor:
    """The mean of ``values`` where ``mask`` is true; zero, with zero derivative, if it is true nowhere.

    Args:
        values: (...); need not be finite where masked out.
        mask: (...) bool.
    """
    kept = torch.where(mask, values, torch.zeros_like(values))
    return kept.sum() / mask.sum().clamp(min=1)
