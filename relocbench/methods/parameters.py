"""The parameters of a method: names, types and defaults by its constructor, and words by its docstrings."""

from __future__ import annotations

import inspect
import re
from contextlib import suppress
from dataclasses import dataclass, is_dataclass
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

_ARGUMENT = re.compile(r" {4}(\w+(?:, \w+)*): *(.*)")
"""a line that begins to describe arguments"""


@dataclass(frozen=True)
class Parameter:
    """A keyword argument of a method's constructor."""

    name: str
    annotation: Any
    default: Any
    """``inspect.Parameter.empty`` if it is required"""
    words: str = ""
    """what it is, from the section ``Args:`` of the docstring; empty where that says nothing"""

    @property
    def required(self) -> bool:
        return self.default is inspect.Parameter.empty

    @property
    def type_name(self) -> str:
        """What values it takes, as ``float`` or ``'dso' | 'lm-reloc' | None``."""
        return _type_name(self.annotation)


def _type_name(annotation: Any) -> str:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _type_name(arguments[0])
    if origin in (Union, UnionType):
        return " | ".join(map(_type_name, arguments))
    if origin is Literal:
        return " | ".join(map(repr, arguments))
    if origin is not None and arguments:
        inside = ("..." if each is Ellipsis else _type_name(each) for each in arguments)
        return f"{inspect.formatannotation(origin)}[{', '.join(inside)}]"
    return "None" if annotation is type(None) else inspect.formatannotation(annotation).replace("typing.", "")


def parameters_of_factory(factory: Any) -> list[Parameter]:
    """The parameters of a class or of a function that makes a method, in the order in which it has them."""
    signature = inspect.signature(factory)
    function = factory.__init__ if inspect.isclass(factory) else factory
    hints: dict[str, Any] = {}
    # The constructor that a dataclass has names types as the modules of its bases know them, each its own.
    for source in (factory, function) if is_dataclass(factory) else (function,):
        with suppress(NameError, TypeError):
            hints |= get_type_hints(source, include_extras=True)
    words = _argument_words(factory)
    out = []
    for p in signature.parameters.values():
        if p.kind in (p.VAR_POSITIONAL, p.VAR_KEYWORD):
            continue
        out.append(Parameter(p.name, hints.get(p.name, Any), p.default, words.get(p.name, "")))
    return out


def _argument_words(factory: Any) -> dict[str, str]:
    """What docstrings say of each argument below ``Args:``: those of the function, or of a class and its bases."""
    bases = inspect.getmro(factory) if inspect.isclass(factory) else ()
    documented = [part for base in bases for part in (vars(base).get("__init__"), base)] or [factory]
    out: dict[str, str] = {}
    for part in documented:
        lines = inspect.cleandoc(getattr(part, "__doc__", None) or "").split("\n")
        below = lines[lines.index("Args:") + 1 :] if "Args:" in lines else []
        names: list[str] = []
        for line in below:
            if line.strip() and not line.startswith(" "):
                break
            named = _ARGUMENT.match(line)
            if named is not None:
                names = [name for name in named[1].split(", ") if name not in out]
            for name in names:
                out[name] = f"{out.get(name, '')} {named[2] if named else line.strip()}".strip()
    return out
