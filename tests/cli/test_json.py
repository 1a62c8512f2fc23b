"""``--json``: every command prints one strict JSON object with counts on standard output, and nothing else there."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from command_line import Outcome, relocbench
from made_pairs import SETTINGS
from register_scenes import room_view
from repository import DOCS
from small_dataset import ACROSS, WITHIN, make_small_dataset
from small_views import make_small_views
from submissions import salt_file, submit

from relocbench.cli.app import app
from relocbench.cli.commands import demo as demo_module
from relocbench.datasets import importers
from relocbench.datasets.core.dataset import Dataset
from relocbench.weights import PublishedFile

pytestmark = pytest.mark.usefixtures("workers_kept", "towns_kept")
SPLITS = {"train": [ACROSS, WITHIN], "validation": [ACROSS]}
THUMBNAIL = "t=retrievers_for_tests:Thumbnail"


class NeedsWeights:
    """A tracker whose weights are there already."""

    path = Path()

    def track(self, reference: object, query: object, prior: object = None) -> None: ...

    @classmethod
    def published(cls, **_: object) -> dict[Path, PublishedFile]:
        return {cls.path: PublishedFile(cls.path.name, "http://127.0.0.1:9/weights", "its authors", "MIT")}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """Folders of the smallest dataset of each kind, and of results on it."""
    root = tmp_path_factory.mktemp("json")
    dataset = make_small_dataset(root / "d", frames=3, correspondences=200, splits=SPLITS, rejected=1)
    views = make_small_views(root / "v", places=4)
    results = root / "r"
    done = relocbench("evaluate", "-d", dataset.root, "-m", "identity", "-o", results, "-j", 0, "-q")
    assert done.status == 0, done.err
    return SimpleNamespace(dataset=dataset.root, views=views, results=results)


def _parse(outcome: Outcome) -> dict[str, Any]:
    """The one object on standard output."""
    assert len(outcome.out.splitlines()) == 1, outcome.out
    told = json.loads(outcome.out, parse_constant=pytest.fail)
    assert isinstance(told, dict)
    counts = told["counts"]
    assert counts
    assert all(type(value) is int and value >= 0 for value in counts.values())
    return told


def _submission(data: SimpleNamespace, folder: Path) -> Path:
    return submit(folder / "submission", Dataset(data.dataset))


Given = Callable[[SimpleNamespace, Path], list[object]]
COMMANDS: dict[str, tuple[Given, dict[str, int]]] = {
    "build-dataset": (
        lambda d, t: [
            "synthetic",
            "--preset",
            "smoke",
            "--conditions",
            "Sunny",
            "--size",
            "48x36",
            "--out",
            t / "town",
            "-j",
            1,
        ],
        {"traversals": 1, "rejected": 0},
    ),
    "preview": (lambda d, t: ["-c", "Sunny", "--size", 64, "--out", t / "p.png"], {"pictures": 1, "files_written": 1}),
    "evaluate": (
        lambda d, t: ["-d", d.dataset, "-m", "identity", "-o", t / "r", "-j", 0],
        {"pair_sets": 2, "pairs": 7, "rejected": 1, "methods": 1, "answered": 7, "failed": 0, "broke": 0},
    ),
    "evaluate-retrieval": (
        lambda d, t: ["-d", d.views, "-m", THUMBNAIL, "-o", t / "r", "-j", 0],
        {"methods": 1, "failed": 0, "broke": 0},
    ),
    "evaluate-relocalization": (
        lambda d, t: ["-d", d.dataset, "-r", "oracle", "-m", "identity", "-o", t / "r", "-j", 0],
        {"pipelines": 2, "broke": 0},
    ),
    "probe": (
        lambda d, t: [
            *("-d", d.dataset, "-m", "b=trackers_for_probe:Basin", "-o", t / "p", "--pairs", 1, "-j", 0),
            *("--no-pixels", "--directions", 1),
        ],
        {"broke": 0},
    ),
    "leaderboard": (
        lambda d, t: [d.results, "--out", t / "b", "--format", "csv"],
        {"files_written": 3, "pair_sets": 2},  # rows, errors, truth.csv
    ),
    "report": (
        lambda d, t: [d.results, "--out", t / "site", "--pairs", 0],
        {"sets": 1, "methods": 1},
    ),
    "submit-check": (lambda d, t: [_submission(d, t), "-d", d.dataset], {"faults": 0, "pairs": 7, "answered": 7}),
    "leaderboard add": (
        lambda d, t: [_submission(d, t), "--to", t / "r", "-d", d.dataset],
        {"faults": 0, "rows": 1},
    ),
    "train": (
        lambda d, t: ["gn-net", "-d", d.dataset, "-o", t / "w", "-j", 0, "--device", "cpu", *SETTINGS],
        {"validation_pairs": 4},
    ),
    "inspect": (
        lambda d, t: [d.dataset, "--pictures", t / "pictures", "--pairs", 1],
        {"traversals": 2, "pair_sets": 2, "pairs": 7, "rejected": 1, "pictures": 2, "pages": 0},
    ),
    "view": (lambda d, t: [d.dataset, "--out", t / "v.rrd", "--limit", 1], {"pairs": 2, "pairs_left_out": 5}),
    "validate": (lambda d, t: [d.dataset, "--quick"], {"faults": 0}),
    "methods": (lambda d, t: [], {}),
    "register": (
        lambda d, t: [_scan_of_a_room(t), _scan_of_a_room(t), "--sensor", "origin", "--initial", "0 0 0 0 0 0 1"],
        {"files_written": 0},
    ),
    "check-method": (lambda d, t: ["identity"], {"failed": 0}),
    "fetch-weights": (lambda d, t: ["test_json:NeedsWeights"], {"files_written": 0, "skipped": 1}),
    "export": (
        lambda d, t: ["-d", d.dataset, "--format", "tum", "--out", t / "e"],
        {"pair_sets": 2},
    ),
    "demo": (
        lambda d, t: ["--out", t / "demo", "-j", 1],
        {"pair_sets": 2, "pairs": 7, "methods": 1, "answered": 7},
    ),
}
"""command -> its arguments on the smallest data, and some of what it counts then"""


def _scan_of_a_room(folder: Path) -> Path:
    np.save(folder / "room.npy", room_view(1, 0).cloud.points)
    return folder / "room.npy"


def test_the_table_has_every_command() -> None:
    from typer.main import get_command

    commands = getattr(get_command(app), "commands")  # noqa: B009  a group's, which its type does not tell
    assert set(commands) == set(COMMANDS)


@pytest.mark.thorough
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_prints_one_object_with_counts(
    command: str,
    data: SimpleNamespace,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    request: pytest.FixtureRequest,
) -> None:
    NeedsWeights.path = tmp_path / "weights.bin"
    NeedsWeights.path.write_bytes(b"numbers")
    if command == "demo":
        _small_demo(monkeypatch)
    if command == "preview":
        request.getfixturevalue("small_preview")
    arguments, expected = COMMANDS[command]
    outcome = relocbench(*command.split(), *arguments(data, tmp_path), "--json")
    assert outcome.status == 0, outcome.err
    counts = _parse(outcome)["counts"]
    assert {name: counts.get(name) for name in expected} == expected


def _small_demo(monkeypatch: pytest.MonkeyPatch) -> None:
    """The demo on the small dataset with one method, instead of a town that renders for minutes."""

    def build(sources: object, options: object, out: Path, *_: object) -> Dataset:
        return make_small_dataset(out, frames=3, rejected=1)

    usual = importers.importer("synthetic")
    monkeypatch.setattr(importers, "importer", lambda kind: SimpleNamespace(Options=usual.Options, build=build))
    monkeypatch.setattr(demo_module, "_METHODS", ("identity",))
    monkeypatch.setenv("TORCH_HOME", "no-weights")


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("arguments", "counted"),
    [
        (["methods", "dso"], {"parameters"}),
        (["train", "gn-net", "--show-options"], {"options"}),
        (["inspect", "VIEWS"], {"folders", "images"}),
        (["view", "DATASET", "--pair-set", ACROSS, "--pair-index", "0", "--out", "OUT/p.png"], {"pairs"}),
        (
            ["export", "-d", "DATASET", "--results", "RESULTS", "-m", "identity", "-f", "mlad", "--out", "OUT/a.zip"],
            {"files_written", "pair_sets"},
        ),
        (
            ["export", "-d", "DATASET", "-f", "blind", "--salt-file", "OUT/5f1c.salt", "--out", "OUT/b"],
            {"pairs", "pair_sets"},
        ),
        (["submit-check", "--new", "OUT/s"], {"files_written"}),
    ],
)
def test_other_ways_of_asking_print_one_object_too(
    arguments: list[str], counted: set[str], data: SimpleNamespace, tmp_path: Path
) -> None:
    places = {"VIEWS": data.views, "DATASET": data.dataset, "RESULTS": data.results}
    words = [str(places.get(word, word)).replace("OUT/", f"{tmp_path}/") for word in arguments]
    salt_file(tmp_path)
    outcome = relocbench(*words, "--json")
    assert outcome.status == 0, outcome.err
    assert counted <= set(_parse(outcome)["counts"])


def test_faults_and_broken_contracts_are_counted_and_the_status_stays_2(data: SimpleNamespace, tmp_path: Path) -> None:
    broken = relocbench("check-method", "trackers_for_tests:Nowhere", "--json")
    assert broken.status == 2
    predictions = tmp_path / f"{ACROSS}.txt"
    predictions.write_text("1 2 0 0 0 0 0 0 1\n")
    found = relocbench("validate", predictions, "-d", data.dataset, "--json")
    assert found.status == 2
    assert _parse(found)["counts"]["faults"] >= 1


def test_the_page_lists_every_command_and_what_it_counts(data: SimpleNamespace, tmp_path: Path) -> None:
    page = (DOCS / "scripting.md").read_text()
    rows = dict(re.findall(r"^\| `([\w -]+)` \| (.*) \|$", page, flags=re.MULTILINE))
    assert set(rows) == set(COMMANDS)
    for command, (_, expected) in COMMANDS.items():
        assert {name for name in expected if f"`{name}`" not in rows[command]} == set(), command
