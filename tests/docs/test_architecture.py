"""The map of the code shows the code: folders, levels and numbers of ``docs/architecture.md``."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest
from repository import DOCS, ROOT


@pytest.mark.parametrize("package", ["relocbench.datasets", "relocbench.datasets.groundtruth"])
def test_levels_and_numbers_are_those_that_the_tool_prints(package: str) -> None:
    page = (DOCS / "architecture.md").read_text()
    folder = package.replace(".", "/")
    table = page.split(f"| level | folder of `{folder}` |")[1].split("\n\n")[0]
    rows = re.findall(r"^\| (\d+) \| ([^|]+) \|", table, flags=re.MULTILINE)
    shown = {name: int(level) for level, names in rows for name in re.findall(r"`(\w+)`", names)}
    command = [sys.executable, str(ROOT / "tools" / "folders.py"), package]
    printed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    assert shown == {line.split()[1]: int(line.split()[0]) for line in printed[:-1]}
    if f"python tools/folders.py {package}`" in page:
        assert printed[-1].removeprefix(f"{package}: ") in " ".join(page.split())


def test_every_folder_of_the_code_is_on_the_page() -> None:
    page = (DOCS / "architecture.md").read_text()
    for parent in ("relocbench", "relocbench/datasets"):
        for path in sorted((ROOT / parent).iterdir()):
            if path.is_dir() and (path / "__init__.py").exists():
                assert f"`{parent}/{path.name}`" in page or f"`{path.name}`" in page, path


SHARED = re.compile(r"NDArray\[np\.(float64|float32|int64|intp|bool_|uint8)\]")
"""the element types that ``relocbench/arrays.py`` has names for"""


def test_the_types_of_arrays_are_named_in_one_module() -> None:
    folders = ("relocbench", "baselines", "benchmarks", "tests", "tools")
    paths = [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]
    named = {str(path.relative_to(ROOT)) for path in paths if SHARED.search(path.read_text())}
    assert named == {"relocbench/arrays.py"}
