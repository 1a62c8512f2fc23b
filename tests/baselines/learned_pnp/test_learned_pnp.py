"""ALIKED with PnP: matching, files of weights that nobody trusts, coordinates, and poses by the authors' weights."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from command_line import relocbench
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused
from safetensors.torch import save_file
from small_dataset import ACROSS, make_small_dataset

from baselines.learned_pnp import AlikedPnp
from baselines.learned_pnp.kornia_networks import Aliked
from baselines.learned_pnp.trackers import mutual_nearest
from relocbench.arrays import Image
from relocbench.errors import MethodError

kornia_aliked = pytest.importorskip("kornia.feature", reason="the extra 'learned' is not installed")


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Weights of the smallest network that nobody trained."""
    torch.manual_seed(0)
    state = kornia_aliked.ALIKED("aliked-t16").state_dict()
    path = tmp_path_factory.mktemp("weights") / "aliked-t16.pth"
    torch.save({name: tensor for name, tensor in state.items() if name != "dkd.hw_grid"}, path)
    return path


def pattern(height: int, width: int, seed: int = 0) -> Image:
    """Blocks of random colours, blurred."""
    blocks = np.random.default_rng(seed).integers(0, 256, (height // 8 + 1, width // 8 + 1, 3), dtype=np.uint8)
    whole = np.repeat(np.repeat(blocks, 8, axis=0), 8, axis=1)[:height, :width]
    return np.asarray(cv2.GaussianBlur(whole, (0, 0), 1.0), dtype=np.uint8)


@pytest.mark.thorough
def test_remembered_features_are_those_that_the_network_finds(drawn: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    images = [pattern(96, 128, seed) for seed in (0, 1, 2)]
    forgetful, detector = (Aliked(drawn, 200, 1280, "cpu", cache_size, model="t16") for cache_size in (0, 2))
    passed: list[torch.Tensor] = []
    find = detector.find

    def counted(image: torch.Tensor) -> Any:
        passed.append(image)
        return find(image)

    monkeypatch.setattr(detector, "find", counted)
    for number, passes in [(0, 1), (0, 1), (1, 2), (0, 2), (2, 3), (0, 3), (1, 4)]:
        found, expected = detector(images[number].copy()), forgetful(images[number])
        assert len(passed) == passes, "the image used least lately is forgotten first"
        np.testing.assert_array_equal(found.uv, expected.uv)
        np.testing.assert_array_equal(found.descriptors, expected.descriptors)
    detector(images[1].reshape(128, 96, 3))
    assert len(passed) == 5, "the same bytes in another shape are another image"


@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(1, 12), st.sampled_from([1.0, 0.9, 0.6]))
def test_mutual_neighbours_are_those_of_the_definition(seed: int, n: int, m: int, ratio: float) -> None:
    rng = np.random.default_rng(seed)
    first, second = (rng.normal(size=(count, 5)) for count in (n, m))
    first, second = (one / np.linalg.norm(one, axis=1, keepdims=True) for one in (first, second))
    distance = np.linalg.norm(first[:, None] - second[None], axis=-1)
    expected = []
    for i in range(n):
        order = np.argsort(distance[i])
        j = int(order[0])
        distinct = m == 1 or ratio == 1.0 or distance[i, j] < ratio * distance[i, order[1]]
        if distinct and np.argmin(distance[:, j]) == i:
            expected.append([i, j])
    assert mutual_nearest(first, second, ratio).tolist() == expected


def test_there_are_no_matches_without_descriptors() -> None:
    some, none = np.eye(3, dtype=np.float32), np.zeros((0, 3), dtype=np.float32)
    assert [mutual_nearest(*pair).shape for pair in ((some, none), (none, some), (none, none))] == [(0, 2)] * 3


def test_weights_are_read_from_both_kinds_of_file(drawn: Path, tmp_path: Path) -> None:
    tensors = torch.load(drawn, weights_only=True)
    save_file(tensors, tmp_path / "same.safetensors")
    image = pattern(96, 128)
    found = [Aliked(path, 200, 1280, "cpu", model="t16")(image) for path in (drawn, tmp_path / "same.safetensors")]
    assert len(found[0]) > 0
    np.testing.assert_array_equal(found[0].uv, found[1].uv)
    np.testing.assert_array_equal(found[0].descriptors, found[1].descriptors)
    assert np.all(np.diff(found[0].response) <= 0), "the strongest first"


@pytest.mark.parametrize(
    ("change", "names"),
    [
        (lambda t: t.pop("conv1.weight"), ("conv1.weight",)),
        (lambda t: t.update(extra=torch.zeros(1)), ("extra",)),
        (lambda t: t.update({"conv1.weight": torch.zeros(2, 2, 1, 1)}), ("conv1.weight", "(2, 2, 1, 1)")),
        (lambda t: t["conv1.weight"].fill_(torch.nan), ("conv1.weight",)),
        (lambda t: t.pop("block1.bn1.running_mean"), ("block1.bn1.running_mean",)),
    ],
)
def test_weights_of_another_network_are_refused_by_name(
    drawn: Path, tmp_path: Path, change: Callable[[dict[str, torch.Tensor]], Any], names: tuple[str, ...]
) -> None:
    tensors = torch.load(drawn, weights_only=True)
    change(tensors)
    torch.save(tensors, tmp_path / "other.pth")
    with refused(MethodError, tmp_path / "other.pth", None, *names):
        Aliked(tmp_path / "other.pth", 200, 1280, "cpu", model="t16")


def test_files_that_are_no_weights_are_refused(drawn: Path, tmp_path: Path) -> None:
    (tmp_path / "text.pth").write_text("hello")
    torch.save([1, 2], tmp_path / "list.pth")
    for name in ("none.pth", "text.pth", "list.pth"):
        with refused(MethodError, tmp_path / name):
            AlikedPnp(weights=tmp_path / name, model="t16")
    with refused(MethodError, drawn):
        AlikedPnp(weights=drawn, model="n16")


def test_without_weights_one_line_says_which_file_goes_where(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
    dataset = make_small_dataset(tmp_path / "small", frames=3)
    told = relocbench("evaluate", "-d", dataset.root, "-m", "baselines.learned_pnp:AlikedPnp", "-o", tmp_path / "out")
    assert told.status == 2
    assert f"{tmp_path / 'torch'}/hub/checkpoints/aliked-n16.pth: no weights here; put aliked-n16.pth" in told.complaint
    assert "--set aliked-pnp.weights=FILE" in told.complaint


def test_without_kornia_one_line_says_what_to_install(drawn: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "kornia"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "kornia", None)
    with refused(MethodError, "", None, "ALIKED", "kornia", "pip install 'relocbench[learned]'"):
        AlikedPnp(weights=drawn, model="t16")


def test_grey_images_and_small_ones(drawn: Path) -> None:
    detector = Aliked(drawn, 100, 1280, "cpu", model="t16")
    image = pattern(96, 128)[..., 1]
    of_grey, of_three = detector(image), detector(np.stack([image] * 3, axis=-1))
    np.testing.assert_array_equal(of_grey.uv, of_three.uv)
    np.testing.assert_array_equal(of_grey.uv, detector(image[..., None]).uv)
    colour = pattern(96, 128)
    colour.flags.writeable = False
    with warnings.catch_warnings(action="error"):
        assert len(detector(colour)) > 0, "evaluation hands over images that nobody can write to"
    with refused(MethodError, "", None, 64, "128x63"):
        detector(image[:63])


@pytest.mark.thorough
def test_keypoints_of_a_shrunk_image_are_pixels_of_the_original(real_data: Callable[[str], Path]) -> None:
    weights = real_data("weights") / "aliked-t16.pth"
    small = pattern(160, 224)
    large = np.asarray(cv2.resize(small, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST), dtype=np.uint8)
    direct = Aliked(weights, 300, 1280, "cpu", model="t16")(small)
    shrunk = Aliked(weights, 300, 224, "cpu", model="t16")(large)  # the same image again, by areas of 2 x 2
    np.testing.assert_allclose(shrunk.uv, (direct.uv + 0.5) * 2.0 - 0.5, atol=1e-9)
    assert set(shrunk.scale) == {2.0}
    assert set(direct.scale) == {1.0}


@pytest.mark.thorough
def test_keypoints_move_with_the_image(real_data: Callable[[str], Path]) -> None:
    weights = real_data("weights") / "aliked-n16.pth"
    path = min((real_data("kitti_odometry") / "sequences" / "06" / "image_0").glob("*.png"))
    whole = np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), dtype=np.uint8)
    detector = Aliked(weights, 500, 1280, "cpu", model="n16")
    here, there = detector(whole[100:292, 400:720]), detector(whole[103:295, 405:725])
    offset = here.uv[:, None] - (there.uv + np.array([5.0, 3.0]))[None]
    nearest = offset[np.arange(len(here)), np.linalg.norm(offset, axis=-1).argmin(axis=1)]
    near = nearest[np.linalg.norm(nearest, axis=1) < 1.0]
    assert len(near) > 300
    assert np.abs(np.median(near, axis=0)).max() < 0.05


@pytest.mark.thorough
def test_poses_with_the_weights_of_the_authors(real_data: Callable[[str], Path], tmp_path: Path) -> None:
    weights = real_data("weights") / "aliked-n16.pth"
    dataset = make_small_dataset(tmp_path / "small", frames=4, size=(160, 120))
    words = ("-m", "aliked=baselines.learned_pnp:AlikedPnp", "--set", f"aliked.weights={weights}")
    told = relocbench("evaluate", "-d", dataset.root, *words, "-o", tmp_path / "out", "-j", 0, "--json")
    assert told.status == 0, told.err
    from relocbench.evaluation.tables.errors import read_errors

    (table,) = (tmp_path / "out").glob(f"*/aliked/{ACROSS}.errors.csv")
    rows = read_errors(table)
    assert np.median([row.translation_error_m for row in rows]) < 0.05
    again = relocbench("evaluate", "-d", dataset.root, *words, "-o", tmp_path / "two", "-j", 0, "-q")
    assert again.status == 0
    (other,) = (tmp_path / "two").glob(f"*/aliked/{ACROSS}.txt")
    assert other.read_bytes() == table.with_name(f"{ACROSS}.txt").read_bytes()
