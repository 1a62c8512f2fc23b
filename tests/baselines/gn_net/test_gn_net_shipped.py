"""The weights that come with the package: there, small, told where from, and those that their card speaks of."""

from __future__ import annotations

import json
import re

import pytest

from baselines.gn_net.tracker import SHIPPED, GnNet, GnNetContrastive, LmNet
from baselines.gn_net.weights import read_card

LARGEST_BYTES = 10_000_000
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
    assert "| reference -> query | pairs | t_auc@0.5m |" in told


@pytest.mark.parametrize("tracker", TRACKERS, ids=lambda tracker: tracker.name)
def test_a_tracker_without_settings_takes_them(tracker: type[GnNet]) -> None:
    assert tracker().net.options.levels == 4


def test_the_weights_that_are_not_the_default_load_and_tell_what_they_were_made_of() -> None:
    path = SHIPPED / "gn-net-lite0.safetensors"
    assert path.stat().st_size < 25_000_000
    options = GnNet(weights=path).net.options
    assert (options.levels, options.encoder, options.confidence) == (5, "efficientnet-lite0", True)
    told = path.with_suffix(".md").read_text(encoding="utf-8")
    for fingerprint in json.loads(read_card(path)["data"]).values():
        assert fingerprint in told
    for word in ("Apache-2.0", "MIT", "CC-BY-4.0", "tools/train_gn_net.sh"):
        assert word in told
