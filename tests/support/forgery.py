"""What a forger of results does: change files, and make all that can be computed without the truth fit again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from relocbench.evaluation.common.results import MethodResults
from relocbench.evaluation.tables.errors import ErrorTable, PairErrors, read_errors, write_errors
from relocbench.evaluation.tracking.score import groups_of, predictions_hash, summarize_rows
from relocbench.files import dump_yaml, load_yaml_values, sha256_file, write_text


def change_yaml(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Apply ``change`` to the mapping in a YAML file."""
    values, _ = load_yaml_values(path, "a record")
    change(values)
    write_text(path, dump_yaml(values))


def reseal(folder: MethodResults) -> None:
    """Compute the digests in ``scores.yaml`` again from the files as they are."""

    def digests(scores: dict[str, Any]) -> None:
        scores["run"] = sha256_file(folder.run_yaml)
        for name in scores["predictions"]:
            scores["predictions"][name] = predictions_hash(folder, name)
            scores["errors"][name] = sha256_file(folder.errors(name))
        for name in scores["matching_tables"]:
            scores["matching_tables"][name] = sha256_file(folder.matching(name))

    change_yaml(folder.scores_yaml, digests)


def forge_errors(folder: MethodResults, pair_set: str, change: Callable[[PairErrors], PairErrors]) -> None:
    """Change the rows of a table of errors, and nothing else."""
    rows = [change(row) for row in read_errors(folder.errors(pair_set))]
    write_errors(folder.errors(pair_set), rows)


def forge_summary(folder: MethodResults, pair_set: str) -> None:
    """Make ``scores.yaml`` summarise the table of errors as it is, and leave its digests as they were."""
    rows: ErrorTable = read_errors(folder.errors(pair_set))
    summary = {group: summarize_rows(rows, group).to_dict() for group in groups_of(rows)}
    change_yaml(folder.scores_yaml, lambda scores: scores["pair_sets"].update({pair_set: summary}))
