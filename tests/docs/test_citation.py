"""The package, its citation in both formats, its changelog and its addresses say the same."""

from __future__ import annotations

import re
import tomllib
from typing import Any

import yaml
from repository import ROOT

from relocbench.version import __version__

ENTRY = re.compile(r"^@(\w+)\{(\w+),\n(.*?)^\}", re.MULTILINE | re.DOTALL)
FIELD = re.compile(r"^\s*(\w+)\s*=\s*\{(.*)\},?$", re.MULTILINE)


def _entries(text: str) -> dict[str, dict[str, str]]:
    """The BibTeX entries of a text, by type."""
    return {kind: dict(FIELD.findall(body)) for kind, _, body in ENTRY.findall(text)}


def _cff() -> dict[str, Any]:
    loaded: dict[str, Any] = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    return loaded


def _project() -> dict[str, Any]:
    project: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    return project


def test_bibtex_and_citation_file_agree() -> None:
    cff, bib = _cff(), _entries((ROOT / "CITATION.bib").read_text())
    software = bib["software"]
    assert software["title"] == cff["title"]
    assert software["version"] == str(cff["version"])
    assert software["year"] == cff["date-released"][:4]
    assert software["url"] == cff["url"]
    assert software["author"].strip("{}").split(" and ") == [author["name"] for author in cff["authors"]]
    (paper,) = cff["references"]
    names = [f"{author['family-names']}, {author['given-names']}" for author in paper["authors"]]
    assert bib["article"] == {
        "author": " and ".join(names),
        "title": paper["title"],
        "journal": paper["journal"],
        "year": str(paper["year"]),
    }


def test_a_citation_in_the_readme_is_that_of_the_file() -> None:
    bib = _entries((ROOT / "CITATION.bib").read_text())
    for block in re.findall(r"```bibtex\n(.*?)```", (ROOT / "README.md").read_text(), flags=re.DOTALL):
        shown = _entries(block)
        assert shown.items() <= bib.items()


def test_version_authors_and_addresses_are_those_of_the_package() -> None:
    cff, project = _cff(), _project()
    newest = re.findall(r"^## (\d\S+)", (ROOT / "CHANGELOG.md").read_text(), flags=re.MULTILINE)[0]
    assert str(cff["version"]) == __version__ == newest
    assert [author["name"] for author in cff["authors"]] == [author["name"] for author in project["authors"]]
    assert cff["url"] == cff["repository-code"] == project["urls"]["Source"]
    assert all(address.startswith(cff["url"]) for address in project["urls"].values())
