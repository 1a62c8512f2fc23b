"""A blind export of images asks retrievers the same and tells no name, and answers to it become rows."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from command_line import relocbench
from forgery import change_yaml
from refusals import refused
from repository import ROOT
from small_dataset import make_small_dataset
from small_views import make_small_views
from submissions import SALT_TEXT, change_card, salt, salt_file

from relocbench.datasets.core.dataset import Dataset
from relocbench.errors import ConfigError, DatasetError
from relocbench.evaluation.retrieval.blind_export import BlindImages, export_blind_images
from relocbench.evaluation.retrieval.blind_set import BlindSetFile, keys_file, open_blind_set
from relocbench.evaluation.retrieval.opening import OpenedSet, SetOptions, open_set
from relocbench.evaluation.submission.card import TEMPLATE
from relocbench.files import dump_yaml, load_yaml, parse_yaml
from relocbench.geometry import make_transform
from relocbench.progress import Silent
from relocbench.retrieval import RetrievalTask

HERE = "retrievers_for_tests"
D2S = "drone-satellite"


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of drives and one of views, and the blind export of each."""
    made = tmp_path_factory.mktemp("made")
    make_small_dataset(made / "town", frames=5, size=(24, 18), name="town")
    make_small_views(made / "views", places=5)
    for name in ("town", "views"):
        export(made / name, made / f"{name}-blind")
    salt_file(made)
    return made


def export(folder: Path, out: Path, edition: int = 1) -> BlindSetFile:
    return export_blind_images(BlindImages(opened(folder), salt(), edition), out, Silent())


def opened(folder: Path) -> OpenedSet:
    return open_set(folder, folder.parent / "out", SetOptions(), Silent())


def shown(folder: Path, task: str) -> str:
    """What a task is called in the export."""
    return BlindImages(opened(folder), salt()).tasks[task]


def submit(to: Path, name: str, fingerprint: str, lists: Path) -> Path:
    """A submission of lists under a name, with its card."""
    text = TEMPLATE.replace("FILL IN: https://...", "https://example.org/code").replace("FILL IN: ", "my ")
    card: dict[str, Any] = parse_yaml(text)
    card["weights"]["splits_seen"] = []
    card |= {"task": "retrieval", "datasets": {name: {"fingerprint": fingerprint, "asked_once": True}}}
    (to / name).mkdir(parents=True)
    (to / "card.yaml").write_text(dump_yaml(card))
    for path in lists.glob("*.txt"):
        (to / name / path.name).write_text(path.read_text())
    return to


def answered(blind: Path, out: Path) -> Path:
    """The lists of the example script."""
    script = ROOT / "docs" / "examples" / "rank_blind.py"
    subprocess.run([sys.executable, script, blind, out, "--top", "4"], check=True)
    return out


def handed_in(root: Path, name: str, to: Path) -> Path:
    file, _ = open_blind_set(root / f"{name}-blind")
    return submit(to / "s", file.name, file.fingerprint, answered(root / f"{name}-blind", to / "lists"))


def check(submission: Path, *datasets: Path, options: tuple[str, ...] = ()) -> tuple[int, str]:
    named = [word for dataset in datasets for word in ("-d", dataset)]
    given = ("--salt-file", datasets[0].parent / f"{SALT_TEXT[:4]}.salt")
    outcome = relocbench("submit-check", submission, *named, *given, *options)
    return outcome.status, outcome.out + outcome.err


def add(submission: Path, dataset: Path, results: Path) -> int:
    given = ("--salt-file", dataset.parent / f"{SALT_TEXT[:4]}.salt")
    return relocbench("leaderboard", "add", submission, "--to", results, "-d", dataset, "-q", *given).status


@pytest.mark.parametrize("name", ["town", "views"])
def test_the_same_images_are_asked_under_keys(root: Path, name: str) -> None:
    asked, (file, tasks) = opened(root / name), open_blind_set(root / f"{name}-blind")
    keys = BlindImages(asked, salt())
    assert file.name == str(keys.name)
    assert [task.name for task in tasks] == sorted(keys.tasks.values())
    for own in asked.all_tasks:
        (shown,) = (task for task in tasks if task.name == keys.tasks[own.name])
        assert shown.queries[0].view == own.queries[0].view
        assert [one.key for one in shown.queries] == sorted(keys.queries(own))
        named = {**keys.queries(own), **keys.gallery(own)}
        pixels = {one.key: one.image for one in (*own.queries, *own.gallery)}
        for one in (*shown.queries, *shown.gallery):
            assert np.array_equal(one.image, pixels[named[one.key]])
        assert not shown.relevance.indices.size


def conditions(task: RetrievalTask) -> tuple[str, str]:
    return task.condition_query, task.condition_gallery


@pytest.mark.parametrize("name", ["town", "views"])
def test_no_file_tells_a_name_a_place_or_a_path(root: Path, name: str) -> None:
    asked = opened(root / name)
    images = [one.key for task in asked.all_tasks for one in (*task.queries, *task.gallery)]
    words = {asked.name, *(name for task in asked.all_tasks for name in (task.name, *conditions(task)) if name)}
    for path in (root / f"{name}-blind").rglob("*"):
        assert not any(Path(key).stem == path.stem for key in images)
        if path.suffix in (".csv", ".txt", ".yaml"):
            text = path.read_text()
            assert not any(key in text or Path(key).name in text for key in images), path
            assert not any(word in text for word in (str(root), *words)), path
    order = [path.stem for path in sorted((root / f"{name}-blind" / "images").iterdir())]
    assert len(order) == len(set(images))


def test_keys_follow_from_the_salt_the_truth_and_the_edition(root: Path, tmp_path: Path) -> None:
    asked = opened(root / "views")
    first, second, guessed = (BlindImages(asked, *a) for a in ((salt(),), (salt(), 2), (salt("c3" * 32),)))
    image = asked.all_tasks[0].queries[0].key
    assert first.key(image) == BlindImages(opened(root / "views"), salt()).key(image)
    assert len({first.key(image), second.key(image), guessed.key(image)}) == 3
    assert len({first.name.id, second.name.id, guessed.name.id}) == 3
    moved = make_small_views(tmp_path / "views", places=5)
    one, other = (moved / "test" / "gallery_satellite" / f"000{k}" / "0.png" for k in (1, 2))
    swapped = one.read_bytes(), other.read_bytes()
    one.write_bytes(swapped[1])
    other.write_bytes(swapped[0])
    assert BlindImages(opened(moved), salt()).key(image) != first.key(image)
    fault = make_transform(np.eye(3), [0.2, 0.0, 0.0])
    town = make_small_dataset(tmp_path / "town", frames=5, size=(24, 18), name="town", pose_fault=fault)
    assert BlindImages(opened(town.root), salt()).name.id != BlindImages(opened(root / "town"), salt()).name.id
    with refused(DatasetError, "", None, str(first.name), "withheld"):
        BlindImages(opened(root / "views-blind"), salt())


def test_an_export_has_the_same_bytes_again_and_takes_nobodys_folder(root: Path, tmp_path: Path) -> None:
    assert export(root / "views", tmp_path / "b") == open_blind_set(root / "views-blind")[0]
    export(root / "views", tmp_path / "b")  # begun anew over its own files
    with refused(ConfigError, tmp_path / "b", None, str(BlindImages(opened(root / "views"), salt(), 2).name)):
        export(root / "views", tmp_path / "b", 2)
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "thesis.tex").write_text("mine")
    with refused(ConfigError, "", None, "thesis.tex"):
        export(root / "views", tmp_path / "c")


def test_a_changed_export_is_refused_with_the_file(root: Path, tmp_path: Path) -> None:
    export(root / "views", tmp_path / "b")
    queries = keys_file(tmp_path / "b", shown(root / "views", D2S), "queries")
    text = queries.read_text()
    queries.write_text("".join(text.splitlines(keepends=True)[:-1]))
    with refused(DatasetError, "blind.yaml", None, "fingerprint", "images.csv"):
        open_blind_set(tmp_path / "b")
    queries.write_text(text + "abc\n")
    with refused(DatasetError, queries, len(text.splitlines()) + 1, "abc"):
        open_blind_set(tmp_path / "b")
    queries.write_text(text)
    image = next((tmp_path / "b" / "images").iterdir())
    cv2.imwrite(str(image), np.zeros((4, 4, 3), np.uint8))
    _, tasks = open_blind_set(tmp_path / "b")
    (view,) = {one.key: one for t in tasks for one in (*t.queries, *t.gallery) if one.key == image.stem}.values()
    with refused(DatasetError, image, None, "images.csv"):
        view.read()


@pytest.mark.parametrize("name", ["town", "views"])
def test_answers_to_an_export_are_scored_as_the_same_lists_by_name_are(root: Path, name: str, tmp_path: Path) -> None:
    submission = handed_in(root, name, tmp_path)
    status, told = check(submission, root / f"{name}-blind")
    assert status == 0, told
    assert add(submission, root / name, tmp_path / "r") == 0
    asked = opened(root / name)
    keys, lists = BlindImages(asked, salt()), tmp_path / "named"
    lists.mkdir()
    for task in asked.all_tasks:
        named = {**keys.queries(task), **keys.gallery(task)}
        lines = (tmp_path / "lists" / f"{keys.tasks[task.name]}.txt").read_text().split()
        pairs = zip(lines[::2], lines[1::2], strict=True)
        (lists / f"{task.name}.txt").write_text("".join(f"{named[q]} {named[k]}\n" for q, k in pairs))
    whose = Dataset(root / name) if name == "town" else asked
    direct = submit(tmp_path / "direct", whose.name, whose.fingerprint, lists)
    assert add(direct, root / name, tmp_path / "r2") == 0
    (row,), (other,) = ([*(tmp_path / r).glob("*@*/my-method")] for r in ("r", "r2"))
    for task in asked.all_tasks:
        assert (row / f"{task.name}.csv").read_text() == (other / f"{task.name}.csv").read_text()
    run = parse_yaml((row / "run.yaml").read_text())
    assert (run["answered_blind"], run["made_elsewhere"]) == (str(keys.name), True)


def test_the_board_names_the_export_and_shows_the_card(root: Path, tmp_path: Path) -> None:
    assert add(handed_in(root, "views", tmp_path), root / "views", tmp_path / "r") == 0
    board = relocbench("leaderboard", tmp_path / "r", "-d", root / "views", "-o", tmp_path / "b", "-q")
    assert board.status == 0, board
    page = (tmp_path / "b" / "retrieval.md").read_text()
    assert f"Answered `{open_blind_set(root / 'views-blind')[0].name}" in page
    with (tmp_path / "b" / "retrieval.csv").open(newline="", encoding="utf-8") as stream:
        assert {row["method"] for row in csv.DictReader(stream)} == {"my-method", "(chance)"}


def test_faults_of_answers_are_named(root: Path, tmp_path: Path) -> None:
    submission = handed_in(root, "views", tmp_path)
    (path,) = submission.glob(f"*/{shown(root / 'views', D2S)}.txt")
    lines = path.read_text().splitlines()
    real = opened(root / "views").all_tasks[0].queries[0].key
    query, image = lines[0].split()
    path.write_text("\n".join([*lines[4:], f"{real} {image}", f"{query} {real}", lines[5]]) + "\n")
    status, told = check(submission, root / "views")
    assert status == 1
    assert told.count("this is a real name, and the card names a blind export") == 2
    assert "occurs again" in told
    assert "1 of 10 are not answered" in told


def test_the_wrong_export_dataset_or_radius_is_named(root: Path, tmp_path: Path) -> None:
    submission = handed_in(root, "town", tmp_path)
    status, told = check(submission, root / "views")
    assert (status, "is no export of views" in told) == (2, True)
    status, told = check(submission, root / "town", options=("--radius", "10"))
    assert (status, "--radius chooses" in told) == (2, True)
    name = open_blind_set(root / "town-blind")[0].name
    other = name[:-1] + ("0" if name[-1] != "0" else "1")
    (submission / name).rename(submission / other)
    change_card(submission, lambda card: card.update(datasets={other: card["datasets"][name]}))
    status, told = check(submission, root / "town")
    assert (status, f"'{other}' is no export of town.places-25m" in told) == (2, True)


def test_an_export_alone_cannot_score_and_named_answers_are_refused_where_blind_ones_are_due(
    root: Path, tmp_path: Path
) -> None:
    submission = handed_in(root, "views", tmp_path)
    outcome = relocbench("leaderboard", "add", submission, "--to", tmp_path / "r", "-d", root / "views-blind", "-q")
    assert (outcome.status, "is withheld" in outcome.complaint) == (2, True)
    assert not list(tmp_path.glob("r/*@*"))
    assert check(submission, root / "views", options=("--blind-only",))[0] == 0
    asked = opened(root / "views")
    direct = submit(tmp_path / "d", asked.name, asked.fingerprint, tmp_path / "lists")
    status, told = check(direct, root / "views", options=("--blind-only",))
    assert (status, "expected answers to a blind export" in told) == (1, True)


def test_a_retriever_runs_on_an_export_and_its_folder_is_handed_in(root: Path, tmp_path: Path) -> None:
    asked = ("evaluate-retrieval", "-d", root / "views-blind", "-m", f"t={HERE}:Thumbnail", "--workers", 0)
    outcome = relocbench(*asked, "-o", tmp_path / "own")
    assert outcome.status == 0, outcome
    assert "is a blind export" in outcome.err
    (folder,) = (tmp_path / "own").glob("*@*/t")
    assert not (folder / "scores.yaml").exists()
    file, _ = open_blind_set(root / "views-blind")
    submission = submit(tmp_path / "s", file.name, file.fingerprint, folder)
    (submission / file.name / "run.yaml").write_bytes((folder / "run.yaml").read_bytes())
    assert check(submission, root / "views")[0] == 0
    change_yaml(submission / file.name / "run.yaml", lambda run: run.update(fingerprint="ab" * 32))
    assert f"is of {file.name}@" in check(submission, root / "views")[1]
    refused = relocbench("evaluate-retrieval", *asked[1:], "-o", tmp_path / "x", "--radius", 5)
    assert (refused.status, "is a blind export" in refused.complaint) == (2, True)


def test_the_command_exports_and_refuses_what_does_not_fit(root: Path, tmp_path: Path) -> None:
    given = ("--radius", 0.2, "--salt-file", root / f"{SALT_TEXT[:4]}.salt")
    outcome = relocbench("export", "-d", root / "town", "-f", "blind-images", *given, "-o", tmp_path / "b")
    assert outcome.status == 0, outcome
    file, (task,) = open_blind_set(tmp_path / "b")
    assert outcome.out.split()[-1] == file.name
    assert file.name != open_blind_set(root / "town-blind")[0].name
    assert (task.name, len(task.queries), len(task.gallery)) == ("task1", 5, 5)
    assert load_yaml(tmp_path / "b" / "blind.yaml", type(file), "x", DatasetError).licence == file.licence != ""
    blind = ("-f", "blind-images", *given[2:])
    for options in (("-f", "blind", "--radius", 1), (*blind, "-m", "x"), blind[:2], ("-f", "tum", "--edition", 2)):
        refused = relocbench("export", "-d", root / "town", *options, "-o", tmp_path / "t")
        assert refused.status == 2, options
    assert not (tmp_path / "t").exists()
