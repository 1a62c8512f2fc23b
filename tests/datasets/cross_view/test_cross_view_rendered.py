"""A rendered cross-view set: where its cameras are, what is a place, and the same bytes however it is built."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest
from command_line import relocbench
from refusals import ErrorData, assert_names, refused

from relocbench.datasets.core.images import read_image
from relocbench.datasets.cross_view import CrossViewSet, open_cross_view
from relocbench.datasets.cross_view.rendered import flight
from relocbench.datasets.cross_view.rendered.flight import Optics
from relocbench.datasets.cross_view.rendered.places import Building, buildings, spread
from relocbench.datasets.cross_view.rendered.plan import Views, choose_places, photos_of
from relocbench.datasets.cross_view.rendered.work import PhotoUnit, render_unit, seen_by
from relocbench.datasets.importers.rendered import cross_view
from relocbench.datasets.synthetic.conditions.condition import condition_named
from relocbench.datasets.synthetic.jobs import scenes
from relocbench.datasets.synthetic.town.network import StreetNetwork
from relocbench.errors import ConfigError, DatasetError
from relocbench.execution import Run
from relocbench.geometry import apply, invert, is_rotation, transform_from_tq
from relocbench.progress import Silent

pytestmark = pytest.mark.usefixtures("towns_kept")
TINY = {
    "split": "test",
    "places": 3,
    "distractors": 1,
    "drone_views": 2,
    "street_views": 1,
    "size": 48,
    "extent": 190.0,
    "conditions": ("Sunny", "Overcast"),
}
TOWN = scenes.DistrictSpec(0, "test", 190.0)
HOUSE = Building(7, np.array([12.0, -30.0]), np.array([9.0, 10.0]), 14.0)
OPTICS = Optics(64, 80.0)


def build(out: Path, workers: int = 1, **options: object) -> CrossViewSet:
    chosen = cross_view.Options.model_validate({**TINY, **options})
    return cross_view.build_places([], chosen, out, Silent(), Run(workers))


def content(root: Path) -> dict[str, bytes]:
    return {p.relative_to(root).as_posix(): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}


def test_the_drone_comes_down_in_three_rounds_and_always_faces_the_house() -> None:
    poses = flight.drone(HOUSE, 54, 110.0, 0.3)
    target = np.array([*HOUSE.centre, 7.0])
    away = np.array([T[:3, 3] - target for T in poses])
    distance = np.linalg.norm(away, axis=1)
    assert distance[0] == pytest.approx(110.0)
    assert distance[0] / distance[-1] == pytest.approx(256 / 121.5)
    assert np.all(np.diff(distance) < 0)
    bearing = np.unwrap(np.arctan2(away[:, 1], away[:, 0]))
    assert bearing[-1] - bearing[0] == pytest.approx(2 * np.pi * 3 * 53 / 54)
    camera = OPTICS.camera("drone")
    for T_world_cam in poses:
        assert is_rotation(T_world_cam[:3, :3], 1e-9)
        assert T_world_cam[2, 0] == pytest.approx(0.0)  # level
        assert T_world_cam[2, 1] < 0  # the image's down is the world's
        seen, ahead = camera.project(apply(invert(T_world_cam), target[None]))
        assert ahead.all()
        assert seen[0] == pytest.approx([31.5, 31.5])


@pytest.mark.parametrize("turn", [0.0, 0.7, 4.0])
def test_the_satellite_looks_straight_down_north_up(turn: float) -> None:
    T_world_cam = flight.satellite(HOUSE, turn)
    assert is_rotation(T_world_cam[:3, :3], 1e-9)
    north = np.array([-np.sin(turn), np.cos(turn)])
    points = [[*HOUSE.centre, 0.0], [*(HOUSE.centre + 40.0 * north), 0.0]]
    seen, _ = OPTICS.camera("satellite").project(apply(invert(T_world_cam), np.array(points)))
    assert seen[0] == pytest.approx([31.5, 31.5])
    assert seen[1] == pytest.approx([31.5, 31.5 - 32.0])  # half of the 80 m that the image covers


def test_street_views_stand_on_the_nearest_street_and_face_the_house() -> None:
    nodes = np.array([[-100.0, -20.0], [100.0, -20.0], [100.0, 80.0]])
    edges = {(0, 1): 0, (1, 0): 0, (1, 2): 1, (2, 1): 1}
    network = StreetNetwork(nodes, edges, (), {}, frozenset())
    poses = flight.street(HOUSE, 3, network)
    assert [T[0, 3] for T in poses] == pytest.approx([7.0, 12.0, 17.0])
    assert all(T[1:3, 3] == pytest.approx([-20.0, 1.6]) for T in poses)
    assert all((T[:3, :3] @ [0, 0, 1])[1] < 0 for T in poses)


@pytest.mark.thorough
def test_places_keep_their_distance_and_none_is_of_a_row_of_equal_houses() -> None:
    district = scenes.district(TOWN)
    every, found = buildings(district, every=True), buildings(district)
    assert 5 < len(found) < len(every)
    for front in district.periodic.fronts:
        middle = (front.start + front.end) / 2
        assert min(np.linalg.norm(b.centre - middle) for b in every) < 10
        assert min(np.linalg.norm(b.centre - middle) for b in found) > 10
    chosen = spread(found, 25.0, np.random.default_rng(0))
    gaps = [np.linalg.norm(a.centre - b.centre) for a in chosen for b in chosen if a is not b]
    assert min(gaps) >= 25.0


def test_no_view_has_headlights_and_satellites_have_no_weather_in_the_air() -> None:
    views = Views(OPTICS, 54, 0, 110.0, False, "Rain", ("Rain",))
    for name in ("Rain", "Fog", "Snow", "Night"):
        factors = condition_named(name).factors
        above, drone = (seen_by(view, factors, views) for view in ("satellite", "drone"))
        assert not any(seen_by(view, factors, views).headlights for view in ("drone", "satellite", "street"))
        assert above.rain_mm_h == above.snowfall_mm_h == above.fog_density == above.lens_drops == 0
        assert (above.wetness, above.snow_cover) == (factors.wetness, factors.snow_cover)
        assert drone.fog_density * views.far_m <= 1.0 + 1e-9
        assert drone.rain_mm_h == factors.rain_mm_h


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> CrossViewSet:
    return build(tmp_path_factory.mktemp("cross-view") / "out")


@pytest.mark.thorough
def test_the_set_has_university_1652s_layout(made: CrossViewSet) -> None:
    assert sorted(p.relative_to(made.root).as_posix() for p in (made.root / "test").glob("*/5000/*")) == [
        "test/gallery_drone/5000/image-01.png",
        "test/gallery_drone/5000/image-02.png",
        "test/gallery_satellite/5000/5000.png",
        "test/gallery_street/5000/1.png",
        "test/query_drone/5000/image-01.png",
        "test/query_drone/5000/image-02.png",
        "test/query_satellite/5000/5000.png",
        "test/query_street/5000/1.png",
    ]
    tasks = {task.name: task for task in made.tasks()}
    assert len(tasks) == 6
    task = tasks["drone-satellite"]
    assert (len(task.queries), len(task.gallery)) == (6, 4)  # one place is a distractor
    assert (task.condition_query, task.condition_gallery) == ("Overcast", "Sunny")
    assert task.relevance.positives.tolist() == [1] * 6
    assert task.queries[0].image.shape == (48, 48, 3)


@pytest.mark.thorough
def test_images_show_something_and_no_two_are_alike(made: CrossViewSet) -> None:
    shots = [shot for folder in made.galleries.values() for shot in folder]
    pictures = [shot.view.image.astype(float) for shot in shots]
    assert all(picture.std() > 12 for picture in pictures)
    assert len({picture.tobytes() for picture in pictures}) == len(shots) == 16


@pytest.mark.thorough
def test_poses_are_those_of_the_images_and_face_their_places(made: CrossViewSet) -> None:
    with (made.root / "places.csv").open() as stream:
        places = {row["class"]: row for row in csv.DictReader(stream)}
    with (made.root / "poses.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert {row["image"] for row in rows} == {k for k in content(made.root) if k.endswith(".png")}
    for row in rows:
        pose = [float(row[c]) for c in ("tx", "ty", "tz", "qx", "qy", "qz", "qw")]
        T_world_cam = transform_from_tq(pose[:3], pose[3:])
        place = places[row["class"]]
        height = float(place["height_m"]) * {"drone": 0.5, "satellite": 0.0, "street": 0.45}[row["view"]]
        target = np.array([float(place["x_m"]), float(place["y_m"]), height])
        x, y, z = apply(invert(T_world_cam), target[None])[0]
        assert abs(x / z) < 1e-3
        assert abs(y / z) < 1e-3
        assert row["condition"] == ("Sunny" if row["view"] == "satellite" else "Overcast")


@pytest.mark.thorough
def test_a_killed_build_goes_on_and_ends_with_the_same_bytes(made: CrossViewSet, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(made.root, out)
    for name in ("dataset.yaml", "manifest.csv", "poses.csv", "places.csv"):
        (out / name).unlink()
    shutil.rmtree(out / "test" / "query_drone")
    (out / "test/gallery_satellite/5001/5001.png").unlink()
    torn = out / "test/gallery_satellite/5002/5002.png"
    torn.write_bytes(torn.read_bytes()[:500])
    (out / "test/gallery_drone/5001/.image-01.0123abcd.part.png").write_bytes(b"half")
    with refused(DatasetError, out, None, "unfinished"):
        open_cross_view(out)
    assert build(out).fingerprint == made.fingerprint
    assert content(out) == content(made.root)


@pytest.mark.thorough
def test_a_finished_set_is_not_made_again_but_mended(made: CrossViewSet, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(made.root, out)
    times = {p: p.stat().st_mtime_ns for p in out.rglob("*.png")}
    assert build(out).fingerprint == made.fingerprint
    assert times == {p: p.stat().st_mtime_ns for p in out.rglob("*.png")}
    (out / "test/gallery_satellite/5000/5000.png").unlink()
    with refused(DatasetError, "5000.png", None, "manifest.csv"):
        open_cross_view(out)
    assert build(out).fingerprint == made.fingerprint
    assert content(out) == content(made.root)


@pytest.mark.thorough
def test_what_was_added_or_changed_is_noticed(made: CrossViewSet, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(made.root, out)
    shutil.copy(out / "test/gallery_street/5000/1.png", out / "test/gallery_street/5000/2.png")
    with refused(DatasetError, "2.png", None, "manifest.csv"):
        open_cross_view(out)
    with refused(DatasetError, "2.png"):
        build(out)
    (out / "test/gallery_street/5000/2.png").unlink()
    manifest = out / "manifest.csv"
    listed = manifest.read_text()
    manifest.write_text(listed.replace("gallery_street/5000", "gallery_street/5001", 1))
    with refused(DatasetError, "dataset.yaml", None, "manifest.csv", "fingerprint"):
        open_cross_view(out)
    manifest.write_text(listed)
    with refused(DatasetError, out, None, "options", "--out"):
        build(out, seed=1)


@pytest.mark.thorough
def test_an_image_depends_on_nothing_that_was_rendered_before(made: CrossViewSet, tmp_path: Path) -> None:
    """So that it is the same whichever worker renders it, and after what."""
    factors = condition_named("Overcast").factors
    views = Views(Optics(48, 80.0), 2, 1, 110.0, False, "Sunny", ("Overcast",))
    (place, network), (other, _) = choose_places("test", 3, 1, None, 25.0, 190.0, 0, Silent())[:2]
    chosen = [p for x in (other, place) for p in photos_of(x, network, views, "test", 0) if p.view == "drone"]
    assert render_unit(PhotoUnit(tmp_path, views, factors, tuple(reversed(chosen)))) == 4
    before = content(made.root)
    after = content(tmp_path)
    assert sorted(after) == sorted(p.keys[0] for p in chosen)
    assert all(before[key] == data for key, data in after.items())


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--conditions", "Hail"), ("", None, "Hail")),
        (("--conditions", "Sunny,Rain,Rain"), ("", None, "--conditions")),
        (("--split", "train", "--distractors", "3"), ("", None, "--distractors")),
        (("--places", "6000"), ("", None, "5000")),
        (("--size", "8"), ("", None, "--size", "32")),
        (("--drone-views", "0"), ("", None, "--drone-views")),
    ],
)
def test_bad_options_are_one_line(tmp_path: Path, options: tuple[str, ...], words: ErrorData) -> None:
    outcome = relocbench("build-dataset", "cross-view", "--out", tmp_path / "o", *options)
    assert outcome.status == 2
    assert_names(outcome.complaint, *words)


def test_more_places_than_the_towns_have_room_for_are_refused(tmp_path: Path) -> None:
    with refused(ConfigError, "", None, "1", "190", "25", "90"):
        build(tmp_path / "o", places=90, distractors=0, towns=1)


@pytest.mark.thorough
def test_the_command_prints_what_it_made(made: CrossViewSet) -> None:
    given = [
        x for k, v in TINY.items() for x in (f"--{k.replace('_', '-')}", ",".join(v) if isinstance(v, tuple) else v)
    ]
    outcome = relocbench("build-dataset", "cross-view", "--out", made.root, *given)
    assert outcome.status == 0
    for words in ("test/query_drone", "test/gallery_satellite", "Overcast", made.fingerprint[:12]):
        assert words in outcome.out
    assert read_image(made.root / "test/query_drone/5000/image-01.png").shape == (48, 48, 3)


@pytest.mark.thorough
def test_inspect_and_validate_know_the_set(made: CrossViewSet, tmp_path: Path) -> None:
    shown = relocbench("inspect", made.root, "--json")
    assert '"folder": "test/gallery_drone", "classes": 4, "images": 8' in shown.out
    assert "are for pairs" in relocbench("inspect", made.root, "--pictures", tmp_path / "p").complaint
    whole = relocbench("validate", made.root, "--quiet")
    assert (whole.status, whole.out.strip()) == (0, f"{made.root}: no fault (cross-view set)")
    out = tmp_path / "out"
    shutil.copytree(made.root, out)
    path = out / "test/gallery_drone/5001/image-01.png"
    data = bytearray(path.read_bytes())
    data[200] ^= 255
    path.write_bytes(bytes(data))
    found = relocbench("validate", out, "--quiet")
    assert found.status == 2
    assert "gallery_drone/5001/image-01.png" in found.out
    assert relocbench("validate", out, "--quick", "--quiet").status == 0
