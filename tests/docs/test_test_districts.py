"""The test districts follow from the phrase that the documentation fixes."""

from __future__ import annotations

import sys

import pytest
from repository import ROOT

from relocbench.datasets.importers.edition.dataset import recipe
from relocbench.datasets.importers.edition.districts import CONDITIONS as DRAWN_FROM
from relocbench.datasets.synthetic.conditions.condition import CONDITIONS

sys.path.insert(0, str(ROOT / "benchmarks" / "publish"))
import districts


def test_the_page_has_the_phrase_the_seeds_and_the_conditions() -> None:
    page = (ROOT / "docs" / "test-districts.md").read_text()
    assert f"> {districts.PHRASE}\n" in page
    assert f"> {recipe('2026.1').phrases['test']}\n" in page
    for each in districts.districts(districts.PHRASE, districts.COUNT):
        assert f"| {each.number} | {each.seed} | {', '.join(each.conditions)} |" in page


def test_a_district_has_three_conditions_that_exist_and_a_seed_of_its_own() -> None:
    found = list(districts.districts(districts.PHRASE, districts.COUNT))
    assert len({each.seed for each in found}) == districts.COUNT
    assert sorted(DRAWN_FROM) == sorted(CONDITIONS)
    assert all(len(set(each.conditions)) == 3 for each in found)


@pytest.mark.parametrize("phrase", ["", "another phrase", *recipe("2026.1").phrases.values()])
def test_another_phrase_gives_other_districts(phrase: str) -> None:
    ours = {each.seed for each in districts.districts(districts.PHRASE, districts.COUNT)}
    assert not ours & {each.seed for each in districts.districts(phrase, districts.COUNT)}
