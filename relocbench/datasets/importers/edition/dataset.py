"""Kind ``edition``: the districts of a named edition, each rendered as a dataset of its own.

An edition is a recipe in this package: a phrase for each split, from which the seeds and conditions of its districts
follow, and for each tier the options of ``build-dataset synthetic``, some of which change from district to district. A
recipe never changes; another one gets another name.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.edition_folder import (
    FILE,
    EditionFile,
    EditionFolder,
    TierRecord,
    district_name,
    questions_of,
    read_edition,
    write_edition,
)
from relocbench.datasets.core.schema import Strict
from relocbench.datasets.importers.edition.districts import District, districts
from relocbench.errors import ConfigError, DatasetError, available
from relocbench.execution import Run
from relocbench.files import load_yaml
from relocbench.metrics.pose.tiers import TIERS, Tier
from relocbench.progress import Reporter

_RECIPES = "recipes"


class Options(Strict):
    """Options of ``relocbench build-dataset edition``."""

    edition: str = Field(description="name of the edition, such as 2026.1")
    split: Literal["validation", "test"] = Field(
        "validation", description="'validation' to develop with; 'test' once, for a finished method"
    )
    tier: Tier | None = Field(None, description="one tier of difficulty; default: all")
    districts: int | None = Field(
        None, ge=1, description="only the first districts, to try something; what they give is no result of the edition"
    )


class TierRecipe(Strict):
    """What the districts of a tier have in common, and in what they differ."""

    options: dict[str, Any]
    """of ``build-dataset synthetic``"""
    in_turn: dict[str, list[Any]] = Field(default_factory=dict)
    """options of which district K takes the K-th value, over and over"""


class Recipe(Strict):
    """One edition."""

    edition: str
    districts: int
    phrases: dict[str, str]
    """by split"""
    options: dict[str, Any]
    """of ``build-dataset synthetic``, the same for all"""
    tiers: dict[Tier, TierRecipe]
    questions: dict[str, dict[str, str]] = Field(default_factory=dict)
    """split -> tier -> the digest of questions that everybody gets"""


def recipe(name: str) -> Recipe:
    """The recipe of an edition. Raises ConfigError, listing the names, if there is none."""
    folder = files(__package__) / _RECIPES
    names = sorted(entry.name.removesuffix(".yaml") for entry in folder.iterdir() if entry.name.endswith(".yaml"))
    if name not in names:
        raise ConfigError(f"no edition '{name}'{available(name, names)}")
    return load_yaml(Path(str(folder / f"{name}.yaml")), Recipe, "the recipe of an edition")


def options_of(edition: Recipe, split: str, tier: Tier, district: District) -> dict[str, Any]:
    """The options of ``build-dataset synthetic`` for one district."""
    own = edition.tiers[tier]
    turn = {name: values[(district.number - 1) % len(values)] for name, values in own.in_turn.items()}
    return {
        "name": district_name(edition.edition, split, tier, district.number),
        **edition.options,
        **own.options,
        **{name: value for name, value in turn.items() if value is not None},
        "tier": tier,
        "split": split,
        "seed": district.seed,
        "conditions": district.conditions,
    }


def build_edition(options: Options, out: Path, reporter: Reporter, run: Run) -> EditionFolder:
    """Render the districts of an edition that are not there yet.

    Raises:
        ConfigError: there is no such edition.
        DatasetError: ``out`` holds something else.
    """
    from relocbench.datasets.importers.rendered.dataset import Options as RenderedOptions
    from relocbench.datasets.importers.rendered.dataset import build

    edition = recipe(options.edition)
    count = min(options.districts or edition.districts, edition.districts)
    file = _claimed(out, EditionFile(edition=edition.edition, split=options.split, districts=count))
    chosen = list(districts(edition.phrases[options.split], count))
    pairs: dict[str, int] = {}
    for tier in TIERS if options.tier is None else (options.tier,):
        made: dict[str, Dataset] = {}
        for district in chosen:
            number = f"{district.number:02d}"
            reporter.note(f"{tier}: district {district.number} of {count}")
            rendering = RenderedOptions.model_validate(options_of(edition, options.split, tier, district))
            made[number] = build([], rendering, out / tier / number, reporter, run)
        pairs[tier] = sum(len(made[n].pair_set(name).pairs) for n in made for name in made[n].pair_set_names)
        ids = {number: dataset.content_id for number, dataset in made.items()}
        record = TierRecord(questions=questions_of(ids), datasets=ids)
        file = file.model_copy(update={"tiers": _in_order({**file.tiers, tier: record})})
        write_edition(out, file)
    expected = edition.questions.get(options.split, {}) if count == edition.districts else {}
    return EditionFolder(out, file, pairs, expected)


def _claimed(out: Path, wanted: EditionFile) -> EditionFile:
    """The edition that the folder holds already, or the wanted one, written there."""
    known = read_edition(out)
    if known is None:
        if out.exists() and any(path.name != FILE and not path.name.startswith(".") for path in out.iterdir()):
            raise DatasetError("holds something else; expected an empty folder or the same edition", out)
        write_edition(out, wanted)
        return wanted
    same = (known.edition, known.split, known.districts) == (wanted.edition, wanted.split, wanted.districts)
    if not same:
        held = f"{known.districts} districts of {known.edition}, split {known.split}"
        asked = f"{wanted.districts} of {wanted.edition}, split {wanted.split}"
        raise DatasetError(f"holds {held}; expected {asked}, or another folder", out / FILE)
    return known


def _in_order(tiers: Mapping[str, TierRecord]) -> dict[str, TierRecord]:
    return {tier: tiers[tier] for tier in TIERS if tier in tiers}
