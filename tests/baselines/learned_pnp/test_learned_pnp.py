"""ALIKED with PnP: matching, and coordinates and poses by the authors' weights."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import relocbench
from drawn_places import pattern
from hypothesis import given
from hypothesis import strategies as st
from small_dataset import ACROSS, make_small_dataset

from baselines.learned_pnp.kornia_networks import Aliked
from baselines.learned_pnp.trackers import mutual_nearest

pytest.importorskip("kornia.feature", reason="the extra 'learned' is not installed")


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
