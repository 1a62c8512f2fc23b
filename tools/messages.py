"""Write the catalogue of messages, ``tests/messages.txt``: ``python tools/messages.py``.

The catalogue has a line for each text that a user may read as an error: the module, and the text with which an error of
the family in ``relocbench.errors`` is made there, or a fault that becomes one. A field of an f-string is shown by the
name of its value. A text that is put together from a variable, or from the answer of a function of the same module, is
shown in each of its forms. A test compares the catalogue with the code, so that a better sentence is one changed line.
"""

from __future__ import annotations

import ast
import sys
from collections import defaultdict
from functools import cache
from pathlib import Path
from typing import cast

ROOT = Path(__file__).resolve().parent.parent
CATALOGUE = ROOT / "tests" / "messages.txt"
PACKAGES = ("relocbench", "baselines")
_FAMILY = {
    *("RelocbenchError", "DatasetError", "PredictionError", "MethodError", "ConfigError"),
    *("ContractFault", "FramingFault", "ProgramFault", "YamlFault", "Finding"),
    *("error", "fault"),
}
"""what makes an error of a text: classes, parameters that hold one of them, and methods"""
_OPTION = "OptionError"
"""its third argument is what was expected of an option"""
_SUGGESTS = ("available", "did_you_mean", "hint")
"""what names or folders are alike, and not the name itself"""
_DEPTH = 4
"""variables and functions that are followed from one text"""


def catalogue() -> list[str]:
    """The lines of the catalogue, sorted."""
    lines = set()
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            if "Error" in text or "ault" in text:
                module = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
                lines |= {f"{module}: {message}" for message in _Module(text).messages()}
    return sorted(lines)


class _Module:
    """What a module's names hold, as far as its own text says it."""

    def __init__(self, text: str) -> None:
        self.tree = ast.parse(text)
        self.functions: dict[str, ast.FunctionDef] = {}
        self.texts: list[tuple[ast.expr, ast.AST]] = []
        """the text of each error that is made, and the function or module around it"""
        self._look_below(self.tree, self.tree, validates=False)
        self._assigned = cache(_assigned)

    def messages(self) -> set[str]:
        forms = (form for text, around in self.texts for form in self._forms(text, around, _DEPTH))
        return {form for form in forms if _is_text(form)}

    def _look_below(self, node: ast.AST, around: ast.AST, *, validates: bool) -> None:
        if isinstance(node, ast.FunctionDef):
            self.functions[node.name] = around = node
            validates = any("validator" in ast.unparse(decorator) for decorator in node.decorator_list)
        elif isinstance(node, ast.Call):
            text = _message_of(node, validates)
            if text is not None:
                self.texts.append((text, around))
        for child in ast.iter_child_nodes(node):
            self._look_below(child, around, validates=validates)

    def _forms(self, text: ast.expr, around: ast.AST, depth: int) -> list[str]:
        """Each form that an expression for a text may take."""
        if isinstance(text, ast.Constant):
            return [text.value] if isinstance(text.value, str) else []
        if isinstance(text, ast.JoinedStr):
            return [
                "".join(str(part.value) if isinstance(part, ast.Constant) else _field(part) for part in text.values)
            ]
        if isinstance(text, ast.IfExp):
            return self._forms(text.body, around, depth) + self._forms(text.orelse, around, depth)
        if isinstance(text, ast.BoolOp):
            return [form for value in text.values for form in self._forms(value, around, depth)]
        if isinstance(text, ast.BinOp) and isinstance(text.op, ast.Add):
            left, right = (self._forms(side, around, depth) or [_field(side)] for side in (text.left, text.right))
            return [first + second for first in left for second in right]
        if isinstance(text, ast.Name) and depth:
            known = self._assigned(around).get(text.id) or self._assigned(self.tree).get(text.id, [])
            return [form for value in known for form in self._forms(value, around, depth - 1)]
        if isinstance(text, ast.Call) and isinstance(text.func, ast.Name) and depth:
            function = self.functions.get(text.func.id, ast.Pass())
            answers = [node.value for node in ast.walk(function) if isinstance(node, ast.Return)]
            return [form for value in answers if value for form in self._forms(value, function, depth - 1)]
        return []


def _message_of(call: ast.Call, validates: bool) -> ast.expr | None:
    """The text of an error that a call makes."""
    name = call.func.id if isinstance(call.func, ast.Name) else getattr(call.func, "attr", "")
    arguments = [*call.args, *(keyword.value for keyword in call.keywords if keyword.arg in ("expected", "message"))]
    if name == _OPTION and len(call.args) == 3:
        return call.args[2]
    if not arguments or not (name in _FAMILY or (validates and name == "ValueError")):
        return None
    # A method that makes an error of a place has the text last: ``part.fault(topic, received_ns, "is cut off")``.
    texts = [one for one in arguments if isinstance(one, ast.Constant | ast.JoinedStr | ast.BinOp | ast.IfExp)]
    texts = [one for one in texts if not (isinstance(one, ast.Constant) and not isinstance(one.value, str))]
    return texts[0] if texts else arguments[0]


def _assigned(around: ast.AST) -> dict[str, list[ast.expr]]:
    """The values that are assigned to each name in a function, or in a module outside of its functions."""
    found: dict[str, list[ast.expr]] = defaultdict(list)
    for node in ast.walk(around) if isinstance(around, ast.FunctionDef) else ast.iter_child_nodes(around):
        if isinstance(node, ast.NamedExpr):
            found[node.target.id].append(node.value)
        for target in node.targets if isinstance(node, ast.Assign) else ():
            value = cast(ast.Assign, node).value
            pairs = [(target, value)]
            if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
                pairs = list(zip(target.elts, value.elts, strict=False))
            for name, part in pairs:
                if isinstance(name, ast.Name):
                    found[name.id].append(part)
    return found


def _field(node: ast.AST) -> str:
    """A value in a text, by its name in braces."""
    if isinstance(node, ast.FormattedValue | ast.Subscript | ast.Starred):
        return _field(node.value)
    if isinstance(node, ast.Name):
        return f"{{{node.id}}}"
    if isinstance(node, ast.Attribute):
        return f"{{{node.attr}}}"
    if isinstance(node, ast.GeneratorExp | ast.ListComp):
        return _field(node.generators[0].iter)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
        if isinstance(node.func, ast.Name) and node.func.id in _SUGGESTS:
            return f"{{{node.func.id}}}"
        if isinstance(node.func, ast.Name) and node.func.id == "quoted":
            return f"'{_field(node.args[0])}'"
        if not node.args:
            return _field(node.func.value if isinstance(node.func, ast.Attribute) else node.func)
        inner = _field(node.args[0])
        return _field(node.func) if inner == "{}" else inner
    return "{}"


def _is_text(form: str) -> bool:
    """Whether a form has words beside its fields."""
    return " " in form.strip() or (form.isalpha() and len(form) > 3)


def main() -> int:
    lines = catalogue()
    CATALOGUE.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    print(f"{CATALOGUE.relative_to(ROOT)}: {len(lines)} messages", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
