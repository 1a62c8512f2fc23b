"""Compare GN-Net across weathers with direct alignment on intensities and with ORB, on datasets rendered from seeds.

In each of three districts that no training saw (test split, ``--seeds``) two datasets are rendered: the three weathers
of the CARLA part of the GN-Net benchmark in all nine combinations, and six more conditions of queries against a
``WetNoon`` map. They have six cameras of 512x512 pixels, and pairs about 1.6 m apart. ``relocbench evaluate`` runs
every method. The differences to each other method with their 95 % intervals are printed and written to ``--out``:
across conditions, for each combination, and within a condition.

The intervals are those of a paired bootstrap over blocks of neighbouring steps of the drives. The pairs of a step, from
its six cameras and all combinations of the group, are at one place and resampled together, as one observation.

Datasets and results are kept in ``--scratch``; when it is run again, only what is missing is made.

    python benchmarks/publish/cross_weather.py --scratch S [--out leaderboard/weather] [--workers N] [-m METHOD ...]

The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from relocbench.evaluation.common.error_table import read_errors
from relocbench.evaluation.common.results import all_results
from relocbench.metrics import Difference, PoseErrors, metric_named, paired_difference

Array = NDArray[np.float64]

CARLA = ("WetNoon", "SoftRainNoon", "WetCloudySunset")
OTHERS = ("Sunny", "Overcast", "Rain", "Snow", "Night", "Fog")
METRICS = ("t_auc@0.5m", "r_auc@0.5deg", "recall@(0.25m,2deg)")
METHODS = ("identity", "dso", "orb-pnp", "gn-net-contrastive", "lm-net", "gn-net")
SUBJECT = "gn-net"
RIVALS = ("dso", "orb-pnp")
"""methods that the subject should be ahead of"""
_HEAD = """# Across weathers

Printed by `python benchmarks/publish/cross_weather.py`; what is asked and how intervals are made stands there. Shares
are in percent, failures count as infinite errors. A difference whose interval excludes zero has a star.
"""


@dataclass(frozen=True)
class Group:
    """A group of pairs that are evaluated together."""

    name: str
    rows: pd.DataFrame
    """one row for each method and pair, with its district, step, pair_set and the per-pair value of each metric"""

    @property
    def pairs(self) -> int:
        return len(self.rows) // self.rows["method"].nunique()

    def mean(self, method: str, metric: str) -> float:
        """The mean over all pairs."""
        return float(self.rows.loc[self.rows["method"] == method, metric].mean())

    def ahead(self, method: str, other: str, metric: str) -> Difference:
        """The difference of ``method`` to ``other``, over the steps of the drives."""
        a, b = self._by_step(method, metric), self._by_step(other, metric)
        return paired_difference(a, b)

    def _by_step(self, method: str, metric: str) -> list[Array]:
        """One series for each district: the mean over the pairs of each step."""
        rows = self.rows[self.rows["method"] == method]
        return [of[metric].groupby(of["step"]).mean().to_numpy() for _, of in rows.groupby("district")]


def main() -> None:
    options = _options()
    with tempfile.TemporaryDirectory() as temporary:
        scratch = options.scratch or Path(temporary)
        datasets = _build(scratch, options)
        for dataset in datasets:
            methods = [word for method in options.methods for word in ("-m", method)]
            settings = [word for setting in options.settings for word in ("--set", setting)]
            results = "--out", scratch / "results", "--split", options.split, "-j", options.workers, "-q"
            _run("evaluate", "-d", dataset, *results, *methods, *settings)
        methods = list(dict.fromkeys(method.split("=")[0] for method in options.methods))
        rows = _scored(_errors(scratch / "results", methods))
    together, single = _groups(rows)
    tables = "\n".join(_tables(together, single, methods))
    print(tables)
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "cross_weather.md").write_text(f"{_HEAD}{tables}\n")
    print(json.dumps({"benchmark": "cross_weather", **_claims(together, single, methods)}))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scratch", type=Path, help="folder that keeps datasets and results; default: a temporary one")
    parser.add_argument("--out", type=Path, help="folder for cross_weather.md")
    parser.add_argument("--split", default="test")
    parser.add_argument("--seeds", default="100,101,102", help="seeds of the districts")
    parser.add_argument(
        "--steps", type=int, default=20, help="steps of each drive, each with six pairs for each combination"
    )
    parser.add_argument("--workers", "-j", type=int, default=2)
    parser.add_argument("-m", dest="methods", action="append", help=f"default: {', '.join(METHODS)}")
    parser.add_argument("--set", dest="settings", action="append", default=[], help="method.key=value")
    options = parser.parse_args()
    options.methods = options.methods or list(METHODS)
    return options


def _build(scratch: Path, options: argparse.Namespace) -> list[Path]:
    built = []
    for seed in options.seeds.split(","):
        for name, conditions, reference in (
            (f"weather-carla-{seed}", CARLA, "all"),
            (f"weather-seasons-{seed}", ("WetNoon", *OTHERS), "first"),
        ):
            out = scratch / name
            _run(
                "build-dataset", "synthetic", "--name", name, "--conditions", ",".join(conditions), "--cameras", "six",
                "--size", "512x512", "--steps", options.steps, "--speed", 10, "--split", options.split, "--seed", seed,
                "--reference", reference, "--correspondences", 300, "--out", out, "-j", options.workers, "-q",
            )  # fmt: skip
            built.append(out)
    return built


def _run(*words: object) -> None:
    """Run a relocbench command; its messages go to standard error."""
    subprocess.run([sys.executable, "-m", "relocbench", *map(str, words)], check=True)


def _errors(results: Path, methods: Sequence[str]) -> pd.DataFrame:
    """One row for each dataset, pair set, method and pair."""
    rows = []
    for folder in all_results(results):
        for method in folder.methods():
            if method.label not in methods:
                continue
            for pair_set in folder.record.pair_sets:
                about = {"dataset": folder.record.name, "pair_set": pair_set, "method": method.label}
                for pair in read_errors(method.errors(pair_set)):
                    ref_timestamp_ns, query_timestamp_ns = pair.key
                    rows.append(
                        {
                            **about,
                            "ref_timestamp_ns": ref_timestamp_ns,
                            "query_timestamp_ns": query_timestamp_ns,
                            "rotation_error_deg": pair.rotation_error_deg,
                            "translation_error_m": pair.translation_error_m,
                            "mlad_translation_error_m": pair.mlad_translation_error_m,
                        }
                    )
    return pd.DataFrame(rows)


def _scored(errors: pd.DataFrame) -> pd.DataFrame:
    """Conditions, district, step and per-pair values of every metric, for every answer.

    ``WetNoon`` against itself is in both datasets of a district and is counted once.
    """
    named = errors["pair_set"].str.extract(r"^[a-z]+-(?P<reference>\w+)-\d+__[a-z]+-(?P<query>\w+)-\d+__")
    district = errors["dataset"].str.extract(r"-(?P<district>\d+)$")
    rows = pd.concat([errors, named, district], axis=1)
    own = (rows["reference"] == rows["query"]) & rows["dataset"].str.startswith("weather-seasons")
    rows = rows[~own].sort_values(["dataset", "pair_set", "query_timestamp_ns", "ref_timestamp_ns", "method"])
    by_drive = rows.groupby(["district", "dataset", "query"])["query_timestamp_ns"]
    rows["step"] = by_drive.rank(method="dense").astype(int)
    of_pairs = PoseErrors(
        rotation_error_deg=rows["rotation_error_deg"].to_numpy(dtype=np.float64),
        translation_error_m=rows["translation_error_m"].to_numpy(dtype=np.float64),
        mlad_translation_error_m=rows["mlad_translation_error_m"].to_numpy(dtype=np.float64),
    )
    for name in METRICS:
        per_pair = metric_named(name).per_pair
        assert per_pair is not None
        rows[name] = per_pair(of_pairs)
    return rows


def _groups(rows: pd.DataFrame) -> tuple[list[Group], list[Group]]:
    """The groups: all pairs across conditions, all within a condition, and each combination of conditions."""
    across = rows["reference"] != rows["query"]
    together = [Group("across conditions", rows[across]), Group("within a condition", rows[~across])]
    order = {name: number for number, name in enumerate((*CARLA, *OTHERS))}
    names = sorted(
        set(zip(rows["reference"], rows["query"], strict=True)),
        key=lambda ends: (order[ends[1]] >= len(CARLA), order[ends[0]], order[ends[1]]),
    )
    single = [
        Group(f"{reference} -> {query}", rows[(rows["reference"] == reference) & (rows["query"] == query)])
        for reference, query in names
    ]
    return together, single


def _tables(together: list[Group], single: list[Group], methods: Sequence[str]) -> list[str]:
    lines = []
    for metric in METRICS:
        lines += [f"\n## {metric}, %\n", f"| reference -> query | pairs | {' | '.join(methods)} |"]
        lines += [f"|---|---|{'---|' * len(methods)}"]
        for group in (*together, *single):
            cells = [f"{100 * group.mean(method, metric):.1f}" for method in methods]
            lines.append(f"| {group.name} | {group.pairs} | {' | '.join(cells)} |")
    others = [method for method in methods if method != SUBJECT]
    lines += [f"\n## {SUBJECT} less another method, percentage points [95 % interval]\n"]
    lines += [f"| reference -> query | metric | {' | '.join(others)} |", f"|---|---|{'---|' * len(others)}"]
    for group in (*together, *single):
        for metric in METRICS:
            cells = [_told(group.ahead(SUBJECT, other, metric)) for other in others]
            lines.append(f"| {group.name} | {metric} | {' | '.join(cells)} |")
    return lines


def _told(difference: Difference) -> str:
    interval = difference.interval
    if interval is None:
        return f"{100 * difference.mean:+.1f}"
    star = " *" if difference.significant else ""
    return f"{100 * difference.mean:+.1f} [{100 * interval.low:+.1f}, {100 * interval.high:+.1f}]{star}"


def _claims(together: list[Group], single: list[Group], methods: Sequence[str]) -> dict[str, Any]:
    """The differences of the subject to each other method."""
    claims: dict[str, Any] = {"pairs_a_combination": min(group.pairs for group in single)}
    crossing = [group for group in single if len(set(group.name.split(" -> "))) == 2]
    for other in methods:
        if other == SUBJECT:
            continue
        told: dict[str, Any] = {}
        for group in together:
            for metric in METRICS:
                difference = group.ahead(SUBJECT, other, metric)
                interval = difference.interval
                ends = [None, None] if interval is None else [interval.low, interval.high]
                told[f"{group.name}, {metric}"] = [difference.mean, *ends]
        for metric in METRICS:
            told[f"combinations ahead, {metric}"] = sum(
                group.mean(SUBJECT, metric) > group.mean(other, metric) for group in crossing
            ) / len(crossing)
        claims[f"{SUBJECT} less {other}"] = told
    rivals = [method for method in RIVALS if method in methods]
    for metric in METRICS if rivals else ():
        claims[f"combinations ahead of {' and '.join(rivals)}, {metric}"] = sum(
            all(group.mean(SUBJECT, metric) > group.mean(rival, metric) for rival in rivals) for group in crossing
        ) / len(crossing)
    return claims


if __name__ == "__main__":
    main()
