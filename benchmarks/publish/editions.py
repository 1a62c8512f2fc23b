"""Print the recipe of an edition as the tables of ``docs/editions.md``.

    python benchmarks/publish/editions.py 2026.1

What all districts have in common is one line; then a row for each option that differs between tiers, and one for each
district. Values that are joined by slashes are taken in turn by one district after another; a dash is the default.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from typing import Any

from relocbench.datasets.importers.edition.dataset import Recipe, TierRecipe, recipe
from relocbench.datasets.importers.edition.districts import districts


def lines(edition: Recipe) -> Iterator[str]:
    """The lines of Markdown."""
    yield ", ".join(f"`--{_flag(name)} {value}`" for name, value in edition.options.items())
    tiers = edition.tiers.values()
    names = dict.fromkeys(name for tier in tiers for name in (*tier.options, *tier.in_turn))
    yield ""
    yield from _table(
        ["option", *(f"`{name}`" for name in edition.tiers)],
        [[f"`--{_flag(name)}`", *(_value(tier, name) for tier in tiers)] for name in names],
    )
    drawn = [districts(phrase, edition.districts) for phrase in edition.phrases.values()]
    yield ""
    yield from _table(
        ["district", *(text for split in edition.phrases for text in (f"{split}: seed", "conditions"))],
        [
            [str(of[0].number), *(text for each in of for text in (str(each.seed), ", ".join(each.conditions)))]
            for of in zip(*drawn, strict=True)
        ],
    )


def _flag(name: str) -> str:
    return name.replace("_", "-")


def _value(tier: TierRecipe, name: str) -> str:
    values = tier.in_turn.get(name, [tier.options.get(name)])
    return " / ".join("–" if value is None else str(value) for value in values)


def _table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> Iterator[str]:
    for row in (head, ["---"] * len(head), *rows):
        yield f"| {' | '.join(row)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("edition", metavar="NAME")
    for line in lines(recipe(parser.parse_args().edition)):
        print(line)


if __name__ == "__main__":
    main()
