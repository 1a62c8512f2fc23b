"""Methods that try to learn the pose from somewhere else than the images gain nothing over the identity."""

from __future__ import annotations

import json
import shutil
import socket
import sys
from contextvars import Context
from pathlib import Path

import numpy as np
import pytest
from cheating_retrievers import KeyGuesser, MeanGrey
from cheating_trackers import FRAMES, QUESTION, Trilaterator
from refusals import refused
from small_dataset import ACROSS, WITHIN, make_small_dataset
from small_views import make_small_views

from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.cross_view import open_cross_view
from relocbench.errors import MethodError
from relocbench.evaluation.common.blindness import check_blind
from relocbench.evaluation.common.results import MethodResults
from relocbench.evaluation.isolation.framing import FramingFault, receive_answer
from relocbench.evaluation.isolation.tracker import _answers as as_answers
from relocbench.evaluation.isolation.worker import Assignment, Visibility
from relocbench.evaluation.relocalization.evaluate import RelocalizationOptions, evaluate_pipelines
from relocbench.evaluation.retrieval.answers import ANSWERS as RETRIEVED
from relocbench.evaluation.retrieval.describe import AnonymousViews, Describer, anonymous
from relocbench.evaluation.retrieval.evaluate import RetrievalOptions, evaluate_retrievers
from relocbench.evaluation.tables.answers import Answer, read_answers
from relocbench.evaluation.tables.errors import read_errors
from relocbench.evaluation.tables.matching import MATCHING, OFFSETS_PX
from relocbench.evaluation.tracking.check import check
from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods
from relocbench.execution import Run
from relocbench.execution.sandbox import NONE, working_sandbox
from relocbench.geometry import Camera
from relocbench.methods import MethodSpec, parse_method, parse_methods
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


CHEATS = {
    "clock": "Clock",
    "keys": "KeyReader",
    "walker": "StackWalker",
    "declared": "DeclaredClock",
    "mutator": "Mutator",
    "patch": "Forger",
    "stopwatch": "Forger",
    "note-a": "NoteTaker",
    "note-b": "NoteTaker",
    "order": "Order",
    "disk": "DiskReader",
}
SETTINGS = ("patch.how=patch", "stopwatch.how=clock")


def backwards(dataset: Dataset) -> str:
    """Where the dataset is, so that no check of parameters sees it."""
    return f"disk.place={str(dataset.root)[::-1]}"


@pytest.fixture(scope="module")
def asked(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> dict[str, MethodResults]:
    """All cheats, by label, asked in one run, and the identity after them; with workers of their own, which end."""
    methods = [f"{label}={HERE}:{name}" for label, name in CHEATS.items()]
    folders = Context().run(
        evaluate,
        dataset,
        tmp_path_factory.mktemp("asked"),
        *methods,
        "orb-pnp",
        "identity",
        set=(*SETTINGS, backwards(dataset)),
    )
    return {folder.label: folder for folder in folders}


@pytest.mark.parametrize("label", ["clock", "keys", "walker"])
def test_who_looks_elsewhere_finds_nothing(asked: dict[str, MethodResults], label: str) -> None:
    assert [json.loads(answer.info)["found"] for answer in answers(asked[label])] == [[]] * len(answers(asked[label]))
    assert errors(asked[label]) == errors(asked["identity"])
    assert asked[label].run_record().isolated is True


@pytest.mark.thorough
def test_who_knows_where_the_truth_lies_on_the_disk_finds_nothing_there(
    asked: dict[str, MethodResults], dataset: Dataset, tmp_path: Path
) -> None:
    if working_sandbox() == NONE:
        pytest.skip("no sandbox works on this system: the disk can be read")
    assert all(json.loads(answer.info)["found"] == [] for answer in answers(asked["disk"]))
    assert asked["disk"].run_record().sandbox == working_sandbox()
    (cheat,) = evaluate(dataset, tmp_path, f"disk={HERE}:DiskReader", sandbox="none", set=(backwards(dataset),))
    assert all(len(json.loads(answer.info)["found"]) > 6 for answer in answers(cheat)), "it finds what there is"
    assert cheat.run_record().sandbox == NONE


@pytest.mark.thorough
def test_nowhere_is_a_method_made_where_the_truth_can_be_read(tmp_path: Path) -> None:
    if working_sandbox() == NONE:
        pytest.skip("no sandbox works on this system: the disk can be read")
    few = make_small_dataset(tmp_path / "few", pairs=2, correspondences=20)
    given = f"m.place={str(few.root)[::-1]}", f"m.diary={tmp_path / 'diary'}"
    evaluate(few, tmp_path / "r", f"m={HERE}:Diarist", matching=True, set=given)
    assert set((tmp_path / "diary").read_text().split()) == {"0"}


@pytest.mark.thorough
def test_a_module_that_changes_the_evaluator_when_it_is_imported_changes_nothing(
    asked: dict[str, MethodResults], dataset: Dataset, tmp_path: Path
) -> None:
    (cheat,) = evaluate(dataset, tmp_path, "cheat=patching_trackers:Patcher")
    assert errors(cheat) == errors(asked["identity"])
    assert "patching_trackers" not in sys.modules


@pytest.mark.thorough
def test_a_run_in_the_evaluators_process_says_so(dataset: Dataset, tmp_path: Path) -> None:
    (cheat,) = evaluate(dataset, tmp_path, f"cheat={HERE}:StackWalker", workers=0)
    assert any(json.loads(answer.info)["found"] for answer in answers(cheat)), "the walker finds what there is"
    assert cheat.run_record().isolated is False


@pytest.mark.thorough
def test_a_run_of_which_a_part_was_not_isolated_says_so(dataset: Dataset, tmp_path: Path) -> None:
    everything = {"pair_sets": (), "set": ("raises_at=0", f"log={tmp_path / 'log'}")}
    evaluate(dataset, tmp_path, "mixed=trackers_for_tests:Logging", workers=0, **{**everything, "pair_sets": (ACROSS,)})
    (mixed,) = evaluate(dataset, tmp_path, "mixed=trackers_for_tests:Logging", workers=1, **everything)
    assert mixed.run_record().isolated is False


def test_who_declares_that_it_uses_times_gets_them_and_is_marked(asked: dict[str, MethodResults]) -> None:
    assert max(errors(asked["declared"])) < 0.13 < max(errors(asked["identity"]))
    assert asked["declared"].run_record().uses_times
    assert not asked["identity"].run_record().uses_times


def test_pairs_are_asked_in_an_order_that_says_nothing(asked: dict[str, MethodResults]) -> None:
    told = [(answer.key, json.loads(answer.info)) for answer in answers(asked["order"])]
    places = {key[0]: info["keyframe"] for key, info in told}
    assert [places[time] for time in sorted(places)] != sorted(places.values()), "keyframes are not asked in time order"


def test_the_order_is_drawn_from_the_seed_and_the_dataset(dataset: Dataset, tmp_path: Path) -> None:
    pair_set = dataset.pair_set(ACROSS)
    keys = [pair.key for pair in pair_set.pairs]

    def order(seed: int, times: bool = False) -> list[tuple[int, int]]:
        assigned = Assignment(dataset, parse_method("identity"), Run(), Visibility(times=times), seed)
        units = assigned.units(pair_set, tmp_path, keys)
        return [key for unit in units for key in unit.keys]

    assert order(0) == order(0) != order(1)
    assert sorted(order(0)) == sorted(keys) == order(0, times=True), "who says that it uses times gets them in order"


@pytest.mark.thorough
def test_who_writes_to_its_input_spoils_nothing_for_the_next(
    dataset: Dataset, asked: dict[str, MethodResults], tmp_path: Path
) -> None:
    (alone,) = evaluate(dataset, tmp_path, "orb-pnp")
    assert asked["orb-pnp"].predictions(ACROSS).read_bytes() == alone.predictions(ACROSS).read_bytes()


def test_answers_are_checked_where_the_method_cannot_reach(asked: dict[str, MethodResults]) -> None:
    told = answers(asked["patch"])
    forged = [answer for answer in told if answer.status == "error"]
    assert len(forged) >= len(told) - 1, "the first answer was given before the patch"
    assert not any("\n" in answer.message for answer in told)


def test_seconds_are_measured_where_the_method_cannot_reach(asked: dict[str, MethodResults]) -> None:
    assert min(answer.seconds or 0 for answer in answers(asked["stopwatch"])) >= 0.05


@pytest.mark.thorough
@pytest.mark.parametrize("how", ["pickle", "early"])
def test_a_process_that_sends_no_answer_costs_its_pairs_and_later_methods_run(tmp_path: Path, how: str) -> None:
    few = make_small_dataset(tmp_path / "few", pairs=2)
    cheat, identity = Context().run(
        evaluate, few, tmp_path / "r", f"cheat={HERE}:Forger", "identity", set=(f"cheat.how={how}",)
    )
    assert {answer.status for answer in answers(cheat)} == {"error"}
    assert "something other than an answer to the question" in answers(cheat)[0].message
    assert {answer.status for answer in answers(identity)} == {"ok"}


@pytest.mark.thorough
def test_a_retriever_that_sends_no_answer_costs_its_queries_and_later_retrievers_run(tmp_path: Path) -> None:
    options = RetrievalOptions(
        dataset=make_small_views(tmp_path / "views", places=3),
        out=tmp_path / "out",
        methods=("cheat=cheating_retrievers:Forger", "colour-histogram"),
    )
    cheat, honest = Context().run(evaluate_retrievers, options, Silent()).folders
    for task in ("drone-satellite", "satellite-drone"):
        told = list(RETRIEVED.read(cheat.answers(task)))
        assert {answer.status for answer in told} == {"error"}
        assert "something other than an answer to the question" in told[0].message
        assert {answer.status for answer in RETRIEVED.read(honest.answers(task))} == {"ok"}


@pytest.mark.parametrize("how", FRAMES)
def test_nothing_that_a_process_may_send_is_taken_for_an_answer(how: str) -> None:
    for question in (QUESTION, "another"):
        here, there = socket.socketpair()
        with here:
            there.sendall(FRAMES[how])
            there.close()
            try:
                words, arrays = receive_answer(here, question, lambda: False)
            except FramingFault:
                continue
        assert question == QUESTION
        assert ({answer.status for answer in as_answers(words, arrays, 1)} == {"error"}) is (how != "early")


@pytest.mark.thorough
def test_a_method_is_not_given_the_path_of_the_dataset(dataset: Dataset, tmp_path: Path) -> None:
    for path in (dataset.root, dataset.root / "pairs", dataset.root.parent / "." / dataset.root.name):
        with refused(MethodError, "", None, "cheat", "weights", "evaluated dataset"):
            evaluate(dataset, tmp_path / "r", "cheat=trackers_for_tests:Required", set=(f"weights={path}",))
    assert not (tmp_path / "r").exists(), "nothing was begun"


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
    (spec,) = parse_methods(["cheat=trackers_for_tests:Required"], [f"weights='{filled}'"])
    with refused(MethodError, "", None, "cheat", "weights", "evaluated dataset"):
        check_blind([spec], dataset.root)


def test_a_program_is_not_given_the_path_of_the_dataset(dataset: Dataset) -> None:
    (spec,) = parse_methods([f"cheat=subprocess:cat --data={dataset.root}/pairs"])
    with refused(MethodError, "", None, "cheat", "command line", "evaluated dataset"):
        check_blind([spec], dataset.root)


@pytest.mark.thorough
def test_the_other_evaluations_do_not_give_it_either(dataset: Dataset, tmp_path: Path) -> None:
    views = make_small_views(tmp_path / "views")
    some_file = next(path for path in sorted(views.rglob("*")) if path.is_file())
    options = RetrievalOptions(
        dataset=views, out=tmp_path / "out", methods=("mine=misbehaving:Describes",), set=(f"mark={some_file}",)
    )
    with refused(MethodError, "", None, "mine", "mark", "evaluated dataset"):
        evaluate_retrievers(options, Silent())
    pipeline = RelocalizationOptions(
        dataset=dataset.root,
        out=tmp_path / "out",
        retriever=("oracle",),
        methods=("cheat=trackers_for_tests:Required",),
        set=(f"cheat.weights={dataset.root}",),
    )
    with refused(MethodError, "", None, "cheat", "weights", "evaluated dataset"):
        evaluate_pipelines(pipeline, Silent())


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
        check_blind(parse_methods(["m=trackers_for_tests:Required"], [f"weights={word!s}"]), dataset.root)


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["PathReader", "KeyGuesser"])
def test_retrievers_find_neither_files_nor_names(tmp_path: Path, name: str) -> None:
    views = make_small_views(tmp_path / "views")
    options = RetrievalOptions(dataset=views, out=tmp_path / "out", methods=(f"cheat=cheating_retrievers:{name}",))
    (folder,) = evaluate_retrievers(options, Silent()).folders
    assert folder.run_record().info == {"found": []}


@pytest.mark.thorough
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


@pytest.mark.thorough
def test_frames_around_keyframes_are_shown_only_where_no_set_asks_their_drive(dataset: Dataset, tmp_path: Path) -> None:
    alone = make_small_dataset(tmp_path / "alone", frames=8, within=False)
    for of, name, shown in ((alone, ACROSS, True), (dataset, ACROSS, False), (dataset, WITHIN, False)):
        (cheat,) = evaluate(of, tmp_path / of.name / name, f"cheat={HERE}:Neighbours", pair_sets=(name,))
        found = [json.loads(answer.info)["found"] for answer in read_answers(cheat.answers(name)).values()]
        assert any(found) is shown, (of, name)
    told = {finding.check: finding for finding in check(parse_method(f"{HERE}:Neighbours"))}
    assert told["says how many neighbours it wants"].passed
    assert "100 on each side" in told["says how many neighbours it wants"].detail


@pytest.mark.thorough
def test_nothing_is_remembered_from_one_pair_set_to_the_next(dataset: Dataset, tmp_path: Path) -> None:
    (cheat,) = evaluate(dataset, tmp_path, f"cheat={HERE}:NoteTaker", pair_sets=(ACROSS, WITHIN))
    across, within = (
        [json.loads(answer.info) for answer in read_answers(cheat.answers(name)).values()] for name in (ACROSS, WITHIN)
    )
    homes = [{place for info in told for place in info["places"][:5]} for told in (across, within)]
    found = {Path(path) for info in across + within for path in info["found"]}
    assert not [path for path in found if str(path.parent) in homes[0] | homes[1]]
    assert working_sandbox() == NONE or not found, "nor in places that methods share"
    assert homes[0].isdisjoint(homes[1]), "each set has a process and folders of its own"


@pytest.mark.thorough
def test_who_intersects_circles_around_its_starts_finds_what_the_starts_find(tmp_path: Path) -> None:
    matched = make_small_dataset(tmp_path / "small", frames=4, correspondences=60, size=(160, 120))
    (cheat,) = evaluate(matched, tmp_path / "r", f"cheat={HERE}:Trilaterator", matching=True)
    rows = MATCHING.read(cheat.matching(ACROSS))
    assert sum(found.pixels for found in rows) > 100
    for found in rows:
        assert (found.within_1px, found.within_3px) == (found.start_within_1px, found.start_within_3px)


@pytest.mark.thorough
def test_who_fits_a_pose_to_all_starts_gains_as_documented_and_is_found_by_check_method(tmp_path: Path) -> None:
    matched = make_small_dataset(tmp_path / "small", frames=4, correspondences=400, size=(160, 120))
    (cheat,) = evaluate(matched, tmp_path / "r", f"cheat={HERE}:PoseFitter", matching=True)
    rows = MATCHING.read(cheat.matching(ACROSS))
    assert sum(found.within_3px for found in rows) > 1.5 * sum(found.start_within_3px for found in rows)
    (alone,) = (f for f in check(parse_method(f"{HERE}:PoseFitter")) if "each pixel by itself" in f.check)
    assert not alone.passed


def test_notes_in_home_caches_and_temporary_files_are_not_found_by_the_next(asked: dict[str, MethodResults]) -> None:
    told = [json.loads(answer.info) for label in ("note-a", "note-b") for answer in answers(asked[label])]
    own = {place for info in told for place in info["places"][:5]}
    assert len(own) == 2 * 5, "each method has folders of its own"
    assert not any(Path(place).exists() for place in own), "they are gone when the methods are"
    found = {Path(path) for info in told for path in info["found"]}
    assert not [path for path in found if str(path.parent) in own]
    if working_sandbox() != NONE:
        assert not found, "nor in places that methods share"


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


@pytest.mark.thorough
def test_nothing_but_pixels_tells_pairs_of_different_places_from_others(tmp_path: Path) -> None:
    apart = make_small_dataset(tmp_path / "small", frames=8, elsewhere=6)
    (cheat,) = evaluate(apart, tmp_path / "out", f"cheat={HERE}:Sorter")
    told = {answer.key: json.loads(answer.info)["told"] for answer in answers(cheat)}
    pair_set = apart.pair_set(ACROSS)
    assert told.keys() == {pair.key for pair in pair_set.evaluated}
    assert all(words == told[pair_set.pairs[0].key] for words in told.values())


@pytest.mark.thorough
def test_whoever_remembers_images_fails_as_many_pairs_of_one_place(tmp_path: Path) -> None:
    """A method that calls pairs different whose two images it has seen before is right half of the time."""
    apart = make_small_dataset(tmp_path / "small", frames=12, size=(32, 24), elsewhere=6)
    pair_set = apart.pair_set(ACROSS)
    keys = [pair.key for pair in pair_set.evaluated]
    exchanged = {time for pair in pair_set.negative_pairs for time in pair.key}
    called = {True: 0, False: 0}
    for seed in range(400):
        keyframes: set[int] = set()
        queries: set[int] = set()
        assigned = Assignment(apart, MethodSpec("m", "identity"), Run(), Visibility(), seed)
        units = assigned.units(pair_set, tmp_path, keys)
        for ref, query in (key for unit in units for key in unit.keys):
            if ref in keyframes and query in queries and {ref, query} <= exchanged:
                called[pair_set.by_key[ref, query].is_negative] += 1
            keyframes.add(ref)
            queries.add(query)
    assert called[True] > 300, "some are called different"
    assert called[True] < 0.55 * sum(called.values())
