"""Retrieval by the commands a user types: the whole way, lists made elsewhere, and mistakes in one line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import relocbench
from refusals import refused
from small_dataset import ACROSS, make_small_dataset
from small_views import make_small_views

from relocbench.errors import MethodError
from relocbench.evaluation.retrieval.answers import ANSWERS
from relocbench.methods import RETRIEVERS, TRACKERS, kind_of, parameters_of, parse_method, parse_methods

HERE = "retrievers_for_tests"
TRACKER = "trackers_for_tests:Shift"
D2S = "drone-satellite"
RETRIEVAL = ("evaluate-retrieval",)


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_small_views(tmp_path_factory.mktemp("views") / "town", places=6)


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_small_dataset(tmp_path_factory.mktemp("street") / "small", frames=4).root


@pytest.mark.thorough
def test_from_images_to_scores_and_a_page(views: Path, tmp_path: Path) -> None:
    common = (*RETRIEVAL, "-d", views, "-m", f"t={HERE}:Thumbnail", "--set", "t.side=4", "--out", tmp_path / "r")
    shown = relocbench(*common)
    assert shown.status == 0, shown.err
    assert "\x1b" not in shown.out + shown.err
    assert "t on town: " in shown.err
    assert all(words in shown.out for words in ("R@1, %", "(chance)", f"{D2S} (12 queries, 7 images)"))
    folder = next((tmp_path / "r").glob("town@*"))
    assert sorted(p.name for p in (folder / "t").iterdir()) == [
        f"{D2S}.csv",
        f"{D2S}.txt",
        "run.yaml",
        "satellite-drone.csv",
        "satellite-drone.txt",
        "scores.yaml",
    ]
    assert "parameters: {side: 4" in (folder / "t" / "run.yaml").read_text()
    scores = json.loads(relocbench(*common, "--json", "-q").out, parse_constant=pytest.fail)
    assert scores["methods"]["t"][D2S]["queries"] == 12
    assert scores["chance"][D2S]["R@1"] == pytest.approx(1 / 7)
    assert relocbench("leaderboard", tmp_path / "r", "--out", tmp_path / "b", "-q").status == 0
    assert (tmp_path / "b" / "retrieval.md").exists()
    assert not (tmp_path / "b" / "leaderboard.md").exists()


@pytest.mark.thorough
def test_a_configuration_file_gives_the_options_of_retrieval(street: Path, tmp_path: Path) -> None:
    config = tmp_path / "run.yaml"
    config.write_text(f"dataset: {street}\nmethods: ['t={HERE}:Thumbnail']\npositives: pairs\nout: {tmp_path}/r\n")
    assert relocbench(*RETRIEVAL, "--config", config, "-q").status == 0
    assert [p.name.split("@")[0] for p in (tmp_path / "r").iterdir()] == ["small.places-pairs"]
    config.write_text(f"dataset: {street}\nmatching: true\n")
    assert f"{config}:2: unknown key 'matching'" in relocbench(*RETRIEVAL, "--config", config).complaint


@pytest.mark.thorough
def test_lists_made_elsewhere_are_scored(street: Path, tmp_path: Path) -> None:
    options = ("-d", street, "--radius", "0.2", "--out", tmp_path / "r", "-q")
    assert relocbench(*RETRIEVAL, *options, "-m", f"t={HERE}:Thumbnail").status == 0
    mine = next((tmp_path / "r").glob("*@*/t"))
    lines = (mine / f"{ACROSS}.txt").read_text().splitlines()
    queries = list(dict.fromkeys(line.split()[0] for line in lines))
    theirs = tmp_path / "netvlad.txt"
    theirs.write_text("# made elsewhere\n" + "".join(f"{line}\n" for line in lines if not line.startswith(queries[2])))
    assert relocbench(*RETRIEVAL, *options, "--predictions", theirs).status == 0
    answers = ANSWERS.read(mine.parent / "netvlad" / f"{ACROSS}.csv")
    assert [a.status for a in answers] == ["ok", "ok", "failed", "ok"]
    assert answers[2].message == "not in the list"
    assert [a.ranks for a in answers][:2] == [a.ranks for a in ANSWERS.read(mine / f"{ACROSS}.csv")][:2]
    assert "target: predictions:netvlad.txt" in (mine.parent / "netvlad" / "run.yaml").read_text()
    copy = tmp_path / "copy"
    copy.mkdir()
    for name in (f"{ACROSS}.txt", "run.yaml"):
        (copy / name).write_bytes((mine / name).read_bytes())
    assert relocbench(*RETRIEVAL, *options, "--predictions", copy, "-m", "again").status == 0
    other = relocbench(*RETRIEVAL, "-q", "-d", street, "--out", tmp_path / "r", "--predictions", copy, "-m", "other")
    assert "run.yaml: predictions are for small.places-0.2m@" in other.complaint


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "{q} {g}\n{q} nowhere.png\n",
            r":2: image 'nowhere.png' is not in the gallery, whose images have names such as 'traversals/",
        ),
        ("nobody.png {g}\n", r":1: unknown query 'nobody.png'; queries have names such as 'traversals/"),
        ("{q} {g}\n\n{q} {g}\n", r":3: image '{g}' occurs again for the query '{q}'"),
        ("{q} {g} 0.5\n", r":1: expected 'query db', found 3 words"),
    ],
)
def test_a_fault_in_a_list_is_named_with_its_line(street: Path, tmp_path: Path, text: str, words: str) -> None:
    times = {
        name: sorted(p.name for p in (street / "traversals" / name).rglob("images/*/*.png"))
        for name in ("winter", "summer")
    }
    keys = {
        "q": f"traversals/winter/images/cam0/{times['winter'][0]}",
        "g": f"traversals/summer/images/cam0/{times['summer'][0]}",
    }
    theirs = tmp_path / f"{ACROSS}.txt"
    theirs.write_text(text.format(**keys))
    for source in (theirs, tmp_path):
        outcome = relocbench(*RETRIEVAL, "-q", "-d", street, "--predictions", source, "-m", "x", "-o", tmp_path / "r")
        assert outcome.status == 2
        assert f"{theirs}{words.format(**keys)}" in outcome.complaint
        assert not (tmp_path / "r").exists()


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["-d", "{v}", "-m", "identity"],
            "is a tracker, not a retriever; evaluate it with `relocbench evaluate`",
        ),
        (["-d", "{v}", "-m", TRACKER], "has no describe(), but track(): it is a tracker for `relocbench evaluate`"),
        (["-d", "{v}", "-m", "subprocess:true"], "a program cannot be a retriever; score what it wrote"),
        (["-d", "{v}", "-m", "no-such"], "no retriever 'no-such'"),
        (["-d", "{v}", "-m", f"{HERE}:Thumbnail", "--set", "sied=3"], "has no parameter 'sied' (did you mean 'side'?)"),
        (["-d", "{v}", "-m", f"{HERE}:makes_nothing"], "made a thing of type object, which has no describe()"),
        (["-d", "{v}"], "nothing to evaluate: give --method NAME or --predictions PATH"),
        (["-m", f"{HERE}:Thumbnail"], "--dataset: must be given"),
        (["-d", "{v}/absent", "-m", f"{HERE}:Thumbnail"], "absent: no such folder"),
        (["-d", "{v}/test/gallery_drone", "-m", f"{HERE}:Thumbnail"], "in University-1652's layout"),
        (["-d", "{v}", "-m", f"{HERE}:Thumbnail", "--out", "{v}/r"], "--out lies inside the dataset"),
        (["-d", "{v}", "-m", f"{HERE}:Thumbnail", "--pair-set", "a"], "no task 'a'; available: drone-satellite"),
        (["-d", "{v}", "-m", f"{HERE}:Thumbnail", "--radius", "3"], "--radius is for the drives of a dataset"),
        (["-d", "{v}", "-m", f"{HERE}:Thumbnail", "--split", "test"], "--split is for the drives of a dataset"),
        (["-d", "{v}", "-m", f"{HERE}:Thumbnail", "--matching"], "--matching; it is an option of relocbench evaluate"),
        (
            ["-d", "{v}", "-m", f"{HERE}:Thumbnail", "-j", "2"],
            "--workers can only be 0",
        ),
        (["-d", "{v}", "-m", f"{HERE}:Thumbnail", "--keep", "0"], "--keep: "),
        (["-d", "{v}", "--predictions", "{v}/absent"], "absent: no such file or folder"),
        (["-d", "{v}", "--predictions", "{v}/test"], "holds no predictions"),
        (["-d", "{s}", "-m", f"{HERE}:Thumbnail", "--radius", "-1"], "--radius: "),
        (["-d", "{s}", "-m", f"{HERE}:Thumbnail", "--heading", "200"], "--heading: "),
    ],
)
def test_a_mistake_is_one_line_and_status_2(
    views: Path, street: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = relocbench(*RETRIEVAL, *(a.format(v=views, s=street) for a in arguments))
    assert outcome.status == 2
    assert words in next(line for line in outcome.err.splitlines() if line.startswith("relocbench: "))
    assert "Traceback" not in outcome.err
    assert list(tmp_path.iterdir()) == []


def test_one_list_cannot_answer_two_tasks(views: Path, tmp_path: Path) -> None:
    theirs = tmp_path / "list.txt"
    theirs.write_text("")
    outcome = relocbench(*RETRIEVAL, "-d", views, "--predictions", theirs, "--out", tmp_path / "r")
    assert "one file answers one task, and there are drone-satellite, satellite-drone" in outcome.complaint


@pytest.mark.thorough
def test_options_of_retrieval_are_refused_where_poses_are_asked(street: Path, tmp_path: Path) -> None:
    common = ("evaluate", "-d", street, "--out", tmp_path / "r")
    for option in (("--keep", "5"), ("--radius", "5"), ("--positives", "pairs"), ("--by-condition",)):
        told = relocbench(*common, "-m", "identity", *option).complaint
        assert f"No such option: {option[0]}; it is an option of relocbench evaluate-re" in told
    told = relocbench(*common, "-m", f"{HERE}:Thumbnail").complaint
    assert "has no track(), but describe(): it is a retriever for `relocbench evaluate-retrieval`" in told
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        (("evalute",), "No such command 'evalute'. Did you mean 'evaluate', 'validate'? (see `relocbench --help`)"),
        (("evaluate", "-d", ".", "more"), "Got unexpected extra argument(s) (more) (see `relocbench evaluate --help`)"),
        (("validate",), "Missing argument 'PATH' (see `relocbench validate --help`)"),
        (("evaluate", "--sed", "1"), "No such option: --sed (Possible options: --scheduler, --seed, --set) (see"),
    ],
)
def test_a_command_line_that_cannot_be_read_is_one_line(words: tuple[str, ...], fault: str) -> None:
    outcome = relocbench(*words)
    assert (outcome.status, outcome.out) == (2, "")
    assert outcome.complaint.startswith(f"relocbench: {fault}")


def test_without_a_command_the_help_is_shown() -> None:
    outcome = relocbench()
    assert (outcome.status, outcome.err) == (2, "")
    assert "evaluate-retrieval" in outcome.out


@pytest.mark.thorough
def test_both_kinds_of_methods_are_listed_and_told_apart() -> None:
    listed = json.loads(relocbench("methods", "--json").out)
    assert "orb-pnp" in listed["tracking"]
    assert set(listed) == {"tracking", "retrieval", "weights", "counts"}
    assert listed["counts"]["tracking"] == len(listed["tracking"])
    assert "identity" in relocbench("methods").out
    shown = relocbench("methods", f"{HERE}:Thumbnail", "--json")
    assert json.loads(shown.out)["parameters"]["side"] == {"type": "int", "default": 8, "words": ""}
    assert (kind_of(f"{HERE}:Thumbnail"), kind_of(TRACKER)) == (RETRIEVERS, TRACKERS)
    assert (kind_of("identity"), kind_of("subprocess:true")) == (TRACKERS, TRACKERS)


@pytest.mark.parametrize("command", ["evaluate", "evaluate-relocalization", "probe"])
def test_places_given_to_a_command_for_pairs_are_named_as_such(tmp_path: Path, command: str) -> None:
    make_small_views(tmp_path / "v", places=4)
    oracle = ("-r", "oracle") if command == "evaluate-relocalization" else ()
    told = relocbench(command, "-d", tmp_path / "v", *oracle, "-m", "identity", "--out", tmp_path / "out")
    assert "holds places by several views and no pairs: retrievers are evaluated on it, by `relocbench eva" in told.err
    assert told.status == 2


@pytest.mark.parametrize("command", ["methods", "check-method"])
def test_a_name_that_nothing_has_is_refused_with_trackers_retrievers_and_trainers(command: str) -> None:
    told = relocbench(command, "orb-bo").complaint
    assert "no method 'orb-bo' (did you mean 'orb-bow'?); installed trackers: aliked-lightglue-pnp, " in told
    assert "; retrievers: colour-histogram, " in told
    assert "; trainers: gn-net, " in told


def test_retrievers_are_configured_as_trackers_are() -> None:
    spec = parse_method(f"mine={HERE}:Thumbnail", ["mine.side=3", "other.side=9"], seed=5, kind=RETRIEVERS)
    assert (spec.label, spec.parameters, spec.kind) == ("mine", {"side": 3, "log": "", "seed": 5}, RETRIEVERS)
    assert spec.create().side == 3
    assert [p.name for p in parameters_of(f"{HERE}:Reversing", RETRIEVERS)] == ["top", "fault"]
    for text, settings, name in (
        (f"{HERE}:Thumbnail", ["side=many"], "side=many"),
        (f"{HERE}:NotARetriever", [], "describe"),
        ("bad__label=x:Y", [], "bad__label"),
    ):
        with refused(MethodError, "", None, name):
            parse_method(text, settings, kind=RETRIEVERS)
    with refused(MethodError, "", None, "a"):
        parse_methods([f"a={HERE}:Thumbnail", f"a={HERE}:Constant"], kind=RETRIEVERS)


@pytest.mark.thorough
def test_a_retriever_can_be_checked() -> None:
    shown = relocbench("check-method", f"mine={HERE}:Thumbnail", "--set", "mine.side=4", "--json")
    assert shown.status == 0, shown.out
    assert all(one["passed"] for one in json.loads(shown.out)["checks"])
    assert relocbench("check-method", f"{HERE}:Constant").status == 2


def test_help_gives_an_example() -> None:
    shown = " ".join(relocbench("evaluate-retrieval", "--help").out.split())
    assert "Example: relocbench evaluate-retrieval" in shown
    assert "--by-condition" in shown
