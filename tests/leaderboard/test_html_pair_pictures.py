"""Small pictures of pairs: what the page of a pair warps."""

from __future__ import annotations

import base64
from pathlib import Path

import numpy as np
import pytest
from small_dataset import ACROSS, make_small_dataset, photograph, render, small_camera

from relocbench.geometry import Camera
from relocbench.leaderboard.html.pair_page.pictures import (
    depth_payload,
    image_payload,
    inverse_depth_grid,
    shown_columns,
    small_image,
)
from relocbench.leaderboard.html.pair_page.pictures import small_camera as thumbnail_camera


def test_a_distorted_image_becomes_what_the_pinhole_camera_sees() -> None:
    bent = Camera("radtan", 160, 120, 130.0, 130.0, 79.5, 59.5, (-0.2, 0.03, 0.001, -0.001))
    seen = small_image(photograph(bent, np.eye(4)), bent).astype(float)
    expected = render(thumbnail_camera(bent), np.eye(4))[0].astype(float)
    raw = photograph(bent, np.eye(4)).astype(float)
    inner = np.s_[15:-15, 15:-15]
    assert np.abs(seen - expected)[inner].mean() < 0.3 * np.abs(raw - expected)[inner].mean()


def test_what_lies_outside_a_distorted_image_is_told_apart_from_black() -> None:
    pincushion = Camera("radtan", 160, 120, 130.0, 130.0, 79.5, 59.5, (0.3, 0.0, 0.0, 0.0))
    white = np.full((120, 160), 255, np.uint8)
    seen, columns = small_image(white, pincushion), shown_columns(pincushion)
    assert columns is not None
    across = np.arange(160)
    shown = (across >= columns[:, :1]) & (across < columns[:, 1:])
    assert (seen[shown] == 255).all()
    assert 0 < (~shown).mean() < 0.5
    assert (seen[~shown] < 255).all()
    stored = np.frombuffer(base64.b64decode(str(image_payload(white, pincushion)["shown"])), dtype="<u2")
    assert (stored.reshape(-1, 2) == columns).all()
    assert shown_columns(small_camera()) is None
    assert "shown" not in image_payload(white, Camera("pinhole", 160, 120, 130.0, 130.0, 79.5, 59.5))


def test_a_large_image_is_made_small_and_a_small_one_keeps_its_size() -> None:
    assert thumbnail_camera(small_camera()).size == (96, 72)
    large = thumbnail_camera(small_camera(1920, 1440))
    assert large.size == (480, 360)
    assert large.fx == pytest.approx(0.87 * 480)
    assert large.cx == pytest.approx((480 - 1) / 2)


@pytest.mark.parametrize("sparse", [False, True])
def test_the_grid_holds_the_keyframes_depth(tmp_path: Path, sparse: bool) -> None:
    dataset = make_small_dataset(tmp_path / "D", sparse=sparse)
    pair_set = dataset.pair_set(ACROSS)
    reference = dataset.reference(pair_set, pair_set.pairs[0])
    grid, step = inverse_depth_grid(reference)
    assert step == 1
    np.testing.assert_allclose(grid, reference.inverse_depth_map)
    payload = depth_payload(reference)
    stored = np.frombuffer(base64.b64decode(str(payload["data"])), dtype="<u2").reshape(grid.shape)
    np.testing.assert_allclose(stored * float(str(payload["unit"])), grid, atol=float(grid.max()) / 65535)
    assert ((stored > 0) == (grid > 0)).all()
