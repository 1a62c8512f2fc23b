"""Losses of LPN and its variants against hand-computed values and finite differences."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal, cast

import pytest
import torch
from refusals import refused
from torch import Tensor
from torch.autograd import gradcheck
from torch.nn import functional

from baselines.lpn.decorrelation import DecorrelationOptions, correlations, decorrelation_loss
from baselines.lpn.losses import LossOptions, instance_loss, total_loss
from baselines.lpn.network import View, ViewOutput
from baselines.lpn.partition_loss import PartitionLossOptions, largest_spread, partition_loss, spread
from baselines.options import options_from_dict
from relocbench.errors import ConfigError

FORMS = [
    PartitionLossOptions(form=form, over=over, relative=relative)
    for form in ("original", "power", "exponential")
    for over in ("parts", "pixels")
    for relative in (False, True)
]
EACH_FORM = pytest.mark.parametrize("options", FORMS, ids=lambda o: f"{o.form}-{o.over}-{o.relative}")


def noise(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def quarters() -> Tensor:
    """(1, 4, 4, 4): each mask is one quarter of the map."""
    index = (torch.arange(4)[:, None] // 2) * 2 + torch.arange(4)[None, :] // 2
    return functional.one_hot(index, 4).movedim(-1, 0)[None].double()


def collapsed() -> Tensor:
    """(1, 4, 4, 4): the first mask has everything."""
    return functional.one_hot(torch.zeros(1, 4, 4, dtype=torch.int64), 4).movedim(-1, 1).double()


def equal() -> Tensor:
    return torch.full((1, 4, 4, 4), 0.25, dtype=torch.float64)


def output(view_seed: int, masks: Tensor | None = None) -> ViewOutput:
    logits = noise(4, 3, 5, seed=view_seed)
    return ViewOutput(noise(4, 3, 6), logits, noise(4, 7, seed=view_seed + 50), masks)


def pull(options: PartitionLossOptions, size: float) -> float:
    """Norm of the loss's derivative by a pixel's logits, which are ``size`` away from equal, towards one of four masks.

    Each of four pixels turns to a mask of its own, so that all variances grow alike; the loss is a mean over pixels.
    """
    towards = torch.eye(4, dtype=torch.float64) - 0.25
    z = (size * towards / towards[0].norm()).requires_grad_()
    (slope,) = torch.autograd.grad(partition_loss(z.softmax(0)[None, :, None, :], options), z)
    return 4 * float(slope[:, 0].norm())


def test_the_instance_loss_is_a_sum_over_parts_of_means_over_images() -> None:
    logits, labels = noise(4, 3, 5), torch.tensor([0, 4, 2, 2])
    by_hand = sum(
        -float(logits[b, p, labels[b]]) + math.log(float(logits[b, p].exp().sum())) for b in range(4) for p in range(3)
    )
    assert float(instance_loss(logits, labels)) == pytest.approx(by_hand / 4)
    assert float(instance_loss(torch.zeros(2, 4, 701), torch.tensor([0, 1]))) == pytest.approx(4 * math.log(701))
    assert gradcheck(lambda z: instance_loss(z, labels), (logits.requires_grad_(),))


def test_the_total_is_a_sum_over_views() -> None:
    outputs: dict[View, ViewOutput] = {"satellite": output(1), "drone": output(2), "street": output(3)}
    labels: dict[View, Tensor] = {view: torch.tensor([0, 4, 2, i]) for i, view in enumerate(outputs)}
    value = total_loss(outputs, labels)
    of_view = [float(instance_loss(outputs[view].logits, labels[view])) for view in outputs]
    assert float(value.total) == pytest.approx(sum(of_view))
    assert float(value.parts["instance/drone"]) == pytest.approx(of_view[1])
    assert float(value.parts["instance"]) == pytest.approx(sum(of_view))
    assert set(value.parts) == {"instance", *(f"{kind}/{view}" for kind in ("instance", "right") for view in outputs)}


def test_an_image_is_right_by_the_sum_of_its_parts_probabilities() -> None:
    logits = torch.log(torch.tensor([[[0.6, 0.4], [0.6, 0.4], [0.1, 0.9]], [[0.6, 0.4], [0.6, 0.4], [0.4, 0.6]]]))
    drone = ViewOutput(noise(2, 3, 6), logits, noise(2, 7), None)
    value = total_loss({"drone": drone}, {"drone": torch.tensor([1, 1])})
    assert float(value.parts["right/drone"]) == 0.5


def test_weights_of_the_total_are_the_options() -> None:
    masks = noise(4, 3, 4, 4).softmax(1)
    outputs: dict[View, ViewOutput] = {"satellite": output(1, masks), "drone": output(2, masks.flip(1))}
    same = torch.tensor([0, 4, 2, 2])
    labels: dict[View, Tensor] = {"satellite": same, "drone": same.clone()}
    options = LossOptions(DecorrelationOptions(weight=0.25), PartitionLossOptions(weight=3.0, form="power"))
    value = total_loss(outputs, labels, options)
    decorrelation = decorrelation_loss(outputs["satellite"].pooled, outputs["drone"].pooled, options.decorrelation)
    partition = (partition_loss(masks, options.partition) + partition_loss(masks.flip(1), options.partition)) / 2
    instance = sum(float(instance_loss(outputs[view].logits, same)) for view in outputs)
    assert float(value.parts["decorrelation"]) == pytest.approx(float(decorrelation))
    assert float(value.parts["partition"]) == pytest.approx(float(partition))
    assert float(value.total) == pytest.approx(0.75 * instance + 0.25 * float(decorrelation) + 3.0 * float(partition))


def test_batches_that_a_loss_cannot_use_are_refused() -> None:
    one, other = torch.tensor([0, 1, 2, 3]), torch.tensor([0, 1, 2, 4])
    pairs = LossOptions(decorrelation=DecorrelationOptions(weight=0.1))
    both: dict[View, ViewOutput] = {"satellite": output(1), "drone": output(2)}
    assert math.isfinite(float(total_loss(both, {"satellite": one, "drone": one}, pairs).total))
    with pytest.raises(ValueError, match="building"):
        total_loss(both, {"satellite": one, "drone": other}, pairs)
    with pytest.raises(ValueError, match="building"):
        total_loss({"drone": output(1)}, {"drone": one}, pairs)
    with pytest.raises(ValueError, match="masks"):
        total_loss({"drone": output(1)}, {"drone": one}, LossOptions(partition=PartitionLossOptions(weight=1.0)))
    for outputs, labels in (({}, {}), ({"drone": output(1)}, {"satellite": one})):
        with pytest.raises(ValueError, match="views"):
            total_loss(cast(dict[View, ViewOutput], outputs), cast(dict[View, Tensor], labels))


def test_correlations_are_those_of_the_channels() -> None:
    a, b = noise(8, 3), noise(8, 3, seed=1)
    by_hand = torch.corrcoef(torch.cat([a.T, b.T]))[:3, 3:]
    assert torch.allclose(correlations(a, b), by_hand, atol=1e-4)  # batch normalisation adds 1e-5 to variances
    moved = correlations(10 * a + 3, b)
    assert torch.allclose(moved, by_hand, atol=1e-4)
    assert torch.allclose(correlations(a, a).diagonal(), torch.ones(3, dtype=torch.float64), atol=1e-4)
    for wrong in (noise(7, 3), noise(8, 4), noise(1, 3), noise(8)):
        with pytest.raises(ValueError, match="expected"):
            correlations(wrong, b if len(wrong) > 1 and wrong.ndim > 1 else wrong)


@pytest.mark.parametrize("powers", [(1.0, 1.0), (0.0, 0.0), (2.0, 0.5)])
def test_the_decorrelation_by_hand(powers: tuple[float, float]) -> None:
    options = DecorrelationOptions(on_power=powers[0], off_power=powers[1])
    a, b = noise(6, 4), noise(6, 4, seed=1)
    c = correlations(a, b).tolist()
    on = off = 0.0
    for i in range(4):
        for j in range(4):
            if i == j:
                on += ((1 - c[i][i]) / 2) ** powers[0] * (1 - c[i][i]) ** 2
            else:
                off += abs(c[i][j]) ** powers[1] * c[i][j] ** 2
    assert float(decorrelation_loss(a, b, options)) == pytest.approx((on + 0.0013 * off) / 32)


def test_the_decorrelation_is_least_for_features_that_agree_and_are_independent() -> None:
    patterns = torch.tensor([[1.0, 1, 1, 1], [1, -1, 1, -1], [1, 1, -1, -1], [1, -1, -1, 1]]).T.double()
    independent = patterns[:, 1:]
    redundant = patterns[:, [1, 1, 1]]
    options = DecorrelationOptions(off_weight=1.0)
    assert float(decorrelation_loss(independent, independent, options)) < 1e-9
    assert float(decorrelation_loss(redundant, redundant, options)) == pytest.approx(6 / 32, rel=1e-3)
    assert float(decorrelation_loss(independent, -independent, options)) == pytest.approx(3 * 4 / 32, rel=1e-3)


def test_dynamic_weights_turn_to_channels_that_are_still_wrong() -> None:
    """Against Barlow Twins, a correlation of 0.1 costs a tenth, one of 1 the same."""
    steady = DecorrelationOptions(on_power=0.0, off_power=0.0, off_weight=1.0)
    dynamic = replace(steady, on_power=1.0, off_power=1.0)
    x, y = torch.tensor([1.0, -1, 1, -1]).double(), torch.tensor([1.0, 1, -1, -1]).double()
    share = {}
    for angle in (0.1, 1.0):
        mixed = angle * x + math.sqrt(1 - angle**2) * y
        a = torch.stack([x, mixed], dim=1)
        share[angle] = float(decorrelation_loss(a, a, dynamic)) / float(decorrelation_loss(a, a, steady))
    assert share[0.1] == pytest.approx(0.1, rel=1e-2)
    assert share[1.0] == pytest.approx(1.0, rel=1e-2)


def test_derivatives_of_the_decorrelation() -> None:
    a, b = noise(5, 4).requires_grad_(), noise(5, 4, seed=1).requires_grad_()
    for options in (DecorrelationOptions(), DecorrelationOptions(on_power=0.0, off_power=0.0, off_weight=1.0)):
        assert gradcheck(lambda one, other, options=options: decorrelation_loss(one, other, options), (a, b))


@pytest.mark.parametrize(
    ("over", "values"),
    [
        ("parts", {"quarters": 1.0, "collapsed": 1.0, "equal": 0.0}),
        ("pixels", {"quarters": 1.0, "collapsed": 0.0, "equal": 0.0}),
    ],
)
@pytest.mark.parametrize("relative", [False, True])
def test_what_either_variance_is_largest_for(
    over: Literal["parts", "pixels"], relative: bool, values: dict[str, float]
) -> None:
    for name, masks in (("quarters", quarters()), ("collapsed", collapsed()), ("equal", equal())):
        share = float(spread(masks, over, relative)) / largest_spread(4, relative)
        assert share == pytest.approx(values[name], abs=1e-9)
    drawn = (4 * noise(50, 4, 3, 3)).softmax(1)
    assert float(spread(drawn, over, relative).max()) < largest_spread(4, relative)


def test_the_variance_by_hand() -> None:
    masks = torch.tensor([0.5, 0.3, 0.2])[None, :, None, None]
    variance = ((0.5 - 1 / 3) ** 2 + (0.3 - 1 / 3) ** 2 + (0.2 - 1 / 3) ** 2) / 3
    assert float(spread(masks, "parts", False)) == pytest.approx(variance)
    assert float(spread(masks, "parts", True)) == pytest.approx(3 * variance)
    two = torch.tensor([[0.5, 0.1], [0.5, 0.9]]).reshape(1, 2, 1, 2)
    assert float(spread(two, "pixels", False)) == pytest.approx(0.04)
    assert float(spread(two, "pixels", True)) == pytest.approx((0.04 / 0.3 + 0.04 / 0.7) / 2)
    with pytest.raises(ValueError, match="two"):
        spread(torch.ones(1, 1, 2, 2), "parts", False)


def test_the_forms_by_hand() -> None:
    masks = torch.tensor([0.5, 0.3, 0.1, 0.1], dtype=torch.float64)[None, :, None, None]
    v = (0.25**2 + 0.05**2 + 2 * 0.15**2) / 4
    q = v / (3 / 16)
    assert float(partition_loss(masks, PartitionLossOptions())) == pytest.approx(math.log(1 + 4 / v))
    power = PartitionLossOptions(form="power", power=3.0)
    assert float(partition_loss(masks, power)) == pytest.approx((1 - q) ** 3)
    exponential = PartitionLossOptions(form="exponential", tau=0.5)
    assert float(partition_loss(masks, exponential)) == pytest.approx(math.exp(-q / 0.5))


@EACH_FORM
def test_each_form_wants_masks_that_differ(options: PartitionLossOptions) -> None:
    costs = [float(partition_loss((size * noise(2, 4, 5, 5)).softmax(1), options)) for size in (0.1, 1.0, 3.0, 10.0)]
    assert costs == sorted(costs, reverse=True)
    assert costs[0] > 1.1 * costs[-1]


@EACH_FORM
def test_derivatives_of_the_partition_loss(options: PartitionLossOptions) -> None:
    z = noise(2, 4, 3, 3).requires_grad_()
    assert gradcheck(lambda each: partition_loss(each.softmax(1), options), (z,))


@EACH_FORM
def test_exactly_equal_masks_give_finite_numbers(options: PartitionLossOptions) -> None:
    z = torch.zeros(1, 4, 3, 3, requires_grad=True)
    value = partition_loss(z.softmax(1), options)
    (slope,) = torch.autograd.grad(value, z)
    assert bool(value.isfinite())
    assert bool(slope.isfinite().all())


def test_the_originals_pull_is_largest_on_masks_that_are_almost_equal() -> None:
    """It grows as 2 / |z| towards equal masks, where the reconstructions' vanish as |z| does."""
    original = PartitionLossOptions(form="original")
    assert pull(original, 0.001) == pytest.approx(2 / 0.001, rel=1e-3)
    assert pull(original, 0.01) == pytest.approx(2 / 0.01, rel=1e-2)
    sizes = (0.001, 0.01, 0.1, 1.0, 3.0, 10.0)
    pulls = [pull(original, size) for size in sizes]
    assert pulls == sorted(pulls, reverse=True)
    for form in ("power", "exponential"):
        for over, relative in (("parts", False), ("pixels", False), ("pixels", True)):
            options = options_from_dict(PartitionLossOptions, {"form": form, "over": over, "relative": relative})
            pulls = [pull(options, size) for size in sizes]
            assert max(pulls) < 3.0
            assert pulls[0] == pytest.approx(pulls[1] / 10, rel=1e-2)
            assert pulls.index(max(pulls)) not in (0, 1, 5)


def test_the_originals_derivative_by_the_variance_never_vanishes() -> None:
    """-K / (s (s + K)): largest at s = 0, and still 5.1 where the masks are one-hot."""
    s = torch.tensor([1e-6, 1e-3, 0.1, 3 / 16], dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(torch.log1p(4 / s).sum(), s)
    assert torch.allclose(slope, -4 / (s * (s + 4)))
    assert float(slope[0]) < -9e5
    assert float(slope[-1]) == pytest.approx(-5.09, abs=0.01)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"partition": {"weight": -1.0}}, "weight"),
        ({"partition": {"power": 0.5}}, "power"),
        ({"partition": {"tau": 0.0}}, "tau"),
        ({"decorrelation": {"weight": 1.0}}, "weight"),
        ({"decorrelation": {"scale": 0.0}}, "scale"),
        ({"decorrelation": {"lambda": 1.0}}, "lambda"),
    ],
)
def test_options_that_make_no_sense_are_named(values: dict[str, object], said: str) -> None:
    with refused(ConfigError, "", None, said):
        options_from_dict(LossOptions, values)
