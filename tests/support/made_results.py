"""Results folders of trackers that are written without running any method, and what is looked up in their boards."""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.pairfile import PoseLine, write_pose_lines
from relocbench.evaluation.common.results import DatasetRecord, MethodResults, PairSetRecord, RunRecord, ScoreRecord
from relocbench.evaluation.tables.answers import ANSWERS, Answer
from relocbench.evaluation.tables.errors import PairErrors, write_errors
from relocbench.evaluation.tracking.score import FORMULAS, groups_of, predictions_hash, summarize_rows
from relocbench.files import dump_yaml, sha256_file, write_text
from relocbench.leaderboard import Board, Row, Table, load_results, make_board

FINGERPRINT = hashlib.sha256(b"a dataset").hexdigest()
TITLE = f"town@{FINGERPRINT[:12]}"
WINTER, NIGHT, SAME = "summer__winter__cam0", "summer__night__cam0", "summer__summer__cam0"


@dataclass(frozen=True)
class Made:
    """What a method answers on one pair set: errors of each pair, inf where it fails."""

    translation_m: Sequence[float] | Array
    rotation_deg: Sequence[float] | Array
    broke: frozenset[int] = frozenset()
    seconds: float = 0.25


@dataclass
class MadeResults:
    """Writes a results folder as `relocbench evaluate` would."""

    root: Path
    pair_sets: Mapping[str, int]
    groups: tuple[str, ...] = ()
    sigma_m: float | None = 0.02
    rejected: int = 3
    splits: dict[str, tuple[str, ...]] = field(default_factory=dict)
    name: str = "town"
    overlaps: Sequence[float] = ()
    """of the pairs of every pair set; without, pairs have no tier"""

    @property
    def fingerprint(self) -> str:
        return FINGERPRINT if self.name == "town" else hashlib.sha256(self.name.encode()).hexdigest()

    @property
    def folder(self) -> Path:
        return self.root / f"{self.name}@{self.fingerprint[:12]}"

    def write_dataset(self) -> None:
        sets = {name: self._record(name, pairs) for name, pairs in self.pair_sets.items()}
        record = DatasetRecord(
            name=self.name, fingerprint=self.fingerprint, licence="CC-BY-4.0", splits=self.splits, pair_sets=sets
        )
        write_text(self.folder / "dataset.yaml", dump_yaml(record.model_dump(mode="json")))

    def add(self, label: str, answers: Mapping[str, Made], target: str = "", **run: Any) -> MethodResults:
        """A method with its predictions, errors and scores; pair sets that are not named stay without."""
        folder = MethodResults(self.folder / label)
        record = RunRecord(
            method=label,
            target=target or label,
            dataset=self.name,
            fingerprint=self.fingerprint,
            **{
                "seed": 0,
                "workers": 2,
                "isolated": True,
                "versions": {"relocbench": "0.1.0", "method": "relocbench 0.1.0"},
                "machine": {"cpu": "Test CPU", "cores": 2},
                "start": "2024-01-01T00:00:00+00:00",
            }
            | run,
        )
        write_text(folder.run_yaml, dump_yaml(record.model_dump(mode="json")))
        hashes, errors, scores = {}, {}, {}
        for name, made in answers.items():
            rows = [self._row(i, made) for i in range(self.pair_sets[name])]
            lines = [PoseLine(*r.key, np.eye(4)) for r in rows if r.status == "ok"]
            write_pose_lines(folder.predictions(name), lines)
            ANSWERS.write(folder.answers(name), [Answer(*r.key, r.status, r.seconds) for r in rows])
            write_errors(folder.errors(name), rows)
            hashes[name], errors[name] = predictions_hash(folder, name), sha256_file(folder.errors(name))
            scores[name] = {g: summarize_rows(rows, g).to_dict() for g in groups_of(rows)}
        score = ScoreRecord(
            relocbench="0.1.0",
            formulas=FORMULAS,
            fingerprint=self.fingerprint,
            run=sha256_file(folder.run_yaml),
            predictions=hashes,
            errors=errors,
            pair_sets=scores,
        )
        write_text(folder.scores_yaml, dump_yaml(score.model_dump(mode="json")))
        return folder

    def board(self, **options: Any) -> Board:
        return make_board(load_results(self.root), **options)

    def _record(self, name: str, pairs: int) -> PairSetRecord:
        reference, query, camera = name.split("__")
        return PairSetRecord(
            reference=reference,
            query=query,
            camera=camera,
            reference_condition="clear, summer",
            query_condition=query,
            pairs=pairs,
            rejected=self.rejected,
            has_truth=True,
            groups=self.groups,
            median_distance_m=0.84,
            median_angle_deg=1.5,
            median_sigma_translation_m=self.sigma_m,
            median_sigma_rotation_deg=None if self.sigma_m is None else 0.05,
        )

    def _row(self, i: int, made: Made) -> PairErrors:
        answered = bool(np.isfinite(made.translation_m[i]))
        return PairErrors(
            ref_timestamp_ns=1_600_000_000_000_000_000 + 100_000_000 * i,
            query_timestamp_ns=1_700_000_000_000_000_000 + 100_000_000 * i,
            group=self.groups[i % len(self.groups)] if self.groups else "",
            status="ok" if answered else "error" if i in made.broke else "failed",
            rotation_error_deg=float(made.rotation_deg[i]) if answered else np.inf,
            translation_error_m=float(made.translation_m[i]),
            mlad_translation_error_m=float(made.translation_m[i]),
            confidence=None,
            seconds=made.seconds,
            distance_m=0.8 + 0.1 * (i % 4),
            angle_deg=1.5,
            sigma_translation_m=self.sigma_m,
            sigma_rotation_deg=None if self.sigma_m is None else 0.05,
            **({"overlap": self.overlaps[i], "overlap_query": 1.0, "scale_change": 1.0} if self.overlaps else {}),
        )


def made(seed: int, pairs: int, metres: float, *, degrees: float | None = None, failing: float = 0.0) -> Made:
    """Errors about that large (Rayleigh), independent from pair to pair, with a share that fails."""
    rng = np.random.default_rng(seed)
    translation = rng.rayleigh(metres, pairs)
    rotation = rng.rayleigh(metres if degrees is None else degrees, pairs)
    translation[rng.random(pairs) < failing] = np.inf
    return Made(translation, rotation)


def table(board: Board, pair_set: str, group: str = "all") -> Table:
    return next(t for d in board.datasets for t in d.tables if (t.pair_set, t.group) == (pair_set, group))


def row(board: Board, pair_set: str, method: str, group: str = "all") -> Row:
    return next(r for r in table(board, pair_set, group).rows if r.method.label == method)


def read_csv(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def cells(page: str, heading: str, method: str) -> list[str]:
    """The cells of a method's first table row after a heading."""
    after = page[page.index(heading) :].splitlines()
    line = next(line for line in after if line.startswith("|") and f" {method} " in line)
    return [cell.strip() for cell in line.strip("|").split("|")]
