"""Methods of an evaluation, none of which is told where the dataset lies that it is asked about."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from relocbench.datasets.core.dataset import Dataset
from relocbench.errors import MethodError
from relocbench.methods import TRACKERS, MethodKind, MethodSpec, parse_methods


def blind_methods(
    dataset: Dataset, texts: Sequence[str], settings: Sequence[str], seed: int, kind: MethodKind = TRACKERS
) -> list[MethodSpec]:
    """The methods that a user names, with their parameters.

    Raises:
        MethodError: as :func:`~relocbench.methods.parse_methods`; also a parameter that names the dataset.
    """
    specs = parse_methods(texts, settings, seed, kind)
    root = dataset.root.resolve()
    for spec in specs:
        for name, value in spec.parameters.items():
            if isinstance(value, str | Path) and _lies_in(str(value), root):
                raise MethodError(
                    f"{kind.noun} '{spec.label}': parameter '{name}' names a file or folder of the dataset that is "
                    "asked about, which holds the truth"
                )
    return specs


def _lies_in(text: str, root: Path) -> bool:
    if not text or len(text) > 4096 or "\0" in text:
        return False
    try:
        path = Path(text).resolve()
    except (OSError, RuntimeError):
        return False
    return path.exists() and (path == root or root in path.parents)
