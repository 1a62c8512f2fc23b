"""Every command on a dataset without images: what can be done is done, and the rest is refused in one line."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from browser_pages import needs_browser, serious_faults
from command_line import relocbench
from submissions import submit
from two_laps import laps, tum_lines

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pairfile import PoseLine, write_pose_lines
from relocbench.geometry import make_transform, so3_exp

ACROSS = "summer__winter__rig"
OFF = make_transform(so3_exp([0.0, 0.0, 0.01]), [0.05, 0.0, 0.0])


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of poses alone, predictions of one method that is 5 cm off, and results of it and both floors."""
    root = tmp_path_factory.mktemp("poses")
    for name, poses in (("summer", laps(1)), ("winter", laps(1, start_ns=1_610_000_000_000_000_000))):
        moved = (
            poses if name == "summer" else {t: T @ make_transform(np.eye(3), [0.8, 0.3, 0]) for t, T in poses.items()}
        )
        (root / f"{name}.txt").write_text(tum_lines(moved))
    conditions = root / "c.yaml"
    conditions.write_text("conditions: {summer: {season: summer}, winter: {season: winter}}\nsigma: 0.01\n")
    sources = root / "summer.txt", root / "winter.txt"
    assert relocbench("build-dataset", "poses", *sources, "--config", conditions, "--out", root / "D", "-q").status == 0
    (pair_set,) = Dataset(root / "D").pair_sets()
    (root / "made").mkdir()
    lines = [PoseLine(*p.key, OFF @ p.T_query_ref) for p in pair_set.pairs[1:] if p.T_query_ref is not None]
    write_pose_lines(root / "made" / f"{ACROSS}.txt", lines)
    out = ("--out", root / "results", "-q")
    assert relocbench("evaluate", "-d", root / "D", "--predictions", root / "made", "-m", "mine", *out).status == 0
    assert relocbench("evaluate", "-d", root / "D", "-m", "identity", "-m", "clock", *out).status == 0
    return root


def told(*arguments: object) -> dict[str, Any]:
    outcome = relocbench(*arguments, "--json")
    assert outcome.status == 0, outcome.err
    found: dict[str, Any] = json.loads(outcome.out)
    return found


@pytest.mark.thorough
def test_predictions_and_both_floors_are_scored(root: Path) -> None:
    scores = {
        path.parent.name: yaml.safe_load(path.read_text())["pair_sets"][ACROSS]["all"]
        for path in (root / "results").glob("*/*/scores.yaml")
    }
    assert sorted(scores) == ["clock", "identity", "mine"]
    assert scores["mine"]["coverage"] == pytest.approx(59 / 60)
    assert scores["mine"]["median_rotation_error_deg"] == pytest.approx(np.degrees(0.01), rel=1e-3)
    assert scores["mine"]["recall@(0.25m,2deg)"] == pytest.approx(59 / 60)
    assert scores["identity"]["median_translation_error_m"] == pytest.approx(np.hypot(0.8, 0.3), rel=0.2)
    assert relocbench("validate", root / "results").status == 0
    assert relocbench("validate", root / "made", "--dataset", root / "D").status == 0


def test_the_identity_is_the_floor_that_others_are_compared_with(root: Path, tmp_path: Path) -> None:
    again = told("evaluate", "-d", root / "D", "-m", "still=identity", "--out", tmp_path / "r")
    assert again["methods"]["still"][ACROSS]["all"]["coverage"] == 1.0
    assert relocbench("leaderboard", root / "results", "--out", tmp_path / "b", "-q").status == 0
    page = (tmp_path / "b" / "leaderboard.md").read_text()
    assert "mine" in page
    assert "not isolated" not in "".join(p.read_text() for p in (tmp_path / "b" / "sets").glob("*.md"))


def test_inspect_counts_poses(root: Path) -> None:
    found = told("inspect", root / "D")
    assert [(t["cameras"], t["images"], t["poses"]) for t in found["traversals"]] == [
        ({"rig": "poses alone"}, 0, 60)
    ] * 2
    assert "rig (poses alone)" in relocbench("inspect", root / "D").out
    assert told("validate", root / "D")["valid"] is True


@pytest.mark.parametrize("name", ["tum", "kitti"])
def test_poses_are_exported_and_are_those_that_went_in(root: Path, tmp_path: Path, name: str) -> None:
    assert relocbench("export", "-d", root / "D", "-f", name, "-o", tmp_path / "e").status == 0
    again = tmp_path / "e" / f"{ACROSS}.txt"
    built = relocbench("build-dataset", "poses", root / "summer.txt", again, "--traversals", "summer,winter",
                       "--out", tmp_path / "again", "-q")  # fmt: skip
    assert built.status == 0, built.err
    (one,), (two,) = (Dataset(folder).pair_sets() for folder in (root / "D", tmp_path / "again"))
    for a, b in zip(one.pairs, two.pairs, strict=True):
        assert a.key == b.key
        assert a.T_query_ref is not None
        assert b.T_query_ref is not None
        np.testing.assert_allclose(a.T_query_ref, b.T_query_ref, atol=1e-6)


def test_a_submission_is_taken(root: Path, tmp_path: Path) -> None:
    dataset = Dataset(root / "D")
    folder = submit(tmp_path / "s", dataset)
    assert relocbench("submit-check", folder, "-d", dataset.root).status == 0
    added = told("leaderboard", "add", folder, "--to", tmp_path / "r", "-d", dataset.root)
    assert [row["state"] for row in added["rows"]] == ["added"]


@pytest.mark.thorough
def test_the_viewer_shows_poses_without_images(root: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    found = told("view", root / "D", "--results", root / "results", "--out", tmp_path / "d.rrd")
    counts = found["counts"]
    assert (counts["pairs"], counts["images"], counts["points"], counts["without_pose"]) == (60, 0, 0, 0)
    from rerun.chunk import RrdReader

    entities = {str(c.entity_path) for c in RrdReader(tmp_path / "d.rrd").stream()}
    assert any(e.endswith(f"pairs/{ACROSS}/answers/mine") for e in entities)
    assert any(e.endswith(f"pairs/{ACROSS}/keyframe") for e in entities)
    assert not any("images" in e for e in entities)


def _edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def _add_image(folder: Path) -> None:
    image = folder / "traversals" / "summer" / "images" / "rig" / "1.png"
    image.parent.mkdir(parents=True)
    image.write_bytes(b"")


def _drop_pose(folder: Path) -> None:
    path = folder / "traversals" / "summer" / "poses.csv"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], *lines[2:]]) + "\n")


NEEDS_IMAGES: dict[str, tuple[list[str], str]] = {
    "a tracker": (
        ["evaluate", "-d", "D", "-m", "dso"],
        "no tracker can run except the baselines identity and clock; score predictions with --predictions",
    ),
    "a tracker beside a floor": (["evaluate", "-d", "D", "-m", "identity", "-m", "orb-pnp"], "no tracker can run"),
    "a program": (["evaluate", "-d", "D", "-m", "mine=subprocess:cat"], "no tracker can run"),
    "a retriever": (["evaluate-retrieval", "-d", "D", "-m", "random"], "retrievers have nothing to rank"),
    "a chain": (
        ["evaluate-relocalization", "-d", "D", "--retriever", "random", "-m", "orb-pnp"],
        "retrievers have nothing to rank",
    ),
    "a probe": (["probe", "-d", "D", "-m", "gn-net", "-o", "p"], "there are no pixels to probe"),
    "a check": (["check-method", "identity", "--dataset", "D"], "there is nothing to try a method on"),
    "training": (["train", "gn-net", "-d", "D", "--out", "w"], "there is nothing to learn from"),
    "pictures": (["inspect", "D", "--pictures", "p"], "there is nothing to draw points in"),
    "a picture": (["view", "D", "--pair-index", "0"], "there is no picture to draw"),
    "colmap": (["export", "-d", "D", "-f", "colmap", "-o", "e"], "colmap files name images; tum, kitti and mlad hold"),
    "kapture": (["export", "-d", "D", "-f", "kapture", "-o", "e"], "kapture files name images"),
    "hloc": (["export", "-d", "D", "-f", "hloc", "-o", "e"], "hloc files name images"),
    "a blind export": (
        ["export", "-d", "D", "-f", "blind", "--salt-file", "salt", "-o", "e"],
        "a blind export would hold keys alone",
    ),
    "blind images": (
        ["export", "-d", "D", "-f", "blind-images", "--salt-file", "salt", "-o", "e"],
        "retrievers have nothing to rank",
    ),
}


@pytest.mark.thorough
@pytest.mark.parametrize("what", NEEDS_IMAGES)
def test_what_needs_images_says_so_in_one_line_and_writes_nothing(
    root: Path, tmp_path: Path, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(root / "D", "D")
    Path("salt").write_text("s" * 32)
    arguments, words = NEEDS_IMAGES[what]
    outcome = relocbench(*arguments, *([] if arguments[0] in ("check-method", "train") else ["-q"]))
    assert outcome.status == 2
    complaint = [line for line in outcome.err.splitlines() if line.startswith("relocbench:")]
    assert len(complaint) == 1, outcome.err
    assert f"D: this dataset has no images: {words}" in complaint[0]
    assert not list(tmp_path.rglob("*.txt")) or {p.name for p in tmp_path.rglob("*.txt")} == {f"{ACROSS}.txt"}
    assert not list(tmp_path.rglob("run.yaml"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: (d / "traversals/winter/traversal.yaml").unlink(), "traversal.yaml: missing"),
        (
            lambda d: _edit(d / "traversals/winter/traversal.yaml", "rig:", "lidar:"),
            "traversal 'winter' has no camera 'rig'",
        ),
        (lambda d: _edit(d / "dataset.yaml", "format_version: 4", "format_version: 1"), "which format_version 4 has"),
        (_add_image, "'rig' is a frame without images in traversal.yaml; expected no files of it"),
        (_drop_pose, "has no pose at 1600000000000000000, from which the pair was made"),
    ],
)
def test_validate_names_what_is_wrong_with_poses_alone(root: Path, tmp_path: Path, change: Any, words: str) -> None:
    spoilt = tmp_path / "D"
    shutil.copytree(root / "D", spoilt)
    change(spoilt)
    outcome = relocbench("validate", spoilt)
    assert outcome.status != 0
    assert words in outcome.out + outcome.err


@pytest.fixture(scope="module")
def site(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("site") / "site"
    done = relocbench("report", root / "results", "--out", out, "-q")
    assert done.status == 0, done.err
    return out


def test_the_pages_of_results_hold_no_pictures(site: Path) -> None:
    assert {p.name for p in (site / "data").iterdir()}.isdisjoint({"images", "depths"})


@needs_browser
@pytest.mark.thorough
def test_the_page_of_a_set_has_its_map_and_that_of_a_pair_its_plan(site: Path, page: Any) -> None:
    page.goto(next(site.glob("set-*.html")).as_uri())
    page.locator("#curves").scroll_into_view_if_needed()
    page.wait_for_selector("#curves .main-svg")
    page.locator("#map").scroll_into_view_if_needed()
    page.wait_for_selector("#map .main-svg")
    across, up = page.evaluate("((trace) => [[...trace.x], [...trace.y]])(document.getElementById('map').data[0])")
    drawn = np.array([across, up], dtype=np.float64)
    # The loop lies flat: it is as wide as it is high, and not seen from the side.
    assert np.ptp(drawn, axis=1) == pytest.approx([80.0, 80.0], abs=1.5)
    assert serious_faults(page) == []


@needs_browser
@pytest.mark.thorough
def test_the_page_of_a_pair_says_that_there_are_no_images_and_draws_poses_from_above(site: Path, page: Any) -> None:
    set_id = next(site.glob("set-*.html")).stem.removeprefix("set-")
    first = min(laps(1)), 1_610_000_000_000_000_000
    page.goto(f"{(site / 'pair.html').as_uri()}#set={set_id}&pairset={ACROSS}&pair={first[0]}-{first[1]}")
    page.wait_for_selector("#none p")
    assert page.locator("#none").inner_text() == "The dataset holds poses alone, without images."
    assert page.locator("#numbers tr").count() == 3
    assert page.locator("#pictured").is_disabled()
