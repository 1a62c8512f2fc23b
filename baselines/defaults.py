"""Methods that differ from another one in the defaults of parameters alone."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

Method = TypeVar("Method")


def with_defaults(**values: Any) -> Callable[[type[Method]], type[Method]]:
    """A decorator of a class whose inherited constructor has other defaults.

    They stand in the signature, where the command line and ``run.yaml`` find them, and can be given other values as
    any parameter.

    Raises:
        TypeError: the constructor has no such keyword parameter.
    """

    def decorate(kind: type[Method]) -> type[Method]:
        inherited: Callable[..., None] = kind.__init__
        signature = inspect.signature(inherited)
        unknown = values.keys() - signature.parameters.keys()
        if unknown:
            raise TypeError(f"{kind.__name__} has no parameter {', '.join(sorted(unknown))}")

        @wraps(inherited)
        def __init__(*args: Any, **given: Any) -> None:
            inherited(**{**values, **signature.bind(*args, **given).arguments})

        parameters = [
            each.replace(default=values[name]) if name in values else each
            for name, each in signature.parameters.items()
        ]
        __init__.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        kind.__init__ = __init__  # type: ignore[method-assign]
        return kind

    return decorate
