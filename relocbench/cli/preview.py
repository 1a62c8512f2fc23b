"""``relocbench preview``: one place of the procedural town in several conditions, on one sheet."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from relocbench.cli.options import Quiet, split_commas


def preview(
    out: Annotated[Path, typer.Option("--out", "-o", help="PNG to write.")],
    condition: Annotated[
        list[str], typer.Option("--condition", "-c", help="Named condition, such as Rain. Repeat for several.")
    ] = [],  # noqa: B006
    all_: Annotated[bool, typer.Option("--all", help="All named conditions.")] = False,
    sweep: Annotated[
        str | None, typer.Option(help="One factor alone from end to end, such as light or leaves.")
    ] = None,
    steps: Annotated[int, typer.Option(min=2, max=20, help="Pictures of a sweep.")] = 5,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the district.")] = 0,
    split: Annotated[str, typer.Option(help="Whose district: train, validation or test.")] = "test",
    at: Annotated[float, typer.Option(min=0, max=200, help="Metres along the drive.")] = 20.0,
    size: Annotated[int, typer.Option(min=64, max=2048, help="Width of each picture in pixels.")] = 400,
    quiet: Quiet = False,
) -> None:
    """Draw one place of the procedural town in several conditions: does the rain look like rain?

    Example: relocbench preview --all --out conditions.png
    """
    from relocbench.cli.console import reporter
    from relocbench.datasets.core.images import write_image
    from relocbench.datasets.synthetic.conditions.presets import SPLITS, previewed
    from relocbench.datasets.synthetic.jobs.contact_sheet import contact_sheet
    from relocbench.errors import ConfigError

    if split not in SPLITS:
        raise ConfigError(f"--split is one of {', '.join(SPLITS)}, got '{split}'")
    shown = previewed(split_commas(condition), everything=all_, swept=sweep, steps=steps)
    write_image(out, contact_sheet(shown, seed=seed, split=split, at_m=at, width=size, reporter=reporter(quiet)))
