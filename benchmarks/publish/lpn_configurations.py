"""Compare LPN and its variants, trained on one cross-view set and evaluated on others with several seeds.

Each configuration is trained with each seed by `relocbench train lpn --no-validation` (on all train places, keeping the
last weights, as in the papers) and evaluated by the code of `relocbench evaluate-retrieval` in both directions
between drone and satellite. Systems that start from LPN's weights (soft partition, masks) start from those of `lpn`
with the same seed, which are trained once; `lpn-dmli` is `lpn` with re-ranking. Baselines that learn nothing are listed
below them. Tables show mean +- standard deviation over the seeds, and the 95 % interval of R@1 by places: what other
places might have given for the same trainings, where all images of one place count as one draw. How far a system is
ahead of `lpn` has a table of its own, with 95 % intervals over places and seeds, both paired: what other places and
other trainings might have given (`relocbench.metrics.statistics.crossed` has the formula). All are computed from the
ranks of each query, which are checked against the retrieved images and the test set.

Beside the direction from drone to satellite are the numbers that the log of trials reports for test places of
University-1652: ANOTHER data set, with another backbone. Only the order of systems can be compared, and differences in
its first block are noise.

Trainings and results are kept in --scratch; when it is run again, only what is missing is done. Beside each page goes
``predictions.tar.xz``: what was retrieved first for each query, all ranks, and the logs of the trainings. With
--published such archives are read in place of training and asking anybody, and every rank is checked against the truth.

    python benchmarks/publish/lpn_configurations.py --train TRAIN --test TEST [TEST ...] --scratch S [--config NAME ...]
        [--seed N ...] [--set key=value ...] [--out leaderboard/retrieval [FOLDER ...]] [--device cpu] [--jobs N]
        [--published leaderboard/retrieval/predictions.tar.xz [ARCHIVE ...]]

The last line is JSON.
"""

from __future__ import annotations

import argparse
import csv
import fnmatch
import io
import json
import os
import subprocess
import sys
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from archives import extract, pack_folder
from lpn_order import Pair, agreement, pairs, scatter

from baselines.lpn.configurations import CONFIGURATIONS, FROM_ABOVE, REPLACED_PARTITION_LOSS, configuration
from baselines.lpn.training.card import differences
from baselines.lpn.training.initial_weights import start_of
from baselines.lpn.training.options import TrainOptions
from baselines.options import options_from_dict
from relocbench.arrays import Array
from relocbench.cli.console import reporter
from relocbench.datasets.cross_view import CrossViewSet, open_cross_view
from relocbench.errors import ConfigError, RelocbenchError
from relocbench.evaluation.common.folders import sets_in
from relocbench.evaluation.retrieval.evaluate import RetrievalOptions, evaluate_retrievers
from relocbench.evaluation.retrieval.records import SetResults
from relocbench.evaluation.retrieval.rescoring import RetrievalTruth
from relocbench.evaluation.retrieval.score import checked_answers, scores_of
from relocbench.files import write_text
from relocbench.methods.trainers import chosen_options, trainer_named
from relocbench.metrics import (
    LEVEL,
    Difference,
    Interval,
    controlled,
    crossed_difference,
    in_points,
    mean_interval,
    per_group,
)
from relocbench.pages import render

FLOORS = ("random", "colour-histogram", "orb-bow")
DIRECTIONS = ("drone-satellite", "satellite-drone")
METRICS = ("R@1", "R@5", "AP")
WITH_INTERVAL = "R@1"
COMPARED = ("R@1", "AP")
LOGGED = "drone-satellite"
"""the direction that the log of trials reports"""
FIRST = "lpn"
"""the configuration that others start from"""
KEPT = 10
"""so many retrieved images of each query are kept and published"""
ARCHIVE = "predictions.tar.xz"

ByPlace = dict[str, dict[str, Array]]
"""by direction and metric: (P,) one value for each place, whose mean is the mean over all queries, 0 to 1"""
Differences = dict[str, dict[str, dict[str, Difference]]]
"""by system, direction and metric"""


@dataclass(frozen=True, eq=False)
class Row:
    """The results of a system with all seeds."""

    name: str
    about: str
    runs: tuple[ByPlace, ...]
    seeds: tuple[int, ...]
    logged: tuple[float, float] | None = None
    """R@1 and AP of the log, percent, on University-1652"""

    def mean_and_deviation(self, direction: str, metric: str) -> tuple[float, float]:
        """Mean and standard deviation in percent; the deviation of a single run is NaN."""
        values = 100 * self.by_seed_and_place(direction, metric).mean(axis=1)
        return float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else float("nan")

    def interval_by_places(self, direction: str) -> Interval | None:
        """The interval of R@1 for other places and the same trainings; None where there are too few places."""
        values = self.by_seed_and_place(direction, WITH_INTERVAL)
        return mean_interval([values.mean(axis=0)], independent=True)

    def by_seed_and_place(self, direction: str, metric: str) -> Array:
        """(S, P) values, which may exceed 1 where a place has more queries than others."""
        return np.stack([run[direction][metric] for run in self.runs])


def trained_by(name: str) -> str:
    """The configuration whose weights a system uses: its own, unless it only re-ranks."""
    system = configuration(name)
    plain_one = configuration(FIRST)
    same = replace(system, name=FIRST, about=plain_one.about, rerank_top=0, logged=plain_one.logged)
    return FIRST if same == plain_one else name


def starts_from_first(name: str) -> bool:
    """Whether the first stage of a configuration is a training of ``lpn``, so that its weights can be used."""
    system = configuration(name)
    return len(system.stages) > 1 and system.network_in(system.stages[0]) == configuration(FIRST).network


def train(name: str, seed: int, given: argparse.Namespace) -> Path:
    """The weights of a configuration and seed, which are trained if they are missing and nothing is published."""
    out = Path(given.scratch) / f"{name}-seed{seed}"
    if given.published:
        return out / "weights.safetensors"
    words = [f"--set={setting}" for setting in (*settings_of(name, given.settings), f"seed={seed}")]
    if given.backbone_weights:
        words.append(f"--backbone-weights={given.backbone_weights}")
    if starts_from_first(name):
        words.append(f"--set=start={Path(given.scratch) / f'{FIRST}-seed{seed}' / 'weights.safetensors'}")
    command = [
        sys.executable,
        "-m",
        "relocbench",
        "train",
        "lpn",
        f"--config={name}",
        f"--out={out}",
        "--no-validation",
    ]
    command += [f"--dataset={root}" for root in given.train] + words
    command += [f"--device={given.device}"] if given.device else []
    command += [f"--workers={given.workers}"] if given.workers is not None else []
    command += ["--quiet"] if given.quiet or given.jobs > 1 else []
    threads = max((os.cpu_count() or 1) // given.jobs, 1)
    environment = {**os.environ, "OMP_NUM_THREADS": str(threads)} if given.jobs > 1 else None
    done = subprocess.run(command, stdout=sys.stderr, env=environment, check=False)
    if done.returncode:
        raise RelocbenchError(f"the training of {name} with seed {seed} ended with status {done.returncode}", out)
    return out / "weights.safetensors"


def trained(wanted: Sequence[tuple[str, int]], given: argparse.Namespace) -> dict[tuple[str, int], Path]:
    """The weights of configurations and seeds, several trained at a time, first those that others start from."""
    firsts = [each for each in wanted if each[0] == FIRST]
    others = [each for each in wanted if each[0] != FIRST]
    with ThreadPoolExecutor(given.jobs) as pool:
        return {
            each: path
            for some in (firsts, others)
            for each, path in zip(some, pool.map(lambda each: train(*each, given), some), strict=True)
        }


def settings_of(name: str, settings: Sequence[str]) -> list[str]:
    """The settings that apply to a configuration, later ones over earlier ones, without those that have the names of
    others in front (``lpn-heatmap*.rate=1e-3``) and without epochs of stages that it does not have."""
    stages = {stage.name for stage in configuration(name).stages}
    out = {}
    for setting in settings:
        key, _, value = setting.partition("=")
        owner, _, rest = key.partition(".")
        if owners := fnmatch.filter(CONFIGURATIONS, owner):
            if name not in owners:
                continue
            key = rest
        if not key.startswith("epochs.") or key.removeprefix("epochs.") in stages:
            out[key] = value
    return [f"{key}={value}" for key, value in out.items()]


def options_of(name: str, given: argparse.Namespace) -> TrainOptions:
    """The options of a configuration's training."""
    settings = settings_of(name, given.settings)
    settings += [f"backbone_weights={given.backbone_weights}"] if given.backbone_weights else []
    return options_from_dict(TrainOptions, chosen_options(trainer_named("lpn"), name, settings)).with_rates()


def ask(
    given: argparse.Namespace, test: CrossViewSet, methods: dict[str, str], settings: Sequence[str] = ()
) -> SetResults:
    """The results of several labelled retrievers on a test set, which are evaluated unless they are published."""
    results = Path(given.scratch) / "results"
    if not given.published:
        options = RetrievalOptions(
            dataset=test.root,
            methods=tuple(f"{label}={target}" for label, target in methods.items()),
            set=tuple(settings),
            out=results,
            pair_sets=DIRECTIONS,
            keep=KEPT,
            workers=0,  # retrievers of one process share the maps of a frozen backbone
        )
        evaluate_retrievers(options, reporter(given.quiet))
    return results_on(test, results)


def results_on(test: CrossViewSet, results: Path) -> SetResults:
    """The folder with results on a test set, or on a copy of it whose pixels are not the same to the last bit.

    Raises:
        RelocbenchError: there is none.
    """
    found = [of for of in sets_in(results, SetResults) if of.record.name == test.name]
    if not found:
        raise RelocbenchError(f"expected results on '{test.name}'", results)
    return max(found, key=lambda of: of.record.fingerprint == test.fingerprint)


def answers(results: SetResults, labels: Iterable[str], test: CrossViewSet) -> dict[str, ByPlace]:
    """What retrievers answered, by label.

    Raises:
        PredictionError: a file of answers is damaged, or ranks do not follow from the retrieved images and the test
            set.
    """
    truth = RetrievalTruth(results, test)
    out: dict[str, ByPlace] = {}
    for folder in map(results.method, labels):
        keep = folder.run_record().keep
        out[folder.label] = {}
        for direction in DIRECTIONS:
            record = results.record.tasks[direction]
            rows = checked_answers(direction, record, folder)
            truth.confirmed(folder, direction, keep, rows)
            scores, places = scores_of(rows, record), [row.group for row in rows]
            out[folder.label][direction] = {m: per_group(scores.per_query(m), places) for m in METRICS}
    return out


def weights_of(given: argparse.Namespace) -> dict[tuple[str, int], Path]:
    """All weights by configuration and seed, which are trained if they are missing."""
    names, seeds = given.config, given.seed
    first = any(starts_from_first(name) or trained_by(name) == FIRST for name in names)
    order = ([FIRST] if first else []) + [name for name in names if trained_by(name) == name and name != FIRST]
    return trained([(name, seed) for seed in seeds for name in order], given)


def rows_of(given: argparse.Namespace, weights: dict[tuple[str, int], Path], test: CrossViewSet) -> list[Row]:
    """A row for every system on one test set, which is evaluated if it is missing."""
    rows, seeds = [], given.seed
    for name in given.config:
        labels = {f"{name}-seed{seed}": "lpn" for seed in seeds}
        settings = [f"{name}-seed{seed}.weights={weights[trained_by(name), seed]}" for seed in seeds]
        settings += [f"{label}.config={name}" for label in labels] + [
            f"{label}.device={given.device or 'cpu'}" for label in labels
        ]
        if (options := options_of(name, given)).frozen != "nothing":
            settings += [f"{label}.shared_blocks={options.cached_blocks}" for label in labels]
        found = answers(ask(given, test, labels, settings), labels, test)
        system = CONFIGURATIONS[name]
        logged = (system.logged.r_at_1, system.logged.ap) if system.logged else None
        rows.append(Row(name, system.about, tuple(found[label] for label in labels), tuple(seeds), logged))
    floors = answers(ask(given, test, {name: name for name in FLOORS}), FLOORS, test)
    return rows + [Row(name, "learns nothing", (floors[name],), ()) for name in FLOORS]


def differences_to_first(rows: Sequence[Row]) -> Differences:
    """How far each trained system is ahead of ``lpn`` at the same places with the same seeds; empty without ``lpn``.

    One error rate holds for all differences together.
    """
    first = next((row for row in rows if row.name == FIRST), None)
    others = [row for row in rows if row.seeds and row is not first]
    if first is None:
        return {}
    cells = [(row, d, m) for row in others for d in DIRECTIONS for m in COMPARED]
    found = [crossed_difference(row.by_seed_and_place(d, m), first.by_seed_and_place(d, m)) for row, d, m in cells]
    out: Differences = {row.name: {d: {} for d in DIRECTIONS} for row in others}
    for (row, d, m), difference in zip(cells, controlled(found), strict=True):
        out[row.name][d][m] = difference
    return out


def page(
    rows: Sequence[Row],
    ahead: Differences,
    given: argparse.Namespace,
    test: CrossViewSet,
    chance: dict[str, float],
    ends: Sequence[tuple[str, str, str, str]] = (),
) -> str:
    """The text of ``lpn_configurations.md`` for a test set."""
    options = options_of(FIRST, given)
    counts = {task.name: (len(task.queries), len(task.gallery)) for task in test.tasks()}
    started = start_of(options).text
    return render(
        __name__,
        "lpn_configurations.md.j2",
        trained_on=[open_cross_view(Path(root)) for root in given.train],
        test=test,
        asked=[(d, *counts[d]) for d in DIRECTIONS],
        places=[(d, len(rows[0].runs[0][d][WITH_INTERVAL])) for d in DIRECTIONS],
        chance=[(d, f"{100 * chance[d]:.2f}") for d in DIRECTIONS],
        options=options,
        started=started,
        settings=[setting for setting in given.settings if not setting.startswith("maps=")],  # a folder's name
        differences=differences(options, started),
        replaced=REPLACED_PARTITION_LOSS,
        level=f"{LEVEL:.0%}".replace("%", " %"),
        metrics=METRICS,
        with_interval=WITH_INTERVAL,
        logged_direction=LOGGED,
        directions=[(d, [(row, _cells(row, d)) for row in rows]) for d in DIRECTIONS],
        first=FIRST,
        seeds=len(given.seed),
        compared=[f"{d} {m}" for d in DIRECTIONS for m in COMPARED],
        ahead=[(name, [in_points(of[d][m]) for d in DIRECTIONS for m in COMPARED]) for name, of in ahead.items()],
        scatter=scatter_to_first(rows) if len(given.seed) > 1 else [],
        order=order_of(rows) if len(given.seed) > 1 else None,
        ends=ends,
        rows=rows,
    )


def scatter_to_first(rows: Sequence[Row]) -> list[tuple[str, list[str]]]:
    """For each system, the standard errors of how far it is ahead of ``lpn`` in R@1, in percentage points."""
    values = _values_of_trained(rows)
    if FIRST not in values:
        return []
    first = values.pop(FIRST)
    return [(name, [f"{100 * each:.2f}" for each in scatter(of, first)]) for name, of in values.items()]


def order_of(rows: Sequence[Row]) -> dict[str, Any] | None:
    """How far the order of the systems in R@1 is that of the log; None for fewer than three of the log's."""
    values = _values_of_trained(rows)
    logged = {row.name: row.logged[0] for row in rows if row.logged}
    agreed = agreement(values, logged)
    if agreed is None:
        return None
    of_pairs = pairs(values, logged)
    told = [(name, [_pair(each) for each in getattr(of_pairs, name)]) for name in of_pairs._fields]
    return {"agreement": agreed, "pairs": told, "count": sum(len(each) for each in of_pairs)}


def _values_of_trained(rows: Sequence[Row]) -> dict[str, Array]:
    return {row.name: row.by_seed_and_place(LOGGED, WITH_INTERVAL) for row in rows if row.seeds}


def _pair(pair: Pair) -> tuple[str, str, str, str]:
    return pair.first, pair.second, f"{pair.apart:+.2f}", in_points(pair.difference)


def ends_of(given: argparse.Namespace) -> list[tuple[str, str, str, str]]:
    """Where the trainings of each system ended: steps of the last stage's log, loss, and images told right, in percent.

    Values are means over the seeds of the last rows of ``log.csv``, over as many steps as one row has.
    """
    out = []
    for name in dict.fromkeys(trained_by(name) for name in given.config):
        last = [_last_row(Path(given.scratch) / f"{name}-seed{seed}" / "log.csv") for seed in given.seed]
        if not all(last):
            continue
        right = [float(value) for row in last for key, value in row.items() if key.startswith("right/")]
        loss = np.mean([float(row["instance"]) for row in last])
        out.append((name, last[0]["step"], f"{loss:.2f}", f"{100 * np.mean(right):.0f}"))
    return out


def _last_row(path: Path) -> dict[str, str]:
    """The last row of a log; empty where there is none."""
    if not path.exists():
        return {}
    with path.open(newline="", encoding="utf-8") as stream:
        return ([{}, *csv.DictReader(stream)])[-1]


def table(rows: Sequence[Row]) -> str:
    """The text of ``lpn_configurations.csv``: one line for each system, seed and direction."""
    text = io.StringIO()
    out = csv.writer(text, lineterminator="\n")
    out.writerow(["system", "seed", "direction", *METRICS])
    for row in rows:
        for seed, run in zip(row.seeds or ("",), row.runs, strict=True):
            for direction in DIRECTIONS:
                out.writerow([row.name, seed, direction, *(f"{run[direction][m].mean():.6f}" for m in METRICS)])
    return text.getvalue()


def _cells(row: Row, direction: str) -> list[str]:
    """The cells of one direction's table behind the number of seeds."""
    out = []
    for metric in METRICS:
        out.append(_cell(*row.mean_and_deviation(direction, metric)))
        if metric == WITH_INTERVAL:
            interval = row.interval_by_places(direction)
            out.append("" if interval is None else f"{100 * interval.low:.1f} to {100 * interval.high:.1f}")
    if direction == LOGGED:
        out += [f"{value:.2f}" for value in row.logged] if row.logged else ["", ""]
    return out


def _cell(mean: float, deviation: float) -> str:
    return f"{mean:.2f}" if np.isnan(deviation) else f"{mean:.2f} ± {deviation:.2f}"


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """The results on one test set, for the last line."""
    return {
        row.name: {d: {m: round(row.mean_and_deviation(d, m)[0], 2) for m in METRICS} for d in DIRECTIONS}
        for row in rows
    }


def summary_of_differences(ahead: Differences) -> dict[str, Any]:
    """The differences to ``lpn`` on one test set in percentage points, for the last line."""
    return {
        name: {d: {m: _plain(difference) for m, difference in of.items()} for d, of in by_direction.items()}
        for name, by_direction in ahead.items()
    }


def _plain(difference: Difference) -> dict[str, float | bool | None]:
    interval = difference.interval
    return {
        "mean": round(100 * difference.mean, 2),
        "low": None if interval is None else round(100 * interval.low, 2),
        "high": None if interval is None else round(100 * interval.high, 2),
        "significant": difference.significant,
    }


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--train", nargs="+", required=True, help="cross-view folders with train/")
    parser.add_argument("--test", nargs="+", required=True, help="cross-view folders with test/, or two sheets")
    parser.add_argument("--scratch", required=True, help="folder that keeps trainings and results")
    parser.add_argument(
        "--config", nargs="+", default=list(FROM_ABOVE), help="configurations [default: all from above]"
    )
    parser.add_argument("--seed", nargs="+", type=int, default=[0, 1, 2], help="[default: 0 1 2]")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        dest="settings",
        help="key=value of the trainer; epochs.STAGE applies to configurations with that stage, NAME.key=value to "
        "those whose names match NAME (lpn-heatmap*.rate=1e-3)",
    )
    parser.add_argument("--backbone-weights", help="file of torchvision's ResNet or of another training; or: imagenet")
    parser.add_argument("--out", nargs="+", default=["leaderboard/retrieval"], help="a folder for each test set's page")
    parser.add_argument(
        "--published", nargs="+", type=Path, default=[], help=f"{ARCHIVE} of each test set, in place of asking anybody"
    )
    parser.add_argument("--device")
    parser.add_argument("--workers", type=int)
    parser.add_argument("--jobs", type=int, default=1, help="trainings at a time, which share the cores")
    parser.add_argument("--quiet", action="store_true")
    return parser.parse_args()


def main() -> int:
    """Print the page and one JSON line."""
    given = arguments()
    try:
        if given.jobs < 1:
            raise ConfigError(f"--jobs is {given.jobs}, expected 1 or more")
        if len(given.out) != len(given.test):
            raise ConfigError(f"--out names {len(given.out)} folders for {len(given.test)} test sets; expected as many")
        for archive in given.published:
            extract(archive, Path(given.scratch))
        for name in given.config:
            configuration(name)
        tests = {Path(folder): open_cross_view(Path(folder)) for folder in given.test}
        for folder, found in tests.items():
            missing = set(DIRECTIONS) - {task.name for task in found.tasks()}
            if missing:
                raise ConfigError(f"has no {' and no '.join(sorted(missing))}", folder)
        weights = weights_of(given)
        results, differences_of = {}, {}
        for found, out in zip(tests.values(), map(Path, given.out), strict=True):
            rows = rows_of(given, weights, found)
            ahead = differences_to_first(rows)
            asked = results_on(found, Path(given.scratch) / "results")
            chance = {d: float(asked.record.tasks[d].chance["R@1"]) for d in DIRECTIONS}
            text = page(rows, ahead, given, found, chance, ends_of(given))
            write_text(out / "lpn_configurations.md", text)
            write_text(out / "lpn_configurations.csv", table(rows))
            if not given.published:
                scratch = asked.root.parents[1]
                logs = [f"{name}-seed{seed}/log.csv" for name in given.config for seed in given.seed]
                pack_folder(scratch, out / ARCHIVE, f"results/{asked.root.name}/**/*", *logs)
            print(text)
            results[found.name] = summary(rows)
            differences_of[found.name] = summary_of_differences(ahead)
    except RelocbenchError as bad:
        print(f"error: {bad}", file=sys.stderr)
        return 2
    last = {"benchmark": "lpn_configurations", "seeds": given.seed, "percent": results}
    print(json.dumps({**last, f"difference_to_{FIRST}": differences_of}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
