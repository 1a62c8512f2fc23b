"""The losses against hand-computed values, finite differences, and what they are said to be."""

from __future__ import annotations

import json
import math
from contextlib import nullcontext
from dataclasses import asdict, replace

import pytest
import torch
from refusals import refused
from torch import Tensor
from torch.distributions import MultivariateNormal

from baselines.gn_net.losses.ascent import AscentOptions, ascent_terms
from baselines.gn_net.losses.contrastive import ContrastiveOptions, negative_terms
from baselines.gn_net.losses.descent import DescentOptions, descent_terms
from baselines.gn_net.losses.gauss_newton import GaussNewtonOptions, draw_starts, gauss_newton_terms
from baselines.gn_net.losses.negatives import hard_negatives, random_negatives
from baselines.gn_net.losses.symmetric import Symmetric, normal_equations
from baselines.gn_net.losses.total import LossOptions, LossValue, masked_mean, total_loss
from baselines.gn_net.network import FeatureNet
from baselines.gn_net.options import NetworkOptions
from baselines.gn_net.sampling import sample, sample_with_gradient
from baselines.options import options_from_dict
from relocbench.errors import ConfigError


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def noise(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(shape, generator=generator(seed), dtype=torch.float64)


def affine_map(slopes: list[list[float]], height: int = 12, width: int = 14) -> Tensor:
    """(D, H, W): channel d is slopes[d] . (u, v)."""
    v, u = torch.meshgrid(torch.arange(height).double(), torch.arange(width).double(), indexing="ij")
    return torch.stack([a * u + b * v for a, b in slopes])


def smooth_map(dim: int = 4, size: int = 16, seed: int = 3) -> Tensor:
    """(D, H, W) sums of waves some pixels long."""
    v, u = torch.meshgrid(torch.arange(size), torch.arange(size), indexing="ij")
    waves = noise(dim, 5, 4, seed=seed)
    phases = 0.4 * (waves[..., 0, None, None] * u + waves[..., 1, None, None] * v) + 6 * waves[..., 2, None, None]
    return (waves[..., 3, None, None] * torch.sin(phases)).sum(1)


def at(*places: tuple[float, float]) -> Tensor:
    return torch.tensor(places, dtype=torch.float64)


# Contrastive


def test_contrastive_values_by_hand() -> None:
    a, b = at((0.0, 0.0), (1.0, 1.0), (0.0, 0.0)), at((0.3, 0.4), (1.0, 1.0), (3.0, 4.0))  # d = 0.5, 0, 5
    assert negative_terms(a, b).tolist() == pytest.approx([0.25, 1.0, 0.0])
    assert negative_terms(a, b, "squared").tolist() == pytest.approx([0.75, 1.0, 0.0])
    assert negative_terms(a, b, "distance", 2.0).tolist() == pytest.approx([2.25, 4.0, 0.0])


@pytest.mark.parametrize("form", ["distance", "squared"])
def test_contrastive_derivatives(form: str) -> None:
    a, b = noise(6, 3).requires_grad_(), (noise(6, 3) + 0.5 * noise(6, 3, seed=1)).requires_grad_()
    assert torch.autograd.gradcheck(lambda x, y: negative_terms(x, y, form, 1.5), (a, b))  # type: ignore[arg-type]


def test_equal_features_of_different_points_have_a_finite_derivative() -> None:
    a = torch.ones(4, 3, requires_grad=True)
    negative_terms(a, torch.ones(4, 3)).sum().backward()
    assert a.grad is not None
    assert a.grad.isfinite().all()


# Gauss-Newton


def test_gauss_newton_values_by_hand() -> None:
    """F = (2 u, 3 v), r0 = (0.2, -0.3), delta = (0.5, -0.25), eps = 0.1:

    H = diag(4.1, 9.1); b = (2 (0.2 + 1.0), 3 (-0.3 - 0.75)) = (2.4, -3.15);
    u_b - mu = (2.4 / 4.1 - 0.5, -3.15 / 9.1 + 0.25) = (0.0853659, -0.0961538);
    e1 = (4.1 * 0.00728733 + 9.1 * 0.00924556) / 2 = 0.0570063; e2 = 1.8378771 - ln(37.31) / 2 = 0.0282541.
    """
    features, u = affine_map([[2.0, 0.0], [0.0, 3.0]]), at((5.2, 6.6))
    f = at((2 * 5.2 - 0.2, 3 * 6.6 + 0.3))
    terms = gauss_newton_terms(features, f, u, u + at((0.5, -0.25)), eps=0.1)
    assert float(terms.e1) == pytest.approx(0.0570063, abs=1e-6)
    assert float(terms.e2) == pytest.approx(math.log(2 * math.pi) - 0.5 * math.log(37.31))
    assert float(terms.e2) == pytest.approx(0.0282541, abs=1e-4)


def test_a_ramp_has_no_error_and_the_hessian_of_its_slopes() -> None:
    slopes = [[0.5, 0.2], [-0.3, 0.7], [0.1, 0.4]]
    features, u = affine_map(slopes), at((5.3, 4.1), (7.0, 6.0), (6.4, 8.9))
    terms = gauss_newton_terms(features, sample(features, u).values, u, u + at((0.9, -0.7)), eps=1e-9)
    A = torch.tensor(slopes, dtype=torch.float64)
    assert terms.e1.abs().max() < 1e-15
    likelihood = math.log(2 * math.pi) - 0.5 * float(torch.logdet(A.T @ A + 1e-9 * torch.eye(2)))
    assert terms.e2.tolist() == pytest.approx([likelihood] * 3)
    assert not terms.near_singular.any()


def test_both_terms_are_the_negative_log_likelihood_of_the_true_pixel() -> None:
    features, u, eps = smooth_map(), at((7.2, 8.4), (5.5, 6.1), (9.9, 4.3)), 1e-3
    f, start = noise(3, 4, seed=5), u + at((0.4, -0.8), (0.1, 0.9), (-0.7, -0.2))
    terms = gauss_newton_terms(features, f, u, start, eps)
    values, jacobian, _ = sample_with_gradient(features, start)
    for i in range(3):
        J, r = jacobian[i], values[i] - f[i]
        H = J.T @ J + eps * torch.eye(2)
        mu = start[i] - torch.linalg.solve(H, J.T @ r)
        gaussian = MultivariateNormal(mu, precision_matrix=H)
        assert float(terms.e1[i] + terms.e2[i]) == pytest.approx(-float(gaussian.log_prob(u[i])), rel=1e-9)


def test_contrast_raises_e1_and_lowers_e2_as_the_formula_says() -> None:
    features, u = smooth_map(), at((7.2, 8.4), (5.5, 6.1))
    f, start = sample(features, u).values, u + 0.5
    one = gauss_newton_terms(features, f, u, start, eps=1e-12)
    ten = gauss_newton_terms(10 * features, 10 * f, u, start, eps=1e-10)
    assert torch.allclose(ten.e1, 100 * one.e1, rtol=1e-9)
    assert torch.allclose(ten.e2, one.e2 - 2 * math.log(10), rtol=1e-9)


def test_an_edge_is_counted_as_near_singular_and_stays_finite() -> None:
    features = affine_map([[1.0, 0.0], [-2.0, 0.0]]).float().requires_grad_()
    u = at((5.0, 5.0)).float()
    terms = gauss_newton_terms(features, torch.zeros(1, 2), u, u + 0.5, eps=1e-6)
    assert terms.near_singular.tolist() == [1.0]
    assert terms.e2.tolist() == pytest.approx([math.log(2 * math.pi) - 0.5 * math.log(5 * 1e-6)], rel=1e-5)
    (terms.e1 + terms.e2).sum().backward()
    assert features.grad is not None
    assert features.grad.isfinite().all()


def test_derivatives_of_gauss_newton() -> None:
    features, f = noise(3, 6, 7).requires_grad_(), noise(2, 3, seed=1).requires_grad_()
    u = at((3.2, 2.7), (2.6, 2.9))
    start = u + at((0.3, -0.6), (0.8, -0.1))

    def drawn(maps: Tensor, ref: Tensor) -> Tensor:
        return torch.stack(gauss_newton_terms(maps, ref, u, start, 1e-2)[:2])

    assert torch.autograd.gradcheck(drawn, (features, f), fast_mode=True)


def test_two_by_two_matrices_agree_with_linear_algebra() -> None:
    J, r = noise(5, 3, 2), noise(5, 3, seed=1)
    H, b = normal_equations(J, r)
    full = J.mT @ J
    assert torch.allclose(H.determinant(), torch.linalg.det(full))
    assert torch.allclose(H.solve(b), torch.linalg.solve(full, (J.mT @ r[..., None])[..., 0]))
    assert torch.allclose(H.smaller_eigenvalue(), torch.linalg.eigvalsh(full)[:, 0])
    assert torch.allclose(H.quadratic(b), (b[..., None, :] @ full @ b[..., None])[..., 0, 0])
    nothing = torch.zeros(1, dtype=torch.float64)
    assert Symmetric(nothing, nothing, nothing).smaller_eigenvalue().tolist() == [0.0]


def test_training_maps_by_the_loss_makes_steps_land() -> None:
    maps = (0.3 * noise(2, 8, 24, 24)).requires_grad_()
    u = 4 + 15 * torch.rand((200, 2), generator=generator(1), dtype=torch.float64)
    optimiser = torch.optim.Adam([maps], lr=0.02)

    def terms(seed: int) -> tuple[Tensor, Tensor]:
        f = sample(maps[0], u).values
        found = gauss_newton_terms(maps[1], f, u, draw_starts(u, 1.0, generator(seed)), 1e-6)
        return found.e1 + found.e2, found.valid

    def misses() -> float:
        """Share of held-out starts whose step ends more than a quarter of a pixel off."""
        with torch.no_grad():
            start = draw_starts(u, 1.0, generator(10_000))
            values, jacobian, _ = sample_with_gradient(maps[1], start)
            H, b = normal_equations(jacobian, values - sample(maps[0], u).values)
            off = (start - H.plus_diagonal(1e-6).solve(b) - u).norm(dim=-1)
            return float((off > 0.25).double().mean())

    before = misses()
    for step in range(150):
        optimiser.zero_grad()
        cost, valid = terms(step)
        masked_mean(cost, valid).backward()
        optimiser.step()
    assert before > 0.9
    assert misses() < 0.5


# Descent


def test_descent_values_by_hand() -> None:
    """F = (2 u, 3 v), f = F(u_b), delta = (4, -3), lambda = 2: x_after - u_b = (4 * 2 / 6, -3 * 2 / 11)."""
    features, u = affine_map([[2.0, 0.0], [0.0, 3.0]]), at((5.2, 6.6))
    f, start = sample(features, u).values, u + at((4.0, -3.0))
    options = DescentOptions(weight=1.0, margin=30.0)
    terms = descent_terms(features, f, u, start, options)
    assert float(terms.cost) == pytest.approx((4 / 3) ** 2 + (6 / 11) ** 2 - 25 + 30)
    assert terms.nearer.tolist() == [True]
    assert descent_terms(features, f, u, start, DescentOptions()).cost.tolist() == [0.0]


def test_a_step_away_costs_more_than_the_margin() -> None:
    features, u = affine_map([[1.0, 0.0], [0.0, 1.0]]), at((6.0, 6.0))
    f = sample(features, u + at((6.0, 0.0))).values  # the features say: 6 px to the right
    terms = descent_terms(features, f, u, u + at((1.0, 0.0)), DescentOptions())
    assert float(terms.cost) == pytest.approx((1 + 5 / 3) ** 2 - 1 + 0.1)
    assert terms.nearer.tolist() == [False]


def test_derivatives_of_descent() -> None:
    features, f = noise(3, 6, 7).requires_grad_(), noise(2, 3, seed=1).requires_grad_()
    u, start = at((3.2, 2.7), (2.6, 2.9)), at((4.1, 3.3), (1.2, 1.7))
    options = DescentOptions(margin=50.0)
    assert torch.autograd.gradcheck(lambda maps, ref: descent_terms(maps, ref, u, start, options).cost, (features, f))


# Starts and negatives


def test_starts_fill_the_vicinity() -> None:
    u = at((5.0, -3.0)).expand(4000, 2)
    noise_drawn = draw_starts(u, 2.0, generator()) - u
    assert noise_drawn.abs().max() <= 2.0
    assert noise_drawn.std(0).tolist() == pytest.approx([2 / math.sqrt(3)] * 2, rel=0.05)
    assert torch.equal(draw_starts(u, 2.0, generator(4)), draw_starts(u, 2.0, generator(4)))
    assert not torch.equal(draw_starts(u, 2.0, generator(4)), draw_starts(u, 2.0, generator(5)))


def test_random_negatives_are_on_the_map_and_away_from_the_true_pixel() -> None:
    u = torch.rand((2, 500, 2), generator=generator(1)) * torch.tensor([29.0, 19.0])
    drawn, found = random_negatives((20, 30), u, 4.0, generator())
    assert drawn.shape == u.shape
    assert found.all()
    assert ((drawn >= 0) & (drawn <= torch.tensor([29.0, 19.0]))).all()
    assert (drawn - u).norm(dim=-1).min() > 4.0
    assert torch.equal(drawn, random_negatives((20, 30), u, 4.0, generator())[0])
    assert not random_negatives((20, 30), u, 100.0, generator())[1].any()


def test_a_hard_negative_is_the_nearest_feature_away_from_the_true_pixel() -> None:
    maps, f = noise(2, 3, 8, 9), noise(2, 20, 3, seed=1)
    u = torch.rand((2, 20, 2), generator=generator(2), dtype=torch.float64) * 7
    chosen, found = hard_negatives(maps, f, u, 2.0, 5000, generator())  # so many that every pixel is drawn
    assert found.all()
    for b in range(2):
        for i in range(20):
            pixels = [(x, y) for y in range(8) for x in range(9) if math.dist((x, y), u[b, i].tolist()) > 2.0]
            best = min(pixels, key=lambda p: float((maps[b, :, p[1], p[0]] - f[b, i]).norm()))
            assert chosen[b, i].tolist() == list(best)
    alone, _ = hard_negatives(maps[0], f[0], u[0], 2.0, 5000, generator())
    assert torch.equal(alone, chosen[0])
    assert not hard_negatives(maps, f, u, 100.0, 50, generator())[1].any()


# Ascent


def test_the_residual_need_not_rise_where_it_is_higher_by_the_margin() -> None:
    """F(u) = (u, v), so that squared residuals are squared distances: 0 at the true pixel, t^2 d^2 on the way."""
    features = affine_map([[1.0, 0.0], [0.0, 1.0]], 40, 40)
    u_true = torch.full((50, 2), 20.0, dtype=torch.float64)
    u_still = u_true + torch.tensor([6.0, 8.0])
    options = AscentOptions(margin=9.0, away=2.0, positions=3)
    terms = ascent_terms(features, u_true, u_true, u_still, options, generator())
    assert terms.cost.shape == (50, 3)
    t = torch.rand((50, 3), generator=generator()) * 1.5 - 0.5
    assert torch.allclose(terms.cost, (9.0 - 100.0 * t.double() ** 2).clamp(min=0), atol=1e-4)
    assert torch.equal(terms.valid, 10.0 * t.abs() >= 2.0)
    assert 0.5 < float(terms.valid.double().mean()) < 1.0
    assert terms.higher.all()


def test_a_minimum_where_no_motion_puts_the_point_costs() -> None:
    """The reference's feature is that of the still pixel: the residual falls on the way to it."""
    features = affine_map([[1.0, 0.0], [0.0, 1.0]], 40, 40)
    u_true = torch.full((20, 2), 12.0, dtype=torch.float64)
    u_still = u_true + 10.0
    terms = ascent_terms(features, u_still, u_true, u_still, AscentOptions(away=1.0), generator())
    ahead = (terms.cost > 0.5) & terms.valid
    assert torch.equal(ahead, ~terms.higher & terms.valid)
    assert bool(ahead.any())
    assert bool((terms.higher & terms.valid).any())  # beyond the true pixel it rises


def test_positions_off_the_map_and_points_that_hardly_move_do_not_count() -> None:
    features = affine_map([[1.0, 0.0], [0.0, 1.0]], 12, 12)
    u_true = torch.full((30, 2), 5.0, dtype=torch.float64)
    off = ascent_terms(features, u_true, u_true, u_true + 1000.0, AscentOptions(), generator())
    still = ascent_terms(features, u_true, u_true, u_true + 0.5, AscentOptions(), generator())
    assert not still.valid.any()
    assert int(off.valid.sum()) <= 1
    assert bool(off.cost.isfinite().all())


# Total

ALL = LossOptions(
    ContrastiveOptions(weight=2.0, negative_weight=0.5, negatives="both", away=2.0, candidates=64),
    GaussNewtonOptions(weight=0.3, e1=1.5, e2=0.25),
    DescentOptions(weight=0.7, vicinity=2.0),
    level_weights=(1.0, 0.5),
)


def pyramids(seed: int = 0) -> tuple[list[Tensor], list[Tensor]]:
    sides = [
        [0.5 * noise(2, 4, 24 >> level, 32 >> level, seed=seed + 10 * side + level).float() for level in range(2)]
        for side in range(2)
    ]
    return sides[0], sides[1]


def points(seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    u = torch.rand((2, 2, 30, 2), generator=generator(seed)) * torch.tensor([31.0, 23.0])
    return u[0], u[1], torch.ones((2, 30), dtype=torch.bool)


def evaluate(options: LossOptions = ALL, seed: int = 0) -> LossValue:
    return total_loss(*pyramids(), *points(), options, generator(seed))


def test_the_total_is_the_weighted_sum_of_its_parts() -> None:
    value = evaluate()
    expected = 0.0
    for level, weight in enumerate(ALL.level_weights):
        part = {name: float(value.parts[f"{level}/{name}"]) for name in ("positive", "negative", "e1", "e2", "descent")}
        expected += weight * 2.0 * (part["positive"] + 0.5 * part["negative"])
        expected += weight * (0.3 * (1.5 * part["e1"] + 0.25 * part["e2"]) + 0.7 * part["descent"])
    assert float(value.total) == pytest.approx(expected, rel=1e-6)
    assert {name.split("/")[1] for name in value.parts} == {
        *("positive", "negative", "e1", "e2", "near_singular", "descent", "nearer", "points")
    }
    assert not any(part.requires_grad for part in value.parts.values())


def test_the_ascent_loss_is_a_part_of_the_total_and_needs_to_know_where_points_are_without_motion() -> None:
    options = replace(ALL, ascent=AscentOptions(weight=2.0, positions=4))
    with pytest.raises(ValueError, match="u_still"):
        evaluate(options)
    u_ref, u_query, mask = points()
    plain = total_loss(*pyramids(), u_ref, u_query, mask, ALL, generator())
    value = total_loss(*pyramids(), u_ref, u_query, mask, options, generator(), u_ref)
    assert {name.split("/")[1] for name in value.parts} - {name.split("/")[1] for name in plain.parts} == {
        *("ascent", "higher")
    }
    of_levels = zip(ALL.level_weights, (float(value.parts[f"{level}/ascent"]) for level in range(2)), strict=True)
    # draws of the first level's ascent loss move those of the second level's other losses
    first = replace(options, level_weights=(1.0, 0.0)), replace(ALL, level_weights=(1.0, 0.0))
    with_it, without = (total_loss(*pyramids(), u_ref, u_query, mask, o, generator(), u_ref) for o in first)
    assert float(with_it.total - without.total) == pytest.approx(2.0 * next(of_levels)[1], rel=1e-6)


def test_positives_of_the_total_by_hand() -> None:
    (a, _), (b, _) = pyramids()
    u_ref, u_query, mask = points()
    only = LossOptions(ContrastiveOptions(), GaussNewtonOptions(weight=0), level_weights=(1.0,))
    value = total_loss([a], [b], u_ref, u_query, mask, only, generator())
    by_hand = ((sample(a, u_ref).values - sample(b, u_query).values) ** 2).sum(-1).mean()
    assert float(value.parts["0/positive"]) == pytest.approx(float(by_hand), rel=1e-6)
    assert set(value.parts) == {"0/positive", "0/negative", "0/points"}


def test_a_seed_decides_everything_and_the_global_state_nothing() -> None:
    torch.manual_seed(1)
    state = torch.get_rng_state()
    first = evaluate()
    assert torch.equal(state, torch.get_rng_state())
    torch.manual_seed(2)
    assert torch.equal(first.total, evaluate().total)
    assert not torch.equal(first.total, evaluate(seed=1).total)


def test_what_is_masked_out_or_off_the_map_has_no_say() -> None:
    u_ref, u_query, mask = points()
    mask[:, 20:] = False
    changed = u_query.clone()
    changed[:, 20:] = torch.nan
    maps = [level.requires_grad_() for side in pyramids() for level in side]
    value = total_loss(maps[:2], maps[2:], u_ref, changed, mask, ALL, generator())
    value.total.backward()
    assert all(level.grad is not None and level.grad.isfinite().all() for level in maps)
    kept = total_loss(*pyramids(), u_ref, torch.where(mask[..., None], u_query, 0), mask, ALL, generator())
    assert torch.equal(value.total.detach(), kept.total)
    assert int(value.parts["0/points"]) == 40
    nothing = total_loss(*pyramids(), u_ref - 100, u_query, mask, ALL, generator())
    assert float(nothing.total) == 0.0
    assert int(nothing.parts["0/points"]) == 0


def test_every_weight_of_the_network_is_trained() -> None:
    net = FeatureNet(NetworkOptions(widths=(4, 6, 8), finest=0, dim=4, levels=2))
    pictures = torch.rand((4, 3, 24, 32), generator=generator(3))
    maps = net(pictures)
    value = total_loss([m[:2] for m in maps], [m[2:] for m in maps], *points(), ALL, generator())
    value.total.backward()
    for name, parameter in net.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.isfinite().all(), name
        assert parameter.grad.abs().max() > 0, name


def test_mixed_precision_gives_about_the_same_loss() -> None:
    net = FeatureNet(NetworkOptions(widths=(4, 6, 8), finest=0, dim=4, levels=2))
    pictures = torch.rand((4, 3, 24, 32), generator=generator(3))
    totals = []
    for enabled in (False, True):
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=enabled):
            maps = net(pictures)
            assert (maps[0].dtype == torch.bfloat16) == enabled
            totals.append(
                total_loss([m[:2] for m in maps], [m[2:] for m in maps], *points(), ALL, generator()).total.item()
            )
    assert totals[1] == pytest.approx(totals[0], rel=0.1)


def test_levels_must_agree() -> None:
    with pytest.raises(ValueError, match="weights"):
        total_loss(*pyramids(), *points(), LossOptions(), generator())


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"contrastive": {"margin": 0}}, "margin"),
        ({"contrastive": {"away": -1}}, "away"),
        ({"gauss_newton": {"eps": 0}}, "eps"),
        ({"gauss_newton": {"e1": -1}}, "e1"),
        ({"gauss_newton": {"lambda": 1}}, "lambda"),
        ({"descent": {"damping": 0}}, "damping"),
        ({"level_weights": [0, 0]}, "level_weights"),
        ({"level_weights": []}, "level_weights"),
        (
            {"contrastive": {"weight": 0}, "gauss_newton": {"weight": 0}},
            "contrastive.weight",
        ),
        ({"ascent": {"margin": 0}}, "margin"),
        ({"pose": {"reach": -1}}, "reach"),
    ],
)
def test_options_that_make_no_sense_are_named(values: dict[str, object], said: str) -> None:
    with refused(ConfigError, "", None, said):
        options_from_dict(LossOptions, values)


def test_loss_options_survive_json() -> None:
    assert options_from_dict(LossOptions, json.loads(json.dumps(asdict(ALL)))) == ALL


def test_nothing_stays_behind_on_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tensors of another device than the CPU refuse to be mixed with it; the meta device has shapes alone."""
    monkeypatch.setattr(torch, "autocast", lambda *_, **__: nullcontext())  # which the meta device has not
    ref, query = ([level.to("meta") for level in side] for side in pyramids())
    u_ref, u_query, mask = (part.to("meta") for part in points())
    value = total_loss(ref, query, u_ref, u_query, mask, ALL, generator())
    assert value.total.device.type == "meta"
    assert value.total.shape == ()
