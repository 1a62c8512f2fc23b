"""Methods that try to learn the pose from somewhere else than the images gain nothing over the identity."""

from __future__ import annotations

import json
import shutil
from contextvars import Context
from pathlib import Path

import numpy as np
import pytest
from cheating_retrievers import KeyGuesser, MeanGrey
from cheating_trackers import FRAMES, Trilaterator
from small_dataset import ACROSS, WITHIN, make_small_dataset
from small_views import make_small_views

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.cross_view import open_cross_view
from relocbench.errors import MethodError, RelocbenchError
from relocbench.evaluation.common.answer_table import Answer, read_answers
from relocbench.evaluation.common.error_table import read_errors
from relocbench.evaluation.common.matching_table import OFFSETS_PX, read_matching
from relocbench.evaluation.common.results import MethodResults
from relocbench.evaluation.common.worker import Shown, units_of
from relocbench.evaluation.relocalization.evaluate import RelocalizationOptions, evaluate_chains
from relocbench.evaluation.retrieval.describe import AnonymousViews, Describer, anonymous
from relocbench.evaluation.retrieval.evaluate import RetrievalOptions, evaluate_retrievers
from relocbench.evaluation.tracking.check import check
from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods
from relocbench.geometry import Camera
from relocbench.methods import MethodSpec, parse_method
from relocbench.progress import Silent
from relocbench.tracking import Query, Reference

pytestmark = pytest.mark.usefixtures("workers_kept")
HERE = "cheating_trackers"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("data") / "small", frames=8)


def evaluate(dataset: Dataset, out: Path, *methods: str, **options: object) -> list[MethodResults]:
    chosen = {"workers": 1, "pair_sets": (ACROSS,), **options}
    return evaluate_methods(EvaluateOptions(dataset=dataset.root, methods=methods, out=out, **chosen), Silent()).folders


def errors(folder: MethodResults) -> list[float]:
    return [row.translation_error_m for row in read_errors(folder.errors(ACROSS))]


def answers(folder: MethodResults) -> list[Answer]:
    return list(read_answers(folder.answers(ACROSS)).values())


@pytest.mark.parametrize("name", ["Clock", "KeyReader", "StackWalker"])
def test_who_looks_elsewhere_finds_nothing(dataset: Dataset, tmp_path: Path, name: str) -> None:
    cheat, floor = evaluate(dataset, tmp_path, f"cheat={HERE}:{name}", "identity")
    assert [json.loads(answer.info)["found"] for answer in answers(cheat)] == [[]] * len(answers(cheat))
    assert errors(cheat) == errors(floor)
    assert cheat.run_record().isolated is True


@pytest.mark.parametrize("name", ["StackWalker"])
def test_a_run_in_the_evaluators_process_says_so(dataset: Dataset, tmp_path: Path, name: str) -> None:
    (cheat,) = evaluate(dataset, tmp_path, f"cheat={HERE}:{name}", workers=0)
    assert any(json.loads(answer.info)["found"] for answer in answers(cheat)), "the walker finds what there is"
    assert cheat.run_record().isolated is False


def test_a_run_of_which_a_part_was_not_isolated_says_so(dataset: Dataset, tmp_path: Path) -> None:
    everything = {"pair_sets": (), "set": ("raises_at=0", f"log={tmp_path / 'log'}")}
    evaluate(dataset, tmp_path, "mixed=trackers_for_tests:Logging", workers=0, **{**everything, "pair_sets": (ACROSS,)})
    (mixed,) = evaluate(dataset, tmp_path, "mixed=trackers_for_tests:Logging", workers=1, **everything)
    assert mixed.run_record().isolated is False


def test_who_declares_that_it_uses_times_gets_them_and_is_marked(dataset: Dataset, tmp_path: Path) -> None:
    clock, floor = evaluate(dataset, tmp_path, f"clock={HERE}:DeclaredClock", "identity")
    assert max(errors(clock)) < 0.13 < max(errors(floor))
    assert clock.run_record().uses_times
    assert not floor.run_record().uses_times


def test_pairs_are_asked_in_an_order_that_says_nothing(dataset: Dataset, tmp_path: Path) -> None:
    def asked(out: str, seed: int) -> list[tuple[int, int, int]]:
        # With a process of its own, which has not been asked before.
        (cheat,) = Context().run(evaluate, dataset, tmp_path / out, f"cheat={HERE}:Order", seed=seed)
        told = [(answer.key, json.loads(answer.info)) for answer in answers(cheat)]
        return [(key[0], info["keyframe"], info["query"]) for key, info in told]

    first, again, other = asked("a", 0), asked("b", 0), asked("c", 1)
    assert first == again, "the order is drawn from the seed"
    assert first != other
    keyframes = sorted({time for time, _, _ in first})
    places = {time: place for time, place, _ in first}
    assert [places[time] for time in keyframes] != sorted(places.values()), "keyframes are not asked in time order"


def test_who_writes_to_its_input_spoils_nothing_for_the_next(dataset: Dataset, tmp_path: Path) -> None:
    evaluate(dataset, tmp_path / "both", f"cheat={HERE}:Mutator", "orb-pnp")
    evaluate(dataset, tmp_path / "alone", "orb-pnp")
    both, alone = (next((tmp_path / out).glob("*@*/orb-pnp")) / f"{ACROSS}.txt" for out in ("both", "alone"))
    assert both.read_bytes() == alone.read_bytes()


def test_answers_are_checked_where_the_method_cannot_reach(dataset: Dataset, tmp_path: Path) -> None:
    (cheat,) = evaluate(dataset, tmp_path, f"cheat={HERE}:Forger", set=("how=patch",))
    forged = [answer for answer in answers(cheat) if answer.status == "error"]
    assert len(forged) >= len(answers(cheat)) - 1, "the first answer was given before the patch"
    assert "not a rigid transform" in forged[0].message
    assert not any("\n" in answer.message for answer in answers(cheat))


def test_seconds_are_measured_where_the_method_cannot_reach(dataset: Dataset, tmp_path: Path) -> None:
    (cheat,) = evaluate(dataset, tmp_path, f"cheat={HERE}:Forger", set=("how=clock",))
    assert min(answer.seconds or 0 for answer in answers(cheat)) >= 0.05


@pytest.mark.parametrize("how", FRAMES)
def test_a_process_that_speaks_out_of_turn_gains_nothing(dataset: Dataset, tmp_path: Path, how: str) -> None:
    try:
        (cheat,) = evaluate(dataset, tmp_path, f"cheat={HERE}:Forger", set=(f"how={how}",))
    except RelocbenchError:
        return  # the run is refused
    (floor,) = evaluate(dataset, tmp_path, "identity")
    assert all(mine >= floors or np.isinf(mine) for mine, floors in zip(errors(cheat), errors(floor), strict=True))


def test_a_method_is_not_given_the_path_of_the_dataset(dataset: Dataset, tmp_path: Path) -> None:
    for path in (dataset.root, dataset.root / "pairs", dataset.root.parent / "." / dataset.root.name):
        with pytest.raises(MethodError, match="names a file or folder of the dataset"):
            evaluate(dataset, tmp_path, "cheat=trackers_for_tests:Required", set=(f"weights={path}",))


PLACES = {
    "a file": "{root}/dataset.yaml",
    "a link to it": "{links}/to-root",
    "a link into it": "{links}/to-pairs",
    "a path from here": "small/pairs",
    "a URL": "file://{root}/pairs",
    "an encoded URL": "file:///{slashless}/%70airs",
    "a list of paths": "/nowhere:{root}",
    "JSON": '{{"where": ["{root}/pairs"]}}',
    "a variable": "$DATASET_OF_THE_TEST/pairs",
    "a copy": "{copy}",
    "a part of a copy": "{copy}/pairs",
    "a folder around it": "{above}",
    "a folder of folders around it": "{above}/..",
    "the folder of a copy": "{copy}/..",
    "a folder with a link to it": "{links}",
}


@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES.keys())
def test_no_other_way_of_naming_the_dataset_is_taken(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    links = tmp_path / "links"
    links.mkdir()
    (links / "to-root").symlink_to(dataset.root)
    (links / "to-pairs").symlink_to(dataset.root / "pairs")
    shutil.copytree(dataset.root, tmp_path / "elsewhere" / "copy")
    monkeypatch.chdir(dataset.root.parent)
    monkeypatch.setenv("DATASET_OF_THE_TEST", str(dataset.root))
    root = str(dataset.root)
    filled = place.format(
        root=root, slashless=root[1:], links=links, copy=tmp_path / "elsewhere" / "copy", above=dataset.root.parent
    )
    with pytest.raises(MethodError, match=r"parameter 'weights' names a (file or folder of|folder that holds)"):
        evaluate(dataset, tmp_path / "r", "cheat=trackers_for_tests:Required", set=(f"weights='{filled}'",))
    assert not (tmp_path / "r").exists(), "nothing was begun"


def test_a_program_is_not_given_the_path_of_the_dataset(dataset: Dataset, tmp_path: Path) -> None:
    with pytest.raises(MethodError, match="its command line names a file or folder of the dataset"):
        evaluate(dataset, tmp_path, f"cheat=subprocess:cat --data={dataset.root}/pairs")


def test_the_other_evaluations_do_not_give_it_either(dataset: Dataset, tmp_path: Path) -> None:
    views = make_small_views(tmp_path / "views")
    some_file = next(path for path in sorted(views.rglob("*")) if path.is_file())
    options = RetrievalOptions(dataset=views, out=tmp_path / "out", methods=("lpn",), set=(f"weights={some_file}",))
    with pytest.raises(MethodError, match="retriever 'lpn': parameter 'weights' names a file or folder of the dataset"):
        evaluate_retrievers(options, Silent())
    chain = RelocalizationOptions(
        dataset=dataset.root,
        out=tmp_path / "out",
        retriever=("oracle",),
        methods=("cheat=trackers_for_tests:Required",),
        set=(f"cheat.weights={dataset.root}",),
    )
    with pytest.raises(MethodError, match="method 'cheat': parameter 'weights' names a file or folder of the dataset"):
        evaluate_chains(chain, Silent())


def test_other_paths_and_words_are_taken(dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(dataset.root.parent.parent)  # where a folder that holds the dataset has the name of a mode
    (tmp_path / "weights").touch()
    words = (
        tmp_path / "weights",
        dataset.root.parent.name,
        "1/2",
        "a: b",
        "/",
        "~",
        "",
        "\\",
        "$NOTHING/x",
        "x" * 9000,
    )
    for word in words:
        evaluate(
            dataset, tmp_path / "r", "m=trackers_for_tests:Required", set=(f"weights={word!s}",), overwrite="always"
        )


@pytest.mark.parametrize("name", ["PathReader", "KeyGuesser"])
def test_retrievers_find_neither_files_nor_names(tmp_path: Path, name: str) -> None:
    views = make_small_views(tmp_path / "views")
    options = RetrievalOptions(dataset=views, out=tmp_path / "out", methods=(f"cheat=cheating_retrievers:{name}",))
    (folder,) = evaluate_retrievers(options, Silent()).folders
    assert folder.run_record().info == {"found": []}


def test_a_retriever_in_the_evaluators_process_would_find_files(tmp_path: Path) -> None:
    views = make_small_views(tmp_path / "views")
    options = RetrievalOptions(
        dataset=views, out=tmp_path / "out", methods=("cheat=cheating_retrievers:PathReader",), workers=0
    )
    (folder,) = evaluate_retrievers(options, Silent()).folders
    assert folder.run_record().info["found"], "the reader finds what there is"


def test_keys_without_a_salt_would_be_guessed(tmp_path: Path) -> None:
    queries = open_cross_view(make_small_views(tmp_path / "views")).tasks()[0].queries
    guesser = KeyGuesser()
    guesser.describe(list(anonymous(queries)))
    assert guesser.info["found"] == sorted(view.key for view in queries)


def test_frames_of_the_querys_own_drive_are_not_shown_as_neighbours(dataset: Dataset, tmp_path: Path) -> None:
    for name, shown in ((ACROSS, True), (WITHIN, False)):
        (cheat,) = evaluate(dataset, tmp_path / name, f"cheat={HERE}:Neighbours", pair_sets=(name,))
        found = [json.loads(answer.info)["found"] for answer in read_answers(cheat.answers(name)).values()]
        assert any(found) is shown


def test_who_intersects_circles_around_its_starts_finds_what_the_starts_find(tmp_path: Path) -> None:
    matched = make_small_dataset(tmp_path / "small", frames=8, correspondences=60, size=(160, 120))
    (cheat,) = evaluate(matched, tmp_path / "r", f"cheat={HERE}:Trilaterator", matching=True)
    rows = [row.found for row in read_matching(cheat.matching(ACROSS))]
    assert sum(found.pixels for found in rows) > 100
    for found in rows:
        assert (found.within_1px, found.within_3px) == (found.start_within_1px, found.start_within_3px)


def test_who_fits_a_pose_to_all_starts_gains_as_documented_and_is_found_by_check_method(tmp_path: Path) -> None:
    matched = make_small_dataset(tmp_path / "small", frames=8, correspondences=400, size=(160, 120))
    (cheat,) = evaluate(matched, tmp_path / "r", f"cheat={HERE}:PoseFitter", matching=True)
    rows = [row.found for row in read_matching(cheat.matching(ACROSS))]
    assert sum(found.within_3px for found in rows) > 1.5 * sum(found.start_within_3px for found in rows)
    (alone,) = (f for f in check(parse_method(f"{HERE}:PoseFitter")) if "each pixel by itself" in f.check)
    assert not alone.passed


def test_notes_in_home_caches_and_temporary_files_are_not_found_by_the_next(dataset: Dataset, tmp_path: Path) -> None:
    methods = (f"a={HERE}:NoteTaker", f"b={HERE}:NoteTaker")
    folders = Context().run(evaluate, dataset, tmp_path / "r", *methods)  # workers of their own, which end
    told = [json.loads(answer.info) for folder in folders for answer in answers(folder)]
    assert [info["found"] for info in told] == [[]] * len(told)
    places = {place for info in told for place in info["places"]}
    assert len(places) == 2 * 5, "each method has folders of its own"
    assert not any(Path(place).exists() for place in places), "they are gone when the methods are"


def test_from_several_starts_of_one_pixel_the_pixel_would_be_found() -> None:
    image, camera = np.zeros((4, 4), np.uint8), Camera("pinhole", 160, 120, 100, 100, 79.5, 59.5)
    reference, query = Reference("r", None, image, camera), Query("q", None, image, camera)
    truth, angles = np.array([70.0, 41.0]), np.arange(len(OFFSETS_PX)) * 1.1
    starts = truth + np.array(OFFSETS_PX)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    cheat = Trilaterator()
    ends = cheat.match(reference, query, np.tile([3.0, 4.0], (len(starts), 1)), starts)
    np.testing.assert_allclose(ends, np.tile(truth, (len(starts), 1)), atol=1e-6)


def test_retrievers_see_images_in_an_order_that_says_nothing(tmp_path: Path) -> None:
    opened = open_cross_view(make_small_views(tmp_path / "views"))
    gallery = opened.tasks()[0].gallery
    names = {next(anonymous([view], "salt")).key: index for index, view in enumerate(gallery)}
    seen = [names[view.key] for view in AnonymousViews(gallery, "salt")]
    assert seen != sorted(seen)
    assert sorted(seen) == list(range(len(gallery)))
    assert [names[view.key] for view in AnonymousViews(gallery, "salt")[2:5]] == seen[2:5]
    described = Describer(MeanGrey(), salt="salt")(gallery, lambda count: None)
    given = Describer(MeanGrey())(gallery, lambda count: None)
    np.testing.assert_array_equal(described.values, given.values)


def test_nothing_but_pixels_tells_pairs_of_different_places_from_others(tmp_path: Path) -> None:
    apart = make_small_dataset(tmp_path / "small", frames=8, elsewhere=6)
    (cheat,) = evaluate(apart, tmp_path / "out", f"cheat={HERE}:Sorter")
    told = {answer.key: json.loads(answer.info)["told"] for answer in answers(cheat)}
    pair_set = apart.pair_set(ACROSS)
    assert told.keys() == {pair.key for pair in pair_set.asked}
    assert all(words == told[pair_set.pairs[0].key] for words in told.values())


def test_whoever_remembers_images_fails_as_many_pairs_of_one_place(tmp_path: Path) -> None:
    """A method that calls pairs different whose two images it has seen before is right half of the time."""
    apart = make_small_dataset(tmp_path / "small", frames=12, size=(32, 24), elsewhere=6)
    pair_set = apart.pair_set(ACROSS)
    keys = [pair.key for pair in pair_set.asked]
    exchanged = {time for pair in pair_set.elsewhere for time in pair.key}
    called = {True: 0, False: 0}
    for seed in range(400):
        keyframes: set[int] = set()
        queries: set[int] = set()
        units = units_of(apart, pair_set, MethodSpec("m", "identity"), tmp_path, keys, Shown(), seed)
        for ref, query in (key for unit in units for key in unit.keys):
            if ref in keyframes and query in queries and {ref, query} <= exchanged:
                called[pair_set.by_key[ref, query].is_elsewhere] += 1
            keyframes.add(ref)
            queries.add(query)
    assert called[True] > 300, "some are called different"
    assert called[True] < 0.55 * sum(called.values())
