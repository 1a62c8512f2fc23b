"""The feature network: where its features sit, sizes, determinism, options, and its weights on disk."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from refusals import refused
from torch import Tensor, nn

from baselines.gn_net.network import FeatureNet, image_tensor
from baselines.gn_net.options import NetworkOptions
from baselines.gn_net.sampling import level_coordinates
from baselines.gn_net.weights import load_weights, read_card, save_weights
from baselines.options import options_from_dict
from relocbench.errors import ConfigError, MethodError

SMALL = NetworkOptions(widths=(4, 6, 8), finest=0, dim=3, levels=3)
HALF = replace(SMALL, finest=1)
"""its finest map has half the image's resolution"""
EACH = pytest.mark.parametrize("options", [SMALL, HALF], ids=["full", "half"])


def image(height: int, width: int, batch: int = 1, seed: int = 0) -> Tensor:
    return torch.rand((batch, 3, height, width), generator=torch.Generator().manual_seed(seed))


def first_convolution(net: FeatureNet) -> nn.Conv2d:
    return next(module for module in net.modules() if isinstance(module, nn.Conv2d))


def lived_in(options: NetworkOptions) -> FeatureNet:
    """A network whose batch normalisation has seen images, as a trained one has."""
    net = FeatureNet(options)
    with torch.no_grad():
        for seed in range(3):
            net(image(32, 32, batch=2, seed=seed))
    return net.eval()


@EACH
def test_each_level_holds_the_whole_pixels_of_its_size(options: NetworkOptions) -> None:
    net = FeatureNet(options).eval()
    for height, width in ((32, 48), (37, 50), (33, 31), (8, 9)):
        maps = net(image(height, width, batch=2))
        levels = range(options.finest, options.finest + 3)
        assert [tuple(m.shape) for m in maps] == [(2, 3, height >> level, width >> level) for level in levels]


@EACH
def test_padding_repeats_the_border_and_leaves_the_rest_where_it_was(options: NetworkOptions) -> None:
    net, odd = lived_in(options), image(37, 50)
    by_hand = nn.functional.pad(odd, (0, -50 % options.stride, 0, -37 % options.stride), mode="replicate")
    for padded, cropped in zip(net(by_hand), net(odd), strict=True):
        assert torch.equal(padded[..., : cropped.shape[-2], : cropped.shape[-1]], cropped)


@EACH
@torch.no_grad()
def test_a_feature_sits_at_its_pixel_on_every_level(options: NetworkOptions) -> None:
    """With symmetric filters of positive weights the network is linear and keeps a ramp: F_l(x) = a u(x) + c.

    u(x) is the ramp at the place of pixel x of level l in the image. Half a pixel of shift anywhere would be seen.
    """
    net = FeatureNet(replace(options, norm="none"))
    for module in net.modules():
        if isinstance(module, nn.Conv2d):
            weight = module.weight.abs()
            module.weight.copy_(weight + weight.flip(-1) + weight.flip(-2) + weight.flip(-1, -2))
    first = first_convolution(net).weight
    of_square = first.unflatten(1, (3, -1))  # (outputs, RGB, pixels of the square, 3, 3)
    first.copy_(of_square.mean(2, keepdim=True).expand_as(of_square).flatten(1, 2))
    net.double()
    u = torch.arange(128, dtype=torch.float64)
    ramp = (2.0 + u / 128).expand(1, 3, 128, 128)  # well above the mean that is taken off: no ReLU cuts
    for image_ramp, along in ((ramp, -1), (ramp.transpose(-1, -2), -2)):
        at_zero, at_one = (net(torch.full_like(ramp, value)) for value in (2.0, 3.0))
        for number, features in enumerate(net(image_ramp)):
            level = options.finest + number
            zero, one = (maps[number][0, :, 64 >> level, 64 >> level] for maps in (at_zero, at_one))
            middle = features[0, :, 64 >> level].T if along == -1 else features[0, :, :, 64 >> level].T
            found = 128 * (middle - zero) / (one - zero)  # (pixels of the level, D), pixels of the image
            inside = slice(56 >> level, 72 >> level)  # far from the border, where zeros come in
            pixels = torch.arange(128 >> level, dtype=torch.float64)[inside, None]
            assert torch.allclose(level_coordinates(found[inside], level), pixels.expand(-1, 3), atol=1e-9)


@EACH
@torch.no_grad()
def test_a_mirrored_image_gives_mirrored_features_when_filters_are_mirrored(options: NetworkOptions) -> None:
    net = lived_in(options)
    mirrored = FeatureNet(options)
    mirrored.load_state_dict(net.state_dict())
    mirrored.eval()
    for module in mirrored.modules():
        if isinstance(module, nn.Conv2d):
            module.weight.copy_(module.weight.flip(-1))
    first, square = first_convolution(mirrored).weight, 1 << options.finest
    first.copy_(first.unflatten(1, (3, square, square)).flip(3).flatten(1, 3))
    pixels = image(32, 48)
    for there, back in zip(net(pixels), mirrored(pixels.flip(-1)), strict=True):
        assert torch.allclose(there, back.flip(-1), atol=1e-4)


@EACH
@torch.no_grad()
def test_an_image_moved_by_the_stride_moves_its_features(options: NetworkOptions) -> None:
    scale = 1 << options.finest
    net, wide, stride = lived_in(options), image(64 * scale, 160 * scale), options.stride
    left, right = net(wide[..., :-stride]), net(wide[..., stride:])
    for level, (here, there) in enumerate(zip(left, right, strict=True), start=options.finest):
        step, inside = stride >> level, (40 * scale) >> level
        assert torch.allclose(here[..., inside + step : -inside], there[..., inside : -inside - step], atol=1e-4)
        assert not torch.allclose(here[..., inside:-inside], there[..., inside:-inside], atol=1e-3)


@torch.no_grad()
def test_the_copy_for_tracking_gives_the_same_features() -> None:
    net, pixels = lived_in(SMALL), image(32, 48)
    tracking = net.for_tracking()
    assert not any(isinstance(module, nn.BatchNorm2d) for module in tracking.modules())
    assert any(isinstance(module, nn.BatchNorm2d) for module in net.modules())
    for slow, fast in zip(net(pixels), tracking(pixels), strict=True):
        assert torch.allclose(slow, fast, atol=1e-4)


@torch.no_grad()
def test_unit_features_are_the_plain_ones_with_norm_one() -> None:
    plain = NetworkOptions(widths=(4, 6), finest=0, dim=4, levels=2)
    raw, unit = (FeatureNet(options).eval()(image(16, 16)) for options in (plain, replace(plain, normalise="unit")))
    for there, here in zip(raw, unit, strict=True):
        norms = there.norm(dim=1, keepdim=True)
        assert (norms > 0).float().mean() > 0.8
        assert torch.allclose(here.norm(dim=1, keepdim=True), (norms > 0).float(), atol=1e-4)
        assert torch.allclose(here * norms, there, atol=1e-4)


@torch.no_grad()
def test_confidences_come_beside_the_same_features() -> None:
    with_them = FeatureNet(replace(SMALL, confidence=True)).eval()
    plain, pixels = FeatureNet(SMALL).eval(), image(33, 50)
    plain.load_state_dict({k: v for k, v in with_them.state_dict().items() if not k.startswith("confidences")})
    features, confidences = with_them.with_confidences(pixels)
    assert plain.with_confidences(pixels)[1] == ()
    for one, other, confidence in zip(features, plain(pixels), confidences, strict=True):
        assert torch.equal(one, other)
        assert confidence.shape == (1, 1, *one.shape[-2:])
        assert bool((confidence == 0.5).all())
    for head, bias in zip(with_them.confidences, (-300.0, 300.0, 0.0), strict=False):
        head.bias.fill_(bias)  # type: ignore[operator]
    assert all(bool(((each > 0) & (each <= 1)).all()) for each in with_them.with_confidences(pixels)[1])
    fast = with_them.for_tracking().with_confidences(pixels)[1]
    assert all(map(torch.allclose, fast, with_them.with_confidences(pixels)[1]))


def test_first_weights_depend_on_their_generator_alone() -> None:
    torch.manual_seed(1)
    state = torch.get_rng_state()
    one, other = FeatureNet(SMALL), FeatureNet(SMALL, torch.Generator().manual_seed(0))
    assert torch.equal(state, torch.get_rng_state())
    different = FeatureNet(SMALL, torch.Generator().manual_seed(1))
    assert all(torch.equal(a, b) for a, b in zip(one.parameters(), other.parameters(), strict=True))
    assert not torch.equal(one.heads[0].weight, different.heads[0].weight)  # type: ignore[arg-type]


def test_first_features_are_neither_nothing_nor_huge() -> None:
    for features in FeatureNet().requires_grad_(False)(image(64, 64, batch=2)):
        assert 0.2 < float(features.norm(dim=1).mean()) < 5.0


def test_the_default_network_is_small() -> None:
    net = FeatureNet()
    assert net.parameters_count == sum(p.numel() for p in net.parameters())
    assert net.parameters_count * 4 < 4e6  # bytes of float32


LITE = NetworkOptions(encoder="efficientnet-lite0", widths=(4, 6, 8), dim=3, levels=3)


def test_efficientnets_stages_are_an_encoder(tmp_path: Path) -> None:
    net = lived_in(LITE)
    assert LITE.least_parameters <= net.parameters_count
    for height, width in ((32, 48), (37, 50), (8, 9)):
        assert [tuple(m.shape) for m in net(image(height, width))] == [
            (1, 3, height >> k, width >> k) for k in (1, 2, 3)
        ]
    with torch.no_grad():
        for whole, folded in zip(net(image(64, 64)), net.for_tracking()(image(64, 64)), strict=True):
            assert torch.allclose(whole, folded, rtol=1e-3, atol=1e-3 * float(whole.abs().max()))
    save_weights(tmp_path / "net.safetensors", net, {})
    again = load_weights(tmp_path / "net.safetensors")
    assert again.options == LITE
    assert all(torch.equal(a, b) for a, b in zip(again(image(32, 32)), net(image(32, 32)), strict=True))


@pytest.mark.parametrize(
    ("changed", "names"),
    [
        ({"finest": 0}, ("finest", 0, 1)),
        ({"norm": "none"}, ("norm", "none", "batch")),
        ({"widths": (4,) * 6}, ("widths", 5)),
    ],
)
def test_what_efficientnet_cannot_be_is_refused(changed: dict[str, object], names: tuple[object, ...]) -> None:
    with refused(ConfigError, "", None, *names):
        options_from_dict(NetworkOptions, {**asdict(LITE), **changed})


def test_grey_images_are_repeated_and_pixels_scaled_to_one() -> None:
    net = FeatureNet(SMALL).eval()
    grey = np.arange(64, dtype=np.uint8).reshape(8, 8) * 4
    assert image_tensor(grey).shape == (1, 1, 8, 8)
    colour = image_tensor(np.repeat(grey[..., None], 3, axis=2))
    assert colour.shape == (1, 3, 8, 8)
    assert float(image_tensor(np.full((2, 2), 255, np.uint8)).max()) == 1.0
    assert torch.equal(net(image_tensor(grey))[0], net(colour)[0])


@pytest.mark.parametrize("shape", [(1, 2, 32, 32), (3, 32, 32), (1, 3, 3, 32)])
def test_what_is_no_image_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="images"):
        FeatureNet(SMALL)(torch.zeros(shape))


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"widths": []}, "widths"),
        ({"widths": [4, 0]}, "widths"),
        ({"dim": 1}, "dim"),
        ({"levels": 6}, "levels"),
        ({"levels": 0}, "levels"),
        ({"levels": "many"}, "levels"),
        ({"depth": 3}, "depth"),
    ],
)
def test_options_that_make_no_sense_are_named(values: dict[str, object], said: str) -> None:
    with refused(ConfigError, "", None, said):
        options_from_dict(NetworkOptions, values)


@torch.no_grad()
def test_weights_come_back_as_they_were_with_options_and_card(tmp_path: Path) -> None:
    net, card = lived_in(SMALL), {"data": "none", "seed": "0"}
    path = tmp_path / "deep" / "net.safetensors"
    save_weights(path, net, card)
    again = load_weights(path)
    assert again.options == SMALL
    assert read_card(path) == card
    assert not again.training
    pixels = image(32, 48)
    assert all(torch.equal(a, b) for a, b in zip(net(pixels), again(pixels), strict=True))
    assert [file.name for file in path.parent.iterdir()] == ["net.safetensors"]


@pytest.mark.thorough
def test_the_same_weights_are_the_same_bytes_in_another_process_without_open3d(tmp_path: Path) -> None:
    script = (
        "import sys, pathlib; from baselines.gn_net.network import FeatureNet;"
        "from baselines.gn_net.options import NetworkOptions; from baselines.gn_net.weights import save_weights;"
        "save_weights(pathlib.Path(sys.argv[1]), FeatureNet(NetworkOptions((4, 6, 8), 0, 3, 3)), {'b': '1', 'a': '2'});"
        "sys.exit('open3d' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", script, str(tmp_path / "there.safetensors")], check=True)
    save_weights(tmp_path / "here.safetensors", FeatureNet(SMALL), {"a": "2", "b": "1"})
    assert (tmp_path / "here.safetensors").read_bytes() == (tmp_path / "there.safetensors").read_bytes()


@pytest.mark.parametrize(
    "damage", ["cut", "short", "empty", "text", "missing", "other", "version", "shape", "nan", "less"]
)
def test_a_file_that_is_not_these_weights_is_one_line_with_its_path(tmp_path: Path, damage: str) -> None:
    from safetensors.torch import load_file, save_file

    path = tmp_path / "net.safetensors"
    net = FeatureNet(SMALL)
    save_weights(path, net, {})
    whole = path.read_bytes()
    about = {"gn-net": json.dumps({"version": 1, "options": asdict(SMALL), "card": {}})}
    tensors = load_file(path)
    if damage in ("cut", "short", "empty", "text"):
        bad = {"cut": whole[:-5], "short": whole[:100], "empty": b"", "text": b"weights\n" * 40}[damage]
        path.write_bytes(bad)
    elif damage == "missing":
        path.unlink()
    elif damage == "other":
        save_file(tensors, path)
    elif damage == "version":
        save_file(tensors, path, {"gn-net": json.dumps({"version": 2})})
    elif damage == "shape":
        save_file({**tensors, "heads.0.bias": torch.zeros(5)}, path, about)
    elif damage == "nan":
        save_file({**tensors, "heads.0.bias": torch.full((3,), torch.nan)}, path, about)
    else:
        save_file({name: value for name, value in tensors.items() if name != "heads.0.bias"}, path, about)
    with pytest.raises(MethodError) as caught:
        load_weights(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_a_card_is_text(tmp_path: Path) -> None:
    with refused(MethodError, "", None, "seed"):
        save_weights(tmp_path / "net.safetensors", FeatureNet(SMALL), {"seed": 3})  # type: ignore[dict-item]
    assert not list(tmp_path.iterdir())
