"""Feature maps between pixels: values, derivatives of the same map, borders, and the aligner's conventions."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from baselines.alignment.shared.pyramid import level_camera, with_gradients
from baselines.gn_net.sampling import level_coordinates, sample, sample_with_gradient
from relocbench.geometry import Camera


def noise(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def places(count: int, size: tuple[int, int], margin: float, seed: int = 1) -> Tensor:
    height, width = size
    extent = torch.tensor([width - 1 - 2 * margin, height - 1 - 2 * margin], dtype=torch.float64)
    return margin + noise(count, 2, seed=seed) * extent


def test_a_level_has_the_coordinates_of_the_aligners_pyramid() -> None:
    camera = Camera("pinhole", 100, 60, 50.0, 50.0, 41.7, 22.3)
    for level in range(4):
        there = level_camera(camera, level)
        centre = level_coordinates(torch.tensor([[camera.cx, camera.cy]], dtype=torch.float64), level)
        assert centre.tolist() == [pytest.approx([there.cx, there.cy])]


def test_values_are_the_maps_at_pixels_and_linear_between_them() -> None:
    features = torch.tensor([[[0.0, 1.0, 5.0], [2.0, 7.0, 11.0]]])
    u = torch.tensor([[0.0, 0.0], [2.0, 1.0], [1.0, 0.0], [0.5, 0.0], [0.0, 0.5], [0.25, 0.5], [1.75, 1.0]])
    values, valid = sample(features, u)
    # (0.25, 0.5): rows 0.25 and 2 + 0.25 * 5 = 3.25, their mean 1.75
    assert values[:, 0].tolist() == pytest.approx([0.0, 11.0, 1.0, 0.5, 1.0, 1.75, 10.0])
    assert valid.all()


def test_places_off_the_map_are_not_valid_and_stay_finite() -> None:
    features = noise(2, 6, 8)
    outside = [[-0.01, 1.0], [7.01, 1.0], [1.0, -0.01], [1.0, 5.01], [torch.nan, 1.0], [1.0, torch.inf], [1e9, -1e9]]
    values, valid = sample(features, torch.tensor(outside, dtype=torch.float64))
    assert not valid.any()
    assert values.isfinite().all()
    rim = torch.tensor(
        [[1.0, 1.0], [6.0, 4.0], [0.99, 2.0], [6.01, 2.0], [2.0, 0.99], [2.0, 4.01]], dtype=torch.float64
    )
    values, jacobian, valid = sample_with_gradient(features, rim)
    assert valid.tolist() == [True, True, False, False, False, False]
    assert values.isfinite().all()
    assert jacobian.isfinite().all()


def test_the_derivative_is_half_the_difference_of_values_one_pixel_to_either_side() -> None:
    features, u = noise(3, 9, 11), places(200, (9, 11), margin=1.0)
    values, jacobian, valid = sample_with_gradient(features, u)
    assert valid.all()
    assert torch.allclose(values, sample(features, u).values, atol=1e-14)
    for axis in range(2):
        step = torch.zeros(2, dtype=torch.float64)
        step[axis] = 1.0
        either = [sample(features, (u + sign * step).clamp(min=0)).values for sign in (1, -1)]
        assert torch.allclose(jacobian[..., axis], (either[0] - either[1]) / 2, atol=1e-12)


def test_values_and_derivatives_are_those_that_the_aligner_reads() -> None:
    features, u = noise(4, 12, 16), places(100, (12, 16), margin=1.0)
    level = with_gradients(features.permute(1, 2, 0).numpy().astype(np.float32))  # (H, W, 3 D)
    corner = np.minimum(np.floor(u.numpy()).astype(int), [14, 10])
    a, b = (u.numpy() - corner).T[..., None]
    x, y = corner.T
    upper = (1 - a) * level[y, x] + a * level[y, x + 1]
    lower = (1 - a) * level[y + 1, x] + a * level[y + 1, x + 1]
    wanted = (1 - b) * upper + b * lower
    values, jacobian, _ = sample_with_gradient(features, u)
    found = np.concatenate([values, jacobian[..., 0], jacobian[..., 1]], axis=1)
    assert np.allclose(found, wanted, atol=1e-6)


def test_images_of_a_batch_do_not_mix() -> None:
    features = noise(3, 2, 7, 9)
    u = torch.stack([places(20, (7, 9), margin=1.0, seed=s) for s in range(3)])
    together = sample_with_gradient(features, u)
    for b in range(3):
        alone = sample_with_gradient(features[b], u[b])
        for one, many in zip(alone, together, strict=True):
            torch.testing.assert_close(one, many[b], rtol=1e-12, atol=1e-12)


def test_derivatives_reach_the_map_and_the_places() -> None:
    features = noise(2, 5, 6).requires_grad_()
    u = places(7, (5, 6), margin=1.0).requires_grad_()
    assert torch.autograd.gradcheck(lambda f, p: sample_with_gradient(f, p)[:2], (features, u))
    assert torch.autograd.gradcheck(lambda f, p: sample(f, p).values, (features, u))


def test_half_precision_maps_are_read_in_single() -> None:
    features = noise(2, 6, 6).half()
    u = places(5, (6, 6), margin=1.0).float()
    values, jacobian, _ = sample_with_gradient(features, u)
    assert values.dtype == jacobian.dtype == torch.float32
    assert torch.allclose(values, sample(features.float(), u).values)


def test_a_map_without_room_for_a_derivative_is_refused() -> None:
    with pytest.raises(ValueError, match="4 x 4"):
        sample_with_gradient(noise(2, 3, 8), torch.ones(1, 2))
