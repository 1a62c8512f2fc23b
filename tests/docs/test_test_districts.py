"""The test districts follow from the phrase that the documentation fixes, and are none that were seen before."""

from __future__ import annotations

import re

from repository import ROOT

from relocbench.datasets.importers.edition.dataset import recipe
from relocbench.datasets.importers.edition.districts import CONDITIONS as DRAWN_FROM
from relocbench.datasets.importers.edition.districts import districts
from relocbench.datasets.synthetic.conditions.condition import CONDITIONS

EDITION = recipe("2026.1")
PAGE = (ROOT / "docs" / "test-districts.md").read_text()


def test_the_page_has_the_phrase_of_the_edition() -> None:
    assert f"> {EDITION.phrases['test']}\n" in PAGE


def test_a_district_has_three_conditions_that_exist_and_a_seed_of_its_own() -> None:
    found = list(districts(EDITION.phrases["test"], EDITION.districts))
    assert len({each.seed for each in found}) == EDITION.districts
    assert set(DRAWN_FROM) <= set(CONDITIONS)
    assert all(len(set(each.conditions)) == 3 for each in found)


def test_every_phrase_has_given_other_districts() -> None:
    phrases = [*EDITION.phrases.values(), *re.findall(r'the phrase "([^"]+)"', PAGE)]
    assert len(set(phrases)) == 5
    seeds = [each.seed for phrase in phrases for each in districts(phrase, 12)]
    assert len(set(seeds)) == len(seeds)
