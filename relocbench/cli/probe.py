"""``relocbench probe``: how far off a method may start."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from relocbench.cli.options import (
    AskingWorkers,
    Json,
    MemoryLimit,
    Methods,
    Quiet,
    Scheduler,
    SchedulerTlsCa,
    SchedulerTlsCert,
    SchedulerTlsKey,
    Settings,
    TimeLimit,
    scheduler_values,
)

if TYPE_CHECKING:
    from relocbench.evaluation.probe import ProbeReport


def probe(
    dataset: Annotated[Path | None, typer.Option("--dataset", "-d", help="Folder of the dataset.")] = None,
    method: Methods = [],  # noqa: B006  typer copies it
    settings: Settings = [],  # noqa: B006
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder for tables and pictures.")] = None,
    split: Annotated[str | None, typer.Option(help="Only the pair sets of this split.")] = None,
    pair_set: Annotated[list[str], typer.Option(help="Only this pair set. Repeat for several.")] = [],  # noqa: B006
    pixels: Annotated[
        bool | None, typer.Option("--pixels/--no-pixels", help="Single pixels, 0 to 16 px off [default: yes].")
    ] = None,
    poses: Annotated[
        bool | None,
        typer.Option("--poses/--no-poses", help="Whole poses, 0 to 8 m and 0 to 16 degrees off [default: yes]."),
    ] = None,
    pairs: Annotated[int | None, typer.Option(min=1, help="Pairs of each pair set at most [default: 50].")] = None,
    per_pair: Annotated[
        int | None, typer.Option(min=1, help="Pixels of a pair, each from every offset [default: 100].")
    ] = None,
    structured: Annotated[
        float | None,
        typer.Option(help="Only so large a share of a pair's pixels, those with most structure [default: 1, all]."),
    ] = None,
    directions: Annotated[int | None, typer.Option(min=1, help="Poses of a pair at each offset [default: 2].")] = None,
    feature_maps: Annotated[
        int | None,
        typer.Option(min=0, help="Draw the features of so many places, of methods that show them [default: 0]."),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of the starts, and of methods [default: 0].")] = None,
    config: Annotated[Path | None, typer.Option(help="YAML file with any of these options.")] = None,
    time_limit: TimeLimit = None,
    memory_limit: MemoryLimit = None,
    workers: AskingWorkers = None,
    scheduler: Scheduler = None,
    scheduler_tls_ca: SchedulerTlsCa = None,
    scheduler_tls_cert: SchedulerTlsCert = None,
    scheduler_tls_key: SchedulerTlsKey = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Start methods known distances off the truth: from how far do they still come back?

    The first method is what the others are compared with. A killed run goes on where it stopped.

    Example: relocbench probe -d D -m dso -m gn-net --out probe
    """
    from relocbench.cli.configuration import merged
    from relocbench.cli.console import print_json, reporter
    from relocbench.evaluation.probe import ProbeOptions, probe_methods
    from relocbench.files import alone_writing_to

    given: dict[str, Any] = {
        "dataset": dataset,
        "methods": method or None,
        "set": settings or None,
        "out": out,
        "split": split,
        "pair_sets": pair_set or None,
        "pixels": pixels,
        "poses": poses,
        "pairs": pairs,
        "per_pair": per_pair,
        "structured": structured,
        "directions": directions,
        "feature_maps": feature_maps,
        "seed": seed,
        "time_limit": time_limit,
        "memory_limit": memory_limit,
        "workers": workers,
        "scheduler": scheduler_values(scheduler, scheduler_tls_ca, scheduler_tls_cert, scheduler_tls_key),
    }
    options = merged(ProbeOptions, config, {k: v for k, v in given.items() if v is not None})
    with alone_writing_to(options.out):
        report = probe_methods(options, reporter(quiet))
    if json:
        print_json(report.to_dict())
    elif not quiet:
        _print_radii(report)
        for label, message in report.broken:
            typer.echo(f"{label}: {message}", err=True)
        typer.echo(f"the whole of it: {', '.join(map(str, report.files))}", err=True)


def _print_radii(report: ProbeReport) -> None:
    from relocbench.cli.console import print_table
    from relocbench.evaluation.probe.tally import UNITS
    from relocbench.evaluation.probe.write import radius_text

    main = [line for line in report.lines if line.radius is not None and line.level is None]
    for what in dict.fromkeys(line.what for line in main):
        here = [line for line in main if line.what == what]
        methods = list(dict.fromkeys(line.method for line in here))
        by = {(line.conditions, line.method): line for line in here}
        rows = [
            [c, *(radius_text(by[c, m].radius) if (c, m) in by else "" for m in methods)]
            for c in dict.fromkeys(line.conditions for line in here)
        ]
        title = f"{what}: half of the starts succeed up to ({UNITS[what]}), by {here[0].criterion}"
        print_table(title, ["conditions", *methods], rows)
