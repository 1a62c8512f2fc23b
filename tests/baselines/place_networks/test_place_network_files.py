"""Files of weights: every form that is read, and one line for every file that is not."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import torch
from drawn_places import (
    RETRIEVERS,
    STATES,
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
from refusals import refused
from safetensors.torch import save_file

from baselines.place_networks import CosPlace
from baselines.place_networks.backbone import Backbone, BackboneName, backbone_of
from relocbench.errors import MethodError


@pytest.mark.parametrize("name", get_args(BackboneName))
def test_each_backbone_is_told_by_its_layers(name: BackboneName) -> None:
    for backbone in (Backbone(name), *([] if name == "VGG16" else [Backbone(name, 3)])):
        with torch.device("meta"):
            state = {f"b.{key}": value for key, value in backbone.make().state_dict().items()}
        assert backbone_of(state, "b") == backbone
        assert state[list(state)[-1]].device.type == "meta"
    assert backbone_of({"b.4": torch.zeros(1), "b.0.weight": torch.zeros(3)}, "b") is None
    assert backbone_of({}, "b") is None


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["netvlad", "megaloc"])
def test_all_forms_of_a_file_give_the_same_descriptors(drawn: Callable[[str], Path], tmp_path: Path, name: str) -> None:
    state = STATES[name]()
    image = pattern(64, 64)
    expected = described(made(name, drawn(name)), image)
    torch.save(state, tmp_path / "old.pth", _use_new_zipfile_serialization=False)
    save_file({key: value.contiguous() for key, value in state.items()}, tmp_path / "flat.safetensors")
    saved({"epoch": 3, "best": 0.5, "state_dict": state}, tmp_path / "training.pth.tar")
    saved({"model_state_dict": {f"module.{key}": v for key, v in state.items()}}, tmp_path / "parallel.pth")
    saved({key: v.double() if v.is_floating_point() else v for key, v in state.items()}, tmp_path / "double.pth")
    saved({key: v for key, v in state.items() if "num_batches" not in key}, tmp_path / "uncounted.pth")
    for path in tmp_path.iterdir():
        np.testing.assert_allclose(described(made(name, path), image), expected, atol=1e-6, err_msg=path.name)


def test_the_file_of_megalocs_release_names_dinov2_otherwise(drawn: Callable[[str], Path], tmp_path: Path) -> None:
    state = {name.replace("backbone.", "backbone.model."): value for name, value in megaloc_state().items()}
    state["backbone.model.mask_token"] = torch.zeros(1, VIT.channels)
    image = pattern(70, 70)
    released = made("megaloc", saved(state, tmp_path / "megaloc.torch"))
    np.testing.assert_allclose(
        described(released, image), described(made("megaloc", drawn("megaloc")), image), atol=1e-6
    )


def test_the_layers_of_a_network_in_parallel_are_named_as_without(drawn: Callable[[str], Path], tmp_path: Path) -> None:
    state = {name.replace(".", ".module.", 1): value for name, value in netvlad_state().items()}
    parallel = made("netvlad", saved({"state_dict": state, "parallel": True}, tmp_path / "a.pth.tar"))
    image = pattern(64, 64)
    np.testing.assert_allclose(
        described(parallel, image), described(made("netvlad", drawn("netvlad")), image), atol=1e-6
    )


def changed(**tensors: Any) -> Callable[[State], Mapping[str, Any]]:
    """A change of a state: tensors by name, with ``__`` for a dot; None leaves one out."""
    named = {name.replace("__", "."): value for name, value in tensors.items()}
    return lambda state: {k: v for k, v in {**state, **named}.items() if v is not None}


CHANGES: list[tuple[str, Callable[[State], Mapping[str, Any]], tuple[str, ...]]] = [
    (
        "cosplace",
        changed(aggregation__3__weight=None),
        ("aggregation.3.weight",),
    ),
    (
        "cosplace",
        changed(aggregation__3__bias=None),
        ("aggregation.3.bias",),
    ),
    ("cosplace", changed(aggregation__3__weight=torch.zeros(3)), ("(3,)", "2")),
    ("cosplace", changed(aggregation__3__weight=torch.zeros(0, 512)), ("(0, 512)", "2")),
    (
        "cosplace",
        changed(aggregation__3__weight=torch.zeros(7, 64)),
        ("aggregation.3.bias", "(32,)"),
    ),
    (
        "cosplace",
        changed(aggregation__1__p=torch.tensor([torch.nan])),
        ("aggregation.1.p",),
    ),
    ("cosplace", changed(aggregation__1__p=torch.tensor([3])), ("aggregation.1.p",)),
    (
        "cosplace",
        changed(more=torch.zeros(1)),
        ("more",),
    ),
    ("cosplace", changed(backbone__0__weight=None), ("backbone",)),
    ("cosplace", changed(backbone__4__2__conv1__weight=torch.zeros(1)), ("backbone",)),
    (
        "cosplace",
        changed(backbone__0__weight=torch.zeros(64, 3, 5, 5)),
        ("backbone.0.weight", "(64, 3, 5, 5)"),
    ),
    ("netvlad", changed(pool__centroids=None), ("pool.centroids",)),
    (
        "netvlad",
        changed(pool__conv__bias=torch.zeros(4)),
        ("pool.conv.bias", "(4,)", "(5,)"),
    ),
    ("netvlad", changed(encoder__0__weight=None), ("encoder",)),
    (
        "netvlad",
        changed(WPCA__0__bias=torch.zeros(4)),
        ("WPCA.0.weight",),
    ),
    ("netvlad", changed(WPCA__0__weight=torch.zeros(4, 9, 1, 1)), ("WPCA.0.bias",)),
    (
        "megaloc",
        changed(backbone__pos_embed=torch.zeros(1, 25, 128)),
        ("backbone",),
    ),
    (
        "megaloc",
        changed(backbone__register_tokens=torch.zeros(1, 4, 128)),
        ("backbone.register_tokens",),
    ),
    (
        "megaloc",
        changed(aggregator__linear__weight=None),
        ("aggregator.linear.weight",),
    ),
    (
        "megaloc",
        changed(aggregator__agg__dust_bin=torch.zeros(1)),
        ("aggregator.agg.dust_bin", "(1,)"),
    ),
    (
        "megaloc",
        changed(**{f"backbone__blocks__{k}__x": torch.zeros(1) for k in range(99)}),
        ("backbone",),
    ),
]


@pytest.mark.parametrize(("name", "change", "names"), CHANGES)
def test_files_of_another_network_are_refused_by_name(
    tmp_path: Path, name: str, change: Callable[[State], Mapping[str, Any]], names: tuple[str, ...]
) -> None:
    path = saved(change(STATES[name]()), tmp_path / "other.pth")
    with refused(MethodError, path, None, *names) as bad:
        made(name, path)
    assert "\n" not in str(bad.value)


@pytest.mark.parametrize("name", list(RETRIEVERS))
def test_files_of_the_other_retrievers_are_refused(drawn: Callable[[str], Path], name: str) -> None:
    alike = {"cosplace", "eigenplaces"}
    for other in RETRIEVERS:
        if other != name and {name, other} != alike:
            with refused(MethodError, drawn(other), None, {"netvlad": "NetVLAD", "megaloc": "MegaLoc"}.get(name, name)):
                made(name, drawn(other))


@pytest.mark.parametrize("name", ["cosplace", "netvlad", "megaloc"])
def test_files_that_are_none_are_refused(drawn: Callable[[str], Path], tmp_path: Path, name: str) -> None:
    whole = drawn(name).read_bytes()
    stream = io.BytesIO()
    torch.save({"recalls": np.zeros(3), "state_dict": STATES[name]()}, stream)
    files = {
        "text.pth": b"hello",
        "empty.pth": b"",
        "cut.pth": whole[: len(whole) // 2],
        "cut.safetensors": b"\x40\0\0\0\0\0\0\0{",
        "code.pth": stream.getvalue(),
        "list.pth": saved([1, 2], tmp_path / "made").read_bytes(),  # type: ignore[arg-type]
    }
    for file, content in files.items():
        path = tmp_path / file
        path.write_bytes(content)
        with pytest.raises(MethodError) as bad:
            made(name, path)
        assert bad.value.path == path
        assert "\n" not in str(bad.value)
    for path in (tmp_path / "absent.pth", tmp_path):
        with refused(MethodError, path):
            made(name, path)


def test_a_tensor_of_more_numbers_than_are_stored_is_refused(tmp_path: Path) -> None:
    """One number with strides of 0 stands for 2 x 10^12 here; the network would take 8 TB."""
    state = gem_state()
    wide = torch.zeros(1).expand(4 * 10**9, 512)
    path = saved({**state, "aggregation.3.weight": wide}, tmp_path / "a.pth")
    with refused(MethodError, "", None, "aggregation.3.weight"):
        CosPlace(weights=path)
