"""Finding and configuring methods."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import Field
from refusals import refused

from relocbench.errors import MethodError
from relocbench.evaluation.tracking.check import check
from relocbench.methods import installed_methods, parameters_of, parse_method, parse_methods
from relocbench.methods.parameters import Parameter

HERE = "trackers_for_tests"


def test_installed_methods_are_found_by_entry_point() -> None:
    found = installed_methods()
    assert {"identity", "orb-pnp", "sift-pnp", "dso", "dso-multistart"} <= set(found)
    assert list(found) == sorted(found)


@pytest.mark.parametrize(
    ("text", "label", "target"),
    [
        ("identity", "identity", "identity"),
        ("floor=identity", "floor", "identity"),
        (f"{HERE}:Shift", "Shift", f"{HERE}:Shift"),
        (f"mine={HERE}:Shift", "mine", f"{HERE}:Shift"),
        (f"subprocess:{sys.executable} a=b", Path(sys.executable).stem, f"subprocess:{sys.executable} a=b"),
        (f"cpp=subprocess:{sys.executable} --x", "cpp", f"subprocess:{sys.executable} --x"),
    ],
)
def test_a_method_is_a_label_and_a_target(text: str, label: str, target: str) -> None:
    spec = parse_method(text)
    assert (spec.label, spec.target) == (label, target)


def test_parameters_are_the_constructors_keywords_with_their_types() -> None:
    names = {p.name: (p.type_name, p.default) for p in parameters_of(f"{HERE}:Shift")}
    assert names == {"metres": ("float", 0.1), "steps": ("int", 3), "loud": ("bool", False), "seed": ("int", 0)}


def test_the_fields_of_a_dataclass_have_the_types_of_the_modules_that_they_are_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    head = "from __future__ import annotations\nfrom dataclasses import dataclass\n"
    (tmp_path / "its_base.py").write_text(
        f"{head}from typing import Literal as Word\n\n@dataclass\nclass Base:\n    mode: Word['near', 'far'] = 'near'\n"
    )
    (tmp_path / "its_tracker.py").write_text(
        f"{head}from its_base import Base\n\n@dataclass\nclass Tracker(Base):\n    steps: int = 3\n\n"
        "    def track(self, reference, query, prior=None): ...\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    found = {p.name: p.type_name for p in parameters_of("its_tracker:Tracker")}
    assert found == {"mode": "'near' | 'far'", "steps": "int"}


@pytest.mark.parametrize(
    ("annotation", "said"),
    [
        (Annotated[float, Field(gt=0)], "float"),
        (Literal["dso", "lm-reloc"] | None, "'dso' | 'lm-reloc' | None"),
        (Annotated[float, Field(ge=0, le=1)] | None, "float | None"),
        (int | None, "int | None"),
        (tuple[int, ...], "tuple[int, ...]"),
        (tuple[Annotated[float, Field(allow_inf_nan=False)], ...], "tuple[float, ...]"),
    ],
)
def test_the_type_of_a_parameter_says_what_it_takes(annotation: object, said: str) -> None:
    assert Parameter("p", annotation, None).type_name == said


def test_settings_are_converted_and_defaults_are_kept() -> None:
    spec = parse_method(f"a={HERE}:Shift", ["metres=1e-3", "a.steps=7", "loud=true", "b.steps=9"], seed=5)
    assert spec.parameters == {"metres": 0.001, "steps": 7, "loud": True, "seed": 5}
    assert parse_method(f"a={HERE}:Shift", ["seed=9"], seed=5).parameters["seed"] == 9


@pytest.mark.parametrize(
    ("text", "settings", "names"),
    [
        ("orb-pmp", [], ["orb-pmp", "orb-pnp"]),
        ("no_such_module_here:Class", [], ["no_such_module_here"]),
        (f"{HERE}:Absent", [], ["Absent"]),
        (f"{HERE}:NotATracker", [], ["track"]),
        (f"{HERE}:Shift", ["metre=1"], ["metre", "metres"]),
        (f"{HERE}:Shift", ["steps=many"], ["steps=many"]),
        (f"{HERE}:Shift", ["metres=-1"], ["metres=-1", 0]),
        (f"{HERE}:Shift", ["metres"], ["metres"]),
        (f"{HERE}:Required", [], ["weights"]),
        ("subprocess:/no/such/program", [], ["/no/such/program"]),
        ("bad__label=identity", [], ["bad__label"]),
    ],
)
def test_a_mistake_is_named(text: str, settings: list[str], names: list[object]) -> None:
    with refused(MethodError, "", None, *names):
        parse_method(text, settings).create()


@pytest.mark.parametrize(
    ("code", "names"),
    [
        ("1 / 0", ["ZeroDivisionError", "broken_method.py", "line 1"]),
        ("class T(:", ["SyntaxError", "broken_method.py", "line 1"]),
        ("import sys\nsys.exit(5)", ["SystemExit: 5"]),
        ("import no_such_module_here", ["no_such_module_here"]),
        (
            "class T:\n  def __init__(self): raise OSError('no weights')\n  def track(self, *a): pass",
            ["OSError: no weights"],
        ),
        (
            "class T:\n  def __init__(self): import no_such_module_here\n  def track(self, *a): pass",
            ["no_such_module_here"],
        ),
    ],
)
def test_a_method_that_cannot_be_loaded_is_one_line_that_says_where(
    code: str, names: list[object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "broken_method.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "broken_method", raising=False)
    with refused(MethodError, "", None, *names) as raised:
        parse_method("broken_method:T").create()
    assert "\n" not in str(raised.value)


def test_a_package_baselines_of_somebody_else_is_named(tmp_path: Path) -> None:
    other = tmp_path / "elsewhere" / "baselines"
    other.mkdir(parents=True)
    (other / "__init__.py").write_text("")
    code = 'from relocbench.methods import parse_method; parse_method("identity")'
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(other.parent), *sys.path])}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    assert f"package 'baselines' of another distribution is found first, in {other}; uninstall it" in done.stderr


def test_two_methods_of_one_label_are_refused() -> None:
    with refused(MethodError, "", None, "identity"):
        parse_methods(["identity", "identity"])


def test_a_setting_for_no_method_of_the_run_is_refused() -> None:
    with refused(MethodError, "", None, "dsx"):
        parse_methods(["identity"], ["dsx.points=3"])


@pytest.mark.thorough
@pytest.mark.parametrize(
    "method",
    [
        *("identity", "orb-pnp", f"{HERE}:Shift", f"{HERE}:Batched"),
        "sift-pnp",
        "dso",
    ],
)
def test_methods_that_keep_the_contract_pass_the_check(method: str) -> None:
    findings = check(parse_method(method))
    assert [f for f in findings if not f.passed] == []
    assert len(findings) >= 8


def test_every_breach_of_the_contract_is_found() -> None:
    for answer in range(7):
        findings = check(parse_method(f"{HERE}:WrongAnswers", [f"answer={answer}"]))
        assert all(not f.passed for f in findings if f.check.startswith("answers")), answer


@pytest.mark.thorough
def test_confidence_where_nothing_is_known_is_called_doubtful() -> None:
    doubtful = {f.check for f in check(parse_method(f"{HERE}:Certain")) if f.doubtful}
    assert doubtful == {
        "answers a query that shows nothing known",
        "answers a query of a different place",
        "answers a black query",
    }
    assert not any(f.doubtful for f in check(parse_method("orb-pnp")))


def test_a_parameter_has_the_words_of_the_docstring_of_its_class_or_a_base() -> None:
    words = {p.name: p.words for p in parameters_of("sift-pnp")}
    assert all(words.values())
    assert words["min_inliers"] == "with fewer inliers, tracking fails."


def test_an_author_is_told_the_line_of_their_own_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "singular_tracker.py").write_text(
        "import numpy as np\n\n\nclass Singular:\n"
        "    def track(self, reference, query, prior=None):\n        return inverse(np.zeros((2, 2)))\n\n\n"
        "def inverse(matrix):\n    return np.linalg.inv(matrix)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    told = next(f for f in check(parse_method("singular_tracker:Singular")) if f.check.startswith("answers"))
    assert f"LinAlgError: Singular matrix ({tmp_path / 'singular_tracker.py'}, line 10)" in told.detail


def test_a_method_with_a_memory_and_a_pen_is_found_out() -> None:
    failed = {f.check for f in check(parse_method(f"{HERE}:Forgetful")) if not f.passed}
    assert "gives the same answer in any order of calls" in failed
    assert "leaves the images it is given unchanged" in failed
