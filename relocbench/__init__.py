"""relocbench: relocalization tracking measured across weather, light and season.

The functions for notebooks are those of :mod:`relocbench.api`, which is imported when one of them is first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from relocbench.version import __version__

if TYPE_CHECKING:
    from relocbench.api import (
        PairView,
        evaluate,
        iterate_pairs,
        open_dataset,
        read_errors,
        read_leaderboard,
        retrievers,
        trackers,
    )

__all__ = [
    "PairView",
    "__version__",
    "evaluate",
    "iterate_pairs",
    "open_dataset",
    "read_errors",
    "read_leaderboard",
    "retrievers",
    "trackers",
]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    from relocbench import api

    return getattr(api, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
