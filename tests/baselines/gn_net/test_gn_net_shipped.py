"""The weights that come with the package: there, small, told where from, and those that their card speaks of."""

from __future__ import annotations

import json
import re

import pytest

from baselines.gn_net.method import SHIPPED
from baselines.gn_net.tracker import GnNet, GnNetContrastive, LmNet
from baselines.gn_net.weights import read_card

LARGEST_BYTES = 25_000_000
TRACKERS = [
    tracker for tracker in (GnNet, GnNetContrastive, LmNet) if (SHIPPED / f"{tracker.name}.safetensors").exists()
]


def test_the_method_of_the_paper_has_weights() -> None:
    assert GnNet in TRACKERS


@pytest.mark.parametrize("tracker", TRACKERS, ids=lambda tracker: tracker.name)
def test_weights_are_small_and_their_card_says_how_to_make_them_again(tracker: type[GnNet]) -> None:
    path = SHIPPED / f"{tracker.name}.safetensors"
    assert path.stat().st_size < LARGEST_BYTES
    inside = read_card(path)
    told = path.with_suffix(".md").read_text(encoding="utf-8")
    assert inside["name"] == tracker.name
    assert told.startswith(f"# {tracker.name}\n")
    for fingerprint in json.loads(inside["data"]).values():
        assert fingerprint in told
    for row in ("data", "seed", "steps", "time", "hardware", "versions", "command"):
        assert re.search(rf"^\| {row} \| \S", told, re.MULTILINE), row
    validated = "| reference -> query | pairs | t_auc@0.5m |" in told
    assert validated or "None during the training: the last weights were kept." in told


@pytest.mark.parametrize("tracker", TRACKERS, ids=lambda tracker: tracker.name)
def test_a_tracker_without_settings_takes_them(tracker: type[GnNet]) -> None:
    options = tracker().net.options
    expected = {"efficientnet-lite0": 5, "plain": 4}
    assert options.levels == expected[options.encoder]
    assert options.confidence == (tracker is GnNet)


@pytest.mark.parametrize("tracker", TRACKERS, ids=lambda tracker: tracker.name)
def test_a_card_names_the_licences_of_what_was_not_rendered(tracker: type[GnNet]) -> None:
    if tracker().net.options.encoder == "plain":
        return
    told = (SHIPPED / f"{tracker.name}.md").read_text(encoding="utf-8")
    licences = "Apache-2.0", "MIT", "CC-BY-4.0", "CC0-1.0", "Emil Persson (`humus`, CC-BY-3.0)"
    for word in (*licences, "tools/train_gn_net.sh"):
        assert word in told
