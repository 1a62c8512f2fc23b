"""The overhead of a unit of work on a local Dask cluster, relative to local processes.

Units do nothing, so that only their distribution and the return of results is measured, from the first result to the
last, which excludes the start of processes. Rounds alternate, and the fastest counts. The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import time

from distributed import LocalCluster

from relocbench.execution import Run, Scheduler, kept_workers, run_units


def seconds_a_unit(count: int, workers: int, scheduler: Scheduler | None) -> float:
    """Seconds for each of ``count`` empty units, after the first result."""
    results = run_units(abs, range(count), Run(workers, scheduler))
    next(results)
    start = time.perf_counter()
    done = sum(1 for _ in results)
    return (time.perf_counter() - start) / done


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--units", type=int, default=500)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--rounds", type=int, default=3)
    asked = parser.parse_args()
    out = []
    for workers in asked.workers:
        with (
            LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address="127.0.0.1:0") as cluster,
            kept_workers(),
        ):
            scheduler = Scheduler(address=cluster.scheduler_address)
            spent: dict[str, list[float]] = {"local": [], "cluster": []}
            for _ in range(asked.rounds):
                # One local worker would be this process itself, which distributes nothing.
                spent["local"].append(seconds_a_unit(asked.units, max(workers, 2), None))
                spent["cluster"].append(seconds_a_unit(asked.units, workers, scheduler))
        local, apart = min(spent["local"]), min(spent["cluster"])
        out.append(
            {
                "workers": workers,
                "local_ms_a_unit": round(1e3 * local, 3),
                "cluster_ms_a_unit": round(1e3 * apart, 3),
                "ratio": round(apart / local, 2),
            }
        )
        print(f"{workers} workers: {1e3 * apart:.2f} ms a unit, local processes {1e3 * local:.2f} ms", flush=True)
    print(json.dumps({"units": asked.units, "rounds": asked.rounds, "overhead": out}))


if __name__ == "__main__":
    main()
