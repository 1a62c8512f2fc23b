"""The pose network: its correlation layer, loss, options and weights file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from made_views import tiny_encoder
from refusals import refused

from baselines.lm_reloc.correlation import correlate, descriptors
from baselines.lm_reloc.loss import pose_loss
from baselines.lm_reloc.network import PoseNetwork
from baselines.lm_reloc.options import PoseNetOptions
from baselines.lm_reloc.weights import load_weights, read_card, save_weights
from baselines.options import options_from_dict
from relocbench.errors import ConfigError, MethodError

TINY = {"side": 32, "stage": 2, "descriptor": 8, "channels": [8, 8], "kernels": [1, 3], "hidden": 8,
        "encoder": {"widths": [4, 6, 8], "dim": 4, "levels": 2}}  # fmt: skip


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def tiny(**changed: Any) -> PoseNetOptions:
    return options_from_dict(PoseNetOptions, {**TINY, **changed})


def test_correlations_are_those_of_a_loop() -> None:
    first, second = random(2, 5, 3, 4), random(2, 5, 2, 3, seed=1)
    found = correlate(first, second)
    assert found.shape == (2, 6, 3, 4)
    for b in range(2):
        for y in range(3):
            for x in range(4):
                products = [max(float(first[b, :, y, x] @ second[b, :, v, u]), 0.0) for v in range(2) for u in range(3)]
                norm = max(sum(p * p for p in products) ** 0.5, 1e-12)
                assert np.allclose(found[b, :, y, x], np.array(products) / norm, atol=1e-6)


def test_descriptors_have_unit_norm_and_nothing_correlates_with_what_is_not_seen() -> None:
    seen = torch.tensor([[[True, False], [True, True]]])
    found = descriptors(7.0 * random(1, 5, 2, 2), seen)
    assert torch.allclose(found.norm(dim=1), seen.float())
    volume = correlate(found, descriptors(random(1, 5, 2, 2, seed=1), seen))
    assert not volume[:, 1].any()
    assert not volume[0, :, 0, 1].any()
    assert torch.isfinite(volume).all()


def test_a_place_finds_itself_best() -> None:
    maps = descriptors(random(1, 16, 4, 4), torch.ones(1, 4, 4, dtype=torch.bool))
    assert correlate(maps, maps).argmax(dim=1).flatten().tolist() == list(range(16))


def test_the_loss_is_the_papers_and_the_same_for_a_pair_and_its_inverse() -> None:
    predicted, true = random(4, 2, 6), random(4, 2, 6, seed=1)
    value = pose_loss(predicted, true, 0.3)
    angles, metres = (predicted - true)[..., :3], (predicted - true)[..., 3:]
    assert float(value.total) == pytest.approx(
        np.mean(
            [float(a.norm() + 0.3 * t.norm()) for a, t in zip(angles.flatten(0, 1), metres.flatten(0, 1), strict=True)]
        )
    )
    swapped = pose_loss(predicted.flip(1), true.flip(1), 0.3)
    assert torch.allclose(torch.stack(swapped), torch.stack(value))
    assert float(pose_loss(true, true, 0.3).total) == 0.0


def test_the_encoder_is_not_trained() -> None:
    net = PoseNetwork(tiny()).train()
    assert not net.encoder.training
    assert not any(parameter.requires_grad for parameter in net.encoder.parameters())
    maps = net.encode(torch.rand(2, 3, 32, 32))
    assert maps.shape == (2, 8, 4, 4)
    assert not maps.requires_grad


def test_inverse_depth_changes_predictions_only_where_it_is_an_input() -> None:
    seen = torch.ones(2, 4, 4, dtype=torch.bool)
    depths = torch.zeros(2, 2, 4, 4), torch.ones(2, 2, 4, 4)
    for depth in (False, True):
        net = PoseNetwork(tiny(depth=depth)).eval()
        described = net.describe(random(2, 8, 4, 4), seen)
        without, with_it = (net(described, described.flip(0), each) for each in depths)
        assert torch.equal(without, with_it) is not depth


def test_folded_normalisation_predicts_the_same() -> None:
    net = PoseNetwork(tiny())
    images, seen, depth = torch.rand(2, 3, 32, 32), torch.ones(2, 4, 4, dtype=torch.bool), torch.zeros(2, 2, 4, 4)
    for module in net.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            module.running_mean.uniform_(-0.1, 0.1, generator=torch.Generator().manual_seed(1))  # type: ignore[union-attr]
    net.eval()
    found = []
    for each in (net, net.for_tracking()):
        described = each.describe(each.encode(images), seen)
        found.append(each(described, described.flip(0), depth).detach())
    assert torch.allclose(found[0], found[1], atol=1e-5)
    assert net.options.least_parameters <= net.parameters_count


@pytest.mark.parametrize(
    ("changed", "names"),
    [
        ({"side": 30}, ("side", 30, 8, 1024)),
        ({"stage": 3}, ("stage", 3, 0, 2)),
        ({"kernels": [1, 4]}, ("kernels", "[1, 4]", "channels", 15)),
        ({"kernels": [1]}, ("kernels", "[1]", "channels")),
        ({"kernels": [3, 5]}, ("kernels", "[3, 5]", 4, 3)),
        ({"channels": []}, ("channels", 1, 12)),
        ({"focal": 0}, ("focal", 0)),
        ({"hidden": 10**9}, ("hidden", 1000000000, 4096)),
    ],
)
def test_a_shape_that_no_network_has_is_refused_by_name(changed: dict[str, Any], names: tuple[object, ...]) -> None:
    with refused(ConfigError, "", None, *names) as caught:
        tiny(**changed)
    assert "\n" not in str(caught.value)


def test_weights_come_back_and_equal_ones_are_equal_bytes(tmp_path: Path) -> None:
    net = PoseNetwork(tiny(depth=True), torch.Generator().manual_seed(3))
    for name in ("a", "b"):
        save_weights(tmp_path / f"{name}.safetensors", net, {"seed": "3"})
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()
    back = load_weights(tmp_path / "a.safetensors")
    assert back.options == net.options
    assert all(torch.equal(value, back.state_dict()[name]) for name, value in net.state_dict().items())
    assert read_card(tmp_path / "a.safetensors") == {"seed": "3"}


def test_weights_of_another_kind_are_one_line(tmp_path: Path) -> None:
    path = tiny_encoder(tmp_path)
    with pytest.raises(MethodError) as caught:
        load_weights(path)
    assert (
        str(caught.value) == f"{path}: a safetensors file, but not weights of pose-net (no 'pose-net' in its metadata)"
    )
