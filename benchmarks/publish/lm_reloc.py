"""What the pose network adds to the alignment of lm-net: from the identity, from its pose, and from matches.

Validation districts that no training read are rendered as those of ``cross_weather.py``: 512x512 pixels, three
conditions, each of which is the map for queries of all three; their seeds follow from a phrase of their own.
``relocbench evaluate`` runs ``identity``, ``pose-net``, ``lm-net-from-prior`` (started from the identity), ``lm-reloc``
(from pose-net's pose alone) and ``lm-net`` (from matches and the identity). For pairs within a condition, and across
conditions with a keyframe within a metre and farther off, it prints the medians of both errors, recall and r_auc with
their 95 % intervals, and the differences of lm-reloc to the other alignments. Districts count alike, and a district is
one series by the step of the drive (``docs/statistics.md``).

    python benchmarks/publish/lm_reloc.py --scratch S [--districts N | --district K] [--steps N]
        [--pose-weights FILE ...]

Each file of ``--pose-weights`` adds the rows ``pose-net-K`` and ``lm-reloc-K``. Datasets and results are kept in
``--scratch``; when it is run again, only what is missing is made. The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from districts import District, districts

import relocbench as rb
from relocbench.arrays import Array
from relocbench.metrics import PoseErrors, by_place, mean_interval, metric_named, paired_difference

PHRASE = "a pose network guesses before the alignment looks"
METRICS = ("recall@(0.25m,2deg)", "r_auc@0.5deg")
METHODS = ("identity", "pose-net", "lm-net-from-prior", "lm-reloc", "lm-net")
SUBJECT, ALIGNED = "lm-reloc", ("lm-net-from-prior", "lm-net")
SPEED_MPS = 40
"""at 10 images a second, the other keyframes of a drive are 4 m away and more"""
NEAR_M = 1.0


def main() -> None:
    options = _options()
    methods, settings = _asked(options.pose_weights)
    with tempfile.TemporaryDirectory() as temporary:
        scratch = options.scratch or Path(temporary)
        chosen = list(districts(PHRASE, max(options.districts, options.district or 0)))
        if options.district:
            chosen = [district for district in chosen if district.number == options.district]
        built = [_build(scratch, district, options) for district in chosen]
        results = scratch / "results"
        named = [word for m in methods for word in ("-m", m)] + [word for text in settings for word in ("--set", text)]
        how = "--split", "validation", "--out", results, "-j", options.workers, "-q"
        for folder in built:
            _run("evaluate", "-d", folder, *named, *how)
        rows = _scored(rb.read_errors(results, split="validation", datasets=built))
    told = {}
    for name, group in _groups(rows).items():
        told[name] = _print_group(name, group, [method.split("=")[0] for method in methods])
    print(json.dumps({"benchmark": "lm_reloc", **told}))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scratch", type=Path, help="folder that keeps datasets and results; default: a temporary one")
    parser.add_argument("--districts", type=int, default=3, help="number of districts")
    parser.add_argument("--district", type=int, choices=range(1, 100), metavar="K", help="district K alone")
    parser.add_argument("--steps", type=int, default=24, help="images of each drive")
    parser.add_argument("--workers", "-j", type=int, default=1)
    parser.add_argument("--pose-weights", type=Path, action="append", default=[], help="other weights of pose-net")
    return parser.parse_args()


def _asked(weights: Sequence[Path]) -> tuple[list[str], list[str]]:
    """All methods and their settings, with two rows for each further file of weights."""
    methods, settings = list(METHODS), []
    for number, path in enumerate(weights, 1):
        methods += [f"pose-net-{number}=pose-net", f"lm-reloc-{number}=lm-reloc"]
        settings += [f"pose-net-{number}.weights={path}", f"lm-reloc-{number}.pose_weights={path}"]
    return methods, settings


def _build(scratch: Path, district: District, options: argparse.Namespace) -> Path:
    out = scratch / f"pose-validation-{district.number:02d}"
    drive = "--cameras", "front", "--size", "512x512", "--steps", options.steps, "--speed", SPEED_MPS
    asked = "--split", "validation", "--seed", district.seed, "--reference", "all", "--correspondences", 0
    words = "--name", out.name, "--conditions", ",".join(district.conditions), *drive, *asked
    _run("build-dataset", "synthetic", *words, "--out", out, "-j", options.workers, "-q")
    return out


def _run(*words: object) -> None:
    """Run a relocbench command; its messages go to standard error."""
    subprocess.run([sys.executable, "-m", "relocbench", *map(str, words)], check=True, stdout=sys.stderr)


def _scored(errors: pd.DataFrame) -> pd.DataFrame:
    """Conditions, step and per-pair values of every metric, for every answer."""
    named = errors["pair_set"].str.extract(r"^[a-z]+-(?P<reference>\w+)-\d+__[a-z]+-(?P<query>\w+)-\d+__")
    rows = pd.concat([errors, named], axis=1)
    rows = rows.sort_values(["dataset", "pair_set", "query_timestamp_ns", "ref_timestamp_ns", "method"])
    rows["step"] = rows.groupby(["dataset", "query"])["query_timestamp_ns"].rank(method="dense").astype(int)
    columns = ("rotation_error_deg", "translation_error_m", "mlad_translation_error_m")
    of_pairs = PoseErrors(**{name: rows[name].to_numpy(dtype=np.float64) for name in columns})
    for name in METRICS:
        per_pair = metric_named(name).per_pair
        assert per_pair is not None
        rows[name] = per_pair(of_pairs)
    return rows


def _groups(rows: pd.DataFrame) -> dict[str, pd.DataFrame]:
    within = rows["reference"] == rows["query"]
    near = rows["distance_m"].astype(np.float64) <= NEAR_M
    return {
        "within a condition": rows[within],
        f"across conditions, keyframe within {NEAR_M:g} m": rows[~within & near],
        "across conditions, keyframe farther off": rows[~within & ~near],
        "across conditions": rows[~within],
    }


def _print_group(name: str, rows: pd.DataFrame, methods: Sequence[str]) -> Mapping[str, Mapping[str, float]]:
    pairs = int((rows["method"] == methods[0]).sum())
    print(f"\n## {name}: {pairs} pairs\n\n| method | median m | median degrees | {' | '.join(METRICS)} |")
    print(f"|---|---|---|{'---|' * len(METRICS)}")
    told = {}
    for method in methods:
        of = rows[rows["method"] == method]
        metres, degrees = (float(of[c].median()) for c in ("translation_error_m", "rotation_error_deg"))
        cells = [f"{metres:.2f}", f"{degrees:.2f}", *(_share(_by_step(of, metric)) for metric in METRICS)]
        print(f"| {method} | {' | '.join(cells)} |")
        shares = {metric: 100 * _mean(_by_step(of, metric)) for metric in METRICS}
        told[method] = shares | {name: value for name, value in (("m", metres), ("deg", degrees)) if np.isfinite(value)}
    print(f"\n| {SUBJECT} less | {' | '.join(METRICS)} |\n|---|{'---|' * len(METRICS)}")
    for other in ALIGNED:
        cells = [_ahead(*(_by_step(rows[rows["method"] == m], metric) for m in (SUBJECT, other))) for metric in METRICS]
        print(f"| {other} | {' | '.join(cells)} |")
    return told


def _by_step(rows: pd.DataFrame, metric: str) -> list[Array]:
    """One series for each district, by the step of the queries."""
    out = []
    for _, district in rows.groupby("dataset"):
        sets = [of for _, of in district.groupby("pair_set")]
        out.append(by_place([of[metric].to_numpy() for of in sets], [of["step"].to_numpy() for of in sets]))
    return out


def _mean(series: Sequence[Array]) -> float:
    return float(np.mean([values.mean() for values in series]))


def _share(series: Sequence[Array]) -> str:
    """A mean over the districts in percent, with its interval where there is one."""
    interval = mean_interval(series, roads=range(len(series)))
    bounds = f" [{100 * interval.low:.1f}, {100 * interval.high:.1f}]" if interval else ""
    return f"{100 * _mean(series):.1f}{bounds}"


def _ahead(first: Sequence[Array], second: Sequence[Array]) -> str:
    """A difference in percentage points, with its interval where there is one."""
    found = paired_difference(first, second, roads=range(len(first)))
    bounds = f" [{100 * found.interval.low:+.1f}, {100 * found.interval.high:+.1f}]" if found.interval else ""
    return f"{100 * found.mean:+.1f}{bounds}"


if __name__ == "__main__":
    main()
