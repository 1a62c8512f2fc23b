"""Opening the retrieval set of a folder: drives, places in University-1652's layout, or a blind export of either."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from relocbench.datasets.cross_view import CrossViewSet, is_cross_view, open_cross_view
from relocbench.datasets.pairs.street_places import Positives, StreetPlaces
from relocbench.errors import ConfigError, DatasetError, available
from relocbench.evaluation.common.opening import check_outside, open_for_evaluation
from relocbench.evaluation.retrieval.blind_set import WITHHELD, is_blind_set, open_blind_set
from relocbench.evaluation.retrieval.run import check_task
from relocbench.metrics.retrieval.relevance import PLACE_RADIUS_M
from relocbench.progress import Reporter
from relocbench.retrieval import RetrievalTask


@dataclass(frozen=True)
class SetOptions:
    """The options that choose a set and its tasks; None for one that was not given."""

    split: str | None = None
    tasks: tuple[str, ...] = ()
    radius_m: float | None = None
    heading_deg: float | None = None
    positives: Positives | None = None
    by_condition: bool = False


@dataclass(frozen=True, eq=False)
class OpenedSet:
    """A :class:`~relocbench.retrieval.RetrievalSet` with all of its tasks, and those that are to be evaluated."""

    name: str
    fingerprint: str
    all_tasks: tuple[RetrievalTask, ...]
    chosen: tuple[RetrievalTask, ...]
    positives: str = ""
    splits: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    options: Mapping[str, float | str] = field(default_factory=dict)
    """command-line options that define this set"""
    content_id: str = ""
    """the same for copies whose images differ in last digits only"""
    source: StreetPlaces | CrossViewSet | None = None
    """what the tasks are of; None for a blind export, whose truth is withheld"""

    def tasks(self) -> tuple[RetrievalTask, ...]:
        return self.all_tasks


def open_set(folder: Path, out: Path, options: SetOptions, reporter: Reporter) -> OpenedSet:
    """Open the set in a folder, to be evaluated with results in another folder.

    Raises:
        DatasetError: the folder holds no set, or a bad one.
        ConfigError: an option that does not apply to the kind of set, no task is left, or ``out`` lies in the folder.
    """
    if is_blind_set(folder):
        return _blind(folder, out, options)
    if is_cross_view(folder):
        return _cross_view(folder, out, options, reporter)
    if not folder.is_dir():
        raise DatasetError("no such folder; expected a dataset", folder)
    if not (folder / "dataset.yaml").exists() and not (folder / "build.yaml").exists():
        raise DatasetError(
            "expected a dataset with dataset.yaml, or places in University-1652's layout "
            "(test/query_drone/PLACE/*.jpg, test/gallery_satellite/PLACE/*.jpg, ...)",
            folder,
        )
    return _street(folder, out, options, reporter)


def _street(folder: Path, out: Path, options: SetOptions, reporter: Reporter) -> OpenedSet:
    if options.by_condition:
        raise ConfigError("--by-condition splits the queries of a cross-view set; a drive has a single condition")
    dataset = open_for_evaluation(folder, out)
    dataset.require_images(dataset.pair_sets(), "retrievers have nothing to rank")
    if options.positives == "pairs" and options.radius_m is not None:
        raise ConfigError("--radius does not apply to --positives pairs")
    places = StreetPlaces(
        dataset,
        PLACE_RADIUS_M if options.radius_m is None else options.radius_m,
        options.heading_deg,
        options.positives or "radius",
    )
    wanted = [dataset.pair_set(name).name for name in options.tasks]
    across = [s.name for s in places.pair_sets]
    within = [s.name for s in dataset.pair_sets(options.split) if s.name not in across]
    if any(name not in across for name in wanted):
        raise ConfigError(f"pair set '{next(n for n in wanted if n not in across)}' is of one traversal", dataset.root)
    if within and not wanted:
        reporter.note(f"left out, since a query would find itself in its own traversal: {', '.join(within)}")
    of_split = [s.name for s in dataset.pair_sets(options.split) if s.name in across]
    names = [name for name in of_split if not wanted or name in wanted]
    if not names:
        raise ConfigError("no pair set of two traversals is left to evaluate", dataset.root)
    tasks = tuple(places.task(s) for s in places.pair_sets if s.name in names)
    for task in tasks:
        _tell_left_out(places, task, reporter)
    return _checked(
        OpenedSet(
            places.name,
            places.fingerprint,
            tasks,
            tasks,
            places.positives,
            places.splits,
            places.options,
            places.content_id,
            places,
        )
    )


def _tell_left_out(places: StreetPlaces, task: RetrievalTask, reporter: Reporter) -> None:
    pair_set = places.dataset.pair_set(task.name)
    times = places.dataset.traversal(pair_set.query).timestamps(pair_set.query_camera)
    if len(times) > len(task.queries):
        why = "are in no pair" if places.rule == "pairs" else "have no pose"
        reporter.note(
            f"{task.name}: {len(times) - len(task.queries)} of {len(times)} query images {why} and are left out"
        )


def _cross_view(folder: Path, out: Path, options: SetOptions, reporter: Reporter) -> OpenedSet:
    given = {
        "--split": options.split,
        "--radius": options.radius_m,
        "--heading": options.heading_deg,
        "--positives": options.positives,
    }
    for option, value in given.items():
        if value is not None:
            raise ConfigError(f"{option} is for the drives of a dataset; {folder} holds places with labels")
    check_outside(out, folder)
    places: CrossViewSet = open_cross_view(folder, reporter)
    tasks = tuple(places.tasks(by_condition=options.by_condition))
    chosen = _chosen(tasks, options, folder)
    opened = OpenedSet(places.name, places.fingerprint, tasks, chosen, places.positives, content_id=places.content_id)
    return _checked(replace(opened, source=places))


def _blind(folder: Path, out: Path, options: SetOptions) -> OpenedSet:
    given = {
        "--split": options.split,
        "--radius": options.radius_m,
        "--heading": options.heading_deg,
        "--positives": options.positives,
        "--by-condition": options.by_condition or None,
    }
    for option, value in given.items():
        if value is not None:
            raise ConfigError(f"{option} is for a dataset with its truth; {folder} is a blind export")
    check_outside(out, folder)
    file, tasks = open_blind_set(folder)
    return _checked(OpenedSet(file.name, file.fingerprint, tasks, _chosen(tasks, options, folder), WITHHELD))


def _chosen(tasks: Sequence[RetrievalTask], options: SetOptions, folder: Path) -> tuple[RetrievalTask, ...]:
    """The tasks that the options name, or all. Raises ConfigError for a name that is none."""
    known = [task.name for task in tasks]
    for name in options.tasks:
        if name not in known:
            raise ConfigError(f"no task '{name}'{available(name, known)}", folder)
    return tuple(task for task in tasks if not options.tasks or task.name in options.tasks)


def _checked(opened: OpenedSet) -> OpenedSet:
    for task in opened.chosen:
        check_task(task)
    return opened
