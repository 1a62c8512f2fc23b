"""Asphalt covers streets once and knows along and across; wear lies where wheels roll and dirt collects."""

from __future__ import annotations

import numpy as np
import pytest

from relocbench.arrays import Array
from relocbench.datasets.synthetic.renderer.wear import street_wear
from relocbench.datasets.synthetic.town.carriageway import carriageway
from relocbench.datasets.synthetic.town.mesh import Material, Semantic
from relocbench.datasets.synthetic.town.network import LANE_M, PARKING_M
from relocbench.datasets.synthetic.town.shapes import Shape
from relocbench.datasets.synthetic.town.town import District, make_district

TRACK_V = LANE_M / 2 - 0.74
"""where the inner wheels roll"""


@pytest.fixture(scope="module")
def district() -> District:
    return make_district(1, "train", 190.0)


@pytest.fixture(scope="module")
def asphalt(district: District) -> Shape:
    return carriageway(district.network)


def weights(shape: Shape, points: Array) -> Array:
    """Barycentric coordinates (N, T, 3) of points (N, 2) in the triangles, seen from above."""
    a, b, c = np.moveaxis(shape.vertices[shape.triangles][..., :2], 1, 0)
    inverse = np.linalg.inv(np.stack([b - a, c - a], axis=2))
    second = np.einsum("tij,ntj->nti", inverse, points[:, None] - a)
    return np.concatenate([1 - second.sum(axis=2, keepdims=True), second], axis=2)


@pytest.mark.thorough
@pytest.mark.parametrize("lateral_m", [0.0, LANE_M, 1.9 - LANE_M])
def test_a_street_is_covered_once_and_knows_how_far_its_centre_line_is(
    district: District, asphalt: Shape, lateral_m: float
) -> None:
    path = district.network.drive(150.0, 2)
    points = np.array([path.pose(float(s), lateral_m)[:2, 3] for s in np.arange(0.0, path.length, 0.37)])
    inside = weights(asphalt, points)
    held = (inside > 1e-9).all(axis=2)
    assert (held.sum(axis=1) == 1).mean() > 0.99  # the others are on edges
    assert np.all(np.any(np.all(inside > -1e-6, axis=2), axis=1))
    v = np.array([(inside[n, t] @ asphalt.uv[t, :, 1]) for n, t in zip(*np.nonzero(held), strict=True)])
    expected = abs(lateral_m - LANE_M / 2)
    assert np.median(np.abs(np.abs(v) - expected)) < 0.02  # drives turn at crossings and cut bends a little


@pytest.mark.thorough
def test_the_dashes_of_centre_lines_lie_on_them_and_stop_lines_across_a_lane(district: District) -> None:
    mesh = district.static
    paint = mesh.uv[(mesh.semantic == Semantic.MARKING) & (mesh.material == Material.LANE_MARKING)]
    length, width = np.moveaxis(np.ptp(paint, axis=1), 1, 0)
    dashes = np.isclose(length, 3.0, atol=0.05) & np.isclose(width, 0.12, atol=0.02)
    assert dashes.sum() > 40
    assert np.abs(paint[dashes][..., 1]).max() < 0.1
    stops = np.isclose(length, 0.4, atol=0.15) & np.isclose(width, LANE_M - 0.3, atol=0.05)
    approaches = [e for e in district.network.street if district.network.degree(e[1]) > 2]
    assert stops.sum() == 2 * len(approaches)
    assert np.abs(np.abs(paint[stops][..., 1].mean(axis=1)) - LANE_M / 2).max() < 0.6
    assert (paint[stops][..., 0] > 8).all()


@pytest.mark.thorough
def test_yellow_lines_are_along_kerbs_without_parking(district: District) -> None:
    mesh = district.static
    lines = mesh.uv[mesh.material == Material.KERB_LINE]
    straight = lines[lines[..., 0].min(axis=1) > 12]
    assert len(straight) > 0
    to_kerb = LANE_M - np.abs(straight[..., 1])
    assert to_kerb.min() > 0.05
    assert to_kerb.max() < 0.6
    assert (mesh.variant[mesh.material == Material.KERB_LINE] % 2 == 0).mean() > 0.7  # corners reach into other sides


def wear(u: float, v: float, half: float = 0.004, variant: int = 6) -> Array:
    return np.array(street_wear(u, v, np.int64(variant), half, half, 0.5, 3))


def test_wheels_roll_in_two_tracks_of_each_lane_and_dirt_lies_at_the_kerb() -> None:
    across = np.arange(-LANE_M + 0.01, LANE_M, 0.02)
    tracks = np.mean([[wear(u, v)[1] for v in across] for u in np.arange(30.0, 60.0, 2.0)], axis=0)
    rolled = np.flatnonzero(tracks > 0.6)
    peaks = [across[group].mean() for group in np.split(rolled, np.flatnonzero(np.diff(rolled) > 1) + 1)]
    outer, inner = LANE_M - TRACK_V, TRACK_V
    assert np.allclose(peaks, [-outer, -inner, inner, outer], atol=0.15)
    assert wear(40.0, LANE_M - 0.02)[2] == wear(40.0, LANE_M + PARKING_M - 0.02, variant=7)[2] == 1
    assert wear(40.0, LANE_M - 0.02, variant=7)[2] == 0  # the kerb is behind the parked cars


def test_a_wide_pixel_sees_the_mean_of_narrow_ones() -> None:
    half, shown = 0.3, []
    for u in np.arange(20.0, 60.0, 1.7):
        for v in (-2.3, -0.6, 0.9, 2.1):
            steps = np.linspace(-half, half, 25)[1::2]
            fine = np.mean([[wear(u + a, v + b)[0] for a in steps] for b in steps])
            shown.append((fine, wear(u, v, half)[0]))
    fine, wide = np.array(shown).T
    assert np.ptp(fine) > 0.15
    assert np.abs(fine - wide).max() < 0.12
    assert np.abs(fine - wide).mean() < 0.03
    assert np.corrcoef(fine, wide)[0, 1] > 0.9
