"""``relocbench inspect``: what is in a dataset, and pictures that show whether the truth is right."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from small_dataset import ACROSS, WITHIN, make_small_dataset, render, small_camera, small_pose
from typer.testing import CliRunner

from relocbench.cli.app import app
from relocbench.datasets.core.images import read_image
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.inspect.agreement import measure_agreement
from relocbench.datasets.inspect.overlay import (
    spread_pairs,
    warp_image,
    write_pictures,
)
from relocbench.datasets.inspect.summary import take_inventory
from relocbench.geometry import invert, make_transform, so3_exp
from relocbench.progress import Silent
from relocbench.tracking import KeyframePoints, Query, Reference


def two_views(size: tuple[int, int] = (160, 120)) -> tuple[Reference, Query, np.ndarray]:
    """A keyframe with depth, a query half a metre ahead and 3 degrees turned, and ``T_query_ref``."""
    camera = small_camera(*size)
    T_world_ref, T_world_query = small_pose(0), small_pose(3, lateral_m=0.1, yaw_deg=3.0)
    image, depth = render(camera, T_world_ref)
    seen, _ = render(camera, T_world_query)
    return (
        Reference("r", 0, image, camera, depth=depth),
        Query("q", 1, seen, camera),
        invert(T_world_query) @ T_world_ref,
    )


def test_the_inventory_counts_what_is_there(tmp_path: Path) -> None:
    found = take_inventory(make_small_dataset(tmp_path / "D", frames=5, rejected=2))
    summer = found.traversals[0]
    assert (summer.name, summer.images, summer.keyframes, summer.poses) == ("summer", 5, 5, 5)
    assert summer.length_m == pytest.approx(4 * 0.15)
    across = next(s for s in found.pair_sets if s.name == ACROSS)
    assert across.pairs == 5 + 4 - 2
    assert across.rejected == {"too few points agree": 2}
    assert across.tiers == {"easy": 7}
    assert across.angle_deg is not None
    assert across.angle_deg.greatest == pytest.approx(2.0)
    within = next(s for s in found.pair_sets if s.name == WITHIN)
    assert within.groups == {"step_1": 4, "step_2": 3}
    assert within.distance_m is not None
    assert [within.distance_m.least, within.distance_m.greatest] == pytest.approx([0.15, 0.3])


def test_the_warped_keyframe_is_the_query_where_the_pose_is_true() -> None:
    reference, query, T_query_ref = two_views()
    warped, known = warp_image(reference, query.camera, T_query_ref)
    assert known.mean() > 0.7
    error = np.abs(warped.astype(float) - query.image)[known]
    assert np.median(error) < 3.0


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("sign", [1, -1])
def test_edges_lie_apart_under_a_wrong_pose_and_not_under_the_true_one(axis: int, sign: int) -> None:
    reference, query, T_query_ref = two_views((320, 240))
    offset = np.zeros(6)
    offset[axis] = sign * (0.15 if axis < 3 else np.radians(1.5))
    wrong = make_transform(so3_exp(offset[3:]), offset[:3]) @ T_query_ref
    right = measure_agreement(reference, query, T_query_ref)
    assert right.verdict == "agree"
    assert right.shift_px < 0.4
    found = measure_agreement(reference, query, wrong)
    assert found.verdict == "apart"
    assert found.shift_px > 1.0


def test_the_shift_of_a_turned_camera_is_measured_in_pixels_of_the_query() -> None:
    reference, query, T_query_ref = two_views((320, 240))
    for px in (3.0, 8.0):
        turn = make_transform(so3_exp([0, px / query.camera.fx, 0]), np.zeros(3))  # points move to the right
        found = measure_agreement(reference, query, turn @ T_query_ref)
        right, down = found.towards_px
        assert right == pytest.approx(-px, rel=0.2)  # more towards the border
        assert down == pytest.approx(0.0, abs=0.5)
        assert "CHECK THE TRUE POSE" in found.words
        assert f"{-right:.1f} px to the left" in found.words


@pytest.mark.parametrize(
    "light",
    [
        lambda grey: 0.5 * grey + 20,
        lambda grey: 255 - grey,
        lambda grey: 255 * (grey / 255) ** 3,
        lambda grey: np.clip(grey * np.linspace(0.2, 1.2, grey.shape[1]), 0, 255),
    ],
    ids=["darker", "negative", "gamma", "shaded"],
)
def test_light_does_not_matter(light: Callable[[np.ndarray], np.ndarray]) -> None:
    reference, query, T_query_ref = two_views((320, 240))
    other = Query("q", 1, light(query.image.astype(float)).astype(np.uint8), query.camera)
    found = measure_agreement(reference, other, T_query_ref)
    assert found.verdict == "agree"
    assert found.shift_px < 0.5


def test_a_rolled_camera_sees_edges_in_other_directions() -> None:
    camera = small_camera(320, 240)
    T_world_ref = small_pose(0)
    T_world_query = T_world_ref @ make_transform(so3_exp([0, 0, np.radians(25)]), np.zeros(3))
    image, depth = render(camera, T_world_ref)
    seen, _ = render(camera, T_world_query)
    reference, query = Reference("r", 0, image, camera, depth=depth), Query("q", 1, seen, camera)
    found = measure_agreement(reference, query, invert(T_world_query) @ T_world_ref)
    assert found.verdict == "agree"
    assert found.measured > found.regions / 2


def test_what_shows_nothing_of_the_keyframe_tells_nothing() -> None:
    reference, query, T_query_ref = two_views((320, 240))
    noise = np.random.default_rng(0).integers(0, 256, size=query.image.shape).astype(np.uint8)
    for image in (np.full_like(query.image, 90), noise):
        found = measure_agreement(reference, Query("q", 1, image, query.camera), T_query_ref)
        assert found.verdict == "cannot tell"
        assert np.isnan(found.shift_px)
        assert "cannot be told" in found.words


@pytest.mark.thorough
def test_lamps_in_the_dark_tell_nothing() -> None:
    reference, query, T_query_ref = two_views((640, 480))
    for seed in range(3):
        rng = np.random.default_rng(seed)
        night = np.zeros(query.image.shape[:2], dtype=np.uint8)
        for u, v, radius in zip(
            rng.integers(640, size=30), rng.integers(480, size=30), rng.integers(2, 8, 30), strict=True
        ):
            cv2.circle(night, (int(u), int(v)), int(radius), 255, -1)
        assert measure_agreement(reference, Query("q", 1, night, query.camera), T_query_ref).verdict == "cannot tell"


@pytest.mark.parametrize("size", [(16, 12), (32, 24), (64, 48), (128, 96)])
def test_other_pictures_of_any_size_tell_nothing(size: tuple[int, int]) -> None:
    reference, query, T_query_ref = two_views(size)
    for seed in range(4):
        noise = np.random.default_rng(seed).uniform(0, 255, size=query.image.shape)
        other = np.clip(cv2.GaussianBlur(noise, (0, 0), 1.5), 0, 255).astype(np.uint8)
        assert measure_agreement(reference, Query("q", 1, other, query.camera), T_query_ref).verdict == "cannot tell"


@pytest.mark.parametrize("count", [300, 2000])
def test_sparse_keyframes_are_measured_around_their_points(count: int) -> None:
    reference, query, T_query_ref = two_views((640, 480))
    dense = reference.points
    rows = np.random.default_rng(0).choice(len(dense.uv), count, replace=False)
    points = KeyframePoints(dense.uv[rows], dense.inverse_depth[rows], dense.sigma[rows])
    sparse = Reference("r", 0, reference.image, reference.camera, sparse_points=points)
    assert measure_agreement(sparse, query, T_query_ref).verdict == "agree"
    turn = make_transform(so3_exp([0, 8.0 / query.camera.fx, 0]), np.zeros(3))
    found = measure_agreement(sparse, query, turn @ T_query_ref)
    assert found.verdict == "apart"
    assert found.shift_px == pytest.approx(8.0, rel=0.2)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("px", "verdict"),
    [(25.0, "apart"), (60.0, "apart"), (200.0, "cannot tell")],
)
def test_large_errors_are_told_as_far_as_the_search_reaches(px: float, verdict: str) -> None:
    reference, query, T_query_ref = two_views((640, 480))
    turn = make_transform(so3_exp([0, px / query.camera.fx, 0]), np.zeros(3))
    found = measure_agreement(reference, query, turn @ T_query_ref)
    assert found.verdict == verdict
    if verdict == "apart":
        assert found.shift_px == pytest.approx(px, rel=0.2)


def test_a_keyframe_without_depth_says_so() -> None:
    reference, query, T_query_ref = two_views()
    assert reference.depth is not None
    empty = Reference("r", 0, reference.image, reference.camera, depth=np.zeros_like(reference.depth))
    found = measure_agreement(empty, query, T_query_ref)
    assert (found.verdict, found.words) == ("cannot tell", "the keyframe has no depth: nothing can be compared")


def test_a_query_that_sees_no_point_is_unseen() -> None:
    reference, query, _ = two_views()
    found = measure_agreement(reference, query, make_transform(so3_exp([0, np.pi, 0]), [0, 0, 0]))
    assert found.verdict == "unseen"
    assert found.words == "the query sees no point of the keyframe by the true pose: check the true pose"


@pytest.mark.thorough
@pytest.mark.parametrize("sparse", [False, True])
def test_pictures_tell_a_wrong_truth_from_a_right_one(tmp_path: Path, sparse: bool) -> None:
    fault = make_transform(so3_exp([0, np.radians(2.0), 0]), [0.1, 0, 0])
    pictures, images = {}, {}
    for name, pose_fault in (("right", None), ("wrong", fault)):
        made = make_small_dataset(tmp_path / name, frames=3, sparse=sparse, pose_fault=pose_fault)
        pictures[name] = write_pictures(made, [made.pair_set(ACROSS)], tmp_path / f"{name}-pictures", 2, 0, Silent())
        images[name] = [read_image(tmp_path / f"{name}-pictures" / p.file) for p in pictures[name]]
    for right, wrong in zip(pictures["right"], pictures["wrong"], strict=True):
        assert right.file == wrong.file
        assert right.agreement.verdict != "apart"
        assert wrong.agreement.verdict != "agree"
        assert sparse or wrong.agreement.verdict == "apart"
    for right_image, wrong_image in zip(images["right"], images["wrong"], strict=True):
        assert fringes(wrong_image) > 1.5 * fringes(right_image)


def fringes(picture: np.ndarray) -> float:
    """Mean difference of red and cyan in the last panel, the lower right one."""
    height, width = picture.shape[:2]
    panel = picture[int(0.6 * height) :, width // 2 + 10 :].astype(float)
    return float(np.mean(np.abs(panel[..., 0] - panel[..., 1])))


def test_the_same_seed_draws_the_same_bytes(tmp_path: Path) -> None:
    made = make_small_dataset(tmp_path / "D", frames=3)
    drawn = [write_pictures(made, [made.pair_set(ACROSS)], tmp_path / f"{i}", 1, 3, Silent())[0].file for i in range(2)]
    assert (tmp_path / "0" / drawn[0]).read_bytes() == (tmp_path / "1" / drawn[1]).read_bytes()


@pytest.mark.parametrize(("count", "rows"), [(1, [0]), (2, [0, 9]), (4, [0, 3, 6, 9]), (50, list(range(10)))])
def test_pairs_are_spread_over_the_drive(count: int, rows: list[int]) -> None:
    pairs = [Pair(i, i, np.eye(4)) for i in range(10)]
    withheld = Pair(99, 99, None)
    assert [p.ref_timestamp_ns for p in spread_pairs([*pairs, withheld], count)] == rows


def test_the_command_prints_tables_or_json_and_draws(tmp_path: Path) -> None:
    made = make_small_dataset(tmp_path / "D", rejected=1)
    runner = CliRunner()
    tables = runner.invoke(app, ["inspect", str(made.root)])
    assert tables.exit_code == 0
    for word in ("summer", "snow, winter, day", ACROSS, "1 rejected: too few points agree", "CC0-1.0"):
        assert word in tables.stdout
    assert made.fingerprint[:12] in tables.stdout
    options = ["--pictures", str(tmp_path / "pictures"), "--pairs", "2", "--pair-set", ACROSS, "--json", "-q"]
    result = runner.invoke(app, ["inspect", str(made.root), *options])
    assert result.exit_code == 0
    plain = json.loads(result.stdout)
    assert plain["fingerprint"] == made.fingerprint
    assert [p["pair_set"] for p in plain["pictures"]] == [ACROSS, ACROSS]
    told = {"verdict", "regions", "measured", "shift_px", "towards_px", "words"}
    assert told < set(plain["pictures"][0])
    assert "agreement" not in plain["pictures"][0]
    assert sorted(p.name for p in (tmp_path / "pictures").iterdir()) == sorted(p["file"] for p in plain["pictures"])
