"""``relocbench view``: what a recording for rerun holds, and that the picture of a pair shows where poses are right."""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from command_line import relocbench
from matplotlib.axes import Axes
from rerun import RecordingStream
from rerun.chunk import RrdReader
from small_dataset import ACROSS, WITHIN, make_small_dataset, photograph, render, small_camera, small_pose

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import Pair, PoseLine, write_pose_lines
from relocbench.datasets.core.schema import Condition
from relocbench.datasets.core.worlds import world_of_traversals
from relocbench.geometry import Camera, invert, make_transform, so3_exp, transform_from_tq
from relocbench.tracking import Query, Reference
from relocbench.viewer.answers import ShownAnswer
from relocbench.viewer.choice import chosen_pairs
from relocbench.viewer.pair_picture import draw_pair, warp_at
from relocbench.viewer.pictures import as_pinhole

OFF = make_transform(so3_exp([0.0, 0.01, 0.0]), [0.05, 0.0, 0.1])
"""by which the answers of the method ``off`` are wrong"""


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("data") / "small", frames=4)


@pytest.fixture(scope="module")
def results(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of ``exact``, and of ``off``, which leaves the first pair of the set across without an answer."""
    folder = tmp_path_factory.mktemp("results")
    for name, error, first in (("exact", np.eye(4), 0), ("off", OFF, 1)):
        answers = folder / "made" / name
        answers.mkdir(parents=True)
        for pair_set in dataset.pair_sets():
            known = [(p.key, p.T_query_ref) for p in _in_order(pair_set.evaluated)[first:] if p.T_query_ref is not None]
            lines = [PoseLine(*key, error @ T_query_ref) for key, T_query_ref in known]
            write_pose_lines(answers / f"{pair_set.name}.txt", lines)
        out = ["--out", folder / "results", "--quiet"]
        done = relocbench("evaluate", "-d", dataset.root, "-m", name, "--predictions", answers, *out)
        assert done.status == 0, done.err
    return folder / "results"


@pytest.fixture(scope="module")
def recording(dataset: Dataset, results: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("rrd") / "small.rrd"
    done = relocbench("view", dataset.root, "--results", results, "--out", out, "--points", 50)
    assert done.status == 0, done.err
    assert f"written: {out}" in done.err
    assert f"({out.stat().st_size / 1e6:.1f} MB" in done.err
    return out


FIRST = 0
"""the pair of the set across that is shown first"""


def _in_order(pairs: list[Pair]) -> list[Pair]:
    return sorted(pairs, key=lambda p: (p.query_timestamp_ns, p.ref_timestamp_ns))


def rows(recording: Path, entity: str) -> Iterator[dict[str, Any]]:
    """Every row that was logged to an entity, by column."""
    for chunk in RrdReader(recording).stream():
        if chunk.entity_path == entity:
            yield from chunk.to_record_batch().to_pylist()


def poses(recording: Path, entity: str) -> dict[int, np.ndarray]:
    """The poses that were logged to an entity, by pair."""
    return {
        row["pair"]: transform_from_tq(row["Transform3D:translation"][0], row["Transform3D:quaternion"][0])
        for row in rows(recording, entity)
        if row.get("pair") is not None and row.get("Transform3D:translation")
    }


def nanoseconds(time: Any) -> int:
    return int(np.datetime64(getattr(time, "value", time), "ns").astype(np.int64))


def test_a_recording_has_an_entity_for_everything_that_is_shown(recording: Path) -> None:
    entities = {chunk.entity_path for chunk in RrdReader(recording).stream()}
    world = "/worlds/summer"
    expected = {f"{world}/traversals/{name}/{what}" for name in ("summer", "winter") for what in ("trajectory", "rig")}
    expected |= {f"{world}/traversals/winter/rig/cam0"}
    for name in (ACROSS, WITHIN):
        expected |= {f"{world}/pairs/{name}/{what}" for what in ("keyframe", "query_true", "points")}
        expected |= {f"{world}/pairs/{name}/answers/{method}" for method in ("exact", "off")}
        expected |= {f"/images/{name}/keyframe", f"/images/{name}/query_true", f"/told/{name}"}
        expected |= {
            f"/errors/{what}/{name}/{method}"
            for what in ("translation_error_m", "rotation_error_deg")
            for method in ("exact", "off")
        }
    assert expected <= entities
    assert len(RrdReader(recording).blueprints()) == 1


def test_poses_of_keyframes_queries_and_answers_are_those_of_the_dataset(dataset: Dataset, recording: Path) -> None:
    summer, winter = dataset.traversal("summer"), dataset.traversal("winter")
    root = f"/worlds/summer/pairs/{ACROSS}"
    found = {what: poses(recording, f"{root}/{what}") for what in ("keyframe", "query_true", "answers/exact")}
    off = poses(recording, f"{root}/answers/off")
    pairs = _in_order(dataset.pair_set(ACROSS).evaluated)
    for index, pair in enumerate(pairs, start=FIRST):
        T_world_query = winter.T_world_cam("cam0", pair.query_timestamp_ns)
        for what in ("query_true", "answers/exact"):
            np.testing.assert_allclose(found[what][index], T_world_query, atol=1e-5)
        if index > FIRST:
            np.testing.assert_allclose(off[index], T_world_query @ invert(OFF), atol=1e-5)
    assert FIRST not in off
    shown = found["keyframe"]
    for index, T in shown.items():  # a keyframe is logged where it changes
        np.testing.assert_allclose(T, summer.T_world_cam("cam0", pairs[index - FIRST].ref_timestamp_ns), atol=1e-5)


def test_both_timelines_say_which_pair_it_is(dataset: Dataset, recording: Path) -> None:
    logged = list(rows(recording, f"/told/{ACROSS}"))
    pairs = _in_order(dataset.pair_set(ACROSS).evaluated)
    assert [row["pair"] for row in logged] == list(range(FIRST, FIRST + len(pairs)))
    assert [nanoseconds(row["query_time"]) for row in logged] == [p.query_timestamp_ns for p in pairs]
    assert all(str(p.ref_timestamp_ns) in row["TextDocument:text"][0] for p, row in zip(pairs, logged, strict=True))
    timelines = {name for chunk in RrdReader(recording).stream() for name in chunk.timeline_names}
    assert timelines == {"pair", "query_time"}


def test_errors_are_those_of_the_answers_and_none_where_there_is_no_answer(recording: Path) -> None:
    entity = f"/errors/translation_error_m/{ACROSS}/off"
    found = {row["pair"]: row["Scalars:scalars"] for row in rows(recording, entity) if row.get("Scalars:scalars")}
    centre = float(np.linalg.norm(invert(OFF)[:3, 3]))
    assert FIRST not in found
    assert len(found) == 6
    assert all(value == pytest.approx([centre], abs=1e-6) for value in found.values())
    first = next(row for row in rows(recording, f"/told/{ACROSS}") if row["pair"] == FIRST)
    assert "| off | no answer" in first["TextDocument:text"][0]


def test_points_of_a_keyframe_lie_on_its_surfaces(dataset: Dataset, recording: Path) -> None:
    first = next(iter(rows(recording, f"/worlds/summer/pairs/{ACROSS}/points")))
    points = np.array(first["Points3D:positions"])
    pair = _in_order(dataset.pair_set(ACROSS).evaluated)[0]
    reference = dataset.traversal("summer").reference("cam0", pair.ref_timestamp_ns)
    assert reference.depth is not None
    uv, _ = reference.camera.project(points)
    u, v = np.rint(uv).astype(int).T
    assert len(points) == 50
    np.testing.assert_allclose(points[:, 2], reference.depth[v, u], rtol=0.01)


def test_images_are_those_of_the_dataset(dataset: Dataset, recording: Path) -> None:
    logged = {row["pair"]: row for row in rows(recording, f"/images/{ACROSS}/query_true")}
    pair = _in_order(dataset.pair_set(ACROSS).evaluated)[2]
    blob = np.array(logged[FIRST + 2]["EncodedImage:blob"][0], dtype=np.uint8)
    decoded = cv2.imdecode(blob, cv2.IMREAD_GRAYSCALE)
    image = dataset.traversal("winter").image("cam0", pair.query_timestamp_ns)
    assert decoded is not None
    assert np.mean(np.abs(decoded.astype(float) - image)) < 4.0  # JPEG


def test_every_and_limit_thin_pairs_out_along_the_drive(dataset: Dataset) -> None:
    sets = dataset.pair_sets()
    every = chosen_pairs(sets, 2, 0)
    assert [one.index for one in every] == list(range(len(every)))
    assert len(every) == sum((len(s.evaluated) + 1) // 2 for s in sets)
    limited = [one for one in chosen_pairs(sets, 1, 3) if one.pair_set.name == ACROSS]
    in_order = _in_order(dataset.pair_set(ACROSS).evaluated)
    assert len(limited) == 3
    assert (limited[0].pair.key, limited[-1].pair.key) == (in_order[0].key, in_order[-1].key)


def test_json_counts_what_was_written_and_what_was_left_out(dataset: Dataset, tmp_path: Path) -> None:
    out = tmp_path / "a.rrd"
    done = relocbench("view", dataset.root, "--out", out, "--limit", 2, "--json", "--quiet")
    told = json.loads(done.out)["counts"]
    of = sum(len(s.evaluated) for s in dataset.pair_sets())
    assert (told["pairs"], told["pair_sets"], told["methods"], told["pairs_left_out"]) == (4, 2, 0, of - 4)
    assert told["bytes"] == out.stat().st_size
    assert done.err == ""


def test_drives_with_frames_of_their_own_are_not_mixed(tmp_path: Path) -> None:
    shared = make_small_dataset(tmp_path / "shared")
    assert world_of_traversals(shared, shared.pair_sets()) == {"summer": "summer", "winter": "summer"}
    elsewhere = make_transform(np.eye(3), [5.0, 0.0, 0.0])
    own = make_small_dataset(tmp_path / "own", pose_fault=elsewhere)
    assert world_of_traversals(own, own.pair_sets()) == {"summer": "summer", "winter": "winter"}


def test_withheld_truth_shows_images_and_no_true_pose(tmp_path: Path) -> None:
    challenge = make_small_dataset(tmp_path / "D", truth=False)
    out = tmp_path / "a.rrd"
    assert relocbench("view", challenge.root, "--out", out, "--quiet").status == 0
    assert len(list(rows(out, f"/images/{ACROSS}/query_true"))) == 7
    assert poses(out, f"/worlds/summer/pairs/{ACROSS}/query_true") == {}


def test_distorted_images_are_undistorted() -> None:
    lens = Camera("radtan", 96, 72, 80.0, 80.0, 47.5, 35.5, (-0.25, 0.05, 0.0, 0.0))
    T_world_cam = small_pose(0)
    straight, _ = render(lens.pinhole(), T_world_cam)
    shown = as_pinhole(photograph(lens, T_world_cam), lens)
    inside = (slice(12, -12), slice(16, -16))
    assert np.mean(np.abs(shown[inside].astype(float) - straight[inside])) < 10
    bent = photograph(lens, T_world_cam)
    assert np.mean(np.abs(bent[inside].astype(float) - straight[inside])) > 15


@pytest.mark.thorough
def test_without_rerun_one_line_says_what_is_missing(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [m for m in sys.modules if m.split(".")[0] == "rerun" or m.startswith("relocbench.viewer")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rerun", None)
    done = relocbench("view", dataset.root, "--out", tmp_path / "a.rrd")
    assert done.status == 2
    assert "'rerun-sdk'" in done.complaint
    assert "'viewer'" in done.complaint
    picture = tmp_path / "a.png"
    asked = ["--pair-set", ACROSS, "--pair-index", 0, "--out", picture, "--quiet"]
    assert relocbench("view", dataset.root, *asked).status == 0
    assert picture.exists()


def test_the_warp_at_the_truth_fits_better_than_at_any_wrong_pose() -> None:
    camera = small_camera(160, 120)
    T_world_ref, T_world_query = small_pose(0), small_pose(3, lateral_m=0.1, yaw_deg=3.0)
    image, depth = render(camera, T_world_ref)
    seen, _ = render(camera, T_world_query)
    darker = (0.5 * seen + 20).astype(np.uint8)
    reference, query = Reference("r", 0, image, camera, depth=depth), Query("q", 1, darker, camera)
    T_query_ref = invert(T_world_query) @ T_world_ref
    true = warp_at(reference, query, T_query_ref)
    assert true.mean_residual is not None
    assert true.known.mean() > 0.5
    shifts = [make_transform(np.eye(3), t) for t in ([0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.3])]
    turns = [make_transform(so3_exp(w), [0, 0, 0]) for w in ([0.02, 0, 0], [0, 0.02, 0])]
    for wrong in (*shifts, *turns, invert(T_query_ref)):
        residual = warp_at(reference, query, wrong @ T_query_ref).mean_residual
        assert residual is not None
        assert residual > 1.5 * true.mean_residual


@pytest.mark.thorough
def test_the_picture_of_a_pair_tells_its_numbers_and_is_the_same_each_time(
    dataset: Dataset, results: Path, tmp_path: Path
) -> None:
    pair = _in_order(dataset.pair_set(ACROSS).evaluated)[3]
    asked = ["view", dataset.root, "--pair", *pair.key, "--results", results]
    done = [
        relocbench(*asked, "--method", method, "--out", tmp_path / f"{n}.png", "--json")
        for n, method in enumerate(("off", "off", "exact"))
    ]
    assert [d.status for d in done] == [0, 0, 0], done[0].err
    off, _, exact = (json.loads(d.out) for d in done)
    assert (off["pair_set"], off["answered"], off["counts"]["files_written"]) == (ACROSS, True, 1)
    assert off["translation_error_m"] == pytest.approx(np.linalg.norm(invert(OFF)[:3, 3]), abs=1e-6)
    assert off["residual_at_answer"] > 1.2 * off["residual_at_truth"]
    assert exact["residual_at_answer"] == pytest.approx(off["residual_at_truth"], rel=1e-3)
    first, again, other = ((tmp_path / f"{n}.png").read_bytes() for n in range(3))
    assert first == again
    assert first != other


@pytest.mark.thorough
def test_titles_in_any_script_and_of_any_length_are_drawn_without_a_warning(
    dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[str] = []
    pair_set = dataset.pair_set(ACROSS)
    monkeypatch.setattr(Condition, "__str__", lambda self: f"雪 $x_1$, {'W' * 200}")
    usual = Axes.set_title

    def titled(axes: Axes, label: str) -> None:
        drawn.append(label)
        usual(axes, label)

    monkeypatch.setattr(Axes, "set_title", titled)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        draw_pair(dataset, pair_set, pair_set.evaluated[0], "m" * 100, ShownAnswer(np.eye(4), 0.0, 0.0, None))
    assert any("雪" in title for title in drawn)
    assert all(len(line) <= 50 for title in drawn for line in title.splitlines())


@pytest.mark.thorough
def test_an_answer_at_the_true_pose_leaves_the_true_camera_in_sight(dataset: Dataset) -> None:
    pair_set = dataset.pair_set(ACROSS)
    pair = _in_order(pair_set.evaluated)[3]
    assert pair.T_query_ref is not None
    green = []
    for T in (pair.T_query_ref, OFF @ OFF @ pair.T_query_ref):
        drawn = draw_pair(dataset, pair_set, pair, "m", ShownAnswer(T, 0.0, 0.0, None))
        picture = cv2.imdecode(np.frombuffer(drawn, np.uint8), cv2.IMREAD_COLOR_RGB)
        assert picture is not None
        green.append(int((np.abs(picture.astype(int) - (0x00, 0x9E, 0x73)).max(axis=2) < 8).sum()))
    assert green[0] > 0.35 * green[1], green


@pytest.mark.thorough
def test_a_picture_says_where_a_method_did_not_answer(dataset: Dataset, results: Path, tmp_path: Path) -> None:
    pair = _in_order(dataset.pair_set(ACROSS).evaluated)[0]
    asked = ["view", dataset.root, "--pair", *pair.key, "--results", results, "--method", "off"]
    done = relocbench(*asked, "--out", tmp_path / "a.png", "--json")
    assert done.status == 0, done.err
    told = json.loads(done.out)
    assert (told["answered"], told["residual_at_answer"], told["translation_error_m"]) == (False, None, None)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--out", "a.png"], "ends in .rrd"),
        (["--pair", "1", "2", "--out", "a.png"], "no accepted pair of the times 1 and 2"),
        (["--pair-index", "0", "--out", "a.png"], "choose it by --pair-set"),
        (["--pair-set", ACROSS, "--pair-index", "99", "--out", "a.png"], "no pair 99"),
        (["--pair-set", "nowhere", "--out", "a.rrd"], "no pair set 'nowhere'"),
        (["--pair", "1", "2", "--pair-index", "0"], "give one of them"),
        (["--methods", "dso", "--out", "a.rrd"], "--results"),
    ],
)
def test_mistakes_are_one_line(dataset: Dataset, options: list[str], said: str) -> None:
    done = relocbench("view", dataset.root, *options)
    assert done.status == 2
    assert said in done.complaint


def test_an_unknown_method_and_results_of_another_dataset_are_refused(
    dataset: Dataset, results: Path, tmp_path: Path
) -> None:
    out = ["--out", tmp_path / "a.rrd"]
    unknown = relocbench("view", dataset.root, "--results", results, "--method", "nobody", *out)
    assert (unknown.status, "'nobody'; available: exact, off" in unknown.complaint) == (2, True)
    other = make_small_dataset(tmp_path / "other", name="other", frames=3)
    foreign = relocbench("view", other.root, "--results", results, *out)
    assert (foreign.status, "holds no results of other@" in foreign.complaint) == (2, True)
    inside = relocbench("view", dataset.root, "--out", dataset.root / "a.rrd")
    assert (inside.status, "lies inside the dataset" in inside.complaint) == (2, True)
    assert not list(tmp_path.glob("*.rrd"))


def test_a_rejected_pair_is_told_to_be_one(tmp_path: Path) -> None:
    dataset = make_small_dataset(tmp_path / "d", frames=3, size=(24, 18), rejected=1)
    (lost,) = dataset.pair_set(ACROSS).rejected
    done = relocbench("view", dataset.root, "--pair", *lost.key, "--out", tmp_path / "p.png")
    assert done.status == 2
    assert f"{lost.key[1]} of {ACROSS} was rejected (too few points agree)" in done.complaint


def test_a_disk_that_is_full_leaves_one_line_and_no_file(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / ".old.0123abcd.part.rrd").write_bytes(b"what a killed command left")

    def fails(*_: object, **__: object) -> None:
        raise RuntimeError("the thread that writes has ended")

    monkeypatch.setattr(RecordingStream, "flush", fails)
    done = relocbench("view", dataset.root, "--out", tmp_path / "v.rrd", "--pairs", 1, "-q")
    assert done.status == 2
    assert "v.rrd: could not be written to its end (the thread that writes has ended)" in done.complaint
    assert list(tmp_path.iterdir()) == []
