"""A site takes the place of no file but those of an earlier site."""

from __future__ import annotations

from pathlib import Path

from refusals import refused

from relocbench.errors import ConfigError
from relocbench.leaderboard.boards import Boards
from relocbench.leaderboard.html.links import method_page
from relocbench.leaderboard.html.manifest import MANIFEST, earlier_files
from relocbench.leaderboard.html.site import write_site

EMPTY = Boards()


def test_a_folder_with_somebodys_files_is_refused_and_unchanged(tmp_path: Path) -> None:
    (tmp_path / "index.html").write_text("mine")
    with refused(ConfigError, tmp_path, None, "index.html"):
        write_site(EMPTY, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["index.html"]
    assert (tmp_path / "index.html").read_text() == "mine"


def test_files_beside_a_site_stay_and_those_of_an_earlier_one_go(tmp_path: Path) -> None:
    write_site(EMPTY, tmp_path)
    (tmp_path / "set-up.html").write_text("mine")
    old = tmp_path / "set-old.html"
    old.write_text("of an earlier site")
    listed = (tmp_path / MANIFEST).read_text()
    (tmp_path / MANIFEST).write_text(listed + "set-old.html\n../outside.txt\n/etc/hostname\n")
    (tmp_path.parent / "outside.txt").write_text("mine")
    write_site(EMPTY, tmp_path)
    assert (tmp_path / "set-up.html").read_text() == "mine"
    assert not old.exists()
    assert (tmp_path.parent / "outside.txt").read_text() == "mine"
    assert (tmp_path / MANIFEST).read_text() == listed


def test_the_list_names_every_file_of_the_site(tmp_path: Path) -> None:
    write_site(EMPTY, tmp_path / "site")
    there = {path for path in (tmp_path / "site").rglob("*") if path.is_file() and path.name != MANIFEST}
    assert earlier_files(tmp_path / "site") == there


def test_another_file_of_that_name_is_no_site(tmp_path: Path) -> None:
    (tmp_path / MANIFEST).write_text("shopping\n")
    with refused(ConfigError, MANIFEST):
        write_site(EMPTY, tmp_path)


def test_names_that_differ_in_case_alone_are_different_files() -> None:
    assert method_page("DSO").lower() != method_page("dso").lower()
