"""Rings, soft partition and heatmap masks: which pixel counts for which part, and how much."""

from __future__ import annotations

from typing import cast

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused
from torch import Tensor
from torch.autograd import gradcheck

from baselines.lpn.head import PartHead
from baselines.lpn.heatmap import HeatmapOptions, HeatmapPartition, heatmap
from baselines.lpn.pooling import PartMean, masked_means
from baselines.lpn.rings import RingMean, Rings, ring_index, ring_weights, stretched
from baselines.lpn.soft_partition import SoftPartition, SoftPartitionOptions
from baselines.options import options_from_dict
from relocbench.errors import ConfigError


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def noise(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(shape, generator=generator(seed), dtype=torch.float64)


def weights_by_hand(height: int, width: int, parts: int, mean: RingMean) -> Tensor:
    """(P, H, W), one square after the other as the module describes them."""
    down, right, middle_v, middle_u = height // (2 * parts), width // (2 * parts), height // 2, width // 2
    squares = torch.zeros(parts, height, width, dtype=torch.float64)
    for i in range(1, parts):
        rows = slice(middle_v - i * down, middle_v + i * down)
        columns = slice(middle_u - i * right, middle_u + i * right)
        squares[i - 1, rows, columns] = 1
    squares[parts - 1] = 1
    rings = squares.clone()
    rings[1:] -= squares[:-1]
    return rings / (squares if mean == "square" else rings).sum((1, 2))[:, None, None]


def test_rings_of_eight_pixels_are_these() -> None:
    quarter = torch.tensor([[3, 3, 3, 3], [3, 2, 2, 2], [3, 2, 1, 1], [3, 2, 1, 0]])
    half = torch.cat([quarter, quarter.flip(1)], dim=1)
    assert torch.equal(ring_index(8, 8, 4), torch.cat([half, half.flip(0)]))


@pytest.mark.parametrize(
    ("mean", "factors"), [("square", [1.0, 0.75, 5.0 / 9.0, 0.4375]), ("ring", [1.0, 1.0, 1.0, 1.0])]
)
def test_a_map_of_ones_gives_the_factors_of_either_mean(mean: RingMean, factors: list[float]) -> None:
    features, masks = Rings(4, mean)(torch.ones(1, 3, 16, 16, dtype=torch.float64))
    assert masks is None
    assert torch.allclose(features, torch.tensor(factors, dtype=torch.float64)[None, :, None].expand(1, 4, 3))
    assert [round(float(value), 4) for value in features[0, :, 0]] == [round(factor, 4) for factor in factors]


def test_rings_average_what_lies_in_them() -> None:
    x = torch.arange(16, dtype=torch.float64).reshape(1, 1, 4, 4)
    assert Rings(2, "ring")(x).features.flatten().tolist() == [7.5, 7.5]
    x[0, 0, 1:3, 1:3] = torch.tensor([[1.0, 2.0], [3.0, 4.0]])
    x[0, 0, 0, 0] = 12.0
    assert Rings(2, "ring")(x).features.flatten().tolist() == [2.5, 102.0 / 12.0]
    assert Rings(2, "square")(x).features.flatten().tolist() == [2.5, 102.0 / 16.0]


@given(
    st.integers(1, 5), st.integers(0, 9), st.integers(0, 9), st.sampled_from(["square", "ring"]), st.integers(0, 2**16)
)
@settings(max_examples=60, deadline=None)
def test_rings_of_any_size_are_the_squares_without_those_inside(
    parts: int, more_down: int, more_across: int, mean: RingMean, seed: int
) -> None:
    height, width = 2 * parts + more_down, 2 * parts + more_across
    x = noise(2, 3, height, width, seed=seed)
    weights = weights_by_hand(height, width, parts, mean)
    assert torch.allclose(ring_weights(height, width, parts, mean), weights)
    assert torch.allclose(Rings(parts, mean)(x).features, torch.einsum("bchw,phw->bpc", x, weights))


def test_what_is_left_over_belongs_to_the_outermost_ring() -> None:
    assert ring_index(16, 16, 5)[8].tolist() == [4, 4, 4, 4, 3, 2, 1, 0, 0, 1, 2, 3, 4, 4, 4, 4]
    assert ring_index(7, 9, 2)[3].tolist() == [1, 1, 0, 0, 0, 0, 1, 1, 1]  # an odd side: nearer to the first column


def test_one_part_is_the_mean_over_the_map() -> None:
    x = noise(2, 3, 5, 4)
    for mean in ("square", "ring"):
        assert torch.allclose(Rings(1, mean)(x).features[:, 0], x.mean((2, 3)))


def test_maps_that_are_too_small_are_stretched() -> None:
    x = noise(1, 2, 4, 5)
    assert stretched(x, 4).shape == (1, 2, 8, 9)
    assert stretched(x, 2) is x
    corners = stretched(x, 4)[..., [0, 0, -1, -1], [0, -1, 0, -1]]
    assert torch.allclose(corners, x[..., [0, 0, -1, -1], [0, -1, 0, -1]])
    assert torch.allclose(Rings(4, "ring")(x).features, Rings(4, "ring")(stretched(x, 4)).features)
    with pytest.raises(ValueError, match="4"):
        ring_index(7, 16, 4)


def test_a_mirror_image_has_the_same_rings_on_even_sides_alone() -> None:
    even, odd = noise(1, 2, 8, 8), noise(1, 2, 9, 9)
    rings = Rings(4, "ring")
    assert torch.allclose(rings(even).features, rings(even.flip(-1)).features)
    assert not torch.allclose(rings(odd).features, rings(odd.flip(-1)).features)


def test_a_heads_normalisation_takes_the_factors_of_the_square_mean_out_again() -> None:
    x = noise(6, 8, 16, 16).float()
    head = PartHead(8, 5, 3, 0.0, generator())
    embeddings = [head.embed(Rings(4, mean)(100 * x).features[:, 3]) for mean in ("square", "ring")]
    assert torch.allclose(embeddings[0], embeddings[1], atol=1e-3)
    assert not torch.allclose(embeddings[0], torch.zeros(6, 5), atol=0.1)


@pytest.mark.parametrize(("mean", "expected"), [("all", [2.0, 0.75]), ("mask", [3.2, 3.0])])
def test_masked_means_by_hand(mean: PartMean, expected: list[float]) -> None:
    x = torch.tensor([[[[1.0, 2.0], [4.0, 4.0]]]])
    first, second = [[0.0, 1.0], [0.75, 0.75]], [[0.0, 0.5], [0.0, 0.5]]  # sums with x 8 and 3, without 2.5 and 1
    found = masked_means(x, torch.tensor([[first, second]]), mean)
    assert torch.allclose(found[0, :, 0], torch.tensor(expected))


def test_an_empty_mask_gives_zeros() -> None:
    masks = torch.tensor([1.0, 0.0])[None, :, None, None].expand(1, 2, 3, 3)
    for mean in cast(tuple[PartMean, ...], ("all", "mask")):
        features = masked_means(torch.ones(1, 4, 3, 3), masks, mean)
        assert torch.equal(features[0], torch.tensor([[1.0], [0.0]]).expand(2, 4))


def test_soft_probabilities_are_those_of_the_columns() -> None:
    part = SoftPartition(2, 3, SoftPartitionOptions(), generator()).double()
    w = torch.tensor([[1.0, 0.0], [0.0, 2.0], [0.0, 0.0]], dtype=torch.float64)
    with torch.no_grad():
        part.classifier.weight.copy_(w[..., None, None])
    x = noise(1, 2, 4, 5)
    features, masks = part(x)
    assert masks is not None
    for v, u in ((0, 0), (3, 1), (2, 4)):
        column = x[0, :, v, u]
        powers = torch.exp(torch.stack([column[0], 2 * column[1], torch.zeros(()).double()]))
        assert torch.allclose(masks[0, :, v, u], powers / powers.sum())
    by_hand = sum(masks[0, :, v, u, None] * x[0, :, v, u] for v in range(4) for u in range(5)) / 20
    assert torch.allclose(features[0], cast(Tensor, by_hand))


def test_soft_parts_divide_regions_and_not_channels() -> None:
    """The parts add up to the mean over the map in every channel: no channel belongs to one part."""
    part = SoftPartition(6, 4, SoftPartitionOptions(), generator()).double()
    with torch.no_grad():
        part.classifier.weight.normal_(generator=generator(1))
    x = noise(2, 6, 5, 5)
    features, masks = part(x)
    assert masks is not None
    assert torch.allclose(features.sum(1), x.mean((2, 3)))
    assert masks.shape == (2, 4, 5, 5)
    assert bool((features.abs().amin((0, 1)) > 0).all())


def test_soft_partition_starts_near_equal_shares() -> None:
    part = SoftPartition(512, 4, SoftPartitionOptions(), generator())
    masks = part.probabilities(noise(2, 512, 8, 8).float().relu()).detach()
    assert float((masks - 0.25).abs().max()) < 0.05
    assert float(masks.std()) > 0


def test_the_heatmap_is_the_sum_over_the_channels() -> None:
    x = noise(2, 3, 4, 4)
    assert torch.allclose(heatmap(x)[:, 0], x[:, 0] + x[:, 1] + x[:, 2])


def test_heatmap_masks_by_hand() -> None:
    """With the first convolution the identity and the second (+h, -h, 0, 0): softmax of (h, -h, 0, 0)."""
    partition = HeatmapPartition(4, HeatmapOptions(hidden=1, kernel=1), generator()).double()
    with torch.no_grad():
        partition.first.weight.fill_(1.0)
        partition.second.weight.copy_(torch.tensor([1.0, -1.0, 0.0, 0.0])[:, None, None, None])
    x = noise(1, 3, 2, 2)
    features, masks = partition(x)
    h = x.sum(1)[0].clamp(min=0)
    powers = torch.stack([h.exp(), (-h).exp(), torch.ones_like(h), torch.ones_like(h)])
    assert torch.allclose(masks[0], powers / powers.sum(0))
    assert torch.allclose(features[0], torch.einsum("phw,chw->pc", powers / powers.sum(0), x[0]) / 4)


def test_the_mean_heat_is_the_sum_over_fewer() -> None:
    of_sum = HeatmapPartition(4, HeatmapOptions(heat="sum"), generator()).double()
    of_mean = HeatmapPartition(4, HeatmapOptions(heat="mean"), generator()).double()
    x = noise(1, 10, 6, 6)
    assert torch.allclose(of_mean.masks(10 * x), of_sum.masks(x))
    assert not torch.allclose(of_mean.masks(x), of_sum.masks(x))


def test_the_sum_over_many_channels_makes_first_masks_hard() -> None:
    """What the module says of the published definition."""
    x = noise(2, 2048, 16, 16).abs()
    hardness = {}
    for heat in ("sum", "mean"):
        partition = HeatmapPartition(4, options_from_dict(HeatmapOptions, {"heat": heat}), generator()).double()
        hardness[heat] = float(partition.masks(x).detach().amax(1).mean())
    assert hardness["sum"] > 0.99
    assert hardness["mean"] < 0.9


@pytest.mark.parametrize("mean", ["all", "mask"])
def test_derivatives_of_the_partitions(mean: PartMean) -> None:
    x = noise(2, 3, 4, 4).requires_grad_()
    soft = SoftPartition(3, 3, SoftPartitionOptions(mean), generator()).double()
    with torch.no_grad():
        soft.classifier.weight.normal_(generator=generator(2))
    masks = HeatmapPartition(3, HeatmapOptions(hidden=2, mean=mean), generator(3)).double()
    for partition in (soft, masks):
        weights = [parameter.requires_grad_() for parameter in partition.parameters()]
        assert gradcheck(lambda each, *_, partition=partition: partition(each), (x, *weights))
    for ring_mean in cast(tuple[RingMean, ...], ("square", "ring")):
        assert gradcheck(lambda each, ring_mean=ring_mean: Rings(2, ring_mean)(each).features, (x,))


def test_first_weights_depend_on_their_generator_alone() -> None:
    torch.manual_seed(1)
    state = torch.get_rng_state()
    for make in (
        lambda g: SoftPartition(4, 3, SoftPartitionOptions(), g),
        lambda g: HeatmapPartition(3, HeatmapOptions(), g),
    ):
        one, same, other = make(generator(5)), make(generator(5)), make(generator(6))
        assert all(torch.equal(a, b) for a, b in zip(one.parameters(), same.parameters(), strict=True))
        assert not torch.equal(next(one.parameters()), next(other.parameters()))
    assert torch.equal(state, torch.get_rng_state())


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"hidden": 0}, "hidden"),
        ({"kernel": 4}, "kernel"),
        ({"width": 4}, "width"),
    ],
)
def test_options_that_make_no_sense_are_named(values: dict[str, object], said: str) -> None:
    with refused(ConfigError, "", None, said):
        options_from_dict(HeatmapOptions, values)
