"""Seconds and peak memory of ``relocbench leaderboard`` on many pair sets and pairs, and of scoring predictions.

There are four cases: 200 pair sets x 10 methods, one pair set of 100,000 pairs x 2 methods, the site of 20 datasets
x 20 methods x 5000 pairs, and ``relocbench evaluate --predictions`` with 100,000 pairs. Results are artificial:
errors follow a random walk along a drive, and a share of pairs fails. Every command runs in a new process and is
timed from start to end; its peak memory is that of the process and of its children. The reference for a leaderboard's
time is that of ``pandas.read_csv`` on the same tables (``PAIRSET.csv`` and ``PAIRSET.errors.csv``) in the same run.

    python benchmarks/speed/leaderboard.py [--sets N] [--methods N] [--pairs N]

The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from relocbench.datasets.core.pairfile import Pair, PoseLine, write_pose_lines
from relocbench.datasets.core.schema import CameraEntry, TraversalFile
from relocbench.datasets.core.writer import DatasetWriter
from relocbench.evaluation.common.results import (
    DatasetRecord,
    MethodResults,
    PairSetRecord,
    RunRecord,
    ScoreRecord,
    write_record,
)
from relocbench.evaluation.tables.answers import ANSWERS, Answer
from relocbench.evaluation.tables.errors import PairErrors, write_errors
from relocbench.evaluation.tracking.score import FORMULAS, groups_of, predictions_hash, summarize_rows
from relocbench.files import sha256_file
from relocbench.geometry import Camera, make_transform, so3_exp

START_NS, STEP_NS = 1_600_000_000_000_000_000, 100_000_000
PER_SET = 50
"""number of pairs of each of the many pair sets"""


@dataclass(frozen=True)
class Measured:
    """The resources that a command used."""

    seconds: float
    cpu_seconds: float
    """processor time, including that of worker processes"""
    peak_mib: float


def make_results(root: Path, sets: int, methods: int, pairs: int, datasets: int = 1) -> Path:
    """Make results of ``methods`` methods on datasets of ``sets`` pair sets of ``pairs`` pairs each."""
    for number in range(datasets):
        _make_dataset_results(root, f"made-{number}", sets, methods, pairs, number)
    return root


def _make_dataset_results(root: Path, name: str, sets: int, methods: int, pairs: int, seed: int) -> None:
    fingerprint = f"{seed:02x}" * 32
    folder = root / f"{name}@{fingerprint[:12]}"
    names = [f"summer__drive-{index:03d}__cam0" for index in range(sets)]
    write_record(
        folder / "dataset.yaml",
        DatasetRecord(
            name=name,
            fingerprint=fingerprint,
            licence="CC0-1.0",
            splits={"test": tuple(names)},
            pair_sets={each: _record(each, pairs) for each in names},
        ),
    )
    for number in range(methods):
        label = "identity" if number == 0 else f"method-{number}"
        run = RunRecord(
            method=label,
            target=label,
            seed=0,
            dataset=name,
            fingerprint=fingerprint,
            versions={"relocbench": "0", "method": "0"},
        )
        rng = np.random.default_rng([seed, number])
        _write_method(MethodResults(folder / label), run, names, pairs, rng, 0.1 + number)


def _write_method(
    folder: MethodResults, run: RunRecord, names: list[str], pairs: int, rng: np.random.Generator, scale: float
) -> None:
    write_record(folder.run_yaml, run)
    pose = make_transform(so3_exp([0.0, 0.01, 0.0]), [0.1, 0.2, 0.3])
    hashes, errors, scores = {}, {}, {}
    for name in names:
        rows = _rows(rng, pairs, scale)
        write_pose_lines(folder.predictions(name), [PoseLine(*row.key, pose) for row in rows if row.status == "ok"])
        ANSWERS.write(folder.answers(name), [Answer(*row.key, row.status, row.seconds) for row in rows])
        write_errors(folder.errors(name), rows)
        hashes[name], errors[name] = predictions_hash(folder, name), sha256_file(folder.errors(name))
        scores[name] = {group: summarize_rows(rows, group).to_dict() for group in groups_of(rows)}
    record = ScoreRecord(
        relocbench="0",
        formulas=FORMULAS,
        fingerprint=run.fingerprint,
        run=sha256_file(folder.run_yaml),
        predictions=hashes,
        errors=errors,
        pair_sets=scores,
    )
    write_record(folder.scores_yaml, record)


def _rows(rng: np.random.Generator, pairs: int, scale: float) -> list[PairErrors]:
    """Errors whose logarithm is a random walk along the drive; a tenth of the pairs fails."""
    wander = np.zeros(pairs)
    for index, step in enumerate(rng.normal(scale=0.3, size=pairs - 1)):
        wander[index + 1] = 0.9 * wander[index] + step
    metres = 0.1 * scale * np.exp(wander) * rng.rayleigh(size=pairs)
    degrees = np.exp(wander) * rng.rayleigh(size=pairs)
    metres[rng.random(pairs) < 0.1] = np.inf
    rows = []
    for index, (metre, degree) in enumerate(zip(metres.tolist(), degrees.tolist(), strict=True)):
        answered = metre < np.inf
        rows.append(
            PairErrors(
                ref_timestamp_ns=START_NS + STEP_NS * index,
                query_timestamp_ns=START_NS + 10**17 + STEP_NS * index,
                group="",
                status="ok" if answered else "failed",
                rotation_error_deg=degree if answered else np.inf,
                translation_error_m=metre,
                mlad_translation_error_m=metre,
                confidence=1.0 / (1.0 + metre) if answered else None,
                seconds=0.05,
                distance_m=0.8,
                angle_deg=1.5,
                sigma_translation_m=0.02,
                sigma_rotation_deg=0.05,
            )
        )
    return rows


def _record(name: str, pairs: int) -> PairSetRecord:
    reference, query, camera = name.split("__")
    return PairSetRecord(
        reference=reference,
        query=query,
        camera=camera,
        reference_condition="clear, summer",
        query_condition=query,
        pairs=pairs,
        rejected=0,
        has_truth=True,
        median_distance_m=0.8,
        median_angle_deg=1.5,
        median_sigma_translation_m=0.02,
        median_sigma_rotation_deg=0.05,
    )


def make_dataset(root: Path, pairs: int) -> Path:
    """Make a dataset of one pair set with ``pairs`` pairs and no images, for existing predictions."""
    writer = DatasetWriter(root, "many", {"kind": "many-pairs", "count": pairs})
    entry = CameraEntry.of(Camera("pinhole", 64, 48, 50.0, 50.0, 31.5, 23.5))
    pose = make_transform(so3_exp([0.0, 0.02, 0.0]), [0.5, 0.0, 0.4])
    for name in ("summer", "winter"):  # scoring needs no images
        writer.traversal(TraversalFile(name=name, cameras={"cam0": entry}, source="made"), {})
    made = [Pair(START_NS + STEP_NS * i, START_NS + 10**17 + STEP_NS * i, pose) for i in range(pairs)]
    writer.pairs("summer", "winter", "cam0", made)
    writer.finish({})
    return root


def make_predictions(folder: Path, dataset: Path) -> Path:
    """Predictions for the pairs of the dataset: its ground truth."""
    for pair_file in (dataset / "pairs").glob("*.txt"):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / pair_file.name).write_bytes(pair_file.read_bytes())
    return folder


def run(*words: str) -> Measured:
    """Run ``relocbench`` in a new process."""
    start = time.perf_counter()
    process = subprocess.Popen([sys.executable, "-m", "relocbench", *words], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"relocbench {' '.join(words)} ended with {process.returncode}")
    return Measured(time.perf_counter() - start, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


def pandas_seconds(results: Path) -> float:
    """The time to read every table of a results folder."""
    start = time.perf_counter()
    for path in sorted(results.rglob("*.csv")):
        pd.read_csv(path)
    return time.perf_counter() - start


def board(scratch: Path, name: str, sets: int, methods: int, pairs: int) -> dict[str, Any]:
    """Measure one leaderboard and the reading of its tables."""
    results = make_results(scratch / name, sets, methods, pairs)
    plain = pandas_seconds(results)
    words = ["leaderboard", str(results), "--out", str(scratch / f"{name}-board"), "--quiet"]
    taken = run(*words)
    print(
        f"{name}, {sets} sets x {methods} methods x {pairs} pairs: {taken.seconds:.1f} s, "
        f"{taken.cpu_seconds:.1f} s of the processor, {taken.peak_mib:.0f} MiB; "
        f"a plain pandas read of the tables {plain:.2f} s",
        flush=True,
    )
    return {
        "sets": sets,
        "methods": methods,
        "pairs": pairs,
        "seconds": round(taken.seconds, 2),
        "cpu_seconds": round(taken.cpu_seconds, 2),
        "peak_mib": round(taken.peak_mib),
        "pandas_seconds": round(plain, 2),
        "times_pandas": round(taken.seconds / plain, 2),
    }


def site(scratch: Path, sets: int, methods: int, pairs: int) -> dict[str, Any]:
    """Measure ``report``: writing the site, and opening it from the disk and sorting a table in Chromium."""
    results = make_results(scratch / "site", 1, methods, pairs, datasets=sets)
    folder = scratch / "site-report"
    taken = run("report", str(results), "--out", str(folder), "--quiet")
    mib = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / 2**20
    print(
        f"report, {sets} datasets x {methods} methods x {pairs} pairs: {taken.seconds:.1f} s, {mib:.0f} MiB", flush=True
    )
    found: dict[str, Any] = {"datasets": sets, "methods": methods, "pairs": pairs, "mib": round(mib)}
    found |= {"seconds": round(taken.seconds, 2), "cpu_seconds": round(taken.cpu_seconds, 2)}
    found["peak_mib"] = round(taken.peak_mib)
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    return found | (_in_browser(folder, browser) if browser else {})


def _in_browser(folder: Path, browser: str) -> dict[str, float]:
    """Seconds until the table of the start page and of a set can be used, and to sort the table."""
    from playwright.sync_api import sync_playwright

    out = {}
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        for name, path in (("start", folder / "index.html"), ("set", next(folder.glob("set-*.html")))):
            page = started.new_page()
            begun = time.perf_counter()
            page.goto(path.as_uri())
            page.wait_for_selector("table.dataTable tbody tr")
            out[f"open_{name}_seconds"] = round(time.perf_counter() - begun, 2)
            took = page.evaluate(
                "() => { const t = new DataTable.Api('table.dataTable'), s = performance.now();"
                " t.order([1, 'desc']).draw(); return performance.now() - s; }"
            )
            out[f"sort_{name}_seconds"] = round(took / 1000, 3)
            page.close()
        started.close()
    print(out, flush=True)
    return out


def predictions(scratch: Path, pairs: int) -> dict[str, Any]:
    """Measure ``evaluate --predictions``."""
    dataset = make_dataset(scratch / "many", pairs)
    answers = make_predictions(scratch / "answers", dataset)
    words = ["evaluate", "--dataset", str(dataset), "--predictions", str(answers), "--out", str(scratch / "taken")]
    taken = run(*words, "--method", "mine", "--quiet")
    print(
        f"evaluate --predictions of {pairs} pairs: {taken.seconds:.1f} s, {taken.cpu_seconds:.1f} s of the processor, "
        f"{taken.peak_mib:.0f} MiB",
        flush=True,
    )
    return {
        "pairs": pairs,
        "seconds": round(taken.seconds, 2),
        "cpu_seconds": round(taken.cpu_seconds, 2),
        "peak_mib": round(taken.peak_mib),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", type=int, default=200)
    parser.add_argument("--methods", type=int, default=10)
    parser.add_argument("--pairs", type=int, default=100_000)
    parser.add_argument("--site-datasets", type=int, default=20, help="of the site of 20 methods, 5000 pairs each")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        scratch = Path(temporary)
        results = {
            "many_sets": board(scratch, "many_sets", options.sets, options.methods, PER_SET),
            "many_pairs": board(scratch, "many_pairs", 1, 2, options.pairs),
            "site": site(scratch, options.site_datasets, 20, 5000),
            "predictions": predictions(scratch, options.pairs),
        }
    print(json.dumps({"benchmark": "leaderboard", **results}))


if __name__ == "__main__":
    main()
