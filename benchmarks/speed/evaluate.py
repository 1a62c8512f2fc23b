"""The throughput of an evaluation in pairs per second, its own time for a pair, its scaling, and its memory.

Ratios are to the same evaluation with one worker in the same run. The evaluation's own time for a pair is all but the
method's seconds, of a method that does nothing: reading and handing over images, checking, keeping and scoring answers.
The throughput excludes the start of the workers and compilation, which take seconds, would hide the scaling of a short
run, and are printed separately. The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_table import write_pairs
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.core.writer import DatasetWriter
from relocbench.datasets.importers import importer
from relocbench.evaluation.tables.answers import read_answers
from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods
from relocbench.execution import Run, default_workers
from relocbench.progress import Silent


def many_pairs(source: Dataset, out: Path, count: int) -> Dataset:
    """Make a dataset of ``count`` pairs from the images of ``source``, which are linked under new timestamps."""
    writer = DatasetWriter(out, f"{source.name}-{count}", {"kind": "many-pairs", "count": count})
    pair_set = next(s for s in source.pair_sets() if s.reference == s.query)
    traversal = source.traversal(pair_set.reference)
    writer.traversal(traversal.file, {})
    camera = pair_set.query_camera
    layout = writer.layout.traversal(traversal.name)
    pairs = []
    base = pair_set.pairs
    for index in range(count):
        # Sixteen pairs share a keyframe.
        ref, query = 2 * (index - index % 16) + 1, 2 * index + 2
        pair = base[(index // 16) % len(base)]
        for kind, old, new in (("images", pair.ref_timestamp_ns, ref), ("images", pair.query_timestamp_ns, query)):
            link(traversal.layout.root / kind / camera / f"{old}.png", layout.root / kind / camera / f"{new}.png")
        link(
            traversal.layout.depth(camera, pair.ref_timestamp_ns),
            layout.depth(camera, ref),
        )
        pairs.append(Pair(ref, query, pair.T_query_ref))
    name = f"{traversal.name}__{traversal.name}__{camera}"
    write_pairs(writer.layout.pair_file(name), writer.layout.pair_table(name), pairs)
    return writer.finish({"test": [name]})


def link(source: Path, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists():
        path.symlink_to(source.resolve())


def measure(dataset: Dataset, method: str, workers: int, out: Path) -> dict[str, float]:
    """The wall-clock seconds of a run, and those of the tracker alone, summed over the pairs."""
    shutil.rmtree(out, ignore_errors=True)
    start = time.perf_counter()
    options = EvaluateOptions(dataset=dataset.root, methods=(method,), out=out, workers=workers)
    report = evaluate_methods(options, Silent())
    wall = time.perf_counter() - start
    answers = [a for s in report.pair_sets for a in read_answers(report.folders[0].answers(s.name)).values()]
    return {"wall_s": wall, "tracker_s": sum(a.seconds or 0.0 for a in answers), "pairs": len(answers)}


def throughput(small: Dataset, large: Dataset, method: str, workers: int, out: Path) -> dict[str, float]:
    """Pairs per second from the difference of a large and a small run, without start-up; the best of three runs."""
    a, b = (
        min((measure(dataset, method, workers, out) for _ in range(3)), key=lambda run: run["wall_s"])
        for dataset in (small, large)
    )
    rate = (b["pairs"] - a["pairs"]) / (b["wall_s"] - a["wall_s"])
    return {
        "pairs_per_s": rate,
        "pairs_per_s_with_start_up": b["pairs"] / b["wall_s"],
        "start_up_s": a["wall_s"] - a["pairs"] / rate,
        "tracker_share": b["tracker_s"] / (b["wall_s"] * workers),
        "own_ms_per_pair": 1000 * (1 / rate - (b["tracker_s"] - a["tracker_s"]) / (b["pairs"] - a["pairs"])),
    }


def peak_mib(dataset: Path, method: str, out: Path) -> dict[str, float]:
    """The peak resident memory of the main process and of the largest worker, measured in a new process."""
    code = (
        "import resource\n"
        "from pathlib import Path\n"
        "from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods\n"
        "from relocbench.progress import Silent\n"
        "if __name__ == '__main__':\n"
        f"    evaluate_methods(EvaluateOptions(dataset=Path({str(dataset)!r}), methods=({method!r},), "
        f"out=Path({str(out)!r}), workers=2), Silent())\n"
        # VmHWM is that of this program; ru_maxrss includes what the parent held when it forked.
        "    own = [line.split()[1] for line in open('/proc/self/status') if line.startswith('VmHWM')]\n"
        "    print(*own, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)\n"
    )
    script = out.parent / "peak.py"
    script.write_text(code)
    done = subprocess.run([sys.executable, str(script)], check=True, capture_output=True, text=True)
    own, child = (int(word) / 1024 for word in done.stdout.split()[-2:])
    return {"main": own, "largest_worker": child}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--method", default="dso")
    parser.add_argument(
        "--pairs", type=int, nargs=2, default=(400, 4000), help="numbers of pairs of the two timed runs"
    )
    parser.add_argument("--memory-pairs", type=int, nargs=2, default=(20, 2000))
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="relocbench-bench-") as scratch:
        folder = Path(scratch)
        town = importer("synthetic")
        source = town.build([], town.Options(), folder / "town", Silent(), Run(default_workers()))
        sizes = sorted({*arguments.pairs, *arguments.memory_pairs})
        datasets = {n: many_pairs(source, folder / f"pairs-{n}", n) for n in sizes}
        small, large = (datasets[n] for n in arguments.pairs)
        one = throughput(small, large, arguments.method, 1, folder / "out")
        two = throughput(small, large, arguments.method, 2, folder / "out")
        own = throughput(small, large, "identity", 1, folder / "out")
        memory = {n: peak_mib(datasets[n].root, arguments.method, folder / f"mem-{n}") for n in arguments.memory_pairs}
    few, many = (memory[n] for n in arguments.memory_pairs)
    result = {
        "benchmark": "evaluate",
        "method": arguments.method,
        "pairs_per_s_per_core": round(one["pairs_per_s"], 1),
        "two_workers_ratio": round(two["pairs_per_s"] / one["pairs_per_s"], 2),
        "own_ms_per_pair": round(own["own_ms_per_pair"], 2),
        "one_worker": {k: round(v, 3) for k, v in one.items()},
        "two_workers": {k: round(v, 3) for k, v in two.items()},
        "peak_mib": {str(n): {k: round(v, 1) for k, v in m.items()} for n, m in memory.items()},
        "peak_growth_mib": {k: round(many[k] - few[k], 1) for k in few},
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main()
