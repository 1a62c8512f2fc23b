"""The harness finds faults that were planted, says which input they are of, and makes the same inputs again."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from fuzz.case import Case, damage
from fuzz.catalogue import Catalogue, catalogue_of
from fuzz.folders import copy_tree
from fuzz.grammar import texts_of
from fuzz.parser import Parser, Place
from fuzz.planted import FAULTS, VALID, write_valid
from fuzz.run import Outcome, fuzz

pytestmark = pytest.mark.thorough
INPUTS = 1


@pytest.fixture(scope="module")
def planted() -> Catalogue:
    return catalogue_of("fuzz.planted")


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("kept")


@pytest.fixture(scope="module")
def outcome(planted: Catalogue, kept: Path, tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    folder = tmp_path_factory.mktemp("planted")
    return fuzz(planted, folder / "seeds", folder / "work", list(FAULTS), inputs=INPUTS, keep=kept, most_s=1.0)


@pytest.mark.parametrize(("name", "kind"), [(name, kind) for name, (_, kind) in FAULTS.items()])
def test_a_planted_fault_is_found_in_every_input_and_called_by_its_name(outcome: Outcome, name: str, kind: str) -> None:
    assert dict(outcome.tallies[name].outcomes) == {kind: INPUTS}


def test_inputs_that_fail_are_kept_whole_and_can_be_read_again(
    outcome: Outcome, kept: Path, planted: Catalogue
) -> None:
    assert outcome.failed == INPUTS * sum(kind not in ("refused", "accepted") for _, kind in FAULTS.values())
    names = {path.name.rsplit("-", 2)[0] for path in kept.iterdir()}
    assert names == {name for name, (_, kind) in FAULTS.items() if kind not in ("refused", "accepted")}
    folder = next(path for path in kept.iterdir() if path.name.startswith("raises-"))
    about = json.loads((folder / "case.json").read_text())
    root = folder / "input"
    with pytest.raises(ValueError, match="no message for a user"):
        planted.parsers["raises"].read(Place(root, root / about["target"], folder))


def test_the_table_and_the_summary_count_every_input(outcome: Outcome) -> None:
    table = outcome.table().splitlines()
    assert len(table) == 1 + len(FAULTS)
    assert outcome.summary()["inputs"] == INPUTS * len(FAULTS)
    assert outcome.summary()["faults"]["death"] == INPUTS


def inputs_of(folder: Path, count: int) -> list[object]:
    """What stands in the place of the valid file, input by input."""
    valid = folder / "valid"
    valid.mkdir()
    write_valid(valid)
    parser = Parser("text", "valid", ("file.txt",), lambda place: None, text=True, names=True)
    found: list[object] = []
    for number in range(count):
        root = folder / f"in-{number}"
        copy_tree(valid, root)
        damage(parser, Case("text", 0, number), root, valid, [b"other"], Path("canary"))
        found.append([_seen(path) for path in sorted(root.iterdir())])
    return found


def _seen(path: Path) -> tuple[str, str]:
    if path.is_symlink():
        return ascii(path.name), f"link to {path.readlink()}"
    return ascii(path.name), path.read_bytes().hex() if path.is_file() else "pipe" if path.is_fifo() else "folder"


def test_the_same_numbers_give_the_same_inputs_in_another_process(tmp_path: Path) -> None:
    here = inputs_of(tmp_path, 60)
    assert len({json.dumps(one) for one in here}) > 50
    program = (
        "import sys, json, relocbench.datasets.core.images; from pathlib import Path; "
        "from test_fuzz_harness import inputs_of; "
        "print(json.dumps(inputs_of(Path(sys.argv[1]), 60)))"
    )
    other = tmp_path / "other"
    other.mkdir()
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "PYTHONHASHSEED": "7"}
    words = [sys.executable, "-c", program, str(other)]
    told = subprocess.run(words, capture_output=True, text=True, env=environment, check=True)
    assert json.loads(told.stdout) == json.loads(json.dumps(here))


def test_drawn_texts_are_made_of_the_words_of_the_format() -> None:
    texts = texts_of("name: town\nrate_hz: 10.0\n", 0, 0)
    assert len(texts) == 25
    assert sum("rate_hz" in text for text in texts) > 5
    assert any(text not in VALID.decode() for text in texts)
