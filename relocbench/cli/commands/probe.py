"""``relocbench probe``: how far off a method may start."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from relocbench.cli import options as common

if TYPE_CHECKING:
    from relocbench.evaluation.probe import ProbeReport


def probe(
    dataset: common.Dataset = None,
    methods: common.Methods = [],  # noqa: B006  typer copies it
    settings: common.Settings = [],  # noqa: B006
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="FOLDER", help="Folder for tables and pictures; required, here or in --config."
        ),
    ] = None,
    split: common.Split = None,
    pair_sets: common.PairSets = [],  # noqa: B006
    pixels: Annotated[
        bool | None,
        typer.Option("--pixels/--no-pixels", help="Whether single pixels start 0 to 16 px off [default: yes]."),
    ] = None,
    poses: Annotated[
        bool | None,
        typer.Option("--poses/--no-poses", help="Whether poses start 0 to 8 m and 0 to 16 degrees off [default: yes]."),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(
            metavar="offsets|identity",
            help="Where whole poses start: at known offsets from the truth, or at the keyframe's pose (identity), "
            "beside mirrored and random starts as far away [default: offsets].",
        ),
    ] = None,
    pairs: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Largest number of pairs of a pair set [default: 50].")
    ] = None,
    per_pair: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Most pixels of a pair, each started once [default: 600]."),
    ] = None,
    structured: Annotated[
        float | None,
        typer.Option(
            metavar="SHARE", help="Use only this share of a pair's pixels, those with most structure [default: 1, all]."
        ),
    ] = None,
    directions: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Start poses of a pair at each offset [default: 2].")
    ] = None,
    feature_maps: Annotated[
        int | None,
        typer.Option(
            min=0, metavar="N", help="Places whose features are drawn, for methods that show them [default: 0]."
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, metavar="N", help="Seed of the start poses and of methods [default: 0].")
    ] = None,
    config: common.ConfigFile = None,
    time_limit: common.TimeLimit = None,
    memory_limit: common.MemoryLimit = None,
    sandbox: common.Sandbox = None,
    workers: common.AskingWorkers = None,
    scheduler: common.Scheduler = None,
    scheduler_tls_ca: common.SchedulerTlsCa = None,
    scheduler_tls_cert: common.SchedulerTlsCert = None,
    scheduler_tls_key: common.SchedulerTlsKey = None,
    quiet: common.Quiet = False,
    json: common.Json = False,
) -> None:
    """Measure convergence by initial error: start methods at known distances and count which return.

    The others are compared with the first method. A killed run continues where it stopped.

    Example: relocbench probe -d D -m dso -m gn-net --out probe
    """
    chosen = common.chosen(locals())
    from relocbench.cli.configuration import merged
    from relocbench.cli.console import print_json, reporter
    from relocbench.evaluation.probe import ProbeOptions, probe_methods
    from relocbench.files import locked_output

    options = merged(ProbeOptions, config, chosen)
    with locked_output(options.out):
        report = probe_methods(options, reporter(quiet))
    if json:
        values = report.to_dict()
        counts = {"radii": len(values["radii"]), "starts": len(values["starts"]), "files_written": len(report.files)}
        print_json(values, {**counts, "broke": len(report.crashed)})
    else:
        _print_radii(report)
        _print_starts(report)
        for label, message in report.crashed:
            typer.echo(f"{label}: {message}", err=True)
        if not quiet:
            typer.echo(f"the whole of it: {', '.join(map(str, report.files))}", err=True)


def _print_starts(report: ProbeReport) -> None:
    from relocbench.cli.console import print_table
    from relocbench.evaluation.probe.starts import KINDS

    if report.starts:
        rows = [[s.conditions, s.method, *(f"{100 * s.shares[kind]:.1f}" for kind in KINDS)] for s in report.starts]
        title = f"share that converges from each start, %, by {report.starts[0].criterion}"
        print_table(title, ["conditions", "method", *KINDS], rows)


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
