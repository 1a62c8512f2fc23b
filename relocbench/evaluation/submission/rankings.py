"""Reading submitted lists of images: every fault with its line, and what is there in numbers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from relocbench.datasets.checks.faults import Findings
from relocbench.errors import PredictionError, quoted
from relocbench.evaluation.submission.contract import UnitAnswers
from relocbench.evaluation.submission.resolving import ResolvedRetrievalSet
from relocbench.files import lines_of, read_text
from relocbench.retrieval import RetrievalTask

_LINE_BYTES, _SPARE_BYTES = 512, 2**16
_REAL = ": this is a real name, and the card names a blind export, whose keys are expected"
MOST_IMAGES = 10_000
"""of one query's list"""


@dataclass
class TaskLists(UnitAnswers):
    """What was submitted for a retrieval task."""

    task: RetrievalTask
    lists: dict[str, list[str]] = field(default_factory=dict)
    """retrieved images of each answered query, best first, by their names in the set"""

    @property
    def name(self) -> str:
        return self.task.name

    @property
    def asked(self) -> int:
        return len(self.task.queries)

    @property
    def answered(self) -> int:
        return len(self.lists)

    def oddities(self) -> Iterator[str]:
        lists = list(self.lists.values())
        if lists:
            yield "no answer has seconds"
        if len(lists) > 1 and all(one == lists[0] for one in lists):
            yield "all queries have one list"


def read_ranked(path: Path, task: RetrievalTask, resolved: ResolvedRetrievalSet, findings: Findings) -> TaskLists:
    """Read ``TASK.txt``, a line ``query db`` for each retrieved image; keys of a blind export become names again."""
    out = TaskLists(task, given=True)
    queries, gallery = resolved.queries(task), resolved.gallery(task)
    names = {image.key for image in (*task.queries, *task.gallery)} if resolved.blind is not None else set()
    most = _SPARE_BYTES + _LINE_BYTES * len(queries) * min(len(gallery), MOST_IMAGES)
    with findings.catching():
        text = read_text(path, "retrieved images, a line 'query db' each", PredictionError, most)
        seen: set[tuple[str, str]] = set()
        for number, line in enumerate(lines_of(text), start=1):
            words = line.split()
            if not words or line.startswith("#"):
                continue
            if len(words) != 2:
                out.invalid += 1
                findings.fault(f"expected 'query db', found {len(words)} words", path, number)
                continue
            query, image = words
            if query not in queries:
                out.unknown += 1
                message = f"unknown query {quoted(query)}; queries are such as '{next(iter(queries))}'"
                findings.fault(message + (_REAL if query in names else ""), path, number)
            elif image not in gallery:
                out.unknown += 1
                message = (
                    f"image {quoted(image)} is not in the gallery, whose images are such as '{next(iter(gallery))}'"
                )
                findings.fault(message + (_REAL if image in names else ""), path, number)
            elif (query, image) in seen:
                out.duplicate += 1
                findings.fault(f"image {quoted(image)} occurs again for the query {quoted(query)}", path, number)
            else:
                seen.add((query, image))
                out.lists.setdefault(queries[query], []).append(gallery[image])
    return out
