"""``relocbench validate RESULTS`` looks at all that results hold: trackers, retrievers, pipelines and cards."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from command_line import relocbench
from small_dataset import make_small_dataset
from submissions import submit

from relocbench.datasets.core.dataset import Dataset

RETRIEVER, CHAIN, TRACKER = "*places*/random", "*relocalization@*/oracle+identity.top*", "small@*/identity"
CARD = "small@*/my-method/card.yaml"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("data") / "d", frames=4, size=(24, 18))


@pytest.fixture(scope="module")
def results(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("validated")
    common = ("-d", dataset.root, "-o", root / "r", "-j", 0, "-q")
    assert relocbench("evaluate", *common, "-m", "identity").status == 0
    assert relocbench("evaluate-retrieval", *common, "-m", "random").status == 0
    done = relocbench("evaluate-relocalization", *common, "-r", "oracle", "-m", "identity")
    assert done.status == 0, done.err
    added = relocbench("leaderboard", "add", submit(root / "s", dataset), "--to", root / "r", "-d", dataset.root, "-q")
    assert added.status == 0, added
    return root / "r"


def faults(path: Path, *options: object) -> list[str]:
    """``FILE: MESSAGE`` of each fault."""
    told = json.loads(relocbench("validate", path, *options, "--json", "-q").out)
    assert told["kind"] == "results"
    return [f"{Path(f['path']).name}: {f['message']}" for f in told["faults"]]


@pytest.mark.thorough
@pytest.mark.parametrize("part", [".", "*places*", RETRIEVER, "*relocalization@*", CHAIN, "small@*", TRACKER])
def test_whole_results_of_every_kind_have_no_fault(results: Path, dataset: Dataset, part: str) -> None:
    path = next(results.glob(part)) if part != "." else results
    assert faults(path) == []
    assert faults(path, "-d", dataset.root) == []


def cut(path: Path) -> None:
    path.write_text("\n".join(path.read_text().splitlines()[:-1]) + "\n")


def spoil(path: Path) -> None:
    path.write_text("x: 1\n")


@pytest.mark.parametrize(
    ("place", "change", "told"),
    [
        (f"{RETRIEVER}/*.csv", cut, "changed since"),
        (f"{RETRIEVER}/*.txt", Path.unlink, "missing, although its ranks are there"),
        ("*places*/retrieval.yaml", spoil, "is missing (and"),
        (f"{CHAIN}/*.csv", cut, "changed since"),
        (f"{CHAIN}/run.yaml", spoil, "is missing (and"),
        (f"{TRACKER}/run.yaml", spoil, "run.yaml: "),
        ("small@*/dataset.yaml", Path.unlink, "missing; expected the record of a dataset"),
        (CARD, Path.unlink, "missing; expected the card of a submission"),
        (CARD, lambda path: path.write_text(path.read_text() + "# more\n"), "is not the card that came with"),
    ],
)
def test_what_was_damaged_is_a_fault(
    results: Path, tmp_path: Path, place: str, change: Callable[[Path], object], told: str
) -> None:
    shutil.copytree(results, tmp_path / "r")
    path = next((tmp_path / "r").glob(place))
    change(path)
    found = faults(tmp_path / "r")
    assert any(told in fault for fault in found), found
    assert len(set(found)) == len(found)


@pytest.mark.parametrize("place", [RETRIEVER, CHAIN, TRACKER])
def test_every_faulty_row_of_a_table_is_named(results: Path, tmp_path: Path, place: str) -> None:
    """Whatever the task: an unknown status, a row of another length, and a row that occurs again."""
    shutil.copytree(results, tmp_path / "r")
    (row,) = (tmp_path / "r").glob(place)
    path = next(path for path in sorted(row.glob("*.csv")) if not path.name.endswith(".errors.csv"))
    head, *lines = path.read_text().splitlines()
    broken = [
        lines[0].replace(",ok,", ",fine,").replace(",failed,", ",fine,"),
        f"{lines[1]},more",
        *lines[2:],
        lines[2],
    ]
    path.write_text("\n".join([head, *broken]) + "\n")
    told = json.loads(relocbench("validate", row, "--json", "-q").out)
    named = [fault["line"] for fault in told["faults"] if fault["path"] == str(path) and fault["line"]]
    assert {2, 3, len(broken) + 1} <= set(named), told["faults"]
