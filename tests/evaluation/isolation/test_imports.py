"""What the process of a method imports before the method does: one is started for each pair set."""

from __future__ import annotations

import subprocess
import sys

PROCESS = "relocbench.evaluation.isolation.isolated_process"
HEAVY = ("cv2", "matplotlib", "numba", "open3d", "pandas", "pydantic", "scipy", "torch", "typer")


def test_the_process_of_a_method_imports_no_large_library_but_numpy() -> None:
    code = f"import sys, {PROCESS}\nprint(*sorted(set({HEAVY}) & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
