"""YAML text as plain values, in one pass and at a bounded cost.

What PyYAML's ``SafeLoader`` makes of a text is made of it here, with these differences: depth, number of nodes, what
aliases stand for, and the length of numbers are limited; a key that occurs twice, a key that is no scalar and an alias
to what it stands in are refused; so are the tags of binary data, sets and ordered pairs. Whatever is wrong, the fault
has a line.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import date
from functools import cached_property
from typing import Any

import yaml

from relocbench.errors import quoted

MAX_DEPTH = 64
"""mappings and lists inside one another, those behind aliases included"""
MAX_NODES = 2_000_000
"""scalars, lists and mappings"""
MAX_ALIASED = 100_000
"""nodes that all aliases together stand for"""
MAX_SCALAR = 100
"""characters of a number, a date or a word such as true"""

Scalar = str | int | float | bool | date | None
_C_PARSER = getattr(getattr(yaml, "cyaml", None), "CParser", None)
"""libyaml's parser, ten times as fast as the one in Python; PyYAML is built without it on some machines"""
_SMALL = 65_536
"""characters: a fault in a text of so many is asked of the parser in Python, whose words are clearer"""
_TAG = "tag:yaml.org,2002:"
_NOT_YAML = re.compile("[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_NOT_TEXT = re.compile("[\0\ud800-\udc7f\udd00-\udfff]")
"""NUL and halves of surrogate pairs; not those that stand for the bytes of a file's name that is no UTF-8"""
_FLOAT = re.compile(r"-?[0-9]{1,25}\.[0-9]{1,25}(e[-+][0-9]{1,3})?")
_INTEGER = re.compile(r"-?(0|[1-9][0-9]{0,17})")


class YamlFault(ValueError):
    """What is wrong with a YAML text.

    Args:
        problem: in one line.
        line: 1-based.
        syntax: whether it is no YAML at all.
    """

    def __init__(self, problem: str, line: int | None = None, *, syntax: bool = False) -> None:
        super().__init__(problem)
        self.problem = problem
        self.line = line
        self.syntax = syntax


class YamlPlaces:
    """Where the parts of a text stand; the text is looked through again, once a line is asked for."""

    def __init__(self, text: str) -> None:
        self._text = text

    def line(self, location: tuple[str | int, ...]) -> int | None:
        """1-based line of the innermost part of a location, keys and indices from the outside in, that exists."""
        node, line = self._tree, None
        for part in location:
            if isinstance(node, yaml.MappingNode):
                found = [(k, v) for k, v in node.value if k.value == str(part)]
                if not found:
                    break
                key, node = found[0]
                line = key.start_mark.line + 1
            elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
                node = node.value[part]
                line = node.start_mark.line + 1
            else:
                break
        return line if line is not None else (node.start_mark.line + 1 if node else None)

    @cached_property
    def _tree(self) -> yaml.Node | None:
        loaders: list[Any] = [yaml.SafeLoader] if _C_PARSER is None else [yaml.SafeLoader, yaml.CSafeLoader]
        for loader in loaders if len(self._text) <= _SMALL else reversed(loaders):
            try:
                return yaml.compose(self._text, Loader=loader)
            except yaml.YAMLError:
                continue  # one parser takes what the other refuses, as a tab
        return None


def parse_yaml(text: str) -> Any:
    """The value of a text that holds one YAML document; None where it holds none.

    Raises:
        YamlFault: with the line.
    """
    strange = _NOT_YAML.search(text)
    if strange:
        line = text.count("\n", 0, strange.start()) + 1
        raise YamlFault(f"the character U+{ord(strange[0]):04X} is not allowed", line, syntax=True)
    try:
        return _read(text, _C_PARSER or _Parser)
    except YamlFault as bad:
        if not bad.syntax or _C_PARSER is None or len(text) > _SMALL:
            raise
    return _read(text, _Parser)


def parse_yaml_setting(text: str) -> Any:
    """The value of a setting ``key=value``: YAML, or where it is none, the text as it stands.

    Raises:
        YamlFault: YAML of a value that cannot be, as a date without such a day.
    """
    try:
        return parse_yaml(text) if text else ""
    except YamlFault as bad:
        if not bad.syntax:
            raise
        return text


class _Parser(yaml.reader.Reader, yaml.scanner.Scanner, yaml.parser.Parser):
    """The parser in Python."""

    def __init__(self, text: str) -> None:
        yaml.reader.Reader.__init__(self, text)
        yaml.scanner.Scanner.__init__(self)
        yaml.parser.Parser.__init__(self)


def _read(text: str, parser: Callable[[str], Any]) -> Any:
    try:
        return _Document(parser(text).get_event).value()
    except yaml.MarkedYAMLError as bad:
        line = bad.problem_mark.line + 1 if bad.problem_mark else None
        raise YamlFault(str(bad.problem), line, syntax=True) from None
    except yaml.YAMLError as bad:
        raise YamlFault(str(bad), syntax=True) from None


class _Document:
    """Makes values of a parser's events as they come."""

    def __init__(self, next_event: Callable[[], Any]) -> None:
        self._next = next_event
        self._nodes = 0
        self._aliased = 0
        self._height = 0
        """levels of the value that was made last; 0 for a scalar"""
        self._anchors: dict[str, tuple[Any, int, int] | None] = {}
        """value, nodes, height; None while it is being made"""

    def value(self) -> Any:
        self._next()
        event = self._next()
        if type(event) is yaml.StreamEndEvent:
            return None
        value = self._node(self._next(), 0)
        self._next()
        event = self._next()
        if type(event) is not yaml.StreamEndEvent:
            raise YamlFault("more than one document", _line(event))
        return value

    def _node(self, event: Any, depth: int) -> Any:
        self._nodes += 1
        if self._nodes > MAX_NODES:
            raise YamlFault(f"more than {MAX_NODES:,} values", _line(event))
        kind = type(event)
        if kind is yaml.ScalarEvent and event.anchor is None:
            self._height = 0
            return _scalar(event)
        if kind is yaml.AliasEvent:
            return self._alias(event, depth)
        anchor, before = event.anchor, self._nodes
        if anchor is not None:
            if anchor in self._anchors:
                raise YamlFault(f"the anchor {quoted(anchor)} occurs again", _line(event))
            self._anchors[anchor] = None
        value: Any
        if kind is yaml.ScalarEvent:
            self._height = 0
            value = _scalar(event)
        elif depth == MAX_DEPTH:
            raise YamlFault(f"nested more than {MAX_DEPTH} levels deep", _line(event))
        else:
            value = self._list(event, depth + 1) if kind is yaml.SequenceStartEvent else self._map(event, depth + 1)
        if anchor is not None:
            self._anchors[anchor] = value, self._nodes - before + 1, self._height
        return value

    def _alias(self, event: Any, depth: int) -> Any:
        if event.anchor not in self._anchors:
            raise YamlFault(f"found undefined alias {quoted(event.anchor)}", _line(event), syntax=True)
        known = self._anchors[event.anchor]
        if known is None:
            raise YamlFault(f"the alias {quoted(event.anchor)} is used inside its own definition", _line(event))
        value, nodes, self._height = known
        self._nodes += nodes - 1
        self._aliased += nodes
        if self._aliased > MAX_ALIASED:
            raise YamlFault(f"aliases expand to more than {MAX_ALIASED:,} values", _line(event))
        if depth + self._height > MAX_DEPTH:
            raise YamlFault(f"nested more than {MAX_DEPTH} levels deep", _line(event))
        return value

    def _list(self, event: Any, depth: int) -> list[Any]:
        _check_tag(event, "seq")
        found: list[Any] = []
        height = 0
        event = self._next()
        while type(event) is not yaml.SequenceEndEvent:
            found.append(self._node(event, depth))
            height = max(height, self._height)
            event = self._next()
        self._height = height + 1
        return found

    def _map(self, event: Any, depth: int) -> dict[Scalar, Any]:
        _check_tag(event, "map")
        found: dict[Scalar, Any] = {}
        merged: dict[Scalar, Any] | None = None
        height = 0
        event = self._next()
        while type(event) is not yaml.MappingEndEvent:
            if _is_merge(event):
                if merged is not None:
                    raise YamlFault("the key '<<' occurs again", _line(event))
                merged = _merged(self._node(self._next(), depth), event)
            else:
                key = self._key(event, depth, found)
                found[key] = self._node(self._next(), depth)
            height = max(height, self._height)
            event = self._next()
        self._height = height + 1
        return found if merged is None else merged | found

    def _key(self, event: Any, depth: int, found: dict[Scalar, Any]) -> Scalar:
        key: Any = self._node(event, depth)
        if isinstance(key, list | dict):
            raise YamlFault("a key is a list or a mapping, expected a word", _line(event))
        if key in found:
            raise YamlFault(f"the key {quoted(key)} occurs again", _line(event))
        scalar: Scalar = key
        return scalar


def _line(event: Any) -> int:
    return int(event.start_mark.line) + 1


def _check_tag(event: Any, kind: str) -> None:
    if event.tag not in (None, "!", _TAG + kind):
        raise YamlFault(f"the tag {_shown(event.tag)} is not allowed here", _line(event))


def _shown(tag: str) -> str:
    return quoted(tag.replace(_TAG, "!!"))


def _is_merge(event: Any) -> bool:
    return type(event) is yaml.ScalarEvent and (
        (event.value == "<<" and event.implicit[0] and event.tag in (None, "!")) or event.tag == _TAG + "merge"
    )


def _merged(value: Any, event: Any) -> dict[Scalar, Any]:
    """What ``<<`` brings: of several mappings the first that has a key says its value."""
    mappings = value if isinstance(value, list) else [value]
    if not all(isinstance(mapping, dict) for mapping in mappings):
        raise YamlFault("'<<' merges something other than mappings", _line(event))
    found: dict[Scalar, Any] = {}
    for mapping in reversed(mappings):
        found.update(mapping)
    return found


def _scalar(event: Any) -> Scalar:
    text: str = event.value
    if event.tag in (None, "!"):
        if not event.implicit[0]:
            return _text(text, event)
        if _FLOAT.fullmatch(text):
            return float(text)
        if _INTEGER.fullmatch(text):
            return int(text)
        for tag, pattern in _RESOLVERS.get(text[:1], ()):
            if pattern.match(text):
                return _typed(tag.removeprefix(_TAG), text, event)
        return _text(text, event)
    if not event.tag.startswith(_TAG):
        raise YamlFault(f"the tag {_shown(event.tag)} is not allowed here", _line(event))
    return _typed(event.tag.removeprefix(_TAG), text, event)


def _text(text: str, event: Any) -> str:
    if _NOT_TEXT.search(text):
        raise YamlFault("a text holds a NUL character or half of a surrogate pair", _line(event))
    return text


def _typed(kind: str, text: str, event: Any) -> Scalar:
    if kind in ("str", "value"):
        return _text(text, event)
    if kind not in _MAKERS:
        raise YamlFault(f"the tag {_shown(_TAG + kind)} is not allowed here", _line(event))
    what, make = _MAKERS[kind]
    if len(text) > MAX_SCALAR:
        raise YamlFault(f"{quoted(text, 30)} has {len(text)} characters, too many for {what}", _line(event))
    try:
        value: Scalar = make(yaml.ScalarNode(_TAG + kind, text))
    except (ValueError, LookupError, AttributeError, OverflowError) as bad:
        why = f" ({bad})" if kind == "timestamp" and isinstance(bad, ValueError) else ""
        raise YamlFault(f"{quoted(text)} is not {what}{why}", _line(event)) from None
    if isinstance(value, int) and not -(2**63) <= value < 2**64:
        raise YamlFault(f"{quoted(text)} does not fit 64 bits", _line(event))
    return value


_CONSTRUCTOR = yaml.constructor.SafeConstructor()
_MAKERS: dict[str, tuple[str, Callable[[yaml.ScalarNode], Any]]] = {
    "int": ("a whole number", _CONSTRUCTOR.construct_yaml_int),
    "float": ("a number", _CONSTRUCTOR.construct_yaml_float),
    "bool": ("true or false", _CONSTRUCTOR.construct_yaml_bool),
    "null": ("null", _CONSTRUCTOR.construct_yaml_null),
    "timestamp": ("a date", _CONSTRUCTOR.construct_yaml_timestamp),
}
_RESOLVERS: dict[str, list[tuple[str, re.Pattern[str]]]] = yaml.SafeLoader.yaml_implicit_resolvers
