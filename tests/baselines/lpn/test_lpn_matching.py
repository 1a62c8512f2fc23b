"""Descriptors and their dot product; aligned parts against every path there is."""

from __future__ import annotations

import math
from itertools import combinations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.autograd import gradcheck
from torch.nn import functional

from baselines.lpn.descriptor import descriptors, over_symmetries, parts_of, unit_parts
from baselines.lpn.dmli import aligned_distance, part_distances, shortest_path


def noise(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def cheapest_of_all_paths(d: Tensor) -> float:
    """Every way from the first to the last cell that steps right or down, one by one."""
    rows, columns = d.shape
    costs = []
    for downs in combinations(range(rows + columns - 2), rows - 1):
        i = j = 0
        cost = float(d[0, 0])
        for step in range(rows + columns - 2):
            i, j = (i + 1, j) if step in downs else (i, j + 1)
            cost += float(d[i, j])
        costs.append(cost)
    assert len(costs) == math.comb(rows + columns - 2, rows - 1)
    return min(costs)


@given(st.integers(1, 6), st.integers(1, 9), st.integers(0, 2**16))
@settings(max_examples=50, deadline=None)
def test_a_dot_product_is_the_mean_of_the_parts_cosines(parts: int, size: int, seed: int) -> None:
    f, g = 5 * noise(3, parts, size, seed=seed), noise(4, parts, size, seed=seed + 1)
    cosines = functional.cosine_similarity(f[:, None], g[None], dim=-1)  # (3, 4, P)
    assert torch.allclose(descriptors(f) @ descriptors(g).T, cosines.mean(-1))
    assert torch.allclose(descriptors(f).norm(dim=-1), torch.ones(3, dtype=torch.float64))


def test_a_descriptor_by_hand() -> None:
    embeddings = torch.tensor([[3.0, 4.0], [0.0, 2.0], [0.0, 0.0], [-1.0, 0.0]])
    assert torch.allclose(descriptors(embeddings), torch.tensor([0.6, 0.8, 0.0, 1.0, 0.0, 0.0, -1.0, 0.0]) / 2)


def test_a_descriptors_parts_are_the_embeddings_of_unit_norm() -> None:
    f = noise(3, 4, 5)
    assert torch.allclose(parts_of(descriptors(f), 4), unit_parts(f))
    for parts in (3, 0):
        with pytest.raises(ValueError, match="consist"):
            parts_of(descriptors(f), parts)


def test_a_parts_length_does_not_count() -> None:
    f = noise(2, 4, 5)
    longer = f * torch.tensor([1.0, 10.0, 0.1, 3.0], dtype=torch.float64)[:, None]
    assert torch.allclose(descriptors(f), descriptors(longer))


def test_the_mirror_images_embedding_is_added() -> None:
    images = noise(2, 3, 4, 5)
    weights = noise(3, 4, 5, seed=1)

    def embed(x: Tensor) -> Tensor:
        return (x * weights).sum((1, 2, 3))

    by_hand = (images * weights).sum((1, 2, 3)) + (images.flip(3) * weights).sum((1, 2, 3))
    assert torch.allclose(over_symmetries(embed, images), by_hand)
    assert torch.allclose(over_symmetries(embed, images.flip(3)), by_hand)


def test_derivatives_of_descriptors() -> None:
    assert gradcheck(descriptors, (noise(2, 3, 4).requires_grad_(),))
    embeddings = noise(2, 3, 4)
    embeddings[0, 1] = 0
    descriptors(embeddings.requires_grad_()).sum().backward()
    assert embeddings.grad is not None
    assert bool(embeddings.grad[1].isfinite().all())


def test_distances_of_parts_by_hand() -> None:
    f, g = torch.tensor([[0.0, 0.0], [3.0, 4.0]]), torch.tensor([[0.0, 0.0], [0.0, 1.0]])
    expected = torch.tensor([[0.0, math.tanh(0.5)], [math.tanh(2.5), math.tanh(0.5 * math.sqrt(18.0))]])
    assert torch.allclose(part_distances(f, g), expected)
    d = torch.tensor([0.5, 2.0])  # the form of the paper: (e^x - 1) / (e^x + 1)
    assert torch.allclose(torch.tanh(d / 2), (d.exp() - 1) / (d.exp() + 1))


def test_a_path_by_hand() -> None:
    d = torch.tensor([[1.0, 9.0, 1.0], [1.0, 1.0, 9.0], [5.0, 1.0, 2.0]])
    assert float(shortest_path(d)) == 6.0  # down, right, down, right
    assert float(shortest_path(torch.eye(2))) == 2.0
    assert float(shortest_path(torch.tensor([[0.25]]))) == 0.25


@given(st.integers(1, 5), st.integers(1, 5), st.integers(0, 2**16))
@settings(max_examples=50, deadline=None)
def test_the_shortest_path_is_the_cheapest_of_all(rows: int, columns: int, seed: int) -> None:
    d = torch.rand((2, 3, rows, columns), generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    found = shortest_path(d)
    assert found.shape == (2, 3)
    for b in range(2):
        for c in range(3):
            assert float(found[b, c]) == pytest.approx(cheapest_of_all_paths(d[b, c]), rel=1e-12)


def test_aligned_distances_of_a_batch_are_those_of_its_pairs() -> None:
    f, g = noise(5, 4, 6), noise(7, 4, 6, seed=1)
    all_pairs = aligned_distance(f[:, None], g[None])
    assert all_pairs.shape == (5, 7)
    for i, j in ((0, 0), (4, 2), (3, 6)):
        one = torch.tensor([[math.tanh(float((a - b).norm()) / 2) for b in g[j]] for a in f[i]])
        assert float(all_pairs[i, j]) == pytest.approx(cheapest_of_all_paths(one), rel=1e-6)
    assert torch.allclose(all_pairs, aligned_distance(g[None], f[:, None]))


def test_equal_images_pay_for_the_steps_beside_the_diagonal() -> None:
    same = noise(1, 6).expand(4, 6)
    assert float(aligned_distance(same, same)) == 0.0
    f = noise(4, 6)
    beside = min(cheapest_of_all_paths(part_distances(f, f)), 7.0)
    assert float(aligned_distance(f, f)) == pytest.approx(beside)
    assert beside > 0


def test_parts_that_slid_by_one_are_nearer_aligned_than_cell_by_cell() -> None:
    f = noise(4, 16)
    slid = torch.stack([f[0], f[0], f[1], f[2]])
    other = noise(4, 16, seed=1)
    assert float(aligned_distance(f, slid)) < float(aligned_distance(f, other))
    straight = float(part_distances(f, slid).diagonal().sum())
    assert float(aligned_distance(f, slid)) < straight + 1.0


def test_derivatives_of_aligned_distances() -> None:
    f, g = noise(2, 4, 3).requires_grad_(), noise(2, 4, 3, seed=1).requires_grad_()
    assert gradcheck(aligned_distance, (f, g))
    same = noise(4, 3).requires_grad_()
    aligned_distance(same, same.detach()).backward()
    assert same.grad is not None
    assert bool(same.grad.isfinite().all())
