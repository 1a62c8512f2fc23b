"""LPN's network and its parts: heads, attention, backbone and its files, views, named configurations, stages."""

from __future__ import annotations

import pickle
from dataclasses import asdict, replace
from pathlib import Path
from typing import cast

import pytest
import torch
from made_places import NarrowResNet
from refusals import refused
from safetensors.torch import save_file
from torch import Tensor, nn
from torch.autograd import gradcheck
from torchvision.models import resnet18, resnet50  # type: ignore[import-untyped]

from baselines.lpn.attention import AttentionOptions, LocalAttention
from baselines.lpn.backbone import make_backbone
from baselines.lpn.backbone_weights import load_backbone
from baselines.lpn.configurations import (
    CONFIGURATIONS,
    FROM_ABOVE,
    REPLACED_PARTITION_LOSS,
    Configuration,
    configuration,
)
from baselines.lpn.head import PartHead, PartHeads
from baselines.lpn.losses import total_loss
from baselines.lpn.network import LpnNetwork, View, copy_weights
from baselines.lpn.options import BackboneName, NetworkOptions
from baselines.lpn.stages import ALL, INDUCED, Stage, enter, group_of
from baselines.options import options_from_dict
from relocbench.errors import ConfigError, MethodError

SMALL = NetworkOptions(backbone="resnet18", parts=2, width=8)
"""2 rings of a 4 x 4 map at 64 pixels"""


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def noise(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(shape, generator=generator(seed), dtype=torch.float64)


def pictures(batch: int = 2, side: int = 64, seed: int = 0) -> Tensor:
    return torch.rand((batch, 3, side, side), generator=generator(seed))


def lived_in(module: nn.Module) -> nn.Module:
    """Normalisations with statistics and weights of their own, as after training."""
    for number, each in enumerate(module.modules()):
        if isinstance(each, nn.BatchNorm1d | nn.BatchNorm2d):
            assert each.running_mean is not None
            assert each.running_var is not None
            with torch.no_grad():
                each.running_mean.normal_(generator=generator(number))
                each.running_var.uniform_(0.5, 2.0, generator=generator(number))
                each.weight.uniform_(0.5, 2.0, generator=generator(number))
    return module.eval()


def same_weights(one: nn.Module, other: nn.Module) -> bool:
    ours, theirs = one.state_dict(), other.state_dict()
    return ours.keys() == theirs.keys() and all(torch.equal(ours[name], theirs[name]) for name in ours)


@pytest.fixture(scope="module")
def small() -> LpnNetwork:
    return cast(LpnNetwork, lived_in(LpnNetwork(5, SMALL)))


# Heads


def test_a_head_by_hand() -> None:
    head = PartHead(2, 2, 3, 0.5, generator())
    with torch.no_grad():
        head.reduce.weight.copy_(torch.tensor([[1.0, 2.0], [0.0, -1.0]]))
        head.reduce.bias.copy_(torch.tensor([0.5, 0.0]))
        head.norm.weight.copy_(torch.tensor([2.0, 1.0]))
        head.norm.bias.copy_(torch.tensor([0.0, 1.0]))
        head.classifier.weight.copy_(torch.tensor([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]))
    head.eval()  # statistics are still mean 0, variance 1
    embedding = head.embed(torch.tensor([[1.0, 2.0]]))
    assert torch.allclose(embedding, torch.tensor([[11.0, -1.0]]), atol=1e-3)
    assert torch.allclose(head.classify(embedding), torch.tensor([[11.0, -1.0, 10.0]]), atol=1e-3)
    head.train()
    batch = head.embed(torch.tensor([[0.0, 0.0], [2.0, 0.0]]))  # reduced: 0.5 and 2.5, 0 and 0
    assert torch.allclose(batch, torch.tensor([[-2.0, 1.0], [2.0, 1.0]]), atol=1e-3)


def test_dropout_stands_before_the_classifier_and_in_training_alone() -> None:
    heads = PartHeads(2, 6, 400, 3, 0.75, generator())
    x = noise(5, 2, 6).float()
    torch.manual_seed(0)
    embeddings, logits = heads(x)
    assert bool((embeddings != 0).all())
    assert not torch.allclose(logits, heads(x).logits)
    head = cast(PartHead, heads.heads[0])
    with torch.no_grad():
        head.classifier.weight.fill_(1.0)
    kept = head.classify(torch.ones(2000, 400))[:, 0] / 4.0  # what is kept is enlarged by 1 / (1 - 0.75)
    assert float(kept.mean().detach()) / 400 == pytest.approx(0.25, rel=0.02)
    heads.eval()
    assert torch.equal(heads(x).logits, heads(x).logits)
    assert torch.equal(heads(x).embeddings, heads.embed(x))


def test_each_part_has_a_head_of_its_own() -> None:
    heads = PartHeads(3, 6, 8, 4, 0.0, generator()).eval()
    x = noise(2, 3, 6).float()
    changed = x.clone()
    changed[:, 1] += 1
    same = (heads(x).logits == heads(changed).logits).all(-1).all(0)
    assert same.tolist() == [True, False, True]
    assert not torch.allclose(heads(x[:, [0, 0, 0]]).logits[:, 0], heads(x[:, [0, 0, 0]]).logits[:, 1])


def test_first_weights_of_a_head_are_those_of_the_field() -> None:
    head = PartHead(2048, 512, 701, 0.75, generator()).requires_grad_(False)
    assert float(head.reduce.weight.std()) == pytest.approx((2 / 512) ** 0.5, rel=0.01)  # fan-out
    assert float(head.classifier.weight.std()) == pytest.approx(0.001, rel=0.01)
    assert float(head.norm.weight.mean()) == pytest.approx(1.0, abs=0.005)
    assert float(head.norm.weight.std()) == pytest.approx(0.02, rel=0.15)
    for bias in (head.reduce.bias, head.classifier.bias, head.norm.bias):
        assert not bool(bias.any())


def test_derivatives_of_heads() -> None:
    heads = PartHeads(2, 3, 2, 4, 0.0, generator()).double()
    weights = list(heads.parameters())
    assert gradcheck(lambda x, *_: tuple(heads(x)), (noise(4, 2, 3).requires_grad_(), *weights))


# Attention


def test_attention_by_hand() -> None:
    attention = LocalAttention(2, 3, False, generator()).double().eval()
    with torch.no_grad():
        attention.depthwise.weight.copy_(torch.tensor([1.0, 2.0])[:, None, None, None].expand(2, 1, 3, 3))
        attention.pointwise.weight.copy_(torch.tensor([[0.0, 1.0], [1.0, 0.0]])[..., None, None])
    x = noise(1, 2, 4, 4)
    around = nn.functional.pad(x, (1, 1, 1, 1))[0, :, 1:4, 2:5].sum((1, 2))  # about row 1, column 2
    normal = 1 / (1 + 1e-5) ** 0.5
    expected = torch.sigmoid(torch.stack([2 * around[1], around[0]]) * normal)
    assert torch.allclose(attention.weights(x)[0, :, 1, 2], expected)
    assert torch.allclose(attention(x), x * attention.weights(x))
    attention.residual = True
    assert torch.allclose(attention(x), x + x * attention.weights(x))


@pytest.mark.parametrize("kernel", [5, 7])
def test_attention_sees_its_kernel_and_nothing_else(kernel: int) -> None:
    attention = cast(LocalAttention, lived_in(LocalAttention(3, kernel, True, generator()).double()))
    x = noise(1, 3, 16, 16).requires_grad_()
    (slope,) = torch.autograd.grad(attention.weights(x)[0, :, 8, 8].sum(), x)
    seen = slope[0].abs().sum(0) > 0
    expected = torch.zeros(16, 16, dtype=torch.bool)
    expected[8 - kernel // 2 : 9 + kernel // 2, 8 - kernel // 2 : 9 + kernel // 2] = True
    assert torch.equal(seen, expected)


def test_derivatives_of_attention() -> None:
    for residual in (False, True):
        attention = LocalAttention(2, 3, residual, generator()).double()
        weights = list(attention.parameters())
        x = noise(2, 2, 3, 3).requires_grad_()
        assert gradcheck(lambda each, *_, attention=attention: attention(each), (x, *weights))


def test_attention_acts_after_the_stages_that_are_named() -> None:
    images = pictures()
    plain = LpnNetwork(5, SMALL)
    for after in (("layer3",), ("layer4",), ("layer3", "layer4")):
        options = replace(SMALL, attention=options_from_dict(AttentionOptions, {"after": after, "kernel": 3}))
        net = LpnNetwork(5, options)
        branch = net.branch("drone")
        assert {name.split(".")[3] for name, _ in net.named_parameters() if ".attention." in name} == set(after)
        branch.backbone.load_state_dict(plain.branch("drone").backbone.state_dict())
        seen: list[Tensor] = []
        for attention in branch.attention.values():
            attention.register_forward_hook(lambda _, given, __, seen=seen: seen.append(given[0]))
        net.eval()
        plain.eval()
        x3 = plain.branch("drone").backbone.to_layer3((images - branch.mean) / branch.deviation)
        found = branch.last_map_from(branch.map_after(images, 0), 0)
        given_to = dict(zip(after, list(seen), strict=True))
        if "layer3" in after:
            assert torch.equal(given_to["layer3"], x3)
            x3 = cast(Tensor, branch.attention["layer3"](x3))
        x4 = plain.branch("drone").backbone.through_last_blocks(x3, 0, len(branch.backbone.last_blocks))
        if "layer4" in after:
            assert torch.equal(given_to["layer4"], x4)
            x4 = cast(Tensor, branch.attention["layer4"](x4))
        assert torch.equal(found, x4)


# Backbone


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "build"), [pytest.param("resnet18", resnet18, marks=pytest.mark.thorough), ("resnet50", resnet50)]
)
def test_the_backbone_is_torchvisions_but_for_the_last_stride(
    name: str, build: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("baselines.lpn.backbone.resnet18", resnet18)
    torch.manual_seed(3)
    theirs = build(weights=None).eval()  # type: ignore[operator]
    state = {key: value for key, value in theirs.state_dict().items() if not key.startswith("fc.")}
    images = pictures(1)
    x = theirs.maxpool(theirs.relu(theirs.bn1(theirs.conv1(images))))
    x = theirs.layer3(theirs.layer2(theirs.layer1(x)))
    halved = make_backbone(cast(BackboneName, name), 2, generator()).eval()
    kept = make_backbone(cast(BackboneName, name), 1, generator()).eval()
    with torch.no_grad():
        for ours in (halved, kept):
            ours.load_state_dict(state)
            assert torch.allclose(ours.to_layer3(images), x, rtol=1e-3, atol=1e-3)
        assert torch.allclose(halved(images), theirs.layer4(x), rtol=1e-3, atol=1e-3)
        assert kept(images).shape == (1, kept.channels["layer4"], 4, 4)
        assert kept.to_layer3(images).shape == (1, kept.channels["layer3"], 4, 4)
        # The same weights at the same places: every second pixel of the first block's output is the halved one's.
        first = kept.get_submodule("layer4.0")(x)
        if name == "resnet50":
            assert torch.allclose(first[..., ::2, ::2], halved.get_submodule("layer4.0")(x), rtol=1e-3, atol=1e-3)


def test_lpns_last_map_has_sixteen_by_sixteen_columns() -> None:
    backbone = make_backbone("resnet50", 1, generator()).to("meta")
    assert backbone(torch.zeros(1, 3, 256, 256, device="meta")).shape == (1, 2048, 16, 16)


def test_first_weights_depend_on_their_generator_alone() -> None:
    torch.manual_seed(1)
    state = torch.get_rng_state()
    attention = options_from_dict(AttentionOptions, {"after": ("layer3", "layer4")})
    options = replace(SMALL, attention=attention, partition="heatmap", street="separate")
    one, same = LpnNetwork(5, options), LpnNetwork(5, options, generator(0))
    other = LpnNetwork(5, options, generator(1))
    assert torch.equal(state, torch.get_rng_state())
    assert same_weights(one, same)
    assert all(bool(value.isfinite().all()) for value in one.state_dict().values())
    for name, parameter in one.named_parameters():
        if parameter.ndim > 1:
            assert not torch.equal(parameter, other.get_parameter(name))
    first = one.branch("drone").backbone.get_parameter("layer1.0.conv1.weight")
    assert float(first.detach().std()) == pytest.approx((2 / (8 * 9)) ** 0.5, rel=0.1)  # fan-out


def test_a_backbones_file_is_read(tmp_path: Path) -> None:
    theirs = NarrowResNet()
    for number, tensor in enumerate(theirs.state_dict().values()):
        if tensor.is_floating_point():
            tensor.uniform_(0.1, 1.0, generator=generator(number))
    state = theirs.state_dict()
    torch.save(state, tmp_path / "theirs.pth")
    save_file(state, tmp_path / "theirs.safetensors")
    older = {name: value for name, value in state.items() if not name.endswith("num_batches_tracked")}
    torch.save(older, tmp_path / "older.pth")
    torch.save({name: value.double() for name, value in older.items()}, tmp_path / "double.pth")
    for name in ("theirs.pth", "theirs.safetensors", "older.pth", "double.pth"):
        backbone = make_backbone("resnet18", 1, generator())
        load_backbone(tmp_path / name, backbone)
        for key, value in backbone.state_dict().items():
            assert value.dtype == state[key].dtype
            assert torch.equal(value, state[key])


def test_files_that_are_no_weights_are_refused_in_one_line(tmp_path: Path) -> None:
    backbone = make_backbone("resnet18", 1, generator())
    before = {name: value.clone() for name, value in backbone.state_dict().items()}
    state = before.copy()
    names: dict[str, tuple[object, ...]] = {"missing.pth": (), "missing.safetensors": ()}
    (tmp_path / "text.pth").write_text("weights will be here\n")
    (tmp_path / "empty.pth").write_bytes(b"")
    (tmp_path / "text.safetensors").write_text("weights will be here\n")
    (tmp_path / "code.pth").write_bytes(pickle.dumps(SMALL))
    torch.save(backbone, tmp_path / "module.pth")
    torch.save(state, tmp_path / "whole.pth")
    (tmp_path / "cut.pth").write_bytes((tmp_path / "whole.pth").read_bytes()[:10000])
    names |= dict.fromkeys(("text.pth", "empty.pth", "code.pth", "module.pth", "cut.pth", "text.safetensors"), ())
    torch.save({"epoch": 3, "state_dict": state}, tmp_path / "checkpoint.pth")
    torch.save([1, 2], tmp_path / "list.pth")
    names |= dict.fromkeys(("checkpoint.pth", "list.pth"), ())
    torch.save(resnet18(weights=None).state_dict(), tmp_path / "deeper.pth")
    names["deeper.pth"] = ()
    torch.save({**state, "head.weight": torch.zeros(3)}, tmp_path / "more.pth")
    names["more.pth"] = ("head.weight",)
    torch.save({name: value for name, value in state.items() if name != "bn1.weight"}, tmp_path / "fewer.pth")
    names["fewer.pth"] = ("bn1.weight",)
    torch.save({**state, "bn1.weight": torch.zeros(3)}, tmp_path / "shape.pth")
    names["shape.pth"] = ("bn1.weight", 3, 8)
    torch.save({**state, "bn1.weight": torch.full((64,), torch.nan)}, tmp_path / "nan.pth")
    torch.save({**state, "bn1.weight": torch.ones(64, dtype=torch.int64)}, tmp_path / "whole-numbers.pth")
    names |= dict.fromkeys(("nan.pth", "whole-numbers.pth"), ("bn1.weight",))
    for name, said in names.items():
        with refused(MethodError, tmp_path / name, None, *said) as caught:
            load_backbone(tmp_path / name, backbone)
        assert "\n" not in str(caught.value)
    assert all(torch.equal(value, before[name]) for name, value in backbone.state_dict().items())


# The network


def test_what_comes_out_has_these_shapes(small: LpnNetwork) -> None:
    out = small("drone", pictures(3))
    assert out.embeddings.shape == (3, 2, 8)
    assert out.logits.shape == (3, 2, 5)
    assert out.pooled.shape == (3, 64)
    assert out.masks is None
    assert torch.equal(out.embeddings, small.embed("drone", pictures(3)))
    branch = small.branch("drone")
    last = branch.last_map_from(branch.map_after(pictures(3), 0), 0)
    assert torch.equal(out.pooled, last.flatten(2).max(-1).values)


def test_images_are_normalised_as_imagenets(small: LpnNetwork) -> None:
    seen: list[Tensor] = []
    backbone = small.branch("drone").backbone
    hook = backbone.get_submodule("conv1").register_forward_hook(lambda _, given, __: seen.append(given[0]))
    small.embed("drone", torch.tensor([0.485, 0.456 + 0.224, 0.406 - 0.225])[None, :, None, None].expand(1, 3, 64, 64))
    hook.remove()
    assert torch.allclose(seen[0][0, :, 3, 4], torch.tensor([0.0, 1.0, -1.0]), atol=1e-6)
    for wrong in (torch.zeros(1, 1, 64, 64), torch.zeros(3, 64, 64)):
        with pytest.raises(ValueError, match="images"):
            small.embed("drone", wrong)


def test_a_descriptor_is_the_same_for_the_mirror_image(small: LpnNetwork) -> None:
    images = pictures(2)
    found = small.describe("drone", images)
    assert found.shape == (2, 16)
    assert torch.allclose(found.norm(dim=-1), torch.ones(2))
    assert torch.allclose(found, small.describe("drone", images.flip(-1)), atol=1e-4)
    assert not torch.allclose(found[0], found[1], atol=1e-3)
    small.train()
    try:
        with pytest.raises(RuntimeError, match="mode"):
            small.describe("drone", images)
    finally:
        small.eval()


@pytest.mark.parametrize("street", ["none", "separate", "shared"])
def test_drone_and_satellite_share_a_branch_and_street_as_told(street: str) -> None:
    options = replace(SMALL, street=street)  # type: ignore[arg-type]
    net = LpnNetwork(5, options)
    assert net.branch("drone") is net.branch("satellite")
    assert len(net.branches) == (2 if street == "separate" else 1)
    if street == "none":
        with pytest.raises(ValueError, match="street"):
            net("street", pictures())
    else:
        assert (net.branch("street") is net.branch("drone")) == (street == "shared")
    with pytest.raises(ValueError, match="night"):
        net(cast(View, "night"), pictures())


@pytest.mark.parametrize(("partition", "parts"), [("soft", 2), ("heatmap", 3)])
def test_masks_come_out_of_partitions_that_have_them(partition: str, parts: int) -> None:
    net = LpnNetwork(5, options_from_dict(NetworkOptions, {**asdict(SMALL), "partition": partition, "parts": parts}))
    masks = net("drone", pictures()).masks
    assert masks is not None
    assert masks.shape == (2, parts, 4, 4)
    assert torch.allclose(masks.sum(1), torch.ones(2, 4, 4))


def test_a_network_learns_a_batch_by_heart() -> None:
    net = LpnNetwork(4, replace(SMALL, dropout=0.0))
    images: dict[View, Tensor] = {"satellite": pictures(4, seed=1), "drone": pictures(4, seed=2)}
    labels = torch.arange(4)
    descent = torch.optim.SGD(net.parameters(), lr=0.02, momentum=0.9, nesterov=True)
    values = []
    for _ in range(12):
        value = total_loss({view: net(view, batch) for view, batch in images.items()}, dict.fromkeys(images, labels))
        descent.zero_grad()
        value.total.backward()
        descent.step()
        values.append(float(value.total.detach()))
    assert values[-1] < 0.2 * values[0]
    assert float(value.parts["right/drone"]) == float(value.parts["right/satellite"]) == 1.0


# Configurations and stages


def smaller(config: Configuration) -> Configuration:
    return replace(config, network=replace(config.network, backbone="resnet18", width=8))


@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_each_configuration_trains_what_its_stages_say_and_nothing_else(name: str) -> None:
    config = smaller(configuration(name))
    labels = torch.arange(2)
    before: LpnNetwork | None = None
    for stage in config.stages:
        net = LpnNetwork(3, config.network_in(stage), generator(7))
        if before is not None:
            copy_weights(before, net)
        net.train()
        trained = enter(net, stage)
        assert {id(p) for ps in trained.values() for p in ps} == {id(p) for p in net.parameters() if p.requires_grad}
        images: dict[View, Tensor] = {"satellite": pictures(2, 128, 1), "drone": pictures(2, 128, 2)}
        torch.manual_seed(0)
        outputs = {view: net(view, batch) for view, batch in images.items()}
        total_loss(outputs, dict.fromkeys(images, labels), config.loss_in(stage)).total.backward()
        for key, parameter in net.named_parameters():
            assert (parameter.grad is not None) == (group_of(key) in stage.trained), key
            if parameter.grad is not None:
                assert bool(parameter.grad.isfinite().all()), key
        before = net
    assert before is not None
    assert before.options == config.network
    descriptor = before.eval().describe("drone", pictures(1, 128))
    assert descriptor.shape == (1, 8 * config.network.parts)


def test_the_table_has_these_rows() -> None:
    assert list(CONFIGURATIONS)[:2] == ["global-average", "lpn"]
    assert configuration("global-average").network == NetworkOptions(parts=1)
    assert configuration("lpn").network == NetworkOptions()
    assert configuration("lpn-branch7").network.attention == AttentionOptions(("layer3",), 7, True)
    assert configuration("lpn-attention").network.attention == AttentionOptions(("layer3", "layer4"), 5, False)
    assert configuration("lpn-dmli").rerank_top == 100
    assert configuration("lpn-rpp").stages == INDUCED
    dwdr = configuration("lpn-dwdr")
    assert (dwdr.network.ring_mean, dwdr.loss.decorrelation.weight, dwdr.paired) == ("ring", 0.1, True)
    assert all(configuration(name).network.backbone == "resnet50" for name in FROM_ABOVE)
    street = configuration("street")
    assert (street.views, street.network.street, street.network.parts) == (("street",), "shared", 1)
    assert set(CONFIGURATIONS) == {*FROM_ABOVE, "street"}
    with refused(ConfigError, "", None, "lpn2", "global-average", "lpn"):
        configuration("lpn2")


def test_what_the_log_reports_is_plausible_for_one_positive() -> None:
    """R@1 <= AP <= R@1 + (100 - R@1) / 4, with half a unit of the last digit on either side."""
    rows = [config.logged for config in CONFIGURATIONS.values() if config.logged] + [REPLACED_PARTITION_LOSS]
    assert len(rows) == 11
    for row in rows:
        assert row.r_at_1 - 0.01 <= row.ap <= row.r_at_1 + (100 - row.r_at_1) / 4 + 0.01


def test_reconstructions_are_called_so() -> None:
    named = [config for name, config in CONFIGURATIONS.items() if "power" in name or "exponential" in name]
    assert len(named) == 4
    for config in named:
        assert "reconstruction" in config.about
        assert config.logged is None


def test_induced_training_frees_one_group_after_the_other() -> None:
    assert [stage.partition for stage in INDUCED] == ["rings", "soft", "soft"]
    assert [stage.trained for stage in INDUCED] == [ALL, ("partition",), ALL]
    assert [stage.epochs for stage in INDUCED[1:]] == [60, 50]


def test_what_is_not_trained_stands_still() -> None:
    net = LpnNetwork(3, replace(SMALL, partition="soft"))
    net.train()
    trained = enter(net, INDUCED[1])
    assert [name for name, p in net.named_parameters() if p.requires_grad] == [
        "branches.air.partition.classifier.weight"
    ]
    assert list(trained) == ["partition"]
    before = {name: value.clone() for name, value in net.state_dict().items()}
    outputs = net("drone", pictures(4))
    assert torch.equal(outputs.logits, net("drone", pictures(4)).logits)  # nothing is dropped
    descent = torch.optim.SGD(trained["partition"], lr=1.0)
    total_loss({"drone": outputs}, {"drone": torch.tensor([0, 1, 2, 0])}).total.backward()
    descent.step()
    changed = [name for name, value in net.state_dict().items() if not torch.equal(value, before[name])]
    assert changed == ["branches.air.partition.classifier.weight"]
    net.train()
    enter(net, Stage("all", 1, "soft"))
    assert all(module.training for module in net.modules())
    with pytest.raises(ValueError, match="mean"):
        group_of("branches.air.mean")


def test_weights_are_copied_to_another_partition_and_to_nothing_else() -> None:
    source = LpnNetwork(3, SMALL, generator(1))
    target = LpnNetwork(3, replace(SMALL, partition="heatmap"), generator(2))
    masks = {name: value.clone() for name, value in target.state_dict().items() if ".partition." in name}
    copy_weights(source, target)
    for name, value in target.state_dict().items():
        assert torch.equal(value, masks[name] if name in masks else source.state_dict()[name])
    for other in (LpnNetwork(4, SMALL), LpnNetwork(3, replace(SMALL, width=9)), LpnNetwork(3, replace(SMALL, parts=1))):
        untouched = {name: value.clone() for name, value in other.state_dict().items()}
        with pytest.raises(ValueError, match="heads"):
            copy_weights(source, other)
        assert all(torch.equal(value, untouched[name]) for name, value in other.state_dict().items())


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"parts": 0}, "parts"),
        ({"parts": 1, "partition": "soft"}, "parts"),
        ({"width": 0}, "width"),
        ({"dropout": 1.0}, "dropout"),
        ({"attention": {"after": ["layer3", "layer3"]}}, "layer3"),
        ({"attention": {"kernel": 4}}, "kernel"),
        ({"block": 4}, "block"),
    ],
)
def test_options_that_make_no_sense_are_named(values: dict[str, object], said: str) -> None:
    with refused(ConfigError, "", None, said):
        options_from_dict(NetworkOptions, values)
