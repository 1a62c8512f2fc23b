"""An option that means the same has one name and one form on every command; other spellings are understood."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest
import typer
from pydantic import BaseModel, ConfigDict
from refusals import refused
from typer.main import get_command

from relocbench.cli.app import app
from relocbench.cli.commands.build_dataset import _command
from relocbench.cli.commands.leaderboard import _USUAL
from relocbench.cli.configuration import merged
from relocbench.cli.options import split_names
from relocbench.cli.spellings import OTHER_NAMES, as_shown
from relocbench.datasets.importers import KINDS
from relocbench.errors import ConfigError
from relocbench.leaderboard.relocalization.board import RELOCALIZATION
from relocbench.leaderboard.retrieval.board import RETRIEVAL
from relocbench.leaderboard.tracking import model

OF_TWO_MEANINGS = {"--poses"}
"""files of poses (register), or whether poses are started (probe)"""
ONE_AND_SEVERAL = {"--pair", "--camera"}
"""names of one thing, where the plural is a number of pairs or a list of cameras"""
REPEATED_ALONE = {"--dataset", "--poses", "--set", "--setup"}
"""values that may hold a comma, and numbers"""


@pytest.fixture(scope="module")
def options() -> dict[str, dict[str, Any]]:
    """command or kind of dataset -> long name -> the option"""
    commands = {**get_command(app).commands, **{kind: _command(kind) for kind in KINDS}}  # type: ignore[attr-defined]
    return {
        command: {name: one for one in of.get_params(typer.Context(of)) for name in one.opts if name.startswith("--")}
        for command, of in commands.items()
    }


def test_an_option_has_one_form_on_every_command(options: dict[str, dict[str, Any]]) -> None:
    forms = defaultdict(set)
    for of in options.values():
        for name, one in of.items():
            forms[name].add((one.is_flag, one.nargs, *(other for other in one.opts if other != name)))
            several = one.multiple and not one.metavar.endswith(",...")
            assert not several or name in REPEATED_ALONE, name
    assert {name for name, found in forms.items() if len(found) > 1} == OF_TWO_MEANINGS
    assert {name for name in forms if f"{name}s" in forms} == ONE_AND_SEVERAL


def test_other_names_stand_for_options_that_are_shown(options: dict[str, dict[str, Any]]) -> None:
    for command, names in OTHER_NAMES.items():
        shown = {other for one in options[command].values() for other in one.opts}
        assert not names.keys() & shown, command
        assert {name for name in names.values() if name} <= shown, command


@pytest.mark.parametrize(
    ("command", "words", "understood"),
    [
        ("preview", "--condition Sunny -c Rain --steps=3", "--conditions Sunny --conditions Rain --sweep-steps=3"),
        ("inspect", "-d D --pair-sets a,b", "D --pair-set a,b"),
        ("view", "--dataset=D --methods dso --limit 2", "D --method dso --pairs 2"),
        ("check-method", "--method dso", "dso"),
        ("leaderboard add", "S --to R -- --to", "S --results R -- --to"),
        ("rosbag", "a.bag --max-gap 2", "a.bag --max-pose-gap 2"),
        ("kitti", "--cameras image_2 --unknown", "--camera image_2 --unknown"),
    ],
)
def test_other_spellings_are_understood(
    options: dict[str, dict[str, Any]], command: str, words: str, understood: str
) -> None:
    assert as_shown(words.split(), options[command], OTHER_NAMES.get(command, {})) == understood.split()


class _Options(BaseModel):
    model_config = ConfigDict(extra="forbid")
    methods: tuple[str, ...] = ()


def test_a_file_of_options_takes_singular_and_plural(tmp_path: Path) -> None:
    file = tmp_path / "options.yaml"
    file.write_text("method: [dso]\n")
    assert merged(_Options, file, {}).methods == ("dso",)
    file.write_text("# one\nmethod: [[]]\n")
    with refused(ConfigError, file, 2, "methods.0"):
        merged(_Options, file, {})


def test_help_names_the_metrics_that_rank() -> None:
    assert {
        "--metric": model.RANKING,
        "--retrieval-metric": RETRIEVAL.ranking,
        "--relocalization-metric": RELOCALIZATION.ranking,
    } == _USUAL


def test_methods_are_repeated_or_joined_by_commas() -> None:
    command = "c=subprocess:python -c 'a, b'"
    assert split_names(["dso,a=sift-pnp", "orb-pnp", command]) == ["dso", "a=sift-pnp", "orb-pnp", command]
