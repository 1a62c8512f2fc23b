"""The probe: starts exactly so far off, successes counted right, radii, files, resuming, and pictures of features."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from command_line import relocbench
from pixel_views import INTENSITY, levels, offsets, pixels, view
from refusals import assert_names
from small_dataset import ACROSS, WITHIN, make_small_dataset
from trackers_for_probe import Basin

from baselines.alignment.matching import MatchSettings, match_pixels, match_pixels_by_level
from baselines.gn_net.network import FeatureNet
from baselines.gn_net.weights import save_weights
from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.pairs.correspondences import Correspondences
from relocbench.evaluation.isolation.handles import LocalTracker
from relocbench.evaluation.probe import ProbeOptions, probe_methods
from relocbench.evaluation.probe.feature_maps import places_of, principal_components
from relocbench.evaluation.probe.pixels import NEAR, NEAR_ON_LEVEL, OFFSETS_PX, with_structure
from relocbench.evaluation.probe.poses import CONVERGED, OFFSETS, draw_priors, probe_poses
from relocbench.evaluation.probe.records import read_probe
from relocbench.evaluation.probe.starts import draw_starts, probe_starts, start_line
from relocbench.evaluation.probe.table import ACROSS as ACROSS_CONDITIONS
from relocbench.evaluation.probe.tally import What
from relocbench.geometry import make_transform, se3_exp, so3_exp
from relocbench.metrics import pose_errors
from relocbench.progress import Silent
from relocbench.tracking import Query, TrackResult

pytestmark = pytest.mark.usefixtures("workers_kept")
BASIN = "b=trackers_for_probe:Basin"
TRUTH = se3_exp(np.array([0.4, -0.1, 1.2, 0.02, -0.1, 0.05]))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("data") / "small", correspondences=60, size=(160, 120))


def rows(path: Path) -> list[dict[str, str]]:
    with path.open() as stream:
        return list(csv.DictReader(stream))


def options(dataset: Dataset, out: Path, *methods: str, **more: object) -> ProbeOptions:
    given = {"workers": 0, "pairs": 3, "per_pair": 20, "directions": 1, **more}
    return ProbeOptions(dataset=dataset.root, methods=methods, out=out, **given)


@pytest.mark.parametrize("what", ["translation", "rotation"])
def test_priors_are_off_by_the_offset_and_by_nothing_else(what: What) -> None:
    priors = draw_priors(TRUTH, what, (1, 2), 3, seed=0)
    assert priors.shape == (len(OFFSETS[what]), 3, 4, 4)
    flat = priors.reshape(-1, 4, 4)
    errors = pose_errors(flat, np.repeat(TRUTH[None], len(flat), axis=0))
    wanted = np.repeat(OFFSETS[what], 3)
    moved, turned = errors.translation_error_m, errors.rotation_error_deg
    off, kept = (moved, turned) if what == "translation" else (turned, moved)
    np.testing.assert_allclose(off, wanted, atol=1e-9)
    np.testing.assert_allclose(kept, 0, atol=1e-9)


def test_priors_follow_rays_that_depend_on_the_pair_and_the_seed_alone() -> None:
    first = draw_priors(TRUTH, "translation", (1, 2), 2, seed=0)
    np.testing.assert_array_equal(first, draw_priors(TRUTH, "translation", (1, 2), 2, seed=0))
    rays = (first[1:, :, :3, 3] - TRUTH[:3, 3]) / np.array(OFFSETS["translation"])[1:, None, None]
    np.testing.assert_allclose(rays, np.broadcast_to(rays[0], rays.shape), atol=1e-9)
    for other in (((1, 3), 0), ((1, 2), 1)):
        assert np.abs(draw_priors(TRUTH, "translation", other[0], 2, seed=other[1]) - first).max() > 0.1
    towards = np.concatenate(
        [draw_priors(TRUTH, "translation", (k, 0), 1, 0)[4, :, :3, 3] - TRUTH[:3, 3] for k in range(300)]
    )
    assert np.abs(towards.mean(axis=0)).max() < 0.15  # all directions alike: a mean of 300 has sd 0.033


def test_a_tracker_with_a_known_basin_is_counted_right() -> None:
    class UpToOneMetre:
        def track(self, reference: object, query: object, prior: Array) -> TrackResult:
            far = np.linalg.norm(prior[:3, 3] - TRUTH[:3, 3]) > 1 + 1e-9
            turned = np.linalg.norm(prior[:3, :3] - TRUTH[:3, :3]) > 0.1
            if turned:
                return TrackResult.failure("turned")
            off = make_transform(so3_exp([0.0, 0.0, np.radians(1.5)]), np.zeros(3)) if far else np.eye(4)
            off[0, 3] = 0.24 if far else 0.0
            return TrackResult(off @ TRUTH)

    query = Query("q", 2, np.zeros((4, 4), np.uint8), None)  # type: ignore[arg-type]
    (moved, turned), message = probe_poses(LocalTracker(UpToOneMetre()), query, TRUTH, (1, 2), 4, 0)
    assert message == ""
    assert moved.offsets == (0.0, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
    assert moved.hits["recall@(0.25m,1deg)"] == (4, 4, 4, 4, 4, 0, 0, 0)
    assert moved.hits["recall@(0.1m,0.5deg)"] == (4, 4, 4, 4, 4, 0, 0, 0)
    assert moved.answered == (4,) * 8
    assert moved.start_hits[CONVERGED] == (4, 4, 4, 0, 0, 0, 0, 0)  # exactly 0.25 m is within 0.25 m
    assert turned.start_hits[CONVERGED] == (4, 4, 4, 4, 0, 0, 0)
    assert turned.hits[CONVERGED] == turned.answered == (4, 4, 4, 4, 4, 0, 0)  # 4 degrees are 0.099 of the norm


def test_on_a_level_alone_success_falls_with_the_offset_and_a_coarse_level_reaches_further() -> None:
    uv = pixels(border=70)
    shift = (3.0, -2.0)
    here, there = levels(view()), levels(view(shift))
    shares = np.empty((2, 4))
    for k, length in enumerate((1.0, 4.0, 8.0, 16.0)):
        starts = uv + shift + offsets(len(uv), length)
        ends = match_pixels_by_level(here, there, uv, starts, INTENSITY)
        assert len(ends) == 4
        off = [np.linalg.norm(ends[level] - uv - shift, axis=1) for level in (0, 2)]
        shares[:, k] = np.mean(off[0] <= 1), np.mean(off[1] <= 4)
    assert shares[0, 0] > 0.95
    assert np.all(np.diff(shares[0]) <= 0)
    assert shares[0, 3] < 0.3
    assert np.all(shares[1, 2:] > shares[0, 2:] + 0.2)


def test_the_finest_level_alone_is_a_pyramid_of_one_level() -> None:
    uv = pixels()
    here, there = levels(view()), levels(view((1.5, 0.5)))
    alone = match_pixels_by_level(here, there, uv, uv, INTENSITY)
    np.testing.assert_array_equal(alone[0], match_pixels(here[:1], there[:1], uv, uv, INTENSITY))
    with pytest.raises(ValueError, match="take a larger pattern"):
        match_pixels_by_level(here, there, uv, uv, MatchSettings())


def test_structured_pixels_are_the_corners_among_those_that_are_visible() -> None:
    image = np.full((60, 80), 100, dtype=np.uint8)
    image[20:40, 20:50] = 200  # corners at (20, 20), (49, 20), (20, 39), (49, 39)
    uv = np.array([[20.0, 20.0], [49, 39], [35, 20], [20, 30], [60, 50], [5, 5], [49, 20], [20, 39]])
    n = len(uv)
    visible = np.arange(n) != 6
    known = Correspondences(np.zeros(n, np.int64), np.ones(n, np.int64), uv, np.ones(n), uv, visible, ("both",) * n)
    kept = with_structure(known, image, 3 / 7)
    assert np.nonzero(kept.visible)[0].tolist() == [0, 1, 7]  # neither edges nor a corner that is hidden
    np.testing.assert_array_equal(with_structure(known, np.stack([image] * 3, -1), 3 / 7).visible, kept.visible)
    assert with_structure(known, image, 1.0) is known
    assert with_structure(known, image, 1e-6).visible.sum() == 1


@pytest.mark.thorough
def test_a_method_that_does_not_move_finds_what_it_started_at(dataset: Dataset, tmp_path: Path) -> None:
    report = probe_methods(options(dataset, tmp_path, BASIN), Silent())
    assert not report.crashed
    line = next(li for li in report.lines if li.criterion == NEAR and li.conditions == ACROSS_CONDITIONS)
    np.testing.assert_array_equal(line.shares, [1, 1, 0, 0, 0, 0])
    np.testing.assert_array_equal(line.shares, line.start_shares)
    assert line.radius is not None
    assert (line.pairs, line.radius.value) == (3, 1.5)
    radii = {
        row["what"]: float(row["radius"])
        for row in rows(tmp_path / "radii.csv")
        if row["conditions"] == ACROSS_CONDITIONS
    }
    assert radii["translation"] == pytest.approx(0.375, abs=0.13)  # 0.25 m is at the edge of what is near
    assert radii["pixels"] == 1.5
    read = next(li for li in read_probe(tmp_path).lines if li.points[0].curve[1::2] == ("pixels", ACROSS_CONDITIONS))
    assert {(p.method, p.level, p.pairs) for p in read.points} == {("b", "", 3)}
    assert [p.offset for p in read.points] == list(line.offsets)
    np.testing.assert_allclose([p.share for p in read.points], line.shares)
    assert read.radii is not None
    assert read.radii.half_text == "1.50 px"
    page = (tmp_path / "probe.md").read_text()
    assert "| across conditions | 3 | 1.50 |" in page
    for name in ("curves.png",):
        assert cv2.imread(str(tmp_path / name)) is not None


@pytest.mark.thorough
def test_dso_is_better_near_than_far_and_on_the_same_condition(dataset: Dataset, tmp_path: Path) -> None:
    probe_methods(options(dataset, tmp_path, "dso", BASIN, poses=False, pairs=2, per_pair=40), Silent())
    found = [
        r for r in rows(tmp_path / "probe.csv") if r["method"] == "dso" and r["criterion"] == NEAR and not r["level"]
    ]
    by = {(r["conditions"], int(r["offset"])): float(r["share"]) for r in found}
    assert {offset for _, offset in by} == set(OFFSETS_PX)
    assert by["same condition", 2] > 0.4  # those that do not move find none from there
    assert by["same condition", 2] > by["same condition", 16] + 0.2
    alone = [r for r in rows(tmp_path / "probe.csv") if r["level"] == "0" and r["criterion"] == NEAR_ON_LEVEL]
    assert {r["method"] for r in alone} == {"dso"}
    ratios = [r["ratio"] for r in rows(tmp_path / "radii.csv") if r["method"] == "b" and not r["level"]]
    assert all(ratios)
    assert cv2.imread(str(tmp_path / "levels.png")) is not None


@pytest.mark.thorough
def test_any_number_of_workers_leaves_the_same_bytes(dataset: Dataset, tmp_path: Path) -> None:
    for name, workers in (("one", 1), ("two", 2)):
        probe_methods(options(dataset, tmp_path / name, BASIN, workers=workers), Silent())
    files = ["probe.csv", "radii.csv", "probe.md", "probe.yaml", "curves.png"]
    for name in files:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes(), name


@pytest.mark.thorough
def test_what_is_known_is_not_asked_again_and_other_parameters_are(dataset: Dataset, tmp_path: Path) -> None:
    log = tmp_path / "log"
    given = options(dataset, tmp_path / "out", BASIN, set=(f"b.log={log}",))
    probe_methods(given, Silent())
    asked = log.read_text()
    assert asked.count("match") == 6  # three pairs of each of two sets
    assert asked.count("track") == 6 * sum(map(len, OFFSETS.values()))
    page = (tmp_path / "out" / "probe.md").read_bytes()
    journal = next((tmp_path / "out" / "answers").rglob("*.jsonl"))
    lines = journal.read_text().splitlines(keepends=True)
    journal.write_text("".join(lines[:-1]) + lines[-1][:40])  # as a kill leaves it
    probe_methods(given, Silent())
    assert log.read_text().count("match") == 7
    assert (tmp_path / "out" / "probe.md").read_bytes() == page
    probe_methods(options(dataset, tmp_path / "out", BASIN, set=(f"b.log={log}",), seed=1), Silent())
    assert log.read_text().count("match") == 13


@pytest.mark.thorough
def test_a_method_that_breaks_has_found_nothing_and_is_told(dataset: Dataset, tmp_path: Path) -> None:
    last = max(pair.query_timestamp_ns for pair in dataset.pair_set(ACROSS).pairs)
    given = options(dataset, tmp_path, BASIN, set=(f"b.raises_at={last}",), pair_sets=(ACROSS,), pairs=100)
    report = probe_methods(given, Silent())
    broken = sum(pair.query_timestamp_ns == last for pair in dataset.pair_set(ACROSS).pairs)
    total = len(dataset.pair_set(ACROSS).pairs)
    assert report.crashed[0][0] == "b"
    assert f"crashed on {broken} of {total} pairs" in report.crashed[0][1]
    assert "ZeroDivisionError: on purpose" in report.crashed[0][1]
    line = next(li for li in report.lines if li.criterion == NEAR)
    assert line.shares[0] == pytest.approx(1 - broken / total)


@pytest.mark.thorough
def test_a_method_that_kills_its_worker_has_found_nothing_on_that_pair(dataset: Dataset, tmp_path: Path) -> None:
    last = max(pair.query_timestamp_ns for pair in dataset.pair_set(ACROSS).pairs)
    given = options(dataset, tmp_path, BASIN, set=(f"b.dies_at={last}",), pair_sets=(ACROSS,), pairs=100, workers=2)
    report = probe_methods(given, Silent())
    assert "died twice" in report.crashed[0][1]
    line = next(li for li in report.lines if li.criterion == NEAR)
    assert line.pairs == len(dataset.pair_set(ACROSS).pairs)
    assert 0 < line.shares[0] < 1


def test_levels_that_break_on_a_pair_are_not_found_there(dataset: Dataset, tmp_path: Path) -> None:
    last = max(pair.query_timestamp_ns for pair in dataset.pair_set(ACROSS).pairs)
    given = options(
        dataset,
        tmp_path,
        "b=trackers_for_probe:BadLevels",
        set=(f"b.raises_at={last}",),
        pair_sets=(ACROSS,),
        pairs=100,
        poses=False,
    )
    report = probe_methods(given, Silent())
    assert "match returned shape" in report.crashed[0][1]
    whole = next(li for li in report.lines if li.criterion == NEAR and li.level is None)
    alone = next(li for li in report.lines if li.criterion == NEAR_ON_LEVEL and li.level == 1)
    assert whole.shares[0] == 1
    assert whole.pairs == alone.pairs
    assert 0 < alone.shares[2] < 1  # 2 px off is within 1 px of level 1, except where it crashed


def test_a_level_that_a_method_does_not_have_has_no_row(dataset: Dataset, tmp_path: Path) -> None:
    given = options(dataset, tmp_path, "b=trackers_for_probe:NoFinestLevel", pair_sets=(ACROSS,), poses=False)
    report = probe_methods(given, Silent())
    assert not report.crashed
    assert {line.level for line in report.lines} == {None, 1}


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (["-m", "identity"], "match()"),
        (["-m", "dso", "--no-pixels", "--no-poses"], "--no-pixels"),
        (["-m", "dso", "--pair-set", "nowhere"], "nowhere"),
        (["-m", "dso", "--structured", "0"], "--structured"),
        (["-m", "no-such-method"], "no-such-method"),
        (["-m", "dso", "--set", "dso.speed=3"], "speed"),
        (
            ["-m", "gn-net", "--set", "gn-net.weights=/nowhere.safetensors", "--feature-maps", "1"],
            "/nowhere.safetensors",
        ),
        (["-m", "s=trackers_for_probe:ShowsNonsense", "--feature-maps", "1"], "(H, W, D)"),
        ([], "--method"),
    ],
)
def test_bad_input_is_one_line(dataset: Dataset, tmp_path: Path, arguments: list[str], name: str) -> None:
    outcome = relocbench("probe", "-q", "-d", dataset.root, "--out", tmp_path / "out", "-j", 0, *arguments)
    assert outcome.status == 2
    assert name in outcome.complaint


def test_results_are_kept_out_of_the_dataset(dataset: Dataset) -> None:
    outcome = relocbench("probe", "-d", dataset.root, "--out", dataset.root / "probe", "-m", "dso")
    assert outcome.status == 2
    assert_names(outcome.complaint, "", None, "--out")


@pytest.mark.thorough
def test_without_correspondences_only_poses_are_probed(tmp_path: Path) -> None:
    bare = make_small_dataset(tmp_path / "bare")
    outcome = relocbench(
        "probe",
        "--json",
        "-d",
        bare.root,
        "-o",
        tmp_path / "out",
        "-m",
        BASIN,
        "--pairs",
        1,
        "-j",
        0,
        "--directions",
        1,
    )
    assert outcome.status == 0, outcome.err
    assert "has no correspondences" in outcome.err
    assert {entry["what"] for entry in json.loads(outcome.out)["radii"]} == {"translation", "rotation"}
    refused = relocbench("probe", "-q", "-d", bare.root, "-o", tmp_path / "other", "-m", BASIN, "--no-poses")
    assert "match()" in refused.complaint


@pytest.mark.thorough
def test_untrained_weights_of_gn_net_are_probed_and_drawn(dataset: Dataset, tmp_path: Path) -> None:
    weights = tmp_path / "w.safetensors"
    save_weights(weights, FeatureNet(generator=torch.Generator().manual_seed(0)), {})
    given = ("--set", f"gn-net.weights={weights}", "--pairs", 1, "--per-pair", 20, "--no-poses", "-j", 0)
    outcome = relocbench(
        "probe", "-d", dataset.root, "-o", tmp_path / "out", "-m", "gn-net", *given, "--feature-maps", 1
    )
    assert outcome.status == 0, outcome.err
    (sheet,) = (tmp_path / "out").glob("features_gn-net_*.png")
    image = cv2.imread(str(sheet))
    assert image is not None
    height, width = image.shape[:2]
    assert (width, height) == (5 * 160, 3 * (120 + 22))  # image and four levels; keyframe, summer, winter
    shares = [float(r["share"]) for r in rows(tmp_path / "out" / "probe.csv")]
    assert all(0 <= share <= 1 for share in shares)
    assert max(shares) > 0


def test_components_of_all_images_together_give_the_same_colour_to_the_same_feature() -> None:
    rng = np.random.default_rng(0)
    basis = np.linalg.qr(rng.normal(size=(8, 8)))[0]
    parts = rng.uniform(-1, 1, (40, 50, 3)) * [9.0, 4.0, 1.0]
    a = (parts @ basis[:3] + 5.0).astype(np.float32)
    b = a[::-1].copy()
    first, second = principal_components([a, b])
    np.testing.assert_array_equal(first[::-1], second)
    assert first.shape == (40, 50, 3)
    for channel in range(3):
        # Each channel is one of the made-up components, in the order of their spread, up to its sign.
        inside = (first[..., channel] > 2) & (first[..., channel] < 253)
        correlation = np.corrcoef(first[inside][:, channel], parts[inside][:, channel])[0, 1]
        assert abs(correlation) > 0.98


def test_a_darker_image_keeps_a_colour_scale_in_common() -> None:
    ramp = np.linspace(0, 1, 100, dtype=np.float32).reshape(10, 10, 1) * np.array([1, 0.5, 0.2], np.float32)
    bright, dark = principal_components([ramp, ramp * 0.3])
    assert bright[..., 0].max() > 250
    assert dark[..., 0].max() < 100
    assert np.all(bright[..., 1:] == 128)  # a line has one component: the others are grey


def test_few_channels_and_maps_that_do_not_fit() -> None:
    (picture,) = principal_components([np.random.default_rng(0).random((6, 7, 2)).astype(np.float32)])
    assert np.all(picture[..., 2] == 128)
    assert picture[..., 1].std() > 10
    with pytest.raises(ValueError, match="of one D"):
        principal_components([np.zeros((2, 2, 3), np.float32), np.zeros((2, 2, 4), np.float32)])


def test_places_are_those_that_most_conditions_look_at(dataset: Dataset) -> None:
    sets = dataset.pair_sets()
    places = places_of(dataset, sets, 2)
    assert len(places) == 2
    for place in places:
        titles = [title for title, _, _ in place.images]
        assert titles[0].startswith("keyframe")
        assert len(set(titles)) == 3  # and a query of each of the two conditions
    assert places_of(dataset, [], 2) == []
    within = places_of(dataset, [s for s in sets if s.name == WITHIN], 1)
    assert len(within[0].images) == 2


def test_a_parameter_called_features_is_not_taken_for_features(dataset: Dataset, tmp_path: Path) -> None:
    assert Basin().features == 3
    outcome = relocbench(
        *("probe", "-d", dataset.root, "-o", tmp_path, "-m", BASIN, "-m", "s=trackers_for_probe:Shows"),
        *("--feature-maps", 1, "--no-poses", "--no-pixels", "-j", 0),
    )
    assert outcome.status == 0, outcome.err
    assert "b offers no feature maps" in outcome.err
    assert [path.name[:11] for path in tmp_path.glob("*.png")] == ["features_s_"]


def test_starts_beside_the_keyframes_pose_are_as_far_from_the_truth() -> None:
    starts = draw_starts(TRUTH, (1, 2), 5, seed=0)
    np.testing.assert_allclose(starts[0], np.eye(4), atol=1e-12)
    errors = pose_errors(starts, np.repeat(TRUTH[None], len(starts), axis=0))
    offsets = np.linalg.norm([(s @ np.linalg.inv(TRUTH))[:3, 3] for s in starts[2:]], axis=1)
    np.testing.assert_allclose(offsets, np.linalg.norm(np.linalg.inv(TRUTH)[:3, 3]), rtol=1e-12)
    np.testing.assert_allclose(errors.rotation_error_deg, errors.rotation_error_deg[0], rtol=1e-9)
    there, back = starts[0] @ np.linalg.inv(TRUTH), starts[1] @ np.linalg.inv(TRUTH)
    np.testing.assert_allclose(there @ back, np.eye(4), atol=1e-12)
    assert not np.array_equal(starts, draw_starts(TRUTH, (1, 2), 5, seed=1))


def test_a_method_that_knows_where_queries_lie_is_found_out() -> None:
    class Habit:
        def track(self, reference: object, query: object, prior: Array) -> TrackResult:
            return TrackResult(TRUTH @ prior)  # right from the keyframe's pose alone

    query = Query("q", 2, np.zeros((4, 4), np.uint8), None)  # type: ignore[arg-type]
    tally, message = probe_starts(LocalTracker(Habit()), query, TRUTH, (1, 2), 4, 0)
    assert message == ""
    assert tally.count == (1, 1, 4)
    assert tally.hits[CONVERGED] == (1, 0, 0)
    line = start_line("habit", "all", [[tally] * 3, [tally]])
    assert (line.pairs, line.shares, line.ahead.mean) == (4, {"keyframe": 1.0, "mirrored": 0.0, "random": 0.0}, 1.0)
    nothing, message = probe_starts(None, query, TRUTH, (1, 2), 4, 0)
    assert nothing.hits[CONVERGED] == nothing.answered == (0, 0, 0)


def test_the_start_from_the_keyframe_is_a_table_of_its_own(dataset: Dataset, tmp_path: Path) -> None:
    given = options(dataset, tmp_path, "dso", BASIN, pixels=False, start="identity", pairs=2)
    report = probe_methods(given, Silent())
    assert not report.lines
    assert {line.method for line in report.starts} == {"dso", "b"}
    found = rows(tmp_path / "starts.csv")
    here = next(row for row in found if row["method"] == "dso" and row["conditions"] == "same condition")
    assert float(here["keyframe"]) == 1.0
    assert "| across conditions | dso | 2 |" in (tmp_path / "probe.md").read_text()
    assert not (tmp_path / "curves.png").exists()
