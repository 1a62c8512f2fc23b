"""Publish an edition: render its districts, ask the methods of ``tiers.py``, and print one page with their predictions.

    python benchmarks/publish/edition_page.py --scratch S [--edition 2026.1] [--split test] [--tier T] [--workers N]
    python benchmarks/publish/edition_page.py --only-print [--datasets E]
    python benchmarks/publish/edition_page.py --summary [--split test]

Districts and results are kept in ``--scratch``; when it is run again, only what is missing is made, and what was
published before is not asked again. An archive for each method on each tier, with all errors and predictions, goes to
``OUT/predictions/EDITION-SPLIT/TIER/METHOD.tar.xz``, and the page is printed from these archives alone. ``--only-
print`` makes nothing else. With ``--datasets``, an edition that was rendered again, every error is first computed anew
from the predictions and the truth. ``--summary`` makes nothing, and prints the tables of README and ``docs/results.md``
from the archives.

The page has the share of pairs that each method finds on each tier, with its interval; the differences that answer a
question, on the same pairs and with one error rate for all of them; how exact answers are; the shares by weather; how
often answers are right; and the digests by which to see that the same was asked.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import tiers
from archives import pack, unpack
from groups import FLOORS, METRICS, Group, commit, difference_table, differences, rounded_percent, run

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.edition_folder import datasets_of, questions_of
from relocbench.datasets.importers.edition.dataset import Recipe, recipe
from relocbench.errors import RelocbenchError
from relocbench.evaluation.common.results import all_results
from relocbench.metrics import CONFIDENT
from relocbench.metrics.pose.tiers import TIERS
from relocbench.metrics.statistics.intervals import MANY_ROADS

_HEAD = """# Edition {edition}, split {split}

How many pairs each method finds, in percent: poses within 0.25 m and 2 degrees of the truth. Each
[tier](../../docs/tiers.md) is harder than the one before it; `true-matches` is what matches that are right to a pixel
would find, and bounds all others. In brackets is the 95 % interval, where pairs are worth ten independent ones or more.
[What the methods are](../../docs/results.md), [what the edition is](../../docs/editions.md).

"""
_OF = {
    "validation": "Methods were developed on districts of this split, so that its numbers say how they were tuned.",
    "test": "The [ledger](../LEDGER.md) says when each method was asked.",
}
SUMMARY = ("gn-net", "aliked-pnp", "sift-pnp", "orb-pnp", "dso", "identity")
"""methods of the table of README; the results page has all of them"""
WEATHERS = ("Rain", "Snow", "Night", "Fog")
"""conditions that a column shows by itself"""
_AGAIN = """
## Print it again

From the published predictions and their errors, in a minute:

    {again}

With every error computed anew, on districts that are rendered again, in hours: `python tools/recompute.py --render`.
Printed by commit {commit}.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--edition", default="2026.1")
    parser.add_argument("--split", default="validation", choices=("validation", "test"))
    parser.add_argument("--out", type=Path, default=Path("leaderboard/edition"), help="folder of page and predictions")
    parser.add_argument("--scratch", type=Path, help="folder that keeps districts and results")
    parser.add_argument("--tier", dest="tiers", action="append", choices=TIERS, help="only this; may be repeated")
    parser.add_argument("--districts", type=int, help="only the first districts, to try the whole line out")
    parser.add_argument("--workers", "-j", type=int, default=2)
    parser.add_argument("--only-print", action="store_true", help="render and ask nothing")
    parser.add_argument("--summary", action="store_true", help="print the tables of README and results page")
    parser.add_argument("--predictions", type=Path, help="folder of the archives; default: below --out")
    parser.add_argument("--datasets", type=Path, help="the edition, rendered again: compute every error anew")
    options = parser.parse_args()
    makes = not (options.only_print or options.summary)
    if makes and options.scratch is None:
        parser.error("--scratch FOLDER, --only-print or --summary")
    name = f"{options.edition}-{options.split}"
    archives = options.predictions or options.out / "predictions" / name
    try:
        edition = recipe(options.edition)
        if makes:
            make(edition, archives, options)
        with tempfile.TemporaryDirectory() as temporary:
            results = unpack(archives, Path(temporary) / "results")
            if options.summary:
                columns = tiers.groups(tiers.answers(results))
                for methods in (SUMMARY, tiers.in_order(columns)):
                    print("\n".join(summary(columns, methods)), end="\n\n")
                return
            text = page(edition, options.split, results, options.datasets)
    except RelocbenchError as bad:
        sys.exit(str(bad))
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / f"{name}.md").write_text(text)
    print(text)


def make(edition: Recipe, archives: Path, options: argparse.Namespace) -> None:
    """Render the districts, ask the methods, and pack what they answered; what is there already is kept.

    Districts with published answers are not asked again: an edition may be asked part by part, on several machines,
    whose pixels differ by a grey level.
    """
    name, split = edition.edition, options.split
    datasets, results = options.scratch / f"{name}-{split}", options.scratch / "results"
    first = () if options.districts is None else ("--districts", options.districts)
    published = set()
    if archives.is_dir():
        with tempfile.TemporaryDirectory() as temporary:
            published = {folder.record.question for folder in all_results(unpack(archives, Path(temporary)))}
        unpack(archives, results)
    for tier in options.tiers or edition.tiers:
        words = name, "--split", split, "--tier", tier, *first, "--out", datasets, "-j", options.workers, "-q"
        run("build-dataset", "edition", *words)
        for district in datasets_of(datasets / tier):
            if Dataset(district).content_id not in published:
                tiers.evaluate(district, results, options.workers)
        pack_tier(results, name, split, tier, archives)


def pack_tier(results: Path, edition: str, split: str, tier: str, archives: Path) -> None:
    """An archive of each method's results on all districts of a tier."""
    districts = f"relocbench-{edition}-{split}-{tier}-*"
    for label in sorted({folder.name for folder in results.glob(f"{districts}@*/*/")}):
        pack(results, districts, label, archives / tier / f"{label}.tar.xz")


def page(edition: Recipe, split: str, results: Path, datasets: Path | None = None) -> str:
    """The whole page, from a results folder; with ``datasets``, every error is computed anew by their truth.

    Raises:
        RelocbenchError: results that do not fit together, or errors that are not those of predictions and truth.
    """
    rows = tiers.answers(results, [] if datasets is None else [datasets])
    asked = {folder.record.name: folder.record.question for folder in all_results(results)}
    unknown = sorted(asked.keys() - set(rows["district"]))
    if unknown:
        raise RelocbenchError(f"{unknown[0]} is not among {datasets or 'what was scored'}: its questions are others")
    columns = tiers.groups(rows)
    again = f"python benchmarks/publish/edition_page.py --only-print --edition {edition.edition} --split {split}"
    return "\n".join(
        [
            _HEAD.format(edition=edition.edition, split=split) + "\n".join(tiers.table(columns)),
            "",
            *_notes(edition, split, columns),
            *difference_table(differences(columns)),
            *_exactness(columns),
            *by_weather(columns),
            *_sureness(columns),
            *_questions(edition, split, columns, asked),
            _AGAIN.format(again=again, commit=commit()),
        ]
    )


def summary(columns: Sequence[Group], methods: Sequence[str]) -> list[str]:
    """The shares that methods find on each tier, in whole percent; empty where one was not asked of all pairs."""
    lines = [f"| method | {' | '.join(group.name for group in columns)} |", f"|---|{'---:|' * len(columns)}"]
    for method in methods:
        cells = [rounded_percent(g.mean(method, METRICS[0])) if method in g.methods else "" for g in columns]
        lines.append(f"| `{method}` | {' | '.join(cells)} |")
    return lines


def _notes(edition: Recipe, split: str, columns: Sequence[Group]) -> Iterator[str]:
    few = min(group.districts for group in columns)
    if few < edition.districts or len(columns) < len(edition.tiers):
        yield f"Not all {edition.districts} districts of all tiers were asked: this is no result of the edition."
    if few < MANY_ROADS:
        yield "Intervals speak of these districts alone: on others methods may find more or less."
    else:
        yield "Intervals speak of other districts of the same recipe as well. Districts count alike."
    yield "gn-net, gn-net-from-prior and gn-net-contrastive also try starts up to 10 m ahead and behind along the road."
    yield _OF[split]


def _exactness(columns: Sequence[Group]) -> Iterator[str]:
    """How exact answers are: the areas under the curves of both errors."""
    yield "\n## How exact are answers?\n"
    yield "[Areas under the curves](../../docs/metrics.md) of the errors up to half a metre and half a degree, in"
    yield "percent: 100 is the truth itself, and a pair without an answer counts as 0."
    for metric in METRICS[1:]:
        yield f"\n### {metric}\n"
        yield from tiers.table(columns, metric)


def by_weather(columns: Sequence[Group]) -> Iterator[str]:
    """What is found on each tier of the pairs with a condition at either end; nothing where no pair has one."""
    heading = [
        "\n## By weather\n",
        "Of the pairs with a condition of the rendered town at either end; those of the last column have none of them.",
        "Some conditions were drawn in few districts.",
    ]
    for group in columns:
        seen = [set(name.replace("__", "-").split("-")) & set(WEATHERS) for name in group.rows["pair_set"]]
        found = [Group(name, group.rows[[name in each for each in seen]]) for name in WEATHERS]
        found.append(Group("none of these", group.rows[[not each for each in seen]]))
        if any(seen):
            yield from heading
            yield f"\n### {group.name}\n"
            yield from tiers.table([each for each in found if len(each.rows)])
            heading = []


def _sureness(columns: Sequence[Group]) -> Iterator[str]:
    """How many answers are right, of all and of those that are sure, and how many of the right ones are sure."""
    tables: dict[str, list[str]] = {"sure": [], "right": []}
    for method in (name for name in tiers.in_order(columns) if name not in (*FLOORS, tiers.BOUND)):
        cells: dict[str, list[str]] = {"sure": [], "right": []}
        for group in columns:
            rows = group.rows[group.rows["method"] == method] if method in group.methods else group.rows[:0]
            right, confidence = rows[METRICS[0]].to_numpy(), rows["confidence"].to_numpy(dtype=np.float64)
            sure = confidence >= CONFIDENT
            cells["sure"] += [_share(right[rows["answered"].to_numpy(dtype=bool)]), _share(right[sure])]
            cells["right"].append(_share(sure[right == 1]) if np.isfinite(confidence).any() else "")
        for name, of in cells.items():
            tables[name].append(f"| {method} | {' | '.join(of)} |")
    yield "\n## Are answers right?\n"
    yield "Of the answers that a method gives, in percent, and their number; a pair may also be declined. *Sure* are"
    yield f"answers with a confidence of {CONFIDENT:g} or more, of methods that state one.\n"
    yield f"| method | {' | '.join(f'{group.name} | sure' for group in columns)} |"
    yield f"|---|{'---:|---:|' * len(columns)}"
    yield from tables["sure"]
    yield "\nOf the right answers, how many are sure:\n"
    yield f"| method | {' | '.join(group.name for group in columns)} |"
    yield f"|---|{'---:|' * len(columns)}"
    yield from tables["right"]


def _share(of: Array) -> str:
    return f"{100 * of.mean():.1f} of {len(of)}" if len(of) else ""


def _questions(edition: Recipe, split: str, columns: Sequence[Group], asked: dict[str, str]) -> Iterator[str]:
    """By which digests to see that the same was asked."""
    yield "\n## What was asked\n"
    yield "Who builds the edition and gets the same digests is asked the same"
    yield "([how to see it](../../docs/editions.md#were-two-people-asked-the-same))."
    if any(group.districts < edition.districts for group in columns):
        yield "Of a tier of which not all districts were asked it is the digest of those, which no whole edition has."
    yield ""
    yield "| tier | districts | pairs | digest of the questions |"
    yield "|---|---:|---:|---|"
    for group in columns:
        ids = {name.rpartition("-")[2]: asked[name] for name in sorted(set(group.rows["district"]))}
        yield f"| {group.name} | {group.districts} | {group.pairs} | `{questions_of(ids)}` |"


if __name__ == "__main__":
    main()
