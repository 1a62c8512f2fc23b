"""Bad input, by the commands a user types: one clear line with file and place, exit status 2, nothing lost."""

from __future__ import annotations

import hashlib
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import relocbench
from refusals import assert_names
from small_dataset import ACROSS, make_small_dataset

Damage = Callable[["Case"], list[object]]


@dataclass(frozen=True)
class Case:
    """A dataset of one's own, a recording of one's own, and results that were there before."""

    dataset: Path
    recording: Path
    results: Path
    scratch: Path

    @property
    def evaluate(self) -> list[object]:
        return ["evaluate", "-d", self.dataset, "-m", "orb-pnp", "--out", self.results, "-j", "0"]

    @property
    def build(self) -> list[object]:
        return [
            "build-dataset",
            "kitti",
            self.recording,
            "--sequence",
            "00",
            "--out",
            self.scratch / "built",
            "-j",
            "1",
        ]

    def image(self) -> Path:
        return next((self.dataset / "traversals" / "winter" / "images").rglob("*.png"))

    def edit(self, path: Path, pattern: str, new: str) -> None:
        text, count = re.subn(pattern, new, path.read_text(), count=1, flags=re.MULTILINE)
        assert count == 1, f"{pattern} is not in {path}"
        path.write_text(text)


def truncated_png_in_a_recording(case: Case) -> list[object]:
    path = case.recording / "sequences" / "00" / "image_0" / "000001.png"
    path.write_bytes(path.read_bytes()[:-30])
    return case.build


def truncated_png_in_a_dataset(case: Case) -> list[object]:
    case.image().write_bytes(case.image().read_bytes()[:-30])
    return case.evaluate


def word_in_a_pose_of_a_recording(case: Case) -> list[object]:
    case.edit(case.recording / "poses" / "00.txt", r"^1\.0 ", "one ")
    return case.build


def nan_pose_in_a_dataset(case: Case) -> list[object]:
    case.edit(case.dataset / "traversals" / "winter" / "poses.csv", r"^(\d+),[^,]+,", r"\1,nan,")
    return case.evaluate


def missing_calibration_line(case: Case) -> list[object]:
    case.edit(case.recording / "sequences" / "00" / "calib.txt", r"^P1:.*\n", "")
    return case.build


def duplicate_pair(case: Case) -> list[object]:
    theirs = case.scratch / "theirs"
    theirs.mkdir()
    line = f"{(case.dataset / 'pairs' / f'{ACROSS}.txt').read_text().splitlines()[0]}\n"
    (theirs / f"{ACROSS}.txt").write_text(line * 2)
    return ["evaluate", "-d", case.dataset, "--predictions", theirs, "--out", case.results]


def wrong_quaternion_norm(case: Case) -> list[object]:
    theirs = case.scratch / "theirs"
    theirs.mkdir()
    first = (case.dataset / "pairs" / f"{ACROSS}.txt").read_text().split()[:2]
    (theirs / f"{ACROSS}.txt").write_text(" ".join([*first, "0 0 0 0 0 0.5 1"]) + "\n")
    return ["evaluate", "-d", case.dataset, "--predictions", theirs, "--out", case.results]


def unknown_method(case: Case) -> list[object]:
    return ["evaluate", "-d", case.dataset, "-m", "orb-pmp", "--out", case.results]


def unknown_key_in_yaml(case: Case) -> list[object]:
    config = case.scratch / "run.yaml"
    config.write_text(f"dataset: {case.dataset}\nmethods: [identity]\nout: {case.results}\nwrokers: 3\n")
    return ["evaluate", "--config", config]


def predictions_for_another_fingerprint(case: Case) -> list[object]:
    other = make_small_dataset(case.scratch / "other", seed=9)
    elsewhere = case.scratch / "elsewhere"
    assert relocbench("evaluate", "-d", other.root, "-m", "identity", "--out", elsewhere, "-j", 0, "-q").status == 0
    theirs = next(elsewhere.glob("*@*/identity"))
    return ["evaluate", "-d", case.dataset, "--predictions", theirs, "--out", case.results]


def results_of_another_configuration(case: Case) -> list[object]:
    return [*case.evaluate, "-m", "identity", "--set", "orb-pnp.features=500"]


def dataset_inside_the_recording(case: Case) -> list[object]:
    return [*case.build, "--out", case.recording / "out"]


Told = tuple[str, int | None, tuple[object, ...]]
"""the end of a file's name, the line in it, and what else is named"""
CASES: list[tuple[Damage, Told]] = [
    (truncated_png_in_a_recording, ("image_0/000001.png", None, ())),
    (truncated_png_in_a_dataset, ("", None, ("winter/images/cam0", "manifest.csv"))),
    (word_in_a_pose_of_a_recording, ("poses/00.txt", 1, ("one",))),
    (nan_pose_in_a_dataset, ("winter/poses.csv", None, ())),
    (dataset_inside_the_recording, ("recording/out", None, ())),
    (missing_calibration_line, ("calib.txt", None, ("P1",))),
    (duplicate_pair, (f"theirs/{ACROSS}.txt", 2, (1,))),
    (wrong_quaternion_norm, (f"theirs/{ACROSS}.txt", 1, ("norm",))),
    (unknown_method, ("", None, ("orb-pmp", "orb-pnp"))),
    (unknown_key_in_yaml, ("run.yaml", 4, ("wrokers", "workers"))),
    (predictions_for_another_fingerprint, ("identity/run.yaml", None, ())),
    (results_of_another_configuration, ("orb-pnp/run.yaml", None, ("features", 3000, 500))),
]


@pytest.fixture(scope="module")
def untouched(tmp_path_factory: pytest.TempPathFactory) -> Case:
    root = tmp_path_factory.mktemp("untouched")
    dataset = make_small_dataset(root / "dataset").root
    write_recording(root / "recording")
    assert relocbench("evaluate", "-d", dataset, "-m", "orb-pnp", "--out", root / "results", "-j", 0, "-q").status == 0
    (root / "scratch").mkdir()
    return Case(dataset, root / "recording", root / "results", root / "scratch")


@pytest.fixture
def case(untouched: Case, tmp_path: Path) -> Case:
    names = ("dataset", "recording", "results", "scratch")
    for name in names:
        shutil.copytree(getattr(untouched, name), tmp_path / name)
    return Case(*(tmp_path / name for name in names))


@pytest.mark.thorough
@pytest.mark.parametrize(("damage", "told"), CASES, ids=[damage.__name__ for damage, _ in CASES])
def test_one_clear_line_status_2_and_nothing_lost(case: Case, damage: Damage, told: Told) -> None:
    command = damage(case)
    before = {folder: contents(folder) for folder in (case.dataset, case.recording, case.results)}
    outcome = relocbench(*command)
    assert outcome.status == 2
    complaint = next(line for line in outcome.err.splitlines() if line.startswith("relocbench: "))
    place, line, names = told
    assert_names(complaint, place, line, *names)
    assert "Traceback" not in outcome.err
    for folder, files in before.items():
        assert contents(folder) == files, folder.name


@pytest.mark.thorough
def test_the_undamaged_case_has_nothing_to_complain_about(case: Case) -> None:
    assert relocbench(*case.build, "-q").status == 0
    assert relocbench(*case.evaluate, "-q").status == 0


def contents(folder: Path) -> dict[str, str]:
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def write_recording(root: Path, frames: int = 3) -> None:
    """A KITTI odometry sequence of a textured wall 8 m ahead, moved along by 0.1 m a frame."""
    sequence = root / "sequences" / "00"
    rng = np.random.default_rng(0)
    wall = cv2.resize((rng.random((40, 120)) * 255).astype(np.uint8), (720, 240), interpolation=cv2.INTER_CUBIC)
    focal, baseline, depth = 200.0, 0.4, 8.0
    for camera, disparity in (("image_0", 0.0), ("image_1", focal * baseline / depth)):
        (sequence / camera).mkdir(parents=True)
        for i in range(frames):
            shift = round(100 + disparity + i * 0.1 * focal / depth)
            cv2.imwrite(str(sequence / camera / f"{i:06d}.png"), wall[:, shift : shift + 320])
    projection = f"{focal} 0 159.5 {{}} 0 {focal} 119.5 0 0 0 1 0"
    (sequence / "calib.txt").write_text(f"P0: {projection.format(0)}\nP1: {projection.format(-focal * baseline)}\n")
    (sequence / "times.txt").write_text("".join(f"{0.1 * i:e}\n" for i in range(frames)))
    (root / "poses").mkdir()
    (root / "poses" / "00.txt").write_text(
        "".join(f"1.0 0.0 0.0 {0.1 * i} 0.0 1.0 0.0 0.0 0.0 0.0 1.0 0.0\n" for i in range(frames))
    )
