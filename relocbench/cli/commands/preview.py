"""``relocbench preview``: one place of the procedural town in several conditions, on one sheet."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, get_args

import typer

from relocbench.cli.options import Json, Quiet, split_commas


def preview(
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="FILE", help="File to write: PNG, or JPEG if it ends in .jpg.")
    ],
    conditions: Annotated[
        list[str],
        typer.Option(
            "--conditions",
            metavar="NAME,...",
            callback=split_commas,
            help="Draw these conditions, such as Sunny,Rain.",
        ),
    ] = [],  # noqa: B006
    all_: Annotated[bool, typer.Option("--all", help="Draw all named conditions.")] = False,
    sweep: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Vary one factor over its whole range and keep all others, such as light or leaves."
        ),
    ] = None,
    sweep_steps: Annotated[int, typer.Option(min=2, max=20, metavar="N", help="Number of pictures of a sweep.")] = 5,
    drawn_cameras: Annotated[
        int,
        typer.Option(
            min=0, max=20, metavar="N", help="Show each condition by N drawn cameras too, as --imaging varied has them."
        ),
    ] = 0,
    drawn_views: Annotated[
        int,
        typer.Option(
            min=0,
            max=20,
            metavar="N",
            help="Show each condition in N drawn views too, as --views varied has them but for the size.",
        ),
    ] = 0,
    map_depths: Annotated[
        bool, typer.Option("--map-depths", help="Show one condition, and what each kind of --depth knows of it.")
    ] = False,
    seed: Annotated[
        int, typer.Option(min=0, metavar="N", help="Seed of the district and of drawn cameras and views.")
    ] = 0,
    split: Annotated[
        str, typer.Option(metavar="NAME", help="Split of the district: train, validation or test.")
    ] = "test",
    at: Annotated[float, typer.Option(min=0, max=200, metavar="METRES", help="Distance along the drive.")] = 20.0,
    size: Annotated[
        str, typer.Option(metavar="WIDTHxHEIGHT", help="Pixels of each picture; one number for both.")
    ] = "400x300",
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Draw one place of the procedural town in several conditions: does the rain look like rain?

    Example: relocbench preview --all --out conditions.png
    """
    from relocbench.cli.console import print_json, reporter
    from relocbench.datasets.core.build_options import plain_size, width_height
    from relocbench.datasets.core.images import jpeg_bytes, png_bytes
    from relocbench.datasets.synthetic.conditions.presets import SPLITS, previewed
    from relocbench.datasets.synthetic.jobs.contact_sheet import contact_sheet
    from relocbench.datasets.synthetic.jobs.depth_sheet import depth_sheet
    from relocbench.datasets.synthetic.map_depth.kinds import DepthKind
    from relocbench.errors import ConfigError, available, quoted
    from relocbench.files import atomic_write

    if split not in SPLITS:
        raise ConfigError(f"no --split {quoted(split)}{available(split, SPLITS)}")
    try:
        pixels = width_height(plain_size(size))
    except ValueError as bad:
        raise ConfigError(f"--size {quoted(size)}: {bad}") from None
    shown = previewed(conditions, everything=all_, swept=sweep, steps=sweep_steps, cameras=drawn_cameras, seed=seed)
    if map_depths and (len(shown) != 1 or drawn_views):
        told = f"{len(shown)} conditions" if len(shown) != 1 else f"--drawn-views {drawn_views}"
        raise ConfigError(f"--map-depths shows what maps know in one condition and one view, got {told}")
    with atomic_write(out, "wb") as stream:  # what cannot be written should not be found after rendering
        view: Any = {"seed": seed, "split": split, "at_m": at, "size": pixels, "reporter": reporter(quiet)}
        sheet = depth_sheet(*shown.values(), **view) if map_depths else contact_sheet(shown, **view, views=drawn_views)
        stream.write(jpeg_bytes(sheet) if out.suffix.lower() in (".jpg", ".jpeg") else png_bytes(sheet))
    if json:
        pictures = 1 + len(get_args(DepthKind)) if map_depths else len(shown) * (drawn_views + 1)
        print_json({"file": out}, {"pictures": pictures, "files_written": 1})
