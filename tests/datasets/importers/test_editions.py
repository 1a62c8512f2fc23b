"""Editions: recipes, folders, and what everybody is asked."""

import re
from pathlib import Path
from types import SimpleNamespace

import pytest
from command_line import relocbench

from relocbench.datasets.core import edition_folder
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.edition_folder import datasets_of, questions_of, read_edition
from relocbench.datasets.importers.edition import dataset as edition
from relocbench.datasets.importers.edition.dataset import Options, Recipe, TierRecipe, build_edition, options_of, recipe
from relocbench.datasets.importers.edition.districts import districts
from relocbench.datasets.importers.rendered import dataset as rendered
from relocbench.datasets.importers.rendered.dataset import Options as RenderedOptions
from relocbench.errors import ConfigError, DatasetError
from relocbench.execution import Run
from relocbench.metrics.pose.tiers import TIERS
from relocbench.progress import Silent

pytestmark = pytest.mark.usefixtures("towns_kept")
SMALL = Recipe(
    edition="small",
    districts=2,
    phrases={"validation": "a phrase", "test": "another"},
    options={
        "preset": "smoke",
        "size": "96x72",
        "steps": 10,
        "max_distance": 12.0,
        "extent": 190,
        "reference": "first",
    },
    tiers={
        "easy": TierRecipe(options={"distance": 0.8, "speed": 4.0}),
        "medium": TierRecipe(options={"distance": 4.0}, in_turn={"imaging": ["ideal", "varied"], "months": [None, 3]}),
    },
)


def test_every_recipe_of_the_package_can_be_rendered_on_every_district() -> None:
    real = recipe("2026.1")
    assert real.districts == 12
    assert list(real.tiers) == list(TIERS)
    for split, phrase in real.phrases.items():
        seeds = set()
        for district in districts(phrase, real.districts):
            seeds.add(district.seed)
            for tier in TIERS:
                options = RenderedOptions.model_validate(options_of(real, split, tier, district))
                assert (options.tier, options.split, options.seed) == (tier, split, district.seed)
        assert len(seeds) == real.districts


def test_an_unknown_edition_is_refused_with_the_names() -> None:
    with pytest.raises(ConfigError, match=r"2026\.1"):
        recipe("2025.1")


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(edition, "recipe", lambda name: SMALL)
    monkeypatch.setattr(edition, "TIERS", tuple(SMALL.tiers))


def made(out: Path, **options: object) -> edition_folder.EditionFolder:
    return build_edition(Options.model_validate({"edition": "small", **options}), out, Silent(), Run(1))


def test_the_command_says_whether_everybody_is_asked_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two tiers that ask what nobody else is asked, the recipe is made to expect one."""
    told = SimpleNamespace(content_id="c", pair_set_names=())
    monkeypatch.setattr(rendered, "build", lambda *given: told)
    real = recipe("2026.1")
    asked = questions_of({f"{number:02d}": "c" for number in range(1, real.districts + 1)})
    known = real.model_copy(update={"questions": {"test": {**real.questions["test"], "hard": asked}}})
    monkeypatch.setattr(edition, "recipe", lambda name: known)

    def said(*words: object) -> list[str]:
        out = tmp_path / "-".join(map(str, words))
        printed = relocbench("build-dataset", "edition", "2026.1", "-q", "--split", *words, "--out", out).out
        return re.findall("none published|as published|NOT AS PUBLISHED", printed)

    assert said("test") == [*["NOT AS PUBLISHED"] * 2, "as published", "NOT AS PUBLISHED"]
    assert said("test", "--districts", 3) == said("validation") == ["none published"] * 4


@pytest.mark.thorough
@pytest.mark.usefixtures("small")
def test_an_edition_built_tier_by_tier_asks_the_same_as_one_built_at_once(tmp_path: Path) -> None:
    whole = made(tmp_path / "whole")
    made(tmp_path / "parts", tier="medium")
    parts = made(tmp_path / "parts", tier="easy")
    assert parts.file == whole.file == read_edition(tmp_path / "whole")
    folders = datasets_of(tmp_path / "whole")
    assert [str(path.relative_to(tmp_path / "whole")) for path in folders] == [
        "easy/01", "easy/02", "medium/01", "medium/02",
    ]  # fmt: skip
    assert datasets_of(tmp_path / "whole" / "easy") == folders[:2]
    assert datasets_of(folders[0]) == [folders[0]]
    ids = {path.name: Dataset(path).content_id for path in folders[2:]}
    assert whole.file.tiers["medium"].questions == questions_of(ids)
    medium = [Dataset(path) for path in folders[2:]]
    assert whole.pairs["medium"] == sum(len(d.pair_set(name).pairs) for d in medium for name in d.pair_set_names)


@pytest.mark.thorough
@pytest.mark.usefixtures("small")
def test_a_folder_of_another_split_or_with_something_else_is_left_alone(tmp_path: Path) -> None:
    made(tmp_path / "one", tier="easy", districts=1)
    with pytest.raises(DatasetError, match="holds 1 districts of small, split validation"):
        made(tmp_path / "one", split="test")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "mine.txt").write_text("mine")
    with pytest.raises(DatasetError, match="holds something else"):
        made(tmp_path / "other")
    assert [path.name for path in (tmp_path / "other").iterdir()] == ["mine.txt"]
