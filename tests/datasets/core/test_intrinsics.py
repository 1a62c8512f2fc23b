"""Images with intrinsics of their own: what trackers get, what is refused, and what the digests cover."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused
from small_dataset import ACROSS, CAMERA, make_small_dataset, render

from baselines.feature_pnp import OrbPnp
from relocbench.datasets.checks.validation import validate_dataset
from relocbench.datasets.core import fingerprint
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.images import write_depth, write_image
from relocbench.datasets.core.intrinsics import read_intrinsics, write_intrinsics
from relocbench.datasets.core.layout import DatasetLayout
from relocbench.datasets.core.schema import INTRINSICS_VERSION, DatasetFile
from relocbench.errors import DatasetError
from relocbench.files import dump_yaml, load_yaml, write_text
from relocbench.geometry import Camera
from relocbench.metrics import pose_errors
from relocbench.progress import Silent

positive = st.floats(1e-3, 1e6)


@st.composite
def cameras(draw: st.DrawFn) -> Camera:
    numbers = (draw(positive), draw(positive), draw(st.floats(-1e6, 1e6)), draw(st.floats(-1e6, 1e6)))
    return Camera("pinhole", draw(st.integers(1, 9999)), draw(st.integers(1, 9999)), *numbers)


@given(st.dictionaries(st.integers(0, 2**62), cameras(), max_size=5))
def test_what_is_written_is_read(tmp_path_factory: pytest.TempPathFactory, table: dict[int, Camera]) -> None:
    path = tmp_path_factory.mktemp("intrinsics") / "cam.csv"
    write_intrinsics(path, table)
    assert read_intrinsics(path) == dict(sorted(table.items()))


def test_distorted_cameras_have_no_row(tmp_path: Path) -> None:
    with refused(ValueError, "", None, "equidistant"):
        write_intrinsics(tmp_path / "c.csv", {1: Camera("equidistant", 8, 8, 4, 4, 4, 4, (0.0, 0.0, 0.0, 0.0))})


HEAD = "timestamp_ns,width,height,fx,fy,cx,cy\n"


@pytest.mark.parametrize(
    ("text", "line", "names"),
    [
        ("timestamp_ns,fx\n", 1, ("timestamp_ns,width,height,fx,fy,cx,cy",)),
        (f"{HEAD}1,4,4,2,2,2\n", 2, ("7 columns", "6")),
        (f"{HEAD}1,4.5,4,2,2,2,2\n", 2, ("4.5,4",)),
        (f"{HEAD}1,0,4,2,2,2,2\n", 2, ("0,4",)),
        (f"{HEAD}1,4,4,0,2,2,2\n", 2, ("fx",)),
        (f"{HEAD}1,4,4,2,2,nan,2\n", 2, ("cx",)),
        (f"{HEAD}1,4,4,2,2,2,2\n1,4,4,2,2,2,2\n", 3, ("timestamp 1",)),
        (f"{HEAD}x,4,4,2,2,2,2\n", 2, ("x",)),
    ],
)
def test_a_bad_table_is_refused_with_its_line(tmp_path: Path, text: str, line: int, names: tuple[str, ...]) -> None:
    path = tmp_path / "cam.csv"
    path.write_text(text)
    with refused(DatasetError, path, line, *names):
        read_intrinsics(path)


def with_own_cameras(root: Path) -> tuple[Dataset, dict[int, Camera]]:
    """A small dataset whose queries were taken by cameras that differ in size and focal length."""
    dataset = make_small_dataset(root, size=(192, 144))
    winter, f = dataset.traversal("winter"), dataset.traversal("winter").camera(CAMERA).fx
    own = {
        time: Camera("pinhole", 192 + 8 * i, 144, (1 + 0.1 * i) * f, (1 + 0.12 * i) * f, 97.0 + 4 * i, 70.5)
        for i, time in enumerate(winter.timestamps(CAMERA)[1:], start=1)
    }
    for time, camera in own.items():
        image, depth = render(camera, winter.T_world_cam(CAMERA, time), 0)
        write_image(winter.layout.image(CAMERA, time), image)
        write_depth(winter.layout.depth(CAMERA, time), depth)
    write_intrinsics(winter.layout.intrinsics(CAMERA), own)
    return sealed(root, INTRINSICS_VERSION), own


def sealed(root: Path, version: int) -> Dataset:
    """The dataset in a folder after its content was changed, with a fresh manifest."""
    layout = DatasetLayout(root)
    fingerprint.write_manifest(layout)
    file = load_yaml(layout.dataset_yaml, DatasetFile, "a dataset description", DatasetError)
    digest = fingerprint.compute(layout, version, dict(file.splits))
    changed = file.model_copy(update={"format_version": version, "fingerprint": digest})
    write_text(layout.dataset_yaml, dump_yaml(changed.model_dump(mode="json")))
    return Dataset(root)


@pytest.mark.thorough
def test_trackers_get_the_camera_of_the_image(tmp_path: Path) -> None:
    dataset, own = with_own_cameras(tmp_path / "d")
    winter, usual = dataset.traversal("winter"), dataset.traversal("winter").camera(CAMERA)
    times = winter.timestamps(CAMERA)
    assert [winter.query(CAMERA, t).camera for t in times] == [usual, *own.values()]
    reference = winter.reference(CAMERA, times[1], neighbours=1)
    assert reference.camera == own[times[1]]
    assert [n.camera for n in reference.neighbours] == [usual, own[times[2]]]
    assert [n.image.shape[1] for n in reference.neighbours] == [usual.width, own[times[2]].width]
    assert dataset.traversal("summer").intrinsics(CAMERA) == {}
    assert not validate_dataset(dataset.root, Silent()).faults


def test_poses_are_found_with_the_cameras_of_the_images(tmp_path: Path) -> None:
    dataset, _ = with_own_cameras(tmp_path / "d")
    tracker, pair_set = OrbPnp(features=500), dataset.pair_set(ACROSS)
    right: list[float] = []
    mistaken: list[float] = []
    for pair in pair_set.pairs[1:3]:
        assert pair.T_query_ref is not None
        prepared, query = tracker.prepare(dataset.reference(pair_set, pair)), dataset.query(pair_set, pair)
        usual = replace(query, camera=dataset.traversal("winter").camera(CAMERA))
        for asked, errors in ((query, right), (usual, mistaken)):
            answer = tracker.track(prepared, asked).T_query_ref
            assert answer is not None
            errors.append(float(pose_errors(answer[None], pair.T_query_ref[None]).translation_error_m[0]))
    assert max(right) < 0.1
    assert min(mistaken) > 0.3


def test_an_image_of_another_size_is_refused(tmp_path: Path) -> None:
    dataset, own = with_own_cameras(tmp_path / "d")
    winter = dataset.traversal("winter")
    first = next(iter(own))
    write_image(winter.layout.image(CAMERA, first), np.zeros((144, 192), dtype=np.uint8))
    with refused(DatasetError, "", None, "192x144", "200x144"):
        winter.query(CAMERA, first)


def test_the_digests_cover_the_cameras_of_images(tmp_path: Path) -> None:
    plain = make_small_dataset(tmp_path / "plain")
    dataset, own = with_own_cameras(tmp_path / "own")
    assert plain.content_id != dataset.content_id
    assert dataset.file.format_version == INTRINSICS_VERSION
    last = max(own)
    other = {**own, last: Camera("pinhole", own[last].width, own[last].height, 71.0, 72.0, 40.0, 35.5)}
    write_intrinsics(dataset.traversal("winter").layout.intrinsics(CAMERA), other)
    assert any("intrinsics/cam0.csv" in str(fault) for fault in fingerprint.faults(dataset.layout))
    assert sealed(dataset.root, INTRINSICS_VERSION).content_id != dataset.content_id


def test_validation_names_every_fault_of_a_table(tmp_path: Path) -> None:
    dataset, own = with_own_cameras(tmp_path / "d")
    layout = dataset.traversal("winter").layout
    (layout.root / "intrinsics" / "notes.txt").write_text("?")
    write_intrinsics(layout.intrinsics("rear"), own)
    with layout.intrinsics(CAMERA).open("a") as stream:
        stream.write("99,4,4,-1,2,2,2\n4611686018427387904,4,4,1,2,2,2\n")
    sealed(dataset.root, 1)
    told = [str(fault) for fault in validate_dataset(dataset.root, Silent()).faults]
    for message in (
        "notes.txt: expected a file CAMERA.csv",
        "rear.csv: no camera 'rear' in traversal.yaml",
        "cam0.csv:5: fx and fy must be positive",
        "has intrinsics of an image at 4611686018427387904",
        "which format_version 3 has; this dataset's is 1",
    ):
        assert sum(message in line for line in told) >= 1, (message, told)
