"""The time that relocbench takes to start: when imported, asked for help, and given a path that does not exist.

    python benchmarks/speed/startup.py [--repeats N]

Each is measured in a new process. The reference is a process that starts Python and does nothing. Repeats alternate,
and the fastest counts. The last line is JSON.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time

NOTHING = "python that does nothing"


def calls(out: str) -> dict[str, list[str]]:
    """Arguments of Python, by what is timed."""
    missing = f"{out}/missing"
    command = ["-m", "relocbench"]
    return {
        NOTHING: ["-c", "pass"],
        "import relocbench": ["-c", "import relocbench"],
        "process of a method": ["-c", "import relocbench.evaluation.isolation.isolated_process"],
        "relocbench --help": [*command, "--help"],
        "wrong path: inspect": [*command, "inspect", missing],
        "wrong path: validate": [*command, "validate", missing],
        "wrong path: evaluate": [*command, "evaluate", "--dataset", missing, "--method", "identity"],
        "wrong path: build-dataset kitti": [*command, "build-dataset", "kitti", missing, "--out", f"{out}/built"],
        "wrong path: build-dataset robotcar": [*command, "build-dataset", "robotcar", missing, "--out", f"{out}/built"],
        "wrong path: leaderboard": [*command, "leaderboard", missing],
        "wrong path: train": [*command, "train", "gn-net", "--dataset", missing, "--out", f"{out}/trained"],
    }


def seconds(arguments: list[str], expected: int) -> float:
    """The wall-clock seconds of a process from start to end."""
    start = time.perf_counter()
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=False)
    spent = time.perf_counter() - start
    if done.returncode != expected:
        raise SystemExit(f"{arguments} ended with {done.returncode}, expected {expected}: {done.stderr}")
    return spent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args().repeats
    with tempfile.TemporaryDirectory() as out:
        asked = calls(out)
        least = dict.fromkeys(asked, float("inf"))
        for _ in range(repeats + 1):  # the first round fills caches
            for name, arguments in asked.items():
                least[name] = min(least[name], seconds(arguments, 2 if name.startswith("wrong") else 0))
    base = least[NOTHING]
    for name, spent in least.items():
        print(f"{name:28} {1e3 * spent:7.0f} ms   {spent / base:5.1f} times {NOTHING}")
    beyond = {name: round(1e3 * (spent - base), 1) for name, spent in least.items() if name != NOTHING}
    print(json.dumps({"benchmark": "startup", "python_ms": round(1e3 * base, 1), "beyond_python_ms": beyond}))


if __name__ == "__main__":
    main()
