"""CosPlace, NetVLAD and MegaLoc with weights that nobody trained, against their formulas written again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
import torchvision  # type: ignore[import-untyped]
from drawn_places import (
    CLUSTERS,
    NETVLAD,
    VIT,
    State,
    described,
    gem_state,
    made,
    megaloc_state,
    netvlad_state,
    pattern,
    saved,
)
from numpy.typing import NDArray
from torch import Tensor, nn

from baselines.place_networks import CosPlace, NetVlad
from baselines.place_networks.backbone import Backbone, BackboneName
from baselines.place_networks.dinov2 import DinoV2, VitShape
from baselines.place_networks.megaloc import MegaLocNetwork, assignment
from relocbench.arrays import Array, Image


def normalised(image: Image) -> Tensor:
    """ImageNet's normalisation by hand: (1, 3, H, W)."""
    values = (image / 255.0 - [0.485, 0.456, 0.406]) / [0.229, 0.224, 0.225]
    return torch.tensor(values.transpose(2, 0, 1)[None], dtype=torch.float32)


def unit(vector: NDArray[np.floating]) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))


RESNET = ("conv1", "bn1", "relu", "maxpool", "layer1", "layer2", "layer3", "layer4")


@torch.inference_mode()
def map_by_hand(name: BackboneName, state: State, prefix: str, image: Image, stages: int = 4) -> Array:
    """The map (C, H, W) of torchvision's whole network, each of its layers called by its name."""
    own = {key.removeprefix(f"{prefix}."): value for key, value in state.items() if key.startswith(f"{prefix}.")}
    whole = getattr(torchvision.models, name.lower())(weights=None)
    x = normalised(image)
    if name == "VGG16":
        whole.features.load_state_dict(own, strict=True)
        for layer in whole.eval().features[:29]:
            x = layer(x)
    else:
        renamed = {".".join([RESNET[int(key.split(".")[0])], *key.split(".")[1:]]): v for key, v in own.items()}
        whole.load_state_dict({**whole.state_dict(), **renamed})
        whole.eval()
        for layer in RESNET[: 4 + stages]:
            x = getattr(whole, layer)(x)
    return np.asarray(x[0].double().numpy())


@pytest.mark.parametrize(
    "name", ["ResNet18", *(pytest.param(name, marks=pytest.mark.thorough) for name in ("ResNet50", "VGG16"))]
)
def test_cosplace_is_a_backbone_a_generalised_mean_and_a_linear_layer(tmp_path: Path, name: BackboneName) -> None:
    state = gem_state(name, 24)
    retriever = CosPlace(weights=saved(state, tmp_path / "a.pth"))
    image = pattern(64, 96)
    x = map_by_hand(name, state, "backbone", image)
    x /= np.linalg.norm(x, axis=0)
    p = float(state["aggregation.1.p"])
    pooled = np.mean(np.maximum(x, 1e-6) ** p, axis=(1, 2)) ** (1 / p)
    weight, bias = (state[f"aggregation.3.{part}"].double().numpy() for part in ("weight", "bias"))
    np.testing.assert_allclose(described(retriever, image)[0], unit(weight @ pooled + bias), atol=2e-5)
    assert retriever.info == {"backbone": name, "dimensions": 24, "image_size": "unchanged"}


def netvlad_by_hand(x: Array, state: State, pool: str) -> Array:
    """The formula as a loop over pixels and clusters."""
    weight = state[f"{pool}.conv.weight"].double().numpy()[:, :, 0, 0]
    bias = state[f"{pool}.conv.bias"].double().numpy() if f"{pool}.conv.bias" in state else np.zeros(len(weight))
    centres = state[f"{pool}.centroids"].double().numpy()
    v = np.zeros_like(centres)
    for local in x.reshape(len(x), -1).T:
        local = unit(local)
        scores = np.exp(weight @ local + bias)
        for k, centre in enumerate(centres):
            v[k] += scores[k] / scores.sum() * (local - centre)
    return unit(np.concatenate([unit(row) for row in v]))


@pytest.mark.parametrize(
    ("backbone", "bias", "whitened", "layout"),
    [
        pytest.param(Backbone("VGG16"), False, 20, NETVLAD, marks=pytest.mark.thorough),
        (Backbone("ResNet18", 3), True, None, ("backbone", "aggregation")),
        (Backbone("ResNet18"), False, None, NETVLAD),
    ],
)
def test_netvlad_sums_residuals_to_soft_assigned_centres(
    tmp_path: Path, backbone: Backbone, bias: bool, whitened: int | None, layout: tuple[str, str]
) -> None:
    state = netvlad_state(backbone, bias, whitened, layout)
    state[f"{layout[1]}.conv.weight"] *= 20.0  # undecided between clusters, all would have the same share
    retriever = NetVlad(weights=saved(state, tmp_path / "a.pth"), size=None)
    image = pattern(48, 80)
    expected = netvlad_by_hand(map_by_hand(backbone.name, state, layout[0], image, backbone.stages), state, layout[1])
    if whitened is not None:
        weight, shift = (state[f"WPCA.0.{part}"].double().numpy() for part in ("weight", "bias"))
        expected = unit(weight[:, :, 0, 0] @ expected + shift)
    np.testing.assert_allclose(described(retriever, image)[0], expected, atol=2e-5)
    assert retriever.info["dimensions"] == (whitened or 5 * backbone.channels)


def encoder_by_torch(state: State, number: int) -> nn.TransformerEncoderLayer:
    """A block as torch's own layer; the scale of each channel goes into the linear layer in front of it."""
    own = {
        name.removeprefix(f"backbone.blocks.{number}."): v for name, v in state.items() if f"blocks.{number}." in name
    }
    layer = nn.TransformerEncoderLayer(
        VIT.channels, VIT.channels // 64, VIT.hidden, 0.0, "gelu", 1e-6, batch_first=True, norm_first=True
    )
    one, two = own["ls1.gamma"], own["ls2.gamma"]
    layer.load_state_dict(
        {
            "self_attn.in_proj_weight": own["attn.qkv.weight"],
            "self_attn.in_proj_bias": own["attn.qkv.bias"],
            "self_attn.out_proj.weight": one[:, None] * own["attn.proj.weight"],
            "self_attn.out_proj.bias": one * own["attn.proj.bias"],
            "linear1.weight": own["mlp.fc1.weight"],
            "linear1.bias": own["mlp.fc1.bias"],
            "linear2.weight": two[:, None] * own["mlp.fc2.weight"],
            "linear2.bias": two * own["mlp.fc2.bias"],
            **{f"norm{k}.{part}": own[f"norm{k}.{part}"] for k in (1, 2) for part in ("weight", "bias")},
        }
    )
    return layer.eval()


def salad_by_hand(token: Array, patches: Array, state: State) -> Array:
    """SALAD of a class token (C,) and patches (n, C): Sinkhorn's iterations as divisions of a matrix, then loops."""

    def layer(name: str, x: Array) -> Array:
        weight = state[f"aggregator.agg.{name}.weight"].double().numpy()
        return np.asarray(x @ weight.reshape(len(weight), -1).T + state[f"aggregator.agg.{name}.bias"].double().numpy())

    def mlp(name: str, last: int, x: Array) -> Array:
        return layer(f"{name}.{last}", np.maximum(layer(f"{name}.0", x), 0.0))

    scores = mlp("score", 3, patches).T
    q = np.exp(np.vstack([scores, np.full(len(patches), float(state["aggregator.agg.dust_bin"]))]))
    mass = np.array([1.0] * CLUSTERS + [len(patches) - CLUSTERS])
    for _ in range(3):
        q *= (mass / q.sum(axis=1))[:, None]
        q /= q.sum(axis=0)
    features = mlp("cluster_features", 3, patches)
    v = [unit(sum(q[k, j] * features[j] for j in range(len(patches)))) for k in range(CLUSTERS)]
    joined = unit(np.concatenate([unit(mlp("token_features", 2, token)), np.array(v).T.ravel()]))
    weight, bias = (state[f"aggregator.linear.{part}"].double().numpy() for part in ("weight", "bias"))
    return unit(weight @ joined + bias)


@torch.inference_mode()
def test_megaloc_is_a_vision_transformer_and_optimal_transport(drawn: Callable[[str], Path]) -> None:
    state = megaloc_state()
    image = pattern(70, 70)
    weight, bias = (state[f"backbone.patch_embed.proj.{part}"] for part in ("weight", "bias"))
    cut = normalised(image).unfold(2, 14, 14).unfold(3, 14, 14)  # (1, 3, 5, 5, 14, 14)
    patches = cut.permute(0, 2, 3, 1, 4, 5).reshape(25, -1) @ weight.reshape(VIT.channels, -1).T + bias
    x = torch.cat([state["backbone.cls_token"][0], patches])[None] + state["backbone.pos_embed"]
    for number in range(VIT.blocks):
        x = encoder_by_torch(state, number)(x)
    ends = (state["backbone.norm.weight"], state["backbone.norm.bias"])
    tokens = nn.functional.layer_norm(x[0], (VIT.channels,), *ends, eps=1e-6).double().numpy()
    retriever = made("megaloc", drawn("megaloc"))
    np.testing.assert_allclose(described(retriever, image)[0], salad_by_hand(tokens[0], tokens[1:], state), atol=2e-5)


def test_megaloc_is_as_large_as_is_published() -> None:
    """228.6 million numbers, as those who ported the authors' file to another framework count them."""
    with torch.device("meta"):
        network = MegaLocNetwork(VitShape(768, 3072, 12, 14, 37), 512, 64, 256, 256, 8448)
    assert round(sum(value.numel() for value in network.state_dict().values()) / 1e6, 1) == 228.6


def cubic_ramp(at: Array) -> Array:
    """The ramp 0, 1, 2, ... by cubic convolution (Keys 1981) with torch's a = -0.75, which is not exact for ramps."""
    a, whole = -0.75, np.floor(at)
    t = at - whole

    def weight(x: Array) -> Array:
        near = (a + 2) * x**3 - (a + 3) * x**2 + 1
        return np.where(x <= 1, near, a * x**3 - 5 * a * x**2 + 8 * a * x - 4 * a)

    return np.asarray(whole - weight(1 + t) + weight(1 - t) + 2 * weight(2 - t))


def test_positions_are_read_between_those_of_the_learnt_grid() -> None:
    """A ramp along rows and one along columns are interpolated, and must not be exchanged."""
    shape = VitShape(64, 8, 1, 14, 12)
    network = DinoV2(shape)
    row, column = torch.meshgrid(torch.arange(12.0), torch.arange(12.0), indexing="ij")
    ramps = torch.zeros(1, 145, 64)
    ramps[0, 1:, 0], ramps[0, 1:, 1] = row.flatten(), column.flatten()
    ramps[0, 0] = 5.0
    network.load_state_dict({**network.state_dict(), "pos_embed": ramps})
    rows, columns = 8, 17
    found = network.positions(rows, columns).detach()
    assert found.shape == (1, 1 + rows * columns, 64)
    assert bool((found[0, 0] == 5.0).all()), "the class token's is not interpolated"
    for channel, (axis, count) in enumerate((("row", rows), ("column", columns))):
        values = found[0, 1:, channel].reshape(rows, columns).numpy()
        along = values.mean(axis=1) if axis == "row" else values.mean(axis=0)
        assert np.allclose(values, along[:, None] if axis == "row" else along[None])
        at = np.asarray((np.arange(count) + 0.5) * 12 / (count + 0.1) - 0.5, dtype=np.float64)
        inside = (at > 1) & (at < 10)
        expected = torch.from_numpy(cubic_ramp(at[inside])).float()
        torch.testing.assert_close(torch.from_numpy(along[inside]), expected, atol=1e-4, rtol=0)
    assert network.positions(12, 12) is network.pos_embed


def test_patches_are_assigned_as_a_whole() -> None:
    rng = np.random.default_rng(1)
    scores, dustbin = torch.tensor(rng.normal(0, 2, (2, 5, 30))), torch.tensor(0.3, dtype=torch.float64)
    p = assignment(scores, dustbin)
    taken = p.sum(dim=1)
    assert bool(((taken > 0) & (taken < 1)).all()), "what is left of a patch is the dustbin's"
    order = torch.tensor(rng.permutation(30))
    torch.testing.assert_close(assignment(scores[:, :, order], dustbin), p[:, :, order])
    torch.testing.assert_close(assignment(scores + 3, dustbin + 3), p)
    torch.testing.assert_close(assignment(scores[1:], dustbin), p[1:])
