"""The walk of ``docs/submitting.md``, by its own commands, from a dataset to a row."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import relocbench
from forgery import change_yaml
from repository import ROOT
from small_dataset import make_small_dataset
from submissions import filled_card

from relocbench.datasets.core.dataset import Dataset
from relocbench.evaluation.submission.card import Answered, Card, Weights

PAGE = (ROOT / "docs" / "submitting.md").read_text(encoding="utf-8")


def _commands() -> list[str]:
    blocks = re.findall(r"```bash\n(.*?)```", PAGE, flags=re.DOTALL)
    return [line for block in blocks for line in block.splitlines()]


@pytest.mark.thorough
@pytest.mark.parametrize("rendered", [False, True])
def test_the_walk_leads_from_a_salt_to_a_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rendered: bool) -> None:
    monkeypatch.chdir(tmp_path)
    Path("docs").symlink_to(ROOT / "docs")
    for line in _commands():
        words = shlex.split(line)
        if words[0] != "relocbench":
            subprocess.run(["bash", "-c", line.replace("python3", shlex.quote(sys.executable), 1)], check=True)
            continue
        if words[1] == "build-dataset" and not rendered:
            make_small_dataset(Path("town"), frames=4, size=(24, 18), name="town")
            continue
        if words[1] == "submit-check" and "--dataset" in words:  # steps 2 and 3 are done: the answers and the card
            blind = Dataset("town-blind")
            shutil.copytree("answers", Path("my-submission") / blind.name)
            card = filled_card(blind)
            change_yaml(Path("my-submission") / "card.yaml", lambda template, card=card: template.update(card))  # type: ignore[misc]
        outcome = relocbench(*words[1:])
        assert outcome.status == 0, (words, outcome)
    salt = Path("town.salt").read_text().strip()
    assert not [
        p for p in tmp_path.rglob("*.*") if p.is_file() and p.suffix != ".salt" and salt.encode() in p.read_bytes()
    ]
    page = next((tmp_path / "board" / "sets").glob("*.md")).read_text()
    assert "² made elsewhere: `my-method`" in page
    assert "[Card](../cards/town%40" in page
    rows = relocbench("leaderboard", "results", "-d", "town", "--out", "again", "--json", "-q")
    shown = json.loads(rows.out)["rows"]
    assert {(row["method"], row["made_elsewhere"], row["rescored"]) for row in shown} == {("my-method", "yes", "yes")}


def test_the_page_names_every_entry_of_the_card() -> None:
    for model in (Card, Weights, Answered):
        for name in model.model_fields:
            assert f"`{name}`" in PAGE, name
