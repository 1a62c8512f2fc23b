"""Compare trackers across weathers, on districts that follow from a phrase and were asked nothing before.

Each of the twelve districts of ``docs/test-districts.md`` has 200 m of road and three conditions, each of which is the
map for queries of all three: six changes and three pair sets within a condition. Images have 512x512 pixels; the other
keyframes of a drive are 4 m away and more, those of another drive mostly within a metre. 8 pairs of each set show
different places. ``relocbench evaluate`` runs every method, which is asked once (see ``leaderboard/LEDGER.md``). The
rows of ALIKED need its authors' weights where ``aliked-pnp`` looks for them.
``--split validation`` renders districts of other seeds, to try the whole line out.

The page has the scores of every method across conditions, within a condition, and of all changes with a condition at
one end; the differences that answer the questions of ``QUESTIONS``, with their 95 % intervals and one error rate for
all of them; how far keyframes are, and how far off wrong answers; and how many pairs of different places each answered,
which nothing else counts. Districts count alike, and so do the pair sets of a district, which are one series by the
step of the drive; intervals are at least as wide as the spread of the districts demands (``docs/statistics.md``).

Datasets and results are kept in ``--scratch``; when it is run again, only what is missing is made. With ``--errors``
predictions and errors are also packed into a folder, an archive for each method in each district, and what has one is
not asked again. ``--only-print`` makes nothing and prints what is there: the published page follows from the published
errors.

    python benchmarks/publish/cross_weather.py --scratch S [--out leaderboard/weather] [--workers N] [-m METHOD ...]
    python benchmarks/publish/cross_weather.py --only-print --errors leaderboard/weather/errors
    python benchmarks/publish/cross_weather.py --summary --errors leaderboard/weather/errors

The last line is JSON. ``--summary`` makes nothing either, and prints the tables of README and ``docs/results.md``.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from archives import pack, unpack
from districts import COUNT, PHRASE
from groups import (
    FLOORS,
    METRICS,
    Group,
    Listed,
    commit,
    difference_table,
    differences,
    rounded_percent,
    run,
)

from baselines.gn_net.method import ALONG, TURNS_DEG
from baselines.gn_net.tracker import ONE_START
from relocbench.datasets.importers.edition.districts import District, districts
from relocbench.evaluation.common.results import all_results
from relocbench.evaluation.tables.errors import read_errors
from relocbench.evaluation.tables.schema import ALL
from relocbench.metrics import (
    CONFIDENT,
    DifferentPlaces,
    PoseErrors,
    metric_named,
)

METHODS = (
    "identity",
    "clock",
    "sift-pnp",
    "orb-pnp",
    "dso",
    "dso-multistart",
    "dso-along=dso",
    "dso-from-orb-pnp=dso",
    "dso-from-gn-net-pnp=dso",
    "gn-net-one-start=gn-net-from-prior",
    "gn-net-from-prior",
    "gn-net-pnp",
    "gn-net-contrastive",
    "lm-net",
    "gn-net",
    "aliked-pnp",
    "gn-net-from-aliked-pnp=gn-net-from-prior",
)
SETTINGS = (
    f"dso-along.along={list(ALONG)}",
    f"dso-along.turns_deg={list(TURNS_DEG)}",
    "dso-from-orb-pnp.start=orb-pnp",
    "dso-from-gn-net-pnp.start=gn-net-pnp",
    "dso-from-gn-net-pnp.start.cache_size=200",
    *(f"gn-net-one-start.{name}={json.dumps(value)}" for name, value in ONE_START.items()),
    "gn-net-one-start.cache_size=200",
    "gn-net-from-prior.cache_size=200",
    "gn-net-pnp.cache_size=200",
    "gn-net-contrastive.cache_size=200",
    "lm-net.cache_size=200",
    "gn-net.cache_size=200",
    "aliked-pnp.cache_size=200",
    "gn-net-from-aliked-pnp.cache_size=200",
    "gn-net-from-aliked-pnp.start=aliked-pnp",
    "gn-net-from-aliked-pnp.start.cache_size=200",
    "gn-net-from-aliked-pnp.prior_level=2",
    "gn-net-from-aliked-pnp.min_agreement=0",
)
"""``dso-along`` starts from the poses of ``gn-net-from-prior``, and ``gn-net-one-start`` from the keyframe's alone. A
drive has 52 images: ``cache_size`` saves the network's passes over images that other pair sets of a district showed. No
seconds are printed."""
STARTS = {
    "sift-pnp": "its matches",
    "orb-pnp": "its matches",
    "dso": "the keyframe's pose",
    "dso-multistart": "the keyframe's pose, turned 26 ways too",
    "dso-along": "the keyframe's pose and along the road",
    "dso-from-orb-pnp": "the pose of orb-pnp",
    "dso-from-gn-net-pnp": "the pose of gn-net-pnp",
    "gn-net-one-start": "the keyframe's pose",
    "gn-net-from-prior": "the keyframe's pose and along the road",
    "gn-net-pnp": "its matches",
    "gn-net-contrastive": "its matches, the keyframe's pose and along the road",
    "lm-net": "its matches and the keyframe's pose",
    "gn-net": "its matches, the keyframe's pose and along the road",
    "aliked-pnp": "its matches",
    "gn-net-from-aliked-pnp": "the pose of aliked-pnp",
}
"""where methods start"""
SUMMARY_METHODS = ("gn-net", "aliked-pnp", "sift-pnp", "orb-pnp", "dso", "identity")
_ALL, _SAME, _NEAR, _FAR = (
    "across conditions",
    "within a condition",
    "across, keyframe within 1 m",
    "across, keyframe over 1 m away",
)
SUMMARY = {
    "all changes": (METRICS[0], _ALL),
    **{name: (METRICS[0], f"from or to {name}") for name in ("Rain", "Snow", "Night", "Fog")},
    "same condition": (METRICS[0], _SAME),
}
"""methods and columns of the README's table: the metric and the group of each"""
RESULTS = {
    "all changes": (METRICS[0], _ALL),
    "keyframe within 1 m": (METRICS[0], _NEAR),
    "keyframe over 1 m away": (METRICS[0], _FAR),
    "same condition": (METRICS[0], _SAME),
    f"{METRICS[2]}, all changes": (METRICS[2], _ALL),
    f"{METRICS[2]}, same condition": (METRICS[2], _SAME),
}
"""columns of the table in ``docs/results.md``, which has all methods by their first column"""
VALIDATION_PHRASE = "validation of the page across weathers"
STEPS, SPEED_MPS = 52, 40
"""images of a drive and its speed: at 10 images a second, 204 m of road"""
ELSEWHERE = 8
"""pairs of different places in each pair set"""
DISTANCES_M = (0.0, 0.25, 0.5, 1.0, 2.0, 3.0, 3.9, 4.3, np.inf)
_HEAD = """# Across weathers

Printed by `python benchmarks/publish/cross_weather.py --only-print --errors leaderboard/weather/errors --out
leaderboard/weather` from the errors of every pair. What was evaluated stands there, how intervals are made in
[Statistics](../../docs/statistics.md), and what follows in [Results](../../docs/results.md). Shares are in percent,
failures count as infinite errors. Keyframes within a condition are 4 m away, so that an answer that stays there is
3.9 to 4.3 m off. The trivial baselines identity and clock state no confidence: among negative pairs that counts as
confident, among confident answers it does not count. Printed by commit {commit}; which commit evaluated the methods
stands in the [ledger](../LEDGER.md).
"""


def main() -> None:
    options = _options()
    if options.summary:
        print("\n".join(summaries(options.errors)))
        return
    with tempfile.TemporaryDirectory() as temporary:
        scratch = options.scratch or Path(temporary)
        for district in () if options.only_print else districts(options.phrase, options.districts):
            if district.number < options.first:
                continue
            left = [m for m in options.methods if not packed(options.errors, district, m.split("=")[0]).exists()]
            if not left:
                continue
            dataset = _build(scratch, district, options)
            methods = [word for method in left for word in ("-m", method)]
            labels = [method.split("=")[0] for method in left]
            settings = [word for text in options.settings if text.split(".")[0] in labels for word in ("--set", text)]
            results = "--out", scratch / "results", "--split", options.split, "-j", options.workers, "-q"
            run("evaluate", "-d", dataset, *results, *methods, *settings)
            for label in labels if options.errors is not None else ():
                pack(scratch / "results", dataset.name, label, packed(options.errors, district, label))
        methods = list(dict.fromkeys(method.split("=")[0] for method in options.methods))
        with tempfile.TemporaryDirectory() as unpacked:
            printed = scratch / "results" if options.errors is None else unpack(options.errors, Path(unpacked))
            errors, elsewhere = _errors(printed, methods)
            absent = incomplete(errors, methods)
            methods = [method for method in methods if method not in absent]
            elsewhere = {method: elsewhere[method] for method in methods}
            rows = _scored(errors[errors["method"].isin(methods)])
            far = _distances(printed)
    together, single = _groups(rows)
    wrong = _wrong_table(together, methods)
    apart = _by_distance(rows)
    listed = differences([*together, *apart])
    tables = "\n".join(
        [
            *_absent(absent),
            *far,
            *_distance_table(together),
            *_tables([*together, *apart], single, methods),
            *difference_table(listed),
            *wrong,
            *_confidence_table(together, methods),
            *_by_district_table(together[-1], [method for method in methods if method not in FLOORS]),
            *_elsewhere_table(elsewhere),
        ]
    )
    print(tables)
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "cross_weather.md").write_text(f"{_HEAD.format(commit=commit())}{tables}\n")
    places = {method: found.to_dict() for method, found in elsewhere.items()}
    print(json.dumps({"benchmark": "cross_weather", **_claims(together, listed, methods), "different places": places}))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scratch", type=Path, help="folder that keeps datasets and results; default: a temporary one")
    parser.add_argument("--out", type=Path, help="folder for cross_weather.md")
    parser.add_argument("--split", default="test", choices=("test", "validation"))
    parser.add_argument("--districts", type=int, default=COUNT, help="number of districts")
    parser.add_argument("--first", type=int, default=1, help="number of the first district that is asked")
    parser.add_argument("--steps", type=int, default=STEPS, help="images of each drive")
    parser.add_argument("--elsewhere", type=int, default=ELSEWHERE, help="pairs of different places a pair set")
    parser.add_argument("--workers", "-j", type=int, default=2)
    parser.add_argument("--errors", type=Path, help="folder of the packed errors of each method in each district")
    parser.add_argument("--only-print", action="store_true", help="render and ask nothing, print what there is")
    parser.add_argument(
        "--summary", action="store_true", help="print the tables of README and results page from --errors"
    )
    parser.add_argument("-m", dest="methods", action="append", help=f"default: {', '.join(METHODS)}")
    parser.add_argument("--set", dest="settings", action="append", help="method.key=value")
    options = parser.parse_args()
    if options.first > options.districts:
        parser.error(f"--first {options.first} lies behind the last district, --districts {options.districts}")
    if options.summary and options.errors is None:
        parser.error("--summary needs --errors FOLDER")
    options.settings = options.settings or ([] if options.methods else list(SETTINGS))
    options.methods = options.methods or list(METHODS)
    options.phrase = PHRASE if options.split == "test" else VALIDATION_PHRASE
    return options


def _build(scratch: Path, district: District, options: argparse.Namespace) -> Path:
    name = f"weather-{options.split}-{district.number:02d}"
    out: Path = scratch / name
    drive = "--cameras", "front", "--size", "512x512", "--steps", options.steps, "--speed", SPEED_MPS
    asked = "--split", options.split, "--seed", district.seed, "--reference", "all", "--correspondences", 0
    apart = "--elsewhere", options.elsewhere
    words = "--name", name, "--conditions", ",".join(district.conditions), *drive, *asked, *apart
    run("build-dataset", "synthetic", *words, "--out", out, "-j", options.workers, "-q")
    return out


def incomplete(errors: pd.DataFrame, methods: Sequence[str]) -> list[str]:
    """The methods that were not asked of all pairs that the others were asked of: their rows would not compare."""
    pairs = errors.groupby("method").size().reindex(list(methods), fill_value=0)
    return [method for method in methods if pairs[method] < pairs.max()]


def _absent(methods: Sequence[str]) -> list[str]:
    return [f"\nNot asked of all districts yet, and left out: {', '.join(methods)}."] if methods else []


def packed(errors: Path | None, district: District, label: str) -> Path:
    """The archive of a method's results in a district; without a folder of them one that does not exist."""
    return (errors or Path("nowhere")) / f"{district.number:02d}" / f"{label}.tar.xz"


def _errors(results: Path, methods: Sequence[str]) -> tuple[pd.DataFrame, dict[str, DifferentPlaces]]:
    """One row for each dataset, pair set, method and pair of one place; and what each method did with pairs of
    different places."""
    rows = []
    elsewhere: dict[str, list[DifferentPlaces]] = {method: [] for method in methods}
    for folder in all_results(results):
        for method in (method for method in folder.methods() if method.label in elsewhere):
            for pair_set in folder.record.pair_sets:
                table = read_errors(method.errors(pair_set))
                elsewhere[method.label].append(table.different_places)
                about = {"dataset": folder.record.name, "pair_set": pair_set, "method": method.label}
                for pair in table.of_group(ALL):
                    ref_timestamp_ns, query_timestamp_ns = pair.key
                    rows.append(
                        {
                            **about,
                            "ref_timestamp_ns": ref_timestamp_ns,
                            "query_timestamp_ns": query_timestamp_ns,
                            "rotation_error_deg": pair.rotation_error_deg,
                            "translation_error_m": pair.translation_error_m,
                            "mlad_translation_error_m": pair.mlad_translation_error_m,
                            "confidence": pair.confidence,
                        }
                    )
    return pd.DataFrame(rows), {method: DifferentPlaces.total(parts) for method, parts in elsewhere.items()}


def summaries(folder: Path) -> list[str]:
    """The table of the README, and that of ``docs/results.md``."""
    methods = [method.split("=")[0] for method in METHODS]
    with tempfile.TemporaryDirectory() as unpacked:
        errors, _ = _errors(unpack(folder, Path(unpacked)), methods)
    rows = _scored(errors)
    together, single = _groups(rows)
    groups = {group.name: group for group in (*together, *_by_distance(rows), *single)}
    best_first = sorted(methods, key=lambda method: -groups[_ALL].mean(method, METRICS[0]))
    return [*_summary(groups, SUMMARY_METHODS, SUMMARY), "", *_summary(groups, best_first, RESULTS)]


def _summary(groups: Mapping[str, Group], methods: Sequence[str], columns: Mapping[str, tuple[str, str]]) -> list[str]:
    lines = [f"| method | {' | '.join(columns)} |", f"|---|{'---:|' * len(columns)}"]
    for method in methods:
        shares = [groups[group].mean(method, metric) for metric, group in columns.values()]
        lines.append(f"| `{method}` | {' | '.join(map(rounded_percent, shares))} |")
    return lines


def _distances(results: Path) -> list[str]:
    """How far the queries of pair sets are from their keyframes."""
    lines = [
        "\n## Distances\n",
        "| group | pair sets | median of their medians, m | least | greatest | median, degrees |",
    ]
    lines.append("|---|---|---|---|---|---|")
    # Methods that were asked on machines whose renderings differ in last digits have folders of their own.
    records = {(f.record.name, name): r for f in all_results(results) for name, r in f.record.pair_sets.items()}
    sets = list(records.values())
    for name, within in (("across conditions", False), ("within a condition", True)):
        of = [record for record in sets if (record.reference == record.query) == within]
        metres = [record.median_distance_m for record in of if record.median_distance_m is not None]
        degrees = [record.median_angle_deg for record in of if record.median_angle_deg is not None]
        cells = f"{np.median(metres):.2f}", f"{min(metres):.2f}", f"{max(metres):.2f}", f"{np.median(degrees):.1f}"
        lines.append(f"| {name} | {len(of)} | {' | '.join(cells)} |")
    return lines


def _scored(errors: pd.DataFrame) -> pd.DataFrame:
    """Conditions, district, step and per-pair values of every metric, for every answer."""
    named = errors["pair_set"].str.extract(r"^[a-z]+-(?P<reference>\w+)-\d+__[a-z]+-(?P<query>\w+)-\d+__")
    district = errors["dataset"].str.extract(r"-(?P<district>\d+)$")
    rows = pd.concat([errors, named, district], axis=1)
    rows = rows.sort_values(["dataset", "pair_set", "query_timestamp_ns", "ref_timestamp_ns", "method"])
    by_drive = rows.groupby(["district", "query"])["query_timestamp_ns"]
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
    """All pairs across conditions, all within a condition, and the changes with each condition at one end."""
    across = rows["reference"] != rows["query"]
    together = [Group("across conditions", rows[across]), Group("within a condition", rows[~across])]
    single = [
        Group(f"from or to {name}", rows[across & ((rows["reference"] == name) | (rows["query"] == name))])
        for name in sorted({*rows["reference"], *rows["query"]})
    ]
    return together, single


def _by_distance(rows: pd.DataFrame) -> list[Group]:
    """Pairs across conditions by the distance of the keyframe, which is the error of the identity."""
    pair = ["dataset", "pair_set", "ref_timestamp_ns", "query_timestamp_ns"]
    still = rows[rows["method"] == "identity"]
    if still.empty:
        return []
    metres = still.set_index(pair)["translation_error_m"]
    across = rows[rows["reference"] != rows["query"]]
    near = metres.reindex(pd.MultiIndex.from_frame(across[pair])).to_numpy() <= 1.0
    return [
        Group("across, keyframe within 1 m", across[near]),
        Group("across, keyframe over 1 m away", across[~near]),
    ]


def _distance_table(together: list[Group]) -> list[str]:
    """How many pairs are of which distance, which is the error of the identity."""
    spans = list(pairwise(DISTANCES_M))
    names = [f"{low:g} to {high:g} m" if np.isfinite(high) else f"{low:g} m or more" for low, high in spans]
    lines = ["\n## Pairs by distance\n", "Between the cameras of keyframe and query.\n"]
    lines += [f"| group | pairs | {' | '.join(names)} |", f"|---|---:|{'---:|' * len(names)}"]
    for group in together:
        metres = group.rows[group.rows["method"] == "identity"]["translation_error_m"].to_numpy()
        if not len(metres):
            return []
        counts = [int(np.sum((metres >= low) & (metres < high))) for low, high in spans]
        lines.append(f"| {group.name} | {group.pairs} | {' | '.join(map(str, counts))} |")
    return lines


def _tables(together: list[Group], single: list[Group], methods: Sequence[str]) -> list[str]:
    """For each metric the shares of all methods in the groups, and in the changes with each condition at one end."""
    lines = []
    for metric in METRICS:
        lines += [f"\n## {metric}, %\n", *_share_table(together, metric, methods)]
        lines += [f"\n### {metric}, %, by condition\n", *_share_table(single, metric, methods)]
    return lines


def _share_table(groups: list[Group], metric: str, methods: Sequence[str]) -> list[str]:
    lines = [f"| method | starts from | {' | '.join(group.name for group in groups)} |"]
    lines += [f"|---|---|{'---:|' * len(groups)}"]
    lines += [f"| *pairs* |  | {' | '.join(f'*{group.pairs}*' for group in groups)} |"]
    for method in methods:
        cells = [f"{100 * group.mean(method, metric):.1f}" for group in groups]
        lines.append(f"| {method} | {STARTS.get(method, '')} | {' | '.join(cells)} |")
    return lines


def _wrong_table(together: list[Group], methods: Sequence[str]) -> list[str]:
    """How far off wrong answers are whose rotation is right: beside the keyframe's own pose, 4 m away, or elsewhere."""
    edges = (0.25, 1.0, 3.9, 4.3, np.inf)
    names = [f"{low:g} to {high:g} m" if np.isfinite(high) else f"{low:g} m or more" for low, high in pairwise(edges)]
    lines = ["\n## Wrong answers whose rotation is within 2 degrees, by how far off they are\n"]
    lines += [f"| group | method | not right | {' | '.join(names)} |", f"|---|---|---|{'---|' * len(names)}"]
    for group in together:
        for method in methods:
            rows = group.rows[group.rows["method"] == method]
            metres, turned = rows["translation_error_m"].to_numpy(), rows["rotation_error_deg"].to_numpy()
            missed = int(np.sum((metres > 0.25) | (turned > 2.0)))
            answered = np.isfinite(metres) & (turned <= 2.0)
            counts = [int(np.sum(answered & (metres > low) & (metres <= high))) for low, high in pairwise(edges)]
            lines.append(f"| {group.name} | {method} | {missed} | {' | '.join(map(str, counts))} |")
    return lines


def _confidence_table(together: list[Group], methods: Sequence[str]) -> list[str]:
    """How many answers have a confidence of 0.5 or more, and how many of these are right."""
    lines = [f"\n## Answers with a confidence of {CONFIDENT:g} or more\n", "| group | method | answers | right, % |"]
    lines.append("|---|---|---|---|")
    for group in (*together, Group("both", pd.concat([group.rows for group in together]))):
        for method in methods:
            rows = group.rows[group.rows["method"] == method]
            sure = rows["confidence"].astype(np.float64).to_numpy() >= CONFIDENT
            right = rows[METRICS[0]].to_numpy()[sure]
            share = f"{100 * np.mean(right):.1f}" if len(right) else ""
            lines.append(f"| {group.name} | {method} | {len(right)} | {share} |")
    return lines


def _by_district_table(within: Group, methods: Sequence[str]) -> list[str]:
    """A table of wrong answers with a confidence of 0.5 or more: a row for each method, a column for each district."""
    rows = within.rows[within.rows["confidence"].astype(np.float64) >= CONFIDENT]
    names = sorted(within.rows["district"].unique())
    lines = [
        "\n## Within a condition, by district: wrong ones of the answers with a confidence of 0.5 or more\n",
        f"| method | {' | '.join(names)} |",
    ]
    lines.append(f"|---|{'---|' * len(names)}")
    for method in methods:
        of = rows[rows["method"] == method]
        wrong = of[of[METRICS[0]] == 0.0].groupby("district").size()
        cells = [f"{wrong.get(name, 0)} of {np.sum(of['district'] == name)}" for name in names]
        lines.append(f"| {method} | {' | '.join(cells)} |")
    return lines


def _elsewhere_table(elsewhere: Mapping[str, DifferentPlaces]) -> list[str]:
    """How many pairs of different places each method answered, and how many wrongly and confidently."""
    lines = [
        "\n## Negative pairs\n",
        "| method | pairs | answered | confidently wrong | the same, % [at most, were pairs independent] |",
    ]
    lines.append("|---|---|---|---|---|")
    for method, found in elsewhere.items():
        if found.confident_share is not None and found.confident_high is not None:
            share = f"{100 * found.confident_share:.1f} [{100 * found.confident_high:.1f}]"
            lines.append(f"| {method} | {found.pairs} | {found.answered} | {found.confident} | {share} |")
    return lines


def _claims(together: list[Group], listed: Listed, methods: Sequence[str]) -> dict[str, Any]:
    """The shares of all methods, and all differences that the page lists."""
    claims: dict[str, Any] = {
        "districts": int(together[0].rows["district"].nunique()),
        "pairs": {group.name: group.pairs for group in together},
        "shares": {
            method: {f"{group.name}, {metric}": group.mean(method, metric) for group in together for metric in METRICS}
            for method in methods
        },
    }
    for (both, group, metric), found in listed.items():
        ends = [None, None] if found.interval is None else [found.interval.low, found.interval.high]
        of_both = claims.setdefault(f"{both[0]} less {both[1]}", {})
        of_both[f"{group}, {metric}"] = [found.mean, *ends, found.adjusted_p]
    return claims


if __name__ == "__main__":
    main()
