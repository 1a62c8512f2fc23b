"""Finding third-party code by entry point or dotted path, and calling it with its faults reported in one line."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module, metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from relocbench.errors import MethodError, RelocbenchError, raised
from relocbench.execution import messages_to_stderr

OUR_METHODS = "baselines"
"""The package of the methods that come with relocbench, installed beside it."""


def entry_points_of(group: str, kind: str) -> dict[str, metadata.EntryPoint]:
    """The entry points of a group, sorted by name; nothing is imported.

    Args:
        kind: what the group provides, for messages.

    Raises:
        MethodError: two packages provide different things by the same name.
    """
    points: dict[str, metadata.EntryPoint] = {}
    for point in metadata.entry_points(group=group):
        if point.name in points and points[point.name].value != point.value:
            raise MethodError(
                f"{kind} '{point.name}' is provided twice ({points[point.name].value} and {point.value}); "
                "uninstall one, or name the class by its dotted path"
            )
        points[point.name] = point
    return dict(sorted(points.items()))


def load_dotted(target: str, kind: str) -> Any:
    """Import what ``package.module:Name`` names, also from a module in the current folder.

    Raises:
        MethodError: it cannot be imported, or there is no such name.
    """
    module_name, _, attribute = target.partition(":")
    # As with `python -m`, a class in the user's current folder is found without installing it.
    with suppress(FileNotFoundError):  # a method has removed it
        if "" not in sys.path and str(Path.cwd()) not in sys.path:
            sys.path.insert(0, str(Path.cwd()))
    loaded = call_third_party(f"{kind} '{target}' cannot be imported", lambda: _import(module_name, target, kind))
    for part in attribute.split("."):
        loaded = getattr(loaded, part, None)
    if loaded is None:
        raise MethodError(f"{kind} '{target}': module '{module_name}' has no '{attribute}'")
    return loaded


def _import(module_name: str, target: str, kind: str) -> Any:
    if module_name.partition(".")[0] == OUR_METHODS:
        _refuse_stranger(target, kind)
    try:
        return import_module(module_name)
    except ModuleNotFoundError as bad:
        raise MethodError(f"{kind} '{target}': no module '{bad.name}' (looked on the Python path and here)") from bad


def _refuse_stranger(target: str, kind: str) -> None:
    """Raises MethodError where the package ``baselines`` is that of another distribution, which has the same name."""
    spec = find_spec(OUR_METHODS)
    origin = None if spec is None else spec.origin
    installed_in = Path(__file__).resolve().parents[2]
    if origin is not None and Path(origin).resolve().parent.parent != installed_in:
        raise MethodError(
            f"{kind} '{target}': the package 'baselines' of another distribution is found first, in "
            f"{Path(origin).parent}; uninstall it, or use an environment of its own"
        )


def call_third_party(failed: str, call: Callable[[], Any]) -> Any:
    """Call third-party code. Raises MethodError with what it raised, and where."""
    try:
        with messages_to_stderr():
            return call()
    except (RelocbenchError, KeyboardInterrupt):
        raise
    except BaseException as bad:
        last = traceback.extract_tb(bad.__traceback__)[-1]
        place = "" if isinstance(bad, SyntaxError) else f" ({last.filename}, line {last.lineno})"
        raise MethodError(f"{failed}: {raised(bad)}{place}") from bad
