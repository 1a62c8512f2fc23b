"""The folder that was meant, where somebody names the one above it."""

from __future__ import annotations

from pathlib import Path

import pytest

from relocbench.files import did_you_mean
from relocbench.files import nearby as search


def marked(folder: Path) -> bool:
    return (folder / "mark").exists()


def make(root: Path, *names: str) -> None:
    for name in names:
        (root / name).mkdir(parents=True)
        (root / name / "mark").touch()


def test_the_nearest_and_first_by_name_is_meant(tmp_path: Path) -> None:
    make(tmp_path, "z/deep", "b", "c")
    assert did_you_mean(tmp_path, marked) == f"; did you mean {tmp_path / 'b'}?"
    assert did_you_mean(tmp_path / "z", marked) == f"; did you mean {tmp_path / 'z' / 'deep'}?"


def test_what_is_too_deep_or_a_link_is_not_meant(tmp_path: Path) -> None:
    make(tmp_path, "a/b/c")
    assert did_you_mean(tmp_path, marked) == ""
    make(tmp_path / "elsewhere" / "x", "y")
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "link").symlink_to(tmp_path / "elsewhere" / "x" / "y")
    assert did_you_mean(tmp_path / "home", marked) == ""


def test_what_cannot_be_read_was_not_meant(tmp_path: Path) -> None:
    make(tmp_path, "a", "b")

    def look(folder: Path) -> bool:
        if folder.name == "a":
            raise PermissionError(13, "Permission denied", str(folder))
        return marked(folder)

    assert did_you_mean(tmp_path, look) == f"; did you mean {tmp_path / 'b'}?"
    assert did_you_mean(tmp_path / "absent", marked) == ""


def test_a_large_tree_costs_no_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make(tmp_path, *(f"{number:02d}/in" for number in range(12)))
    looked: list[Path] = []

    def look(folder: Path) -> bool:
        looked.append(folder)
        return False

    monkeypatch.setattr(search, "_MOST", 15)
    assert did_you_mean(tmp_path, look) == ""
    assert len(looked) == 15
