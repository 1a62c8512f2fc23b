"""YAML that others wrote: the values of PyYAML's safe loader, or one line with file and line number; never a hang."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused

from relocbench.datasets.core.schema import TraversalFile
from relocbench.datasets.importers.robotcar.files import read_tags
from relocbench.errors import ConfigError, DatasetError, RelocbenchError
from relocbench.files import (
    YamlFault,
    YamlPlaces,
    dump_yaml,
    load_yaml,
    load_yaml_values,
    parse_yaml,
    parse_yaml_setting,
    yaml_line,
    yaml_text,
)
from relocbench.files.yaml_files import MAX_YAML_BYTES
from relocbench.methods.trainers import trainer_options

BOMB = "\n".join(f"k{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" if n else "k0: &a0 [lol]" for n in range(12))
MERGES = "\n".join(
    f"k{n}: &a{n} {{<<: [{', '.join([f'*a{n - 1}'] * 9)}]}}" if n else "k0: &a0 {x: 1}" for n in range(12)
)
LONG_CHAIN = "\n".join(f"k{n}: &a{n} [{f'*a{n - 1}' if n else ''}]" for n in range(200))
REFUSED: dict[str, tuple[str, tuple[str, ...], int | None]] = {
    "an alias bomb": (BOMB, ("100,000",), 6),
    "a bomb of merges": (MERGES, ("100,000",), 6),
    "a chain of aliases": (LONG_CHAIN, ("64",), None),
    "an alias to what it stands in": ("a: 1\nb: &b [*b]", ("b",), 2),
    "an alias of nothing": ("a: 1\nb: *nothing", (), 2),
    "an anchor twice": ("a: &x 1\nb: &x 2", ("x",), 2),
    "nested lists": ("a: 1\nb: " + "[" * 5000 + "]" * 5000, ("64",), 2),
    "nested lists that are not closed": ("[" * 200_000, ("64",), 1),
    "nested blocks": ("\n".join(" " * n + "a:" for n in range(2000)), ("64",), 65),
    "no such day": ("a: 1\nb: 2001-99-99", ("2001-99-99",), 2),
    "a binary number without digits": ("b: 0b_", ("0b_",), 1),
    "a number of 5,000 digits": ("b: " + "1" * 5000, ("5000",), 1),
    "a hexadecimal number of 5,000 digits": ("b: 0x" + "1" * 5000, (), 1),
    "a number over 64 bits": ("b: " + "9" * 20, ("64",), 1),
    "a word called a number": ("b: !!int x", ("x",), 1),
    "nothing called a number": ("b: !!int ''", (), 1),
    "a word called a float": ("b: !!float x", ("x",), 1),
    "a word called a truth value": ("b: !!bool x", ("x",), 1),
    "a word called a date": ("b: !!timestamp x", ("x",), 1),
    "binary data": ("a: 1\nb: !!binary aGk=", ("!!binary",), 2),
    "a set": ("b: !!set {a, b}", ("!!set",), 1),
    "a Python object": ("b: !!python/object/apply:os.system [true]", (), 1),
    "a tag of nobody": ("b: !mine 1", ("!mine",), 1),
    "a merge of a word": ("a: 1\n<<: word", (), 2),
    "a merge of a list of words": ("<<: [a, b]", (), 1),
    "a key twice": ("a: 1\nb: 2\na: 3", ("a",), 3),
    "a list as a key": ("? [a]\n: 1", (), 1),
    "a mapping as a key": ("{}: 1", (), 1),
    "a tab as indentation": ("a:\n\tb: 1", (), 2),
    "two documents": ("a: 1\n---\nb: 2", (), 2),
    "a NUL character": ("a: 1\nb: \0", ("NUL",), 2),
    "an escaped NUL character": ('a: 1\nb: "x\\0y"', ("NUL",), 2),
    "half of a surrogate pair": ('b: "\\ud800"', (), 1),
    "an escape character": ("a: 1\nb: \x1b[31m", ("U+001B",), 2),
    "an open quotation mark": ("a: 1\nb: 'x", (), None),
    "a list": ("- 1", (), None),
}


@pytest.mark.parametrize(("text", "names", "line"), REFUSED.values(), ids=REFUSED.keys())
def test_yaml_that_cannot_be_taken_is_one_line_with_its_place(
    text: str, names: tuple[str, ...], line: int | None, tmp_path: Path
) -> None:
    path = tmp_path / "thing.yaml"
    path.write_text(text)
    with refused(DatasetError, "thing.yaml", line, *names) as raised:
        load_yaml_values(path, "a thing", DatasetError)
    assert str(raised.value).isprintable()
    assert len(raised.value.expected) < 400


@pytest.mark.parametrize("data", ["a: 1".encode("utf-16"), b"a: \xff"], ids=["UTF-16", "Latin-1"])
def test_text_that_is_not_utf_8_is_refused(data: bytes, tmp_path: Path) -> None:
    (tmp_path / "thing.yaml").write_bytes(data)
    with refused(RelocbenchError, "", None, "UTF-8"):
        load_yaml_values(tmp_path / "thing.yaml", "a thing")


@pytest.mark.parametrize("key", ["1", "2.5", "null", "true", "2024-01-01"])
def test_a_key_that_is_no_name_is_refused_with_its_line(key: str, tmp_path: Path) -> None:
    (tmp_path / "thing.yaml").write_text(f"a: 1\n{key}: 2\n")
    with refused(RelocbenchError, "thing.yaml", 2, "a key is"):
        load_yaml_values(tmp_path / "thing.yaml", "a thing")


def test_a_file_over_the_limit_is_not_read_on(tmp_path: Path) -> None:
    path = tmp_path / "thing.yaml"
    with path.open("wb") as stream:
        stream.truncate(MAX_YAML_BYTES + 1)
    with refused(RelocbenchError, "", None, "16777217", "16777216"):
        load_yaml_values(path, "a thing")


def test_more_values_than_the_limit_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(yaml_text, "MAX_NODES", 100)
    assert len(parse_yaml("[" + "1," * 99 + "]")) == 99
    with refused(YamlFault, "", None, "100"):
        parse_yaml("[" + "1," * 100 + "]")


TAKEN = [
    "",
    "# nothing\n",
    "\ufeffa: 1".lstrip("\ufeff"),
    "a: 0x1f\nb: 0b101\nc: 017\nd: 1_000\ne: 190:20:30\nf: -0\ng: +12\nh: 08",
    "a: 1.5\nb: .5\nc: 1e3\nd: 1.0e+3\ne: 1_0.5\nf: 190:20:30.15\ng: -.inf\nh: 1.\ni: 0.1e-400",
    "a: yes\nb: Off\nc: ~\nd: null\ne: ''\nf:\ng: 'yes'\nh: !!str 12\ni: !!float 1\nj: !!int '7'",
    "a: 2001-12-14\nb: 2001-12-14t21:59:43.10-05:00\nc: '2001-12-14'",
    "base: &b {x: 1, y: 2}\nd: {<<: *b, y: 3}\ne:\n  y: 4\n  <<: [*b, {x: 9, z: 0}]",
    "a: &l [1, {b: c}]\nb: *l\nc: [*l, *l]",
    "a: |\n  text\n  more\nb: >\n  folded\n  too\nc: \"\\x41\\u00e9\\n\"\nd: 'it''s'",
    "3: a\ntrue: b\n2.5: c\n? d\n: e",
    "- - 1\n  - 2\n- {a: [], b: {}}\n-",
    "%YAML 1.1\n---\na: 1\n...\n",
    "Straße: größer\nπ: 😀",
]


@pytest.mark.parametrize("text", TAKEN)
@pytest.mark.parametrize("in_python", [False, True], ids=["libyaml", "Python"])
def test_values_are_those_of_the_safe_loader(text: str, in_python: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if in_python:
        monkeypatch.setattr(yaml_text, "_C_PARSER", None)
    got, wanted = parse_yaml(text), yaml.safe_load(text)
    assert repr(got) == repr(wanted)


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.dates() | st.text(max_size=8),
        lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner, max_size=4),
        max_leaves=12,
    )
)
@settings(max_examples=60, deadline=None)
def test_what_is_written_is_read_back_as_the_safe_loader_does(value: Any) -> None:
    text = dump_yaml(value)
    try:
        got = parse_yaml(text)
    except YamlFault:
        assert "\\0" in text or "\\u" in text or "\\x" in text  # no text that a file or a message could hold
        return
    assert repr(got) == repr(yaml.safe_load(text))


@given(st.text(alphabet="ab1:-[]{}&*!?<>|#'\"\\ \n\t.,%@0x_~=", max_size=40))
@settings(max_examples=200, deadline=None)
def test_any_text_is_a_value_or_a_fault(text: str) -> None:
    try:
        got = parse_yaml(text)
    except YamlFault:
        return
    # The library's parser in C and the one in Python differ in corners; where they agree, so does what is read here.
    known = {_by(loader, text) for loader in (yaml.SafeLoader, getattr(yaml, "CSafeLoader", yaml.SafeLoader))}
    if len(known) == 1 and None not in known:
        assert repr(got) in known


def _by(loader: Any, text: str) -> str | None:
    """What a loader of the library makes of a text, or None where it is no YAML to it."""
    try:
        return repr(yaml.load(text, loader))
    except (yaml.YAMLError, ValueError, TypeError):
        return None


def test_a_line_is_known_or_not_of_whatever_could_be_read() -> None:
    for text in ("a:\t1\n", "a: 1\n\t\nb: 2\n", "- a\n-\tb\n", "a: {b:\tc}\n"):
        try:
            parse_yaml(text)
        except YamlFault:
            continue
        YamlPlaces(text).line(("a",))


def test_a_fault_of_the_model_has_the_line_of_its_key(tmp_path: Path) -> None:
    path = tmp_path / "traversal.yaml"
    path.write_text("name: a\ncondition:\n  weather: rain\n  colour: red\ncameras: {}\n")
    with refused(DatasetError, "traversal.yaml", 4, "condition.colour"):
        load_yaml(path, TraversalFile, "a traversal", DatasetError)
    values, places = load_yaml_values(path, "a traversal")
    assert yaml_line(places, ("condition", "weather")) == 3
    assert list(values) == ["name", "condition", "cameras"]


def test_a_fault_of_the_model_does_not_quote_the_whole_file(tmp_path: Path) -> None:
    path = tmp_path / "traversal.yaml"
    path.write_text(f"name: {['x' * 50] * 1000}\ncameras: {{}}\n")
    with refused(DatasetError, "", None, "name") as raised:
        load_yaml(path, TraversalFile, "a traversal", DatasetError)
    assert len(raised.value.expected) < 500


@pytest.mark.parametrize(
    ("text", "value"), [("", ""), ("1", 1), ("[1, 2]", [1, 2]), ("[1", "[1"), ("@x", "@x"), ("a: b: c", "a: b: c")]
)
def test_a_setting_is_yaml_or_the_text_it_is(text: str, value: Any) -> None:
    assert parse_yaml_setting(text) == value


@pytest.mark.parametrize("text", ["2001-99-99", "0b_", "1" * 5000, "!!int x", "[" * 5000, "{<<: 1}"])
def test_a_setting_that_cannot_be_is_one_line(text: str) -> None:
    with pytest.raises(ConfigError, match="--set") as raised:
        trainer_options({"rate": 0.1}, None, [f"rate={text}"])
    assert len(str(raised.value)) < 700


def test_tags_of_a_drive_are_read_by_the_same_loader(tmp_path: Path) -> None:
    path = tmp_path / "tags.yaml"
    path.write_text("- sun\n- &a [*a]\n")
    with refused(DatasetError, "tags.yaml", 2):
        read_tags(path)
