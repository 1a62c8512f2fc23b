r"""A strict reader of the LaTeX that leaderboards write: ``from latex_parser import check_latex``.

It knows the few commands and environments of such tables, and fails an assertion on any other, on braces or
environments that do not close, on a special character that is not escaped, and on rows of unequal length.
"""

from __future__ import annotations

import re

_COMMANDS = {
    *("begin", "end", "centering", "caption", "label", "resizebox", "ifdim", "width", "linewidth", "else", "fi"),
    *("toprule", "midrule", "bottomrule", "textbf", "textit", "scriptsize", "uparrow", "downarrow", "infty"),
    *("textbackslash", "textasciicircum", "textasciitilde", "textless", "textgreater", "textbar", "textquotedbl"),
    *("textdegree", "textdagger", "textrightarrow", "texttimes", "textpm", "textendash"),
}
_SYMBOLS = set("\\{}$&#%_,")
_TOKEN = re.compile(r"\\([A-Za-z]+|.)|(.)", re.DOTALL)


def check_latex(text: str) -> list[list[list[str]]]:
    """The tables, their rows (the heading first) and the cells of these, as they are written."""
    body = "\n".join(line for line in text.split("\n") if not line.startswith("%"))
    _check_tokens(body)
    tables = re.findall(r"\\begin\{tabular\}\{([lr]+)\}\n(.*?)\\end\{tabular\}", body, re.DOTALL)
    assert len(tables) == body.count(r"\begin{table}") == body.count(r"\caption{") == body.count(r"\label{")
    labels = re.findall(r"\\label\{([^}]*)\}", body)
    assert len(set(labels)) == len(labels)
    return [_rows(columns, inner) for columns, inner in tables]


def _check_tokens(body: str) -> None:
    depth, in_math, open_environments = 0, False, []
    for found in _TOKEN.finditer(body):
        command, character = found.groups()
        if command is not None:
            assert command in _COMMANDS or command in _SYMBOLS, f"unknown command \\{command}"
            name = re.match(r"\{(\w+)\}", body[found.end() :])
            if command == "begin":
                assert name is not None
                open_environments.append(name[1])
            elif command == "end":
                assert name is not None
                assert open_environments.pop() == name[1]
        elif character == "{":
            depth += 1
        elif character == "}":
            depth -= 1
            assert depth >= 0, "a brace that was never opened"
        elif character == "$":
            in_math = not in_math
        else:
            assert character not in "#_^~", f"{character} is not escaped"
            assert character != "%" or body[found.end()] == "\n", "a comment in the middle of a line"
            assert character != "&" or "tabular" in open_environments, "& outside a table"
    assert (depth, in_math, open_environments) == (0, False, [])


def _rows(columns: str, inner: str) -> list[list[str]]:
    lines = [line for line in inner.strip().split("\n") if line not in (r"\toprule", r"\midrule", r"\bottomrule")]
    rows = []
    for line in lines:
        assert line.endswith(r" \\"), line
        assert not line.startswith(("[", "*")), "would belong to the line break before it"
        rows.append([cell.strip() for cell in re.split(r"(?<!\\)&", line.removesuffix(r" \\"))])
    assert {len(row) for row in rows} == {len(columns)}
    return rows
