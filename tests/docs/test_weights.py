"""``docs/weights.md`` names every weights file, with the digest that the file has."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator

from repository import DOCS, ROOT

from relocbench.methods.discovery import RETRIEVERS, TRACKERS, installed_methods, method_class
from relocbench.weights import SupportsFetching

PAGE = (DOCS / "weights.md").read_text()


def _rows(heading: str) -> Iterator[list[str]]:
    section = PAGE.split(f"## {heading}\n")[1].split("\n## ")[0]
    for line in section.splitlines():
        if line.startswith("|"):
            yield [cell.strip().strip("`") for cell in line.strip("|").split("|")]


def test_shipped_weights_have_the_digests_of_the_page() -> None:
    files = {path.name: path for path in (ROOT / "baselines").rglob("*.safetensors")}
    digests = {row[0]: row[1] for row in _rows("Shipped with the package") if re.fullmatch("[0-9a-f]{64}", row[1])}
    assert digests == {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()}
    assert all(str(path.relative_to(ROOT)) in PAGE and path.with_suffix(".md").is_file() for path in files.values())


def test_fetched_weights_are_those_that_the_methods_publish() -> None:
    shown = {row[0]: (set(re.findall(r"[\w-]+", row[1])), row[3]) for row in _rows("Fetched from their authors")}
    expected: dict[str, tuple[set[str], str]] = {}
    for kind in (TRACKERS, RETRIEVERS):
        for method in installed_methods(kind):
            loaded = method_class(method, kind)
            for file in loaded.published().values() if isinstance(loaded, SupportsFetching) else ():
                expected.setdefault(file.name, (set(), file.sha256 or "unknown"))[0].add(method)
    assert {name: row for name, row in shown.items() if "." in name} == expected
