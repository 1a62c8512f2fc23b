"""A camera of its own for each drive: nothing else changes, and without the option nothing changes at all."""

from __future__ import annotations

import csv
import hashlib
import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from command_line import relocbench
from pydantic import ValidationError
from refusals import assert_names, refused

from relocbench.datasets.core import images
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.importers.rendered import dataset as synthetic
from relocbench.datasets.synthetic.conditions.condition import SWEEPS, Factors, changed, sweep
from relocbench.datasets.synthetic.conditions.imaging import Imaging
from relocbench.datasets.synthetic.conditions.presets import conditions_of, previewed
from relocbench.datasets.synthetic.drives.drive import DriveStyle
from relocbench.datasets.synthetic.drives.rig import rig_named
from relocbench.datasets.synthetic.jobs.latest import forget_renderer
from relocbench.datasets.synthetic.jobs.plan import AskedDrives, drive_cameras, make_plans
from relocbench.datasets.synthetic.jobs.rendering import RenderUnit, missing_steps, render_unit
from relocbench.errors import ConfigError
from relocbench.execution import Run
from relocbench.progress import Silent

pytestmark = pytest.mark.usefixtures("renderer_kept")
TINY: dict[str, Any] = {
    "preset": "smoke",
    "conditions": ("Neutral",),
    "size": "48",
    "steps": 2,
    "traversals": 2,
    "correspondences": 40,
}
NAMES = ["test-Neutral-0", "test-Neutral-1"]
BEFORE = "4a307f071ddc776a498345463425ca154530ad19e68af55fd17c14f2dec17963"
"""SHA-256 of the recipe of ``TINY``, keys sorted, as renderer 3 makes it"""


def build(out: Path, **options: Any) -> Dataset:
    return synthetic.build([], synthetic.Options.model_validate({**TINY, **options}), out, Silent(), Run(1))


@pytest.fixture(scope="module")
def ideal(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return build(tmp_path_factory.mktemp("ideal") / "out")


@pytest.fixture(scope="module")
def varied(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return build(tmp_path_factory.mktemp("varied") / "out", imaging="varied")


def files(dataset: Dataset) -> dict[str, bytes]:
    root = dataset.root
    return {str(p.relative_to(root)): p.read_bytes() for p in root.rglob("*") if p.is_file()}


def without_similarity(table: bytes) -> list[dict[str, str]]:
    rows = list(csv.DictReader(table.decode().splitlines()))
    assert rows
    return [{name: value for name, value in row.items() if name != "similarity"} for row in rows]


@pytest.mark.thorough
def test_without_the_option_the_recipe_is_that_of_before(ideal: Dataset) -> None:
    """What ``build.yaml`` holds is what the version before wrote, in any order: the question digest covers it."""
    text = (ideal.root / "build.yaml").read_text(encoding="utf-8")
    assert "imaging" not in text
    recipe = {**yaml.safe_load(text), "renderer": 3}
    assert hashlib.sha256(json.dumps(recipe, sort_keys=True).encode()).hexdigest() == BEFORE


@pytest.mark.thorough
def test_without_the_option_no_effect_is_called(
    tmp_path: Path, ideal: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The ideal camera's images are those of its response; what a camera of its own does is never asked."""
    for name in ("motion_blur", "through_lens", "grey_levels", "exposure_ev"):
        monkeypatch.setattr(f"relocbench.datasets.synthetic.renderer.render.{name}", None)
    again = build(tmp_path / "out")
    assert files(again) == files(ideal)


@pytest.mark.thorough
def test_only_images_change(ideal: Dataset, varied: Dataset) -> None:
    before, after = files(ideal), files(varied)
    assert before.keys() == after.keys()
    differing = {name for name in before if before[name] != after[name]}
    pictures = {name for name in before if "/images/" in name}
    tables = {name for name in before if name.startswith("pairs/") and name.endswith(".csv")}
    assert differing <= pictures | tables | {"build.yaml", "dataset.yaml", "manifest.csv"}
    assert pictures <= differing
    assert len(pictures) == 4
    for name in ideal.pair_set_names:
        pairs = zip(ideal.pair_set(name).pairs, varied.pair_set(name).pairs, strict=True)
        assert all(one.key == other.key for one, other in pairs)
    for name in tables:
        # How alike the images of a pair look is measured in them.
        assert without_similarity(before[name]) == without_similarity(after[name])
    assert any("/depth/" in name for name in before)
    assert any(name.endswith(".parquet") for name in before)


@pytest.mark.thorough
def test_the_recipe_says_which_camera_each_drive_had(varied: Dataset) -> None:
    recipe = yaml.safe_load((varied.root / "build.yaml").read_text(encoding="utf-8"))
    assert recipe["options"]["imaging"] == "varied"
    assert list(recipe["imaging"]) == NAMES
    cameras = [Imaging.model_validate(recipe["imaging"][name]) for name in NAMES]
    assert cameras[0] != cameras[1]
    assert varied.file.made_by["imaging"] == recipe["imaging"]
    conditions = conditions_of(("Neutral",), {}, None, 2)
    assert drive_cameras(AskedDrives(("test",), conditions, 2, 0), varied=True) == dict(
        zip(NAMES, cameras, strict=True)
    )


def test_the_camera_of_a_drive_depends_on_the_seed_and_not_on_what_else_is_built() -> None:
    conditions = conditions_of(("Neutral", "Night"), {}, None, 2)
    everything = drive_cameras(AskedDrives(("train", "validation", "test"), conditions, 2, 3), varied=True)
    assert len(set(everything.values())) == len(everything) == 12
    alone = drive_cameras(AskedDrives(("validation",), conditions, 1, 3), varied=True)
    assert alone.items() <= everything.items()
    other = drive_cameras(AskedDrives(("validation",), conditions, 1, 4), varied=True)
    assert other.items().isdisjoint(alone.items())
    assert drive_cameras(AskedDrives(("train",), conditions, 2, 3), varied=False) == {}
    assert everything["test-Night-0"].exposure_ms >= 8


@pytest.mark.thorough
def test_a_frame_alone_in_another_process_has_the_same_bytes(varied: Dataset, tmp_path: Path) -> None:
    """The unit of work as another process unpickles it, for the last frame only."""
    conditions = conditions_of(("Neutral",), {}, None, 2)
    asked = AskedDrives(("test",), conditions, 2, 0)
    own = drive_cameras(asked, varied=True)
    plan = make_plans(
        asked, 2, DriveStyle(), extent_m=190.0, reporter=Silent(), rig=rig_named("front"), size=(48, 48), imaging=own
    )[1]
    layout = type(varied.layout)(tmp_path / "alone")
    step = missing_steps(plan, layout, 0, ())[-1]
    factors = plan.condition.factors
    forget_renderer()  # which another process does not have
    render_unit(pickle.loads(pickle.dumps(RenderUnit(plan.place, factors, factors, (step,)))))
    (image,) = (tmp_path / "alone").rglob("images/front/*.png")
    expected = varied.layout.root / image.relative_to(tmp_path / "alone")
    assert image.read_bytes() == expected.read_bytes()


def test_a_sweep_of_the_camera_changes_one_factor_of_it() -> None:
    for name, (start, *_) in SWEEPS.items():
        if all(key.startswith("imaging.") for key in start):
            first, middle, last = sweep(name, 3)
            assert first.imaging is not None
            assert last.imaging is not None
            assert first.scene == middle.scene == last.scene
            one, other = first.imaging.model_dump(), last.imaging.model_dump()
            assert {f"imaging.{k}" for k in one if one[k] != other[k]} == set(start)


def test_factors_of_the_camera_are_set_beside_others() -> None:
    own = Factors(wetness=0.5, imaging=Imaging(sharpening=1.0))
    assert Factors.model_validate(own.model_dump(mode="json")) == own
    more = changed(own, {"imaging.defocus_px": 2.0, "fog_density": 0.01})
    assert (more.wetness, more.fog_density) == (0.5, 0.01)
    assert more.imaging == Imaging(sharpening=1.0, defocus_px=2.0)
    assert "imaging" not in Factors().model_dump()
    with pytest.raises(ValidationError, match=r"gamma.*imaging"):
        Factors(gamma=1.8, imaging=Imaging())


def test_a_condition_keeps_the_camera_that_it_sets() -> None:
    sharp = Factors(imaging=Imaging(sharpening=2.0))
    conditions = conditions_of(("Neutral", "Sharp"), {"Sharp": sharp}, None, 2)
    for varied in (False, True):
        cameras = drive_cameras(AskedDrives(("test",), conditions, 1, 0), varied=varied)
        assert cameras["test-Sharp-0"] == sharp.imaging
        assert ("test-Neutral-0" in cameras) == varied


def test_mistakes_are_named(tmp_path: Path) -> None:
    command, out = ("build-dataset", "synthetic", "--imaging"), ("--out", tmp_path / "out")
    for words in (
        (*command, "vivid"),
        (*command, "varied", "--sweep", "light"),
        (*command, "varied", "--recording", "kitti"),
        ("build-dataset", "synthetic", "--recording", "kitti", "--sweep", "sharpening"),
    ):
        told = relocbench(*words, *out)
        assert told.status == 2
        assert_names(told.complaint, "", None, "imaging")
    config = tmp_path / "config.yaml"
    config.write_text("conditions: [Blurred]\nfactors:\n  Blurred: {imaging: {defocus_px: 2, zoom: 3}}\n")
    told = relocbench("build-dataset", "synthetic", "--config", config, *out)
    assert told.status == 2
    assert_names(told.complaint, config, 3, "zoom")
    config.write_text("conditions: [Blurred]\nfactors:\n  Blurred: {imaging: {defocus_px: 2}}\n")
    told = relocbench("build-dataset", "cross-view", "--config", config, *out)
    assert told.status == 2
    assert_names(told.complaint, "", None, "Blurred")
    assert not (tmp_path / "out").exists()


@pytest.mark.thorough
@pytest.mark.usefixtures("small_preview")
def test_a_preview_shows_drawn_cameras(tmp_path: Path) -> None:
    shown = previewed(("Sunny", "Rain"), everything=False, swept=None, steps=2, cameras=2, seed=1)
    assert list(shown)[:3] == ["Sunny", "Sunny, camera 1", "Sunny, camera 2"]
    assert len({factors.imaging for factors in shown.values()}) == 5
    with refused(ConfigError, "", None, "--drawn-cameras"):
        previewed((), everything=False, swept="light", steps=2, cameras=2)
    sheet = tmp_path / "sheet.jpg"
    outcome = relocbench("preview", "-c", "Sunny", "--cameras", 1, "--size", "96x72", "--out", sheet, "--quiet")
    assert outcome.status == 0, outcome.err
    picture = images.read_image(sheet).astype(float)
    assert picture.shape == (72, 2 * 96 + 4, 3)
    assert np.abs(picture[:60, :96] - picture[:60, 100:]).mean() > 3
