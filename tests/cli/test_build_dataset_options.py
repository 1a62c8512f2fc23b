"""``relocbench build-dataset KIND``: each kind offers and explains the options that it uses, and refuses the others."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest
from command_line import relocbench
from refusals import assert_names

from relocbench.datasets.importers import KINDS, options_of

LIDAR = (
    *("robotcar", "kitti-lidar", "generic-lidar", "boreas", "mulran", "helipr", "clouds"),
    *("nclt", "kitti-360", "complex-urban", "ford-av", "rosbag"),
)
UNLINKED = ("robotcar", "mulran", "helipr", "nclt", "complex-urban", "rosbag")
"""kinds of lidar drives that have no images, or whose images have to be converted"""
RECORDINGS = ("kitti", "tum-rgbd", "four-seasons", "generic", "colmap", "kapture")
RENDERED = ("synthetic", "cross-view")


@cache
def help_of(kind: str) -> str:
    """The help as one line, without its frame."""
    return " ".join(re.sub("[│╭╮╰╯─]", " ", relocbench("build-dataset", kind, "--help").out).split())


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("option", "kinds"),
    [
        ("--pair-rule", (*RECORDINGS, "poses", "synthetic")),
        ("--pair-step", (*RECORDINGS, "poses", "synthetic")),
        ("--revisit-gap", ("poses",)),
        ("--trajectories", ("pair-files",)),
        ("--copy-images", (*RECORDINGS, *(kind for kind in LIDAR if kind not in UNLINKED))),
        ("--matcher", LIDAR),
        ("--preset", ("synthetic",)),
    ],
)
def test_an_option_is_shown_by_the_kinds_that_use_it_alone(option: str, kinds: tuple[str, ...]) -> None:
    assert {kind for kind in KINDS if option in help_of(kind).split()} == set(kinds)


def test_options_stand_under_what_they_are_about() -> None:
    headings = ["Where and how work runs", "The dataset", "Which images make a pair", "Options of kitti"]
    parts = re.split("|".join(headings), help_of("kitti"))
    assert ["--workers" in parts[1], "--licence" in parts[2], "--pair-rule" in parts[3], "--sequence" in parts[4]] == [
        True
    ] * 4
    assert "From lidar to true poses" in help_of("robotcar")
    assert "Photo collections" in help_of("colmap")


@pytest.mark.parametrize("kind", ["robotcar", "rosbag"])
@pytest.mark.parametrize(("option", "value"), [("--pair-step", "1"), ("--pair-rule", "nearest")])
def test_an_option_of_other_kinds_is_refused_with_their_names(
    tmp_path: Path, kind: str, option: str, value: str
) -> None:
    those = "build-dataset kitti, tum-rgbd, four-seasons, generic, colmap, kapture, poses and synthetic"
    done = relocbench("build-dataset", kind, "a", "b", option, value, "--out", tmp_path / "o")
    assert done.status == 2
    assert_names(done.complaint, "", None, option, those)
    config = tmp_path / "c.yaml"
    config.write_text(f"depth: lidar\n{option[2:].replace('-', '_')}: {value}\n")
    done = relocbench("build-dataset", kind, "a", "b", "--config", config, "--out", tmp_path / "o")
    assert done.status == 2
    assert_names(done.complaint, "c.yaml", 2, option[2:].replace("-", "_"), those)
    assert not (tmp_path / "o").exists()


def test_an_unknown_kind_or_key_is_refused_with_the_nearest(tmp_path: Path) -> None:
    done = relocbench("build-dataset", "kiti", "a", "--out", tmp_path / "o")
    assert done.status == 2
    assert_names(done.complaint, "", None, "kiti", "kitti", *KINDS)
    config = tmp_path / "c.yaml"
    config.write_text("submop: 60\n")
    done = relocbench("build-dataset", "robotcar", "a", "b", "--config", config, "--out", tmp_path / "o")
    assert_names(done.complaint, "c.yaml", 1, "submop", "submap")


@pytest.mark.parametrize("kind", [kind for kind in KINDS if "licence" in options_of(kind).model_fields])
def test_the_shown_licence_is_that_of_the_dataset(kind: str) -> None:
    licence = options_of(kind)().licence  # type: ignore[attr-defined]
    assert licence == ("CC0-1.0" if kind in RENDERED else "unknown")
    assert f"[default: {licence}]" in help_of(kind)
    made_from = "photographs" if kind == "photographs" else "recordings"
    assert (f"licence of the {made_from}" in help_of(kind)) == (kind not in RENDERED)


@pytest.mark.parametrize(
    ("kind", "default"),
    [("synthetic", "synthetic-PRESET"), ("cross-view", "cross-view-SPLIT"), ("robotcar", "[default: 60.0]")],
)
def test_a_help_shows_the_defaults_of_its_kind(kind: str, default: str) -> None:
    assert default in help_of(kind)


@pytest.mark.parametrize("kind", KINDS)
def test_the_key_that_a_help_shows_is_one_of_the_kind(kind: str) -> None:
    found = re.search(r"sets any of these options \((\w+): ", help_of(kind))
    assert found
    assert found[1] in options_of(kind).model_fields


def test_a_kind_that_converts_every_image_does_not_copy() -> None:
    for kind in ("generic-lidar", "kitti-lidar", "generic"):
        assert options_of(kind).model_validate({"copy_images": True}).copies_images  # type: ignore[attr-defined]
    assert not options_of("robotcar")().copies_images  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("command", "option", "instead"),
    [
        ("evaluate", "--task", ("evaluate-retrieval", "evaluate-relocalization")),
        ("leaderboard", "--no-plots", ("relocbench report",)),
    ],
)
def test_an_option_of_an_earlier_version_is_answered_with_what_to_use_instead(
    command: str, option: str, instead: tuple[str, ...]
) -> None:
    assert_names(relocbench(command, option).complaint, "", None, option, *instead)
