"""``benchmarks/truth/realism.py`` measures what it says, shown on arrays and pictures that are made for it."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import realism
import realism_images
import realism_measures as measures
from scipy.linalg import sqrtm

from relocbench.arrays import Array
from relocbench.datasets.core.images import write_image
from relocbench.errors import DatasetError


def rows_with(mean: Array, covariance: Array, seed: int) -> Array:
    """Rows that have exactly this sample mean and covariance."""
    x = np.random.default_rng(seed).normal(size=(50, len(mean)))
    x -= x.mean(axis=0)
    x = x @ np.linalg.inv(np.linalg.cholesky(np.cov(x, rowvar=False))).T
    return np.asarray(x @ np.linalg.cholesky(covariance).T + mean)


def groups(names: str, seed: int, shift: float = 0.0) -> dict[str, Array]:
    rng = np.random.default_rng(seed)
    return {name: rng.normal(size=(30, 8)) + shift for name in names}


def test_the_frechet_distance_of_gaussians_is_that_of_the_formula() -> None:
    a, b = np.array([[2.0, 0.6, 0.1], [0.6, 1.0, -0.3], [0.1, -0.3, 0.5]]), np.diag([0.5, 3.0, 1.0])
    shift = np.array([1.0, -2.0, 0.5])
    expected = shift @ shift + np.trace(a + b - 2 * np.real(sqrtm(a @ b)))
    assert measures.frechet(rows_with(np.zeros(3), a, 1), rows_with(shift, b, 2)) == pytest.approx(expected, abs=1e-9)
    assert measures.frechet(rows_with(shift, a, 3), rows_with(shift, a, 4)) == pytest.approx(0, abs=1e-9)


def test_pictures_of_one_distribution_are_not_told_apart_and_shifted_ones_are() -> None:
    same = measures.told_apart(groups("abcdef", 0), groups("uvwxyz", 1))
    assert same.error(list("abcdef"), list("uvwxyz")) == pytest.approx(0.5, abs=0.08)
    assert same.bits(list("abcdef"), list("uvwxyz")) == pytest.approx(1.0, abs=0.08)
    other = measures.told_apart(groups("abcdef", 0), groups("uvwxyz", 1, shift=4.0))
    assert other.error(list("abcdef"), list("uvwxyz")) == 0
    assert other.bits(list("abcdef"), list("uvwxyz")) < 0.2


def test_a_group_is_answered_for_by_a_classifier_that_has_not_seen_it() -> None:
    real, rendered = groups("abc", 0), groups("xyz", 1, shift=4.0)
    real["a"] = real["a"] + 4.0
    told = measures.told_apart(real, rendered)
    assert told.wrong["a"] == 1
    assert told.photographs(list("abc"), list("xyz")) == pytest.approx(1 / 3, abs=0.1)


def test_distances_between_halves_show_the_noise_of_the_distance_of_all() -> None:
    real, far = groups("abcdef", 0), groups("uvwxyz", 1, shift=2.0)
    distances = measures.Distances(real, far)
    halves = distances.halves()
    assert distances.variance_kept == pytest.approx(1)
    assert distances.all([*real], [*far]) == pytest.approx(8 * 4, rel=0.1)
    assert halves["real and rendered halves"][0] == pytest.approx(8 * 4, rel=0.1)
    assert max(halves["real halves"][2], halves["rendered halves"][2]) < 2


def test_an_effect_is_the_difference_of_means_in_deviations_of_the_photographs() -> None:
    real = {"a": np.array([[1.0], [3.0]]), "b": np.array([[1.0], [3.0]])}
    found = measures.effect(real, {"x": np.array([[5.0]]), "y": np.array([[5.0], [5.0], [5.0]])})
    assert found.size == pytest.approx(3)
    assert found.interval == pytest.approx([3, 3])
    assert (found.real, found.rendered) == (2, 5)


def test_statistics_tell_flat_pictures_stripes_noise_and_colours() -> None:
    y, x = np.mgrid[:256, :256]
    flat = np.full((256, 256, 3), 128, dtype=np.uint8)
    upright, slanted = (np.where(k // 8 % 2, 200, 60).astype(np.uint8)[..., None].repeat(3, 2) for k in (x, x + y))
    noise = np.random.default_rng(0).integers(60, 200, (256, 256, 1), dtype=np.uint8).repeat(3, 2)
    red = flat * np.array([1, 0, 0], dtype=np.uint8)
    found = {n: measures.statistics(p) for n, p in zip("fusnr", (flat, upright, slanted, noise, red), strict=True)}
    assert found["f"]["share of flat patches"] == 1
    assert found["f"]["kinds of patches (bits)"] == found["f"]["colours (bits)"] == found["f"]["chroma"] == 0
    assert found["u"]["upright and level edges"] == pytest.approx(1)
    assert found["s"]["upright and level edges"] == pytest.approx(0)
    slope = "slope of contrast (fine over coarse)"
    assert found["n"][slope] > 0.5 + found["u"][slope]
    assert found["r"]["chroma"] == pytest.approx(128 / 255)
    assert found["r"]["road: blue over red"] == pytest.approx(-128 / 255)


def test_a_picture_is_the_central_square() -> None:
    wide = np.zeros((10, 30, 3), dtype=np.uint8)
    wide[:, 10:20] = 200
    assert (realism_images.square(wide) == 200).all()


def test_a_missing_folder_of_recordings_ends_with_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for data, named in ((tmp_path / "none", "no such folder"), (tmp_path, "no images of the set 'city streets'")):
        monkeypatch.setattr(sys, "argv", ["realism.py", "--data", str(data)])
        assert realism.main() == 2
        shown = capsys.readouterr().err
        assert shown.count("\n") == 1
        assert str(data) in shown
        assert named in shown


def test_towns_are_never_of_the_test_split_and_frames_of_before_are_not_rendered(tmp_path: Path) -> None:
    towns = realism_images.towns([0, 1])
    assert [town.name for town in towns] == ["train 0", "validation 0", "train 1", "validation 1"]
    with pytest.raises(DatasetError, match="no such frame"):
        towns[0].frames(tmp_path, render=False)
    for name, count in towns[0].conditions.items():
        for k in range(count):
            for level, imaging in enumerate(realism_images.IMAGINGS):
                path = tmp_path / "train-0" / f"{name}-{k}-{imaging}.png"
                path.parent.mkdir(exist_ok=True)
                write_image(path, np.full((512, 512, 3), 100 * level, dtype=np.uint8))
    found = towns[0].frames(tmp_path, render=False)
    assert {imaging: {int(p.max()) for p in frames} for imaging, frames in found.items()} == {
        "ideal": {0},
        "varied": {100},
    }
    assert len(found["ideal"]) == sum(towns[0].conditions.values()) == 16
