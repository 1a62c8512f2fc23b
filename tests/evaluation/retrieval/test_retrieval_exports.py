"""Rankings as hloc's lists: names, order and length, and what is told where there are none."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from command_line import Outcome, relocbench
from small_dataset import ACROSS, CAMERA, WITHIN, make_small_dataset

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.names import write_names
from relocbench.datasets.importers.photos.lists import listed_pairs

METHOD = "t=retrievers_for_tests:Thumbnail"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("street") / "small", frames=4)


@pytest.fixture(scope="module")
def results(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Rankings of three images of each query."""
    out = tmp_path_factory.mktemp("results")
    words = ("-d", dataset.root, "-m", METHOD, "-j", 0, "--keep", 3, "-o", out, "-q")
    done = relocbench("evaluate-retrieval", *words)
    assert done.status == 0, done.err
    return out


def export(dataset: Dataset, results: Path, out: Path, *more: object, label: str = "t") -> Outcome:
    return relocbench("export", "-d", dataset.root, "-f", "hloc", "-r", label, "--results", results, "-o", out, *more)


def kept_lists(results: Path) -> Path:
    (path,) = results.glob(f"*@*/t/{ACROSS}.txt")
    return path


def test_lists_are_the_first_of_each_ranking_by_the_names_of_the_exported_model(
    dataset: Dataset, results: Path, tmp_path: Path
) -> None:
    done = export(dataset, results, tmp_path / "e", "--top", 2)
    assert (done.status, done.err) == (0, "")
    pairs = [pair for _, pair in listed_pairs(tmp_path / "e" / ACROSS / "pairs.txt")]
    ranked: dict[str, list[str]] = {}
    for line in kept_lists(results).read_text().splitlines():
        query, image = (name.removeprefix("traversals/") for name in line.split())
        ranked.setdefault(query, []).append(image)
    assert len(ranked) == 4
    assert pairs == [(query, image) for query, images in ranked.items() for image in images[:2]]
    model = relocbench("export", "-d", dataset.root, "-f", "colmap", "--pair-set", ACROSS, "-o", tmp_path / "m")
    assert model.status == 0, model.err
    lines = (tmp_path / "m" / ACROSS / "images.txt").read_text().splitlines()[::2]
    assert {name for pair in pairs for name in pair} <= {line.split()[-1] for line in lines}


def test_the_folder_of_a_retrieval_set_can_be_named(dataset: Dataset, results: Path, tmp_path: Path) -> None:
    both = shutil.copytree(results, tmp_path / "r")
    words = ("-d", dataset.root, "-m", METHOD, "-j", 0, "--positives", "pairs", "-o", both, "-q")
    assert relocbench("evaluate-retrieval", *words).status == 0
    told = export(dataset, both, tmp_path / "e")
    assert told.status == 2
    assert "2 sets of rankings of 't'; name the folder of one: --results" in told.complaint
    (one,) = both.glob("small.places-pairs@*")
    assert export(dataset, one, tmp_path / "e").status == 0
    assert len(list(listed_pairs(tmp_path / "e" / ACROSS / "pairs.txt"))) == 16, "all four keyframes of four queries"


def test_queries_for_which_nothing_was_retrieved_are_told(dataset: Dataset, results: Path, tmp_path: Path) -> None:
    less = shutil.copytree(results, tmp_path / "r")
    path = kept_lists(less)
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[3:]))
    done = export(dataset, less, tmp_path / "e", "--top", 1)
    assert done.status == 0
    assert done.complaint == f"{tmp_path}/e/{ACROSS}/pairs.txt: 1 of 4 queries have no line"
    assert len(list(listed_pairs(tmp_path / "e" / ACROSS / "pairs.txt"))) == 3


@pytest.mark.parametrize("name", ["winter morning/1.png", "no#1.png", "a\tb.png"])
def test_a_name_that_lists_cannot_hold_is_refused(dataset: Dataset, results: Path, tmp_path: Path, name: str) -> None:
    copy = Dataset(shutil.copytree(dataset.root, tmp_path / "small"))
    winter = copy.traversal("winter")
    names = winter.layout.names
    write_names(names, {time: f"{time}.png" for time in winter.timestamps(CAMERA)[1:]})
    assert export(copy, results, tmp_path / "e").status == 2, "three images of each query are kept"
    assert export(copy, results, tmp_path / "e", "--top", 3).status == 0
    write_names(names, {winter.timestamps(CAMERA)[0]: name})
    for words in (("-r", "t", "--top", 3, "--results", results), ()):
        told = relocbench("export", "-d", copy.root, "-f", "hloc", "--pair-set", ACROSS, "-o", tmp_path / "n", *words)
        assert told.status == 2
        assert told.complaint.startswith(f"relocbench: {names}: image '")
        assert "has a blank or '#' in its name" in told.complaint


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (
            ("--top", 4),
            "keeps 3 images of each query, --top is 4; `relocbench evaluate-retrieval --keep 4` keeps as many",
        ),
        (("--pair-set", WITHIN), f"no rankings of pair set '{WITHIN}'"),
        (("--pair-set", "a"), "no pair set 'a'"),
        (("-m", "orb-pnp"), "--retriever exports lists of images for hloc: give --format hloc and no --method"),
        (("-f", "tum"), "--retriever exports lists of images for hloc: give --format hloc and no --method"),
        (("--top", 0), "--top"),
    ],
)
def test_a_mistake_is_one_line(
    dataset: Dataset, results: Path, tmp_path: Path, more: tuple[object, ...], words: str
) -> None:
    told = export(dataset, results, tmp_path / "e", *more)
    assert told.status == 2
    assert words in told.complaint
    assert not (tmp_path / "e").exists()


def test_rankings_that_are_not_there_are_named(dataset: Dataset, results: Path, tmp_path: Path) -> None:
    told = export(dataset, results, tmp_path / "e", label="netvlad")
    assert f"no rankings of 'netvlad' on small@{dataset.fingerprint[:12]}; there are t" in told.complaint
    assert "there are none" in export(dataset, tmp_path / "empty", tmp_path / "e").complaint
    other = make_small_dataset(tmp_path / "other", frames=3)
    assert "there are none" in export(other, results, tmp_path / "e").complaint
    told = relocbench("export", "-d", dataset.root, "-f", "hloc", "--top", 3, "-o", tmp_path / "e")
    assert "--top is the length of a retriever's lists; name the retriever" in told.complaint


def test_lists_of_another_dataset_are_refused_with_their_line(dataset: Dataset, results: Path, tmp_path: Path) -> None:
    strange = shutil.copytree(results, tmp_path / "r")
    path = kept_lists(strange)
    path.write_text("traversals/winter/images/cam0/1.png a.png\n")
    told = export(dataset, strange, tmp_path / "e", "--top", 1)
    assert f"{path}:1: unknown query 'traversals/winter/images/cam0/1.png'" in told.complaint
