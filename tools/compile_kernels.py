"""Compile the kernels that the demo and the tests need into the user's cache; where they are there, return at once.

    python tools/compile_kernels.py

Without it each process compiles what it calls when it first calls it, and processes that begin together all compile
the same. Here three lines of work that share few kernels run side by side, each on the smallest input: a rendered
town, ground truth from recorded drives, and trackers.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from relocbench.kernels import use_kernel_cache

_ROOT = Path(__file__).resolve().parents[1]
_RELOCBENCH = f"{sys.executable} -m relocbench"
_RENDERED = f"""
{_RELOCBENCH} build-dataset synthetic --preset smoke --conditions Sunny,Rain,Snow,Night --size 96x72 -o town -j 1
"""
_RECORDED = f"""
options=$({sys.executable} -c "
from pathlib import Path
from recorded_street import SMALL, record_street
for number in range(2):
    record_street(Path('drives'), number, azimuths=360)
print(*SMALL)
")
{_RELOCBENCH} build-dataset boreas drives/boreas-* -o street -j 1 $options --calibration estimate
"""
_TRACKED = f"""
{sys.executable} -c "
from pathlib import Path
from small_dataset import make_small_dataset
make_small_dataset(Path('small'))
"
{_RELOCBENCH} evaluate -d small -m dso -m gn-net -o results -j 1
"""


def _checkout() -> str:
    """Digest of where the files with kernels lie and of their times, since Numba finds by these what it compiled."""
    packages = (_ROOT / "relocbench", _ROOT / "baselines")
    files = sorted(path for package in packages for path in package.rglob("*.py") if b"njit" in path.read_bytes())
    told = "".join(f"{path} {path.stat().st_mtime_ns}\n" for path in files)
    return hashlib.sha256(told.encode()).hexdigest()[:16]


def main() -> None:
    use_kernel_cache()
    marker = Path(os.environ["NUMBA_CACHE_DIR"]) / f"compiled-{_checkout()}"
    if marker.exists():
        return
    print("compiling kernels, once for these files", flush=True)
    began = time.monotonic()
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(_ROOT), str(_ROOT / "tests" / "support")]),
        "OMP_NUM_THREADS": "1",
    }
    with tempfile.TemporaryDirectory() as folder:
        running = []
        for number, script in enumerate((_RENDERED, _RECORDED, _TRACKED)):
            scratch = Path(folder) / str(number)
            scratch.mkdir()
            command = ["bash", "-euo", "pipefail", "-c", script]
            running.append(
                subprocess.Popen(
                    command, cwd=scratch, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
                )
            )
        outputs = [process.communicate()[0] for process in running]
    for process, output in zip(running, outputs, strict=True):
        if process.returncode:
            print(f"kernels are compiled when they are called, since this failed:\n{output}", file=sys.stderr)
            return
    marker.touch()
    print(f"compiled kernels in {time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    main()
