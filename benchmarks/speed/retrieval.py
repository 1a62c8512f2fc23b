"""The time of the two evaluations of University-1652 at full size, compared with NumPy's argsort in the same run.

The numbers of labels are those of the test set: 701 of 951 buildings are queries, with 54 drone images of each and one
more of the first. Descriptors are artificial: each image has the vector of its building plus noise (of ``--noise``
times the length), divided by its norm, float32. Timed is the work from descriptors and labels to every metric of every
query.

The reference does what published Python evaluation code does: one float32 product, one ``argsort`` for each query, the
ranks of the positives by ``flatnonzero``, and the same formulas. It runs on ``--reference-queries`` evenly spread
queries, and its time is scaled to all of them (by default it runs on all). Both must find the same metrics, except for
near ties that float32 products cannot distinguish.

Peak memory is the most that NumPy holds besides the descriptors, in a separate run.

    python benchmarks/speed/retrieval.py [--size D] [--noise N] [--reference-queries N]

Times are wall-clock seconds (the least of ``--repeats`` runs) and processor seconds. The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from relocbench.arrays import Floats, Indices
from relocbench.metrics import (
    RETRIEVAL_METRICS,
    rank_descriptors,
    relevance_from_labels,
    score_retrieval,
    summarize_retrieval,
)

Descriptors = Floats

BUILDINGS, ASKED, VIEWS = 951, 701, 54
APART = 0.05
"""percentage points by which the two implementations may differ because of near ties"""


@dataclass(frozen=True, eq=False)
class Case:
    name: str
    query: Descriptors
    query_labels: Indices
    gallery: Descriptors
    gallery_labels: Indices

    def thinned(self, queries: int) -> Case:
        """``count`` evenly spread queries."""
        rows = np.linspace(0, len(self.query) - 1, min(queries, len(self.query))).round().astype(int)
        return Case(self.name, self.query[rows], self.query_labels[rows], self.gallery, self.gallery_labels)


def made_cases(size: int, noise: float, seed: int = 0) -> list[Case]:
    """Drone to satellite and satellite to drone, with the same buildings."""
    rng = np.random.default_rng(seed)
    prototypes = rng.standard_normal((BUILDINGS, size), dtype=np.float32)

    def described(labels: Indices) -> Descriptors:
        x = rng.standard_normal((len(labels), size), dtype=np.float32)
        x *= noise
        x += prototypes[labels]
        x /= np.sqrt(np.einsum("ij,ij->i", x, x))[:, None]
        return x

    def drones(buildings: int) -> Indices:
        return np.concatenate([[0], np.repeat(np.arange(buildings), VIEWS)])

    cases = []
    for name, query, gallery in (
        ("drone to satellite", drones(ASKED), np.arange(BUILDINGS)),
        ("satellite to drone", np.arange(ASKED), drones(BUILDINGS)),
    ):
        cases.append(Case(name, described(query), query, described(gallery), gallery))
    return cases


def ours(case: Case) -> dict[str, float]:
    """The metrics in percent, by name."""
    relevance = relevance_from_labels(case.query_labels, case.gallery_labels)
    scores = score_retrieval(rank_descriptors(case.query, case.gallery, relevance))
    return {name: 100 * value for name, value in summarize_retrieval(scores).values.items()}


def plain(case: Case) -> dict[str, float]:
    """The same with one argsort for each query."""
    products = case.query @ case.gallery.T
    total = dict.fromkeys(RETRIEVAL_METRICS, 0.0)
    top1 = round(0.01 * len(case.gallery))
    for label, row in zip(case.query_labels, products, strict=True):
        order = np.argsort(-row)
        r = np.flatnonzero(case.gallery_labels[order] == label)
        i = np.arange(len(r))
        precision = (i + 1) / (r + 1)
        before = np.where(r > 0, i / np.maximum(r, 1), 1.0)
        total["R@1"] += r[0] < 1
        total["R@5"] += r[0] < 5
        total["R@10"] += r[0] < 10
        total["R@top1%"] += r[0] <= top1
        total["AP"] += np.mean((before + precision) / 2)
        total["AP_rectangle"] += np.mean(precision)
        total["MRR"] += 1 / (r[0] + 1)
    return {name: 100 * float(value) / len(case.query) for name, value in total.items()}


@dataclass(frozen=True)
class Timed:
    """The fastest of several runs."""

    wall: float
    cpu: float
    metrics: dict[str, float]


def timed(work: Callable[[], dict[str, float]], repeats: int) -> Timed:
    runs = []
    for _ in range(repeats):
        wall, cpu = time.perf_counter(), time.process_time()
        metrics = work()
        runs.append(Timed(time.perf_counter() - wall, time.process_time() - cpu, metrics))
    return Timed(min(run.wall for run in runs), min(run.cpu for run in runs), runs[0].metrics)


def peak_mib(work: Callable[[], object]) -> float:
    tracemalloc.start()
    work()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak / 2**20


def measured(case: Case, reference_queries: int, repeats: int) -> dict[str, Any]:
    thin = case.thinned(reference_queries or len(case.query))
    scale = len(case.query) / len(thin.query)
    full, by_argsort = timed(lambda: ours(case), repeats), timed(lambda: plain(thin), repeats)
    same = full.metrics if scale == 1 else ours(thin)
    apart = max(abs(same[name] - by_argsort.metrics[name]) for name in RETRIEVAL_METRICS)
    if apart > APART:
        raise RuntimeError(f"{case.name}: the two implementations are {apart:.3g} percentage points apart")
    return {
        "queries": len(case.query),
        "gallery": len(case.gallery),
        "seconds": round(full.wall, 2),
        "cpu_seconds": round(full.cpu, 2),
        "plain_queries": len(thin.query),
        "plain_seconds": round(by_argsort.wall * scale, 2),
        "plain_cpu_seconds": round(by_argsort.cpu * scale, 2),
        "times_plain": round(by_argsort.wall * scale / full.wall, 2),
        "times_plain_cpu": round(by_argsort.cpu * scale / full.cpu, 2),
        "peak_mib": round(peak_mib(lambda: ours(case)), 1),
        "plain_peak_mib": round(peak_mib(lambda: plain(thin)), 1),
        "apart_points": apart,
        "R@1": round(full.metrics["R@1"], 2),
        "AP": round(full.metrics["AP"], 2),
    }


def printed(name: str, size: int, result: dict[str, Any]) -> str:
    scaled = "" if result["plain_queries"] == result["queries"] else f", scaled from {result['plain_queries']} queries"
    return (
        f"{name}, {result['queries']} x {result['gallery']}, {size} numbers: "
        f"R@1 {result['R@1']}, AP {result['AP']}, apart by {result['apart_points']:.2g} percentage points at most\n"
        f"  relocbench  {result['seconds']:6.2f} s, {result['cpu_seconds']:6.2f} of the processor, "
        f"{result['peak_mib']:.0f} MiB\n"
        f"  argsort     {result['plain_seconds']:6.2f} s, {result['plain_cpu_seconds']:6.2f} of the processor, "
        f"{result['plain_peak_mib']:.0f} MiB{scaled}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=2048, help="size of a descriptor")
    parser.add_argument("--noise", type=float, default=4.0, help="length of the noise, relative to a building's vector")
    parser.add_argument("--reference-queries", type=int, default=0, help="number of queries of the reference; 0: all")
    parser.add_argument("--repeats", type=int, default=2)
    options = parser.parse_args()
    results = {}
    for case in made_cases(options.size, options.noise):
        results[case.name] = measured(case, options.reference_queries, options.repeats)
        print(printed(case.name, options.size, results[case.name]), flush=True)
    print(json.dumps({"benchmark": "retrieval", "size": options.size, "noise": options.noise, **results}))


if __name__ == "__main__":
    main()
