"""Trackers that start from the pose of another one."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from refusals import refused
from small_dataset import ACROSS, make_small_dataset
from trackers_for_tests import FromPrior

from relocbench.datasets.core.dataset import Dataset
from relocbench.errors import MethodError
from relocbench.evaluation.tables.answers import read_answers
from relocbench.evaluation.tracking.evaluate import EvaluateOptions, evaluate_methods
from relocbench.methods import parse_method, parse_methods
from relocbench.methods.started import StartedTracker
from relocbench.progress import Silent
from relocbench.tracking import Query, Reference, TrackResult

HERE = "trackers_for_tests"


class Fails:
    def track(self, reference: Reference, query: Query, prior: np.ndarray | None = None) -> TrackResult:
        return TrackResult.failure("sees nothing")


class Raises:
    def track(self, reference: Reference, query: Query, prior: np.ndarray | None = None) -> TrackResult:
        raise ValueError("is broken")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_small_dataset(tmp_path_factory.mktemp("data") / "small")


@pytest.mark.thorough
def test_the_start_is_named_and_set_on_the_command_line(dataset: Dataset, tmp_path: Path) -> None:
    options = EvaluateOptions(
        dataset=dataset.root,
        methods=(f"refined={HERE}:FromPrior", "other=identity"),
        set=(f"refined.start={HERE}:Shift", "refined.start.metres=0.25"),
        out=tmp_path,
        workers=1,
        pair_sets=(ACROSS,),
    )
    refined, _ = evaluate_methods(options, Silent()).folders
    record = refined.run_record()
    assert record.parameters["start"] == f"{HERE}:Shift"
    assert record.parameters["start.metres"] == 0.25
    assert record.uses_times, "its start uses them"
    answers = list(read_answers(refined.answers(ACROSS)).values())
    assert {answer.status for answer in answers} == {"ok"}
    assert json.loads(answers[0].info) == {"own": 1, "start": "found"}
    line = refined.predictions(ACROSS).read_text().splitlines()[0].split()
    assert float(line[2]) == 0.25


@pytest.mark.parametrize(("start", "how"), [(Fails(), "none: sees nothing"), (Raises(), "ValueError: is broken")])
def test_without_a_start_the_tracker_is_asked_as_if_it_were_alone(start: object, how: str) -> None:
    tracker = StartedTracker(FromPrior(), start)
    reference = tracker.prepare("keyframe")  # type: ignore[arg-type]
    query: Query = None  # type: ignore[assignment]
    assert tracker.track(reference, query).message == "no prior"
    given = np.diag([1.0, -1.0, -1.0, 1.0])
    found = tracker.track(reference, query, given)
    assert found.T_query_ref is given
    assert found.info["start"] == how


def test_what_else_the_tracker_can_do_it_still_can() -> None:
    tracker = StartedTracker(FromPrior(), Fails())
    pixels = np.zeros((2, 2))
    assert tracker.match(tracker.prepare("keyframe"), None, pixels, pixels) is pixels  # type: ignore[arg-type,attr-defined]
    assert not hasattr(tracker, "match_levels")


@pytest.mark.thorough
def test_a_start_of_a_start_and_files_of_both() -> None:
    settings = ("start=dso", "a.start.start=orb-pnp", "a.start.points=500")
    spec = parse_method("a=gn-net", settings)
    assert spec.start is not None
    assert spec.start.start is not None
    assert (spec.start.target, spec.start.start.target) == ("dso", "orb-pnp")
    assert spec.start.parameters["points"] == 500
    assert isinstance(spec.create(), StartedTracker)
    assert set(parse_method("a=dso", ("start=gn-net",)).files()) == {"start.weights"}


@pytest.mark.parametrize(
    ("method", "settings", "assumed"),
    [
        ("gn-net", (), True),
        ("gn-net", ("along=[]",), False),
        ("gn-net-from-prior", ("start=orb-pnp",), True),
        ("gn-net-from-prior", ("start=orb-pnp", "prior_level=0"), False),
        ("gn-net-pnp", (), False),
        ("lm-net", (), False),
        ("dso", (), False),
        ("dso", ("along=[2.0]",), True),
        ("dso", ("start=gn-net",), True),
    ],
)
def test_a_tracker_says_whether_it_starts_along_the_road(method: str, settings: tuple[str, ...], assumed: bool) -> None:
    assert parse_method(method, settings).assumes() == ("starts along the road" if assumed else "")


def test_a_program_that_starts_from_what_uses_times_uses_them() -> None:
    program = "p=subprocess:python3 -c pass"
    assert not parse_method(program, ("start=identity",)).uses_times()
    assert parse_method(program, (f"start={HERE}:Shift",)).uses_times()


@pytest.mark.parametrize(
    ("method", "settings", "name"),
    [
        ("orb-pnp", ("orb-pnp.start=dso",), "start"),
        ("dso", ("dso.start=nothing-like-it",), "nothing-like-it"),
        ("dso", ("dso.start=orb-pnp", "dso.start.nothing=1"), "nothing"),
        ("dso", ("dso.start.points=1",), "dso.start"),
        ("dso", ("dso.start=lpn",), "lpn"),
    ],
)
def test_a_start_that_cannot_be_is_refused(method: str, settings: tuple[str, ...], name: str) -> None:
    with refused(MethodError, "", None, name):
        parse_methods((method,), settings)
