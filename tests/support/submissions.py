"""Submissions for tests: ``from submissions import answer, filled_card, submit``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from forgery import change_yaml

from relocbench.arrays import Array
from relocbench.datasets.core.dataset import Dataset
from relocbench.datasets.core.pair_set import PairSet
from relocbench.datasets.core.pairfile import Pair, PoseLine, write_pose_lines
from relocbench.datasets.core.salt import Salt
from relocbench.evaluation.submission.card import TEMPLATE
from relocbench.evaluation.tracking.blind_export import export_blind
from relocbench.evaluation.tracking.blind_keys import BlindKeys
from relocbench.files import dump_yaml, parse_yaml
from relocbench.geometry import make_transform, so3_exp
from relocbench.progress import Silent

Pose = Callable[[Pair], Array]
SALT_TEXT = "5f1c0e8b47a2d963" * 4


def salt_file(folder: Path, text: str = SALT_TEXT) -> Path:
    """A salt file that its owner alone can read."""
    path = folder / f"{text[:4]}.salt"
    path.touch(mode=0o600)
    path.write_text(f"{text}\n")
    return path


def salt(text: str = SALT_TEXT) -> Salt:
    """The salt of a file with this text."""
    return Salt(Path(f"{text[:4]}.salt"), text.encode())


def blind_export(dataset: Dataset, out: Path, edition: int = 1) -> Dataset:
    """The blind export of a dataset with :func:`salt`."""
    return export_blind(BlindKeys(dataset, salt(), edition), out, Silent())


def filled_card(dataset: Dataset, **changes: Any) -> dict[str, Any]:
    """The template, filled in for one dataset."""
    card = parse_yaml(TEMPLATE.replace("FILL IN: https://...", "https://example.org/code").replace("FILL IN: ", "my "))
    card["weights"]["splits_seen"] = []
    card["datasets"] = {dataset.name: {"fingerprint": dataset.fingerprint, "asked_once": True}}
    return {**card, **changes}


def guess(pair: Pair) -> Array:
    """A pose that is another one for each pair, and no copy of the truth."""
    number = (pair.ref_timestamp_ns * 7 + pair.query_timestamp_ns) % 13
    return make_transform(so3_exp([0.0, 0.01 * number, 0.0]), [0.3, 0.0, -0.1 * number])


def answer(folder: Path, pair_set: PairSet, pose: Pose = guess, **columns: Callable[[Pair], object]) -> Path:
    """Write ``PAIRSET.txt`` and, where columns are given, ``PAIRSET.csv`` to a folder; returns the former."""
    path = folder / f"{pair_set.name}.txt"
    write_pose_lines(path, [PoseLine(*pair.key, pose(pair)) for pair in pair_set.evaluated])
    if columns:
        rows = [["ref_timestamp_ns", "query_timestamp_ns", *columns]]
        rows += [[*map(str, pair.key), *(str(of(pair)) for of in columns.values())] for pair in pair_set.evaluated]
        path.with_suffix(".csv").write_text("".join(",".join(row) + "\n" for row in rows))
    return path


def submit(
    root: Path,
    dataset: Dataset,
    pose: Pose = guess,
    confidence: Callable[[Pair], float] = lambda pair: pair.ref_timestamp_ns % 7,
    **changes: Any,
) -> Path:
    """Write a submission of answers to all pair sets of a dataset, or of its blind export; returns its folder."""
    root.mkdir(parents=True, exist_ok=True)
    (root / "card.yaml").write_text(dump_yaml(filled_card(dataset, **changes)))
    for pair_set in dataset.pair_sets():
        answer(root / dataset.name, pair_set, pose, seconds=lambda pair: 0.1, confidence=confidence)
    return root


def change_card(root: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change the card of a submission."""
    change_yaml(root / "card.yaml", change)
