"""COLMAP's models: what pycolmap writes is read, in text and binary, and what is damaged is refused with its place."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from command_line import relocbench
from refusals import ErrorData, assert_names, refused
from retrievers_for_tests import Thumbnail
from small_dataset import photograph, render, small_pose

from baselines.feature_pnp import OrbPnp
from relocbench.arrays import Array, Image
from relocbench.datasets.checks.validation import validate_dataset
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.named_poses import read_named_poses, write_named_poses
from relocbench.datasets.importers.colmap import dataset as importer
from relocbench.datasets.importers.colmap.model import read_model
from relocbench.datasets.importers.photos.cameras import camera_of
from relocbench.datasets.importers.photos.lists import listed_pairs
from relocbench.datasets.importers.photos.points import Observations, keyframe_points
from relocbench.errors import ConfigError, DatasetError
from relocbench.evaluation.tables.errors import read_errors
from relocbench.evaluation.tables.schema import ALL
from relocbench.evaluation.tracking.colmap_export import colmap_camera
from relocbench.evaluation.tracking.exports import export_poses
from relocbench.execution import Run
from relocbench.geometry import Camera, apply, invert, transform_to_tq
from relocbench.metrics import pose_errors
from relocbench.progress import Silent

CAMERAS = (
    Camera("pinhole", 192, 144, 150.0, 152.0, 96.5, 70.25),
    Camera("pinhole", 176, 132, 130.0, 130.0, 88.0, 66.0),
    Camera("radtan", 200, 150, 160.0, 158.0, 99.0, 75.0, (-0.12, 0.02, 0.001, -0.0005)),
)
FRAMES = 6


def camera_number(frame: int) -> int:
    return frame % len(CAMERAS)


def true_pose(frame: int) -> Array:
    return small_pose(frame, lateral_m=0.05 * frame, yaw_deg=0.7 * frame)


def image_name(frame: int) -> str:
    return f"{'night' if frame >= 4 else 'day'}/{frame}.png"


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder ``images`` and models ``text`` and ``binary`` of it, written by pycolmap."""
    pycolmap: Any = pytest.importorskip("pycolmap")
    root = tmp_path_factory.mktemp("colmap")
    found = pycolmap.Reconstruction()
    for number, camera in enumerate(CAMERAS, start=1):
        name, width, height, *numbers = colmap_camera(camera).split()
        made = pycolmap.Camera(
            camera_id=number, model=name, width=int(width), height=int(height), params=list(map(float, numbers))
        )
        found.add_camera_with_trivial_rig(made)
    rng = np.random.default_rng(4)
    _, depth = render(CAMERAS[0], true_pose(0))
    uv = rng.uniform([2, 2], [189, 141], (400, 2))
    z = depth[np.rint(uv[:, 1]).astype(int), np.rint(uv[:, 0]).astype(int)].astype(np.float64)
    # The scene is flat around these pixels only nearly; the points are what the model holds, not the surface.
    rays, _ = CAMERAS[0].unproject(uv[z > 0])
    points = apply(true_pose(0), rays * z[z > 0, None])
    tracks: list[Any] = [pycolmap.Track() for _ in points]
    for frame in range(FRAMES):
        camera, T_cam_world = CAMERAS[camera_number(frame)], invert(true_pose(frame))
        pixels, valid = camera.project(apply(T_cam_world, points))
        rows = np.flatnonzero(valid & camera.contains(pixels))
        keypoints = [pycolmap.Point2D(pixels[row] + 0.5) for row in rows]
        image = pycolmap.Image(
            name=image_name(frame),
            camera_id=camera_number(frame) + 1,
            image_id=frame + 1,
            points2D=pycolmap.Point2DList([pycolmap.Point2D(np.zeros(2)), *keypoints]),
        )
        translation, quaternion = transform_to_tq(T_cam_world)
        found.add_image_with_trivial_frame(
            image, pycolmap.Rigid3d(pycolmap.Rotation3d(np.array(quaternion)), np.array(translation))
        )
        for index, row in enumerate(rows, start=1):
            tracks[row].add_element(frame + 1, index)
        path = root / "images" / image_name(frame)
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), photograph(camera, true_pose(frame)))
    for point, track in zip(points, tracks, strict=True):
        if track.length():
            found.add_point3D(point, track)
    for name, write in (("text", found.write_text), ("binary", found.write_binary)):
        (root / name).mkdir()
        write(str(root / name))
    return root


def build(source: Path, out: Path, **options: Any) -> Dataset:
    settings = importer.Options.model_validate({"correspondences": 20, **options})
    return importer.build([source], settings, out, Silent(), Run(1))


def test_text_and_binary_say_what_pycolmap_was_told(model: Path) -> None:
    text, binary = read_model(model / "text"), read_model(model / "binary")
    assert list(text.cameras.values()) == list(binary.cameras.values()) == list(CAMERAS)
    for frame in range(FRAMES):
        for found in (text, binary):
            image = found.images[frame + 1]
            assert (image.name, image.camera) == (image_name(frame), camera_number(frame) + 1)
            np.testing.assert_allclose(invert(image.T_cam_world), true_pose(frame), atol=1e-9)
        np.testing.assert_array_equal(text.images[frame + 1].points, binary.images[frame + 1].points)
    np.testing.assert_array_equal(text.point_ids, binary.point_ids)
    np.testing.assert_allclose(text.xyz, binary.xyz, atol=1e-9)
    assert np.isnan(text.error_px).all()


@pytest.mark.parametrize("kind", ["text", "binary"])
def test_a_model_becomes_a_dataset_with_a_camera_for_each_image(model: Path, tmp_path: Path, kind: str) -> None:
    dataset = build(model / kind, tmp_path / "d", queries=["night/*"], metres_per_unit=2.0)
    assert not validate_dataset(dataset.root, Silent()).faults
    drive, query = dataset.traversal("map"), dataset.traversal("query")
    assert list(drive.names.values()) == [image_name(frame) for frame in range(4)]
    assert list(query.names.values()) == [image_name(frame) for frame in (4, 5)]
    for frame, time in enumerate(drive.timestamps("photo")):
        assert drive.camera("photo", time) == CAMERAS[camera_number(frame)].pinhole()
        expected = true_pose(frame)
        expected[:3, 3] *= 2.0
        np.testing.assert_allclose(drive.T_world_cam("photo", time), expected, atol=1e-9)
        points = drive.points("photo", time)
        assert points is not None
        assert len(points) > 100
        _, depth = render(drive.camera("photo", time), true_pose(frame))
        at = np.rint(points.uv).astype(int)
        z = 2.0 * depth[at[:, 1], at[:, 0]]
        assert np.median(np.abs(1.0 / points.inverse_depth - z) / z) < 0.02
        assert np.all(points.sigma > 0)


@pytest.mark.thorough
def test_the_uncertainty_of_depth_is_that_of_triangulating_noisy_keypoints(model: Path) -> None:
    """Points of one image are triangulated again and again from the other images' noisy keypoints."""
    found = read_model(model / "binary")
    seen = Observations.of(found)
    pinholes = {number: camera.pinhole() for number, camera in found.cameras.items()}
    points = keyframe_points(found, seen, pinholes, 1, 6, 0.8, 1.0)
    rows = np.flatnonzero(seen.counts == 6)[:12]
    T_ref_world = found.images[1].T_cam_world
    rng = np.random.default_rng(0)
    ratios = []
    for row in rows:
        p = apply(T_ref_world, found.xyz[row][None])[0]
        uv = pinholes[found.images[1].camera].project(p[None])[0][0]
        k = int(np.argmin(np.linalg.norm(points.uv - uv, axis=1)))
        guesses = []
        for _ in range(60):
            noise = {j: rng.normal(scale=0.8, size=2) for j in range(2, 7)}

            def errors(rho: float, p: Array = p, noise: dict[int, Array] = noise) -> Array:
                out = []
                for j, e in noise.items():
                    other = found.images[j]
                    T = other.T_cam_world @ invert(T_ref_world)
                    camera = pinholes[other.camera]
                    out.append(
                        camera.project(apply(T, (p / p[2] / rho)[None]))[0][0]
                        - camera.project(apply(T, p[None]))[0][0]
                        - e
                    )
                return np.concatenate(out)

            rho = 1.0 / p[2]
            for _ in range(4):
                r, step = errors(rho), 1e-6 * rho
                slope = (errors(rho + step) - r) / step
                rho -= float(slope @ r / (slope @ slope))
            guesses.append(rho)
        ratios.append(np.std(guesses) / points.sigma[k])
    assert 0.8 < np.median(ratios) < 1.25


def test_poses_are_found_across_cameras(model: Path, tmp_path: Path) -> None:
    dataset = build(model / "text", tmp_path / "d", queries=["night/*"])
    tracker = OrbPnp(features=800)
    pair_set = dataset.pair_set("map__query__photo")
    assert len(pair_set.pairs) == 2
    for pair in pair_set.pairs:
        prepared = tracker.prepare(dataset.reference(pair_set, pair))
        answer = tracker.track(prepared, dataset.query(pair_set, pair)).T_query_ref
        assert answer is not None
        assert pair.T_query_ref is not None
        assert pose_errors(answer[None], pair.T_query_ref[None]).translation_error_m[0] < 0.25


def test_pairs_may_be_listed_and_truth_withheld(model: Path, tmp_path: Path) -> None:
    """Queries that the model does not hold: their cameras and keyframes from lists, and their poses from another."""
    shutil.copytree(model / "images", tmp_path / "images")
    (tmp_path / "images/new.png").write_bytes((model / "images/night/4.png").read_bytes())
    (tmp_path / "queries.txt").write_text(f"new.png {colmap_camera(CAMERAS[camera_number(4)])}\n")
    (tmp_path / "pairs.txt").write_text("new.png day/3.png\nnew.png night/5.png\n")
    given = {"images": tmp_path / "images", "query_list": tmp_path / "queries.txt", "pairs": tmp_path / "pairs.txt"}
    withheld = build(model / "text", tmp_path / "withheld", **given)
    assert [p.T_query_ref for p in withheld.pair_set("map__query__photo").pairs] == [None, None]
    translation, (x, y, z, w) = transform_to_tq(invert(true_pose(4)))
    numbers = " ".join(map(repr, map(float, (w, x, y, z, *translation))))
    (tmp_path / "poses.txt").write_text(f"new.png {numbers}\n")
    np.testing.assert_allclose(invert(read_named_poses(tmp_path / "poses.txt")["new.png"]), true_pose(4), atol=1e-9)
    told = build(model / "text", tmp_path / "told", **given, query_poses=tmp_path / "poses.txt")
    names = told.traversal("map").names
    for pair in told.pair_set("map__query__photo").pairs:
        frame = int(Path(names[pair.ref_timestamp_ns]).stem)
        assert pair.T_query_ref is not None
        np.testing.assert_allclose(pair.T_query_ref, invert(true_pose(4)) @ true_pose(frame), atol=1e-8)
    assert not validate_dataset(told.root, Silent()).faults


def test_what_is_exported_is_imported_again(model: Path, tmp_path: Path) -> None:
    """The export's model is read by pycolmap as we read it, and gives the poses and the answers of the dataset."""
    pycolmap: Any = pytest.importorskip("pycolmap")
    first = build(model / "binary", tmp_path / "first", queries=["night/*"], copy_images=True)
    (out,) = export_poses(first, ["map__query__photo"], "colmap", tmp_path / "export", tmp_path, None)
    theirs = pycolmap.Reconstruction(str(out))
    again = build(
        out, tmp_path / "again", images=first.layout.traversals, queries=["query/*"], min_track=1, metres_per_unit=1.0
    )
    ours = read_model(out)
    assert {image.name for image in theirs.images.values()} == {image.name for image in ours.images.values()}
    for number, image in theirs.images.items():
        matrix = np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])
        np.testing.assert_allclose(ours.images[number].T_cam_world, matrix, atol=1e-9)
    tracker = OrbPnp(features=800)
    answers = []
    for dataset in (first, again):
        pair_set = dataset.pair_set("map__query__photo")
        for pair in pair_set.pairs:
            assert pair.T_query_ref is not None
            answer = tracker.track(
                tracker.prepare(dataset.reference(pair_set, pair)), dataset.query(pair_set, pair)
            ).T_query_ref
            assert answer is not None
            answers.append((pair.T_query_ref, answer))
    for (truth, answer), (truth_again, answer_again) in zip(answers[:2], answers[2:], strict=True):
        np.testing.assert_allclose(truth, truth_again, atol=1e-9)
        # The export has no uncertainties of depths, which weigh matches.
        assert pose_errors(answer_again[None], answer[None]).translation_error_m[0] < 0.02


def test_results_of_hloc_are_scored(model: Path, tmp_path: Path) -> None:
    """Named absolute poses, in the unit of the model: exact ones score in full, one that is off by 1 m does not."""
    dataset = build(model / "text", tmp_path / "d", queries=["night/*"], metres_per_unit=2.0)
    poses = {image_name(4): invert(true_pose(4)), "5.png": invert(true_pose(5))}
    poses["5.png"][:3, 3] += [0.5, 0.0, 0.0]
    write_named_poses(tmp_path / "results.txt", poses)
    told = relocbench(
        "evaluate", "-d", dataset.root, "-m", "hloc", "--predictions", tmp_path / "results.txt", "--out",
        tmp_path / "r", "--json",
    )  # fmt: skip
    assert told.status == 0, told.err
    (table,) = (tmp_path / "r").rglob("hloc/*.errors.csv")
    errors = [pair.translation_error_m for pair in read_errors(table).of_group(ALL)]
    np.testing.assert_allclose(errors, [0.0, 1.0], atol=1e-6)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("dusk.png 1 0 0 0 0 0 0\n", ("p.txt", None, "dusk.png", "map__query__photo")),
        ("4.png 1 0 0 0 0 0 0\nnight/4.png 1 0 0 0 0 0 0\n", ("p.txt", None, "night/4.png", "second time")),
        ("4.png 2 0 0 0 0 0 0\n", ("p.txt", 1, "norm 2")),
        ("4.png 1 0 0 0 0 0 0\n4.png 1 0 0 0 0 0\n", ("p.txt", 2, "7 numbers", "found 6")),
    ],
)
def test_bad_results_of_hloc_are_refused(model: Path, tmp_path: Path, text: str, message: ErrorData) -> None:
    dataset = build(model / "text", tmp_path / "d", queries=["night/*"])
    (tmp_path / "p.txt").write_text(text)
    bad = relocbench(
        "evaluate", "-d", dataset.root, "-m", "x", "--predictions", tmp_path / "p.txt", "-o", tmp_path / "r"
    )
    assert bad.status == 2
    assert_names(bad.complaint, *message)


def test_exports_for_hloc_are_read_back(model: Path, tmp_path: Path) -> None:
    dataset = build(model / "text", tmp_path / "d", queries=["night/*"])
    (out,) = export_poses(dataset, ["map__query__photo"], "hloc", tmp_path / "e", tmp_path, None)
    poses = read_named_poses(out / "poses.txt")
    for frame in (4, 5):
        np.testing.assert_allclose(invert(poses[image_name(frame)]), true_pose(frame), atol=1e-8)
    again = build(model / "text", tmp_path / "again", queries=["night/*"], pairs=out / "pairs.txt")
    first, second = (d.pair_set("map__query__photo").pairs for d in (dataset, again))
    assert [p.key for p in first] == [p.key for p in second]


def test_rankings_exported_for_hloc_are_read_back(model: Path, tmp_path: Path) -> None:
    """The lists name images as the model does, keep the order of the ranking, and are pairs of a dataset again."""
    dataset = build(model / "text", tmp_path / "d", queries=["night/*"])
    ranked = relocbench(
        "evaluate-retrieval", "-d", dataset.root, "-m", "t=retrievers_for_tests:Thumbnail", "-j", 0, "--positives",
        "pairs", "-o", tmp_path / "r", "-q",
    )  # fmt: skip
    assert ranked.status == 0, ranked.err
    words = ("export", "-d", dataset.root, "-f", "hloc", "-r", "t", "--top", 3, "--results", tmp_path / "r")
    told = relocbench(*words, "-o", tmp_path / "e")
    assert told.status == 0, told.err
    path = tmp_path / "e" / "map__query__photo" / "pairs.txt"
    assert told.out.split() == [str(path)]
    pairs = [pair for _, pair in listed_pairs(path)]
    seen = {
        image_name(frame): Thumbnail().vector(cv2.cvtColor(dataset_image(dataset, frame), cv2.COLOR_GRAY2RGB))
        for frame in range(FRAMES)
    }
    expected = [
        (image_name(frame), image_name(near))
        for frame in (4, 5)
        for near in sorted(range(4), key=lambda k: -float(seen[image_name(k)] @ seen[image_name(frame)]))[:3]
    ]
    assert pairs == expected
    again = build(model / "text", tmp_path / "again", queries=["night/*"], pairs=path)
    names = {name: again.traversal(name).names for name in ("map", "query")}
    found = again.pair_set("map__query__photo").pairs
    assert {(names["query"][p.query_timestamp_ns], names["map"][p.ref_timestamp_ns]) for p in found} == set(expected)


def dataset_image(dataset: Dataset, frame: int) -> Image:
    traversal = dataset.traversal("query" if frame >= 4 else "map")
    (time,) = (time for time, name in traversal.names.items() if name == image_name(frame))
    return traversal.image("photo", time)


@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_a_binary_file_that_is_cut_off_is_refused(model: Path, tmp_path: Path, name: str, share: float) -> None:
    shutil.copytree(model / "binary", tmp_path / "m")
    path = tmp_path / "m" / f"{name}.bin"
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(DatasetError) as bad:
        read_model(tmp_path / "m")
    assert bad.value.path == path
    path.write_bytes(data + b"\0")
    with refused(DatasetError, path, None, "1 bytes"):
        read_model(tmp_path / "m")


def damaged(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new, 1)


FAULTS: list[tuple[str, Callable[[list[str]], None], tuple[object, ...]]] = [
    ("cameras", lambda rows: rows.append("9 PINHOLE 4 4 1 1 1"), ("PINHOLE", "4 parameters", 3)),
    ("cameras", lambda rows: rows.append("9 FOV 4 4 1 1 1 1 1"), ("FOV",)),
    ("cameras", lambda rows: rows.append("9 PINHOLE 4 4"), ("CAMERA_ID",)),
    ("cameras", lambda rows: rows.append("9 PINHOLE 4 x 1 1 1 1"), ("size", "x")),
    ("images", lambda rows: rows.append("9 2 0 0 0 0 0 0 1 a.png"), ("norm 2", 1)),
    ("images", lambda rows: rows.append("9 1 0 0 0 0 0 1 a.png"), ("IMAGE_ID",)),
    ("images", lambda rows: rows.extend(["9 1 0 0 0 0 0 0 7 a.png", ""]), ("a.png", "camera 7")),
    ("images", lambda rows: rows.extend(["9 1 0 0 0 0 0 0 1 a.png", "1 1 777777"]), ("a.png", "point 777777")),
    ("images", lambda rows: rows.extend(["9 1 0 0 0 0 0 0 1 a.png", "1 1"]), ("POINTS2D",)),
    ("images", lambda rows: rows.extend(["9 1 0 0 0 0 0 0 1 day/1.png", ""]), ("second", "day/1.png")),
    ("points3D", lambda rows: rows.append("1 2 3"), ("POINT3D_ID",)),
    ("points3D", lambda rows: rows.append("900000 2 3 nan 0 0 0 1"), ("Z",)),
]


@pytest.mark.parametrize(("name", "change", "names"), FAULTS)
def test_a_bad_line_is_refused(
    model: Path, tmp_path: Path, name: str, change: Callable[[list[str]], None], names: tuple[object, ...]
) -> None:
    shutil.copytree(model / "text", tmp_path / "m")
    path = tmp_path / "m" / f"{name}.txt"
    rows = path.read_text().rstrip("\n").split("\n")
    change(rows)
    path.write_text("\n".join(rows) + "\n")
    with refused(DatasetError, path, None, *names):
        read_model(tmp_path / "m")


def test_options_that_do_not_fit_are_refused(model: Path, tmp_path: Path) -> None:
    for options, told in (
        ({"queries": ["dusk/*"]}, ("", None, "dusk/*")),
        ({"queries": ["*"]}, ("", None, "all 6 images")),
        ({"query_poses": tmp_path}, ("", None, "--query-poses")),
        ({"query_list": tmp_path, "queries": ["a"]}, ("", None, "--queries", "--query-list")),
        ({"query_list": tmp_path}, ("", None, "--pairs")),
        ({"pairs": tmp_path, "elsewhere": 3}, ("", None, "--pairs")),
        ({"images": tmp_path / "none"}, ("none",)),
    ):
        with refused((DatasetError, ConfigError), *told):
            build(model / "text", tmp_path / "d", **options)
    (tmp_path / "pairs.txt").write_text("day/0.png day/9.png\n")
    with refused(DatasetError, "pairs.txt", 1, "day/9.png"):
        build(model / "text", tmp_path / "p", pairs=tmp_path / "pairs.txt")


def test_the_command_builds_and_names_what_is_missing(model: Path, tmp_path: Path) -> None:
    done = relocbench("build-dataset", "colmap", model / "text", "--queries", "night/*", "--out", tmp_path / "d", "-q")
    assert done.status == 0, done.err
    bad = relocbench("build-dataset", "colmap", tmp_path / "d", "--out", tmp_path / "e")
    assert bad.status == 2
    assert_names(bad.complaint, tmp_path / "d", None, "cameras.bin", "cameras.txt")


@pytest.mark.parametrize(
    ("model_name", "parameters", "expected"),
    [
        ("SIMPLE_PINHOLE", [9, 4, 3], Camera("pinhole", 8, 6, 9, 9, 3.5, 2.5)),
        ("SIMPLE_RADIAL", [9, 4, 3, 0.1], Camera("radtan", 8, 6, 9, 9, 3.5, 2.5, (0.1, 0, 0, 0))),
        ("RADIAL", [9, 4, 3, 0.1, 0.2], Camera("radtan", 8, 6, 9, 9, 3.5, 2.5, (0.1, 0.2, 0, 0))),
        ("RADIAL_FISHEYE", [9, 4, 3, 0.1, 0.2], Camera("equidistant", 8, 6, 9, 9, 3.5, 2.5, (0.1, 0.2, 0, 0))),
        ("FULL_OPENCV", [9, 7, 4, 3, *[0.01] * 8], Camera("radtan", 8, 6, 9, 7, 3.5, 2.5, (0.01,) * 8)),
    ],
)
def test_camera_models_project_as_pycolmap_does(model_name: str, parameters: list[float], expected: Camera) -> None:
    camera = camera_of(model_name, 8, 6, list(map(float, parameters)))
    assert camera == expected
    pycolmap: Any = pytest.importorskip("pycolmap")
    theirs = pycolmap.Camera(camera_id=1, model=model_name, width=8, height=6, params=parameters)
    rays = np.array([[0.1, -0.05, 1.0], [-0.2, 0.1, 2.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(camera.project(rays)[0] + 0.5, theirs.img_from_cam(rays), atol=1e-9)
