"""The town's truth against rays of its own, and how much conditions change it; the full size is in benchmarks/."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from realistic_change import PATCHES, TRACKED, Apart, Frames, matches, patch_correlations
from synthetic_truth import Eye, Scenes, Tally, check, check_depth, report

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.importers.rendered import dataset as synthetic
from relocbench.datasets.pairs.posed_frames import PosedFrames
from relocbench.datasets.synthetic.conditions.condition import condition_named
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.datasets.synthetic.jobs.exact_correspondences import View
from relocbench.datasets.synthetic.jobs.scenes import DistrictSpec
from relocbench.datasets.synthetic.lidar.lidar import LidarScene
from relocbench.datasets.synthetic.town.mesh import Mesh
from relocbench.execution import Run
from relocbench.geometry import Camera
from relocbench.progress import Silent

CAMERA = Camera("pinhole", 40, 32, 30.0, 30.0, 19.5, 15.5)


def build(out: Path, **options: object) -> Dataset:
    asked = {"preset": "smoke", "steps": 3, "extras": (), **options}
    return synthetic.build([], synthetic.Options.model_validate(asked), out, Silent(), Run(1))


@pytest.fixture(scope="module")
def busy(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Two conditions with other parked cars, and with cars that move."""
    return build(tmp_path_factory.mktemp("truth") / "out", traffic=3.0, correspondences=2000, heading=8.0)


def triangles(corners: np.ndarray) -> Mesh:
    """A mesh of triangles (T, 3, 3), each with vertices of its own."""
    count = len(corners)
    return Mesh(
        corners.reshape(-1, 3).astype(np.float32),
        np.arange(3 * count, dtype=np.uint32).reshape(-1, 3),
        np.zeros((count, 3, 2), np.float32),
        np.zeros(count, np.uint8),
        np.zeros(count, np.uint8),
        np.zeros(count, np.uint32),
        np.zeros(count, np.uint32),
        np.zeros(count, np.float32),
    )


@pytest.mark.thorough
def test_the_independent_rays_hit_what_a_plane_equation_says() -> None:
    """Triangles all around the camera, also across its own plane, against solving each for plane and edges."""
    rng = np.random.default_rng(0)
    corners = rng.uniform(-6, 6, (60, 1, 3)) + rng.uniform(-4, 4, (60, 3, 3))
    eye = Eye(CAMERA, np.eye(4), triangles(corners))
    pixels = rng.uniform([0, 0], [39, 31], (300, 2))
    depth, which = eye.cast(pixels)
    rays, _ = CAMERA.unproject(pixels)
    expected = np.full(len(rays), np.inf)
    for a, b, c in corners.astype(np.float32).astype(np.float64):
        for n, ray in enumerate(rays):
            # t ray = (1 - beta - gamma) a + beta b + gamma c
            t, beta, gamma = np.linalg.solve(np.column_stack([ray, a - b, a - c]), a)
            if t > 1e-3 and min(beta, gamma, 1 - beta - gamma) >= 0:
                expected[n] = min(expected[n], t)
    assert 100 < np.isfinite(expected).sum() < 300
    np.testing.assert_allclose(depth, expected, rtol=1e-9)
    assert np.array_equal(which >= 0, np.isfinite(depth))


@pytest.mark.thorough
def test_truth_is_exact_among_parked_and_moving_cars(busy: Dataset) -> None:
    found = report(check(busy, pairs_a_set=2, depth_pixels=2000, seed=0))
    assert found["depth_in_256ths_m"]["rays"] >= 8000
    assert found["depth_in_256ths_m"]["outside_elsewhere"] == 0
    assert found["depth_in_256ths_m"]["within_percent"] > 99.9
    assert found["depth_in_256ths_m"]["max_without_silhouettes"] < 0.51
    for way in ("forward_px", "backward_px"):
        assert found[way]["rays"] > 4000
        assert found[way]["within_percent"] > 99.9
        assert found[way]["outside_elsewhere"] == 0
    assert found["occlusion"]["hidden"] > 100
    assert found["occlusion"]["agree_percent"] > 99.9
    assert found["reference_pixels_on_moving_cars"] == 0


@pytest.mark.thorough
def test_the_check_finds_depth_that_is_off_by_a_centimetre(busy: Dataset) -> None:
    traversal = busy.traversal(busy.traversal_names[0])
    time_ns = traversal.timestamps("front")[0]
    depth = traversal.depth("front", time_ns)
    assert depth is not None
    eye = Scenes(busy).eye(traversal.name, "front", time_ns)
    tally = Tally()
    off = np.asarray(depth + np.float32(0.01) * (depth > 0), dtype=np.float32)
    check_depth(tally, eye, off, 1000, np.random.default_rng(0))
    assert np.mean(tally.depth_units[0] > 1.0) == pytest.approx(np.mean(depth > 0), abs=0.06)


def median_correlation(reference: Frames, query: Frames, rows: list[tuple[int, int]]) -> float:
    assert rows
    return float(np.median(np.concatenate([patch_correlations(reference, r, query, q) for r, q in rows])))


def quad(corner: tuple[float, ...], one: tuple[float, ...], other: tuple[float, ...]) -> np.ndarray:
    """Two triangles (2, 3, 3) of the parallelogram from a corner along two edges."""
    a, u, v = map(np.array, (corner, one, other))
    return np.array([[a, a + u, a + u + v], [a, a + u + v, a + v]])


def test_a_plate_a_millimetre_before_a_wall_hides_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """And ground is still seen that rays meet at one degree: far out, where single precision is coarse."""
    eye = np.array([180.3, 201.7, 1.5])
    wall = quad((190.0, 190.0, -1.0), (0.0, 30.0, 0.0), (0.0, 0.0, 9.0))
    plate = quad((189.999, 190.0, -1.0), (0.0, 12.0, 0.0), (0.0, 0.0, 9.0))
    ground = quad((80.0, 190.0, 0.0), (100.0, 0.0, 0.0), (0.0, 30.0, 0.0))
    scene = LidarScene(triangles(np.concatenate([wall, plate, ground])))
    monkeypatch.setattr(scenes, "static_scene", lambda place, factors: scene)
    T_world_cam = np.eye(4)
    T_world_cam[:3, 3] = eye
    view = View(DistrictSpec(0, "test", 250.0), condition_named("Sunny").factors, CAMERA, T_world_cam)
    rng = np.random.default_rng(0)
    sides = rng.uniform([191, 0], [212, 7], (500, 2))
    sides = sides[np.abs(sides[:, 0] - 202) > 0.1]
    on_wall = np.column_stack([np.full(len(sides), 190.0), sides])
    assert np.array_equal(view.sees(on_wall), sides[:, 0] > 202)
    on_ground = np.column_stack([rng.uniform(95, 175, 500), rng.uniform(195, 215, 500), np.zeros(500)])
    assert np.degrees(np.arcsin(1.5 / np.linalg.norm(on_ground - eye, axis=1).max())) < 1.1
    assert view.sees(on_ground).all()
    assert not view.sees(on_ground + np.array([0, 0, 0.05])).any()


def test_pairs_are_chosen_by_distance_and_evenly_along_the_drive() -> None:
    """Steps of 0.8 m with one gap; the second drive is 0.1 m behind and 0.3 m aside."""
    along = np.concatenate([np.arange(10) * 0.8, 20 + np.arange(10) * 0.8])
    T_first = np.tile(np.eye(4), (20, 1, 1))
    T_first[:, 0, 3] = along
    T_second = T_first.copy()
    T_second[:, :2, 3] += [-0.1, 0.3]
    first, second = (PosedFrames(tuple(range(20)), T, frozenset(range(20))) for T in (T_first, T_second))
    within = matches(first, first, TRACKED, 100, same_drive=True)
    assert len(within) == 20
    assert all(abs(r - q) == 1 for r, q in within)
    again = matches(first, second, TRACKED, 100, same_drive=False)
    # The frame before is sqrt(0.7^2 + 0.3^2) = 0.76 m away; those without one have the next at 0.95 m.
    assert again == [(q - 1 if q % 10 else q + 1, q) for q in range(20)]
    assert matches(first, second, PATCHES, 100, same_drive=False) == []
    some = matches(first, second, TRACKED, 5, same_drive=False)
    assert [q for _, q in some] == [0, 5, 10, 14, 19]


@pytest.mark.thorough
def test_patches_stay_alike_within_a_condition_and_not_across(tmp_path: Path) -> None:
    """Frames about half a metre apart; the exact warp takes motion out, so that only looks differ."""
    options = {"conditions": ("Sunny", "Snow"), "size": "160x120", "speed": 5.0, "lateral": 0.1, "correspondences": 0}
    town = build(tmp_path / "out", **options)
    sunny, snow = (Frames(town.traversal(f"test-{name}-0")) for name in ("Sunny", "Snow"))
    itself = patch_correlations(sunny, 1, sunny, 1)
    assert len(itself) > 50
    np.testing.assert_allclose(itself, 1.0, atol=1e-3)
    half = Apart(0.5, 0.3, 20.0)
    within = median_correlation(sunny, sunny, matches(sunny.posed, sunny.posed, half, 9, same_drive=True))
    across = median_correlation(sunny, snow, matches(sunny.posed, snow.posed, half, 9, same_drive=False))
    assert within > 0.9
    assert across < within - 0.1
