"""``relocbench fetch-weights``: the files that a method needs and its authors publish."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from relocbench.cli.options import Json, Quiet, Settings

if TYPE_CHECKING:
    from relocbench.weights import PublishedFile


def fetch_weights(
    name: Annotated[
        str, typer.Argument(metavar="METHOD", help="The method: an installed name or package.module:Class.")
    ],
    settings: Settings = [],  # noqa: B006
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Fetch without asking.")] = False,
    unverified: Annotated[
        bool, typer.Option("--unverified", help="Fetch files whose SHA-256 is unknown too: nothing is compared.")
    ] = False,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Fetch the weights that a method needs, from those who publish them, to where the method looks for them.

    What is fetched, under which licence, and where it goes is shown first, and asked about. Files that are there
    already are never replaced. A file with another SHA-256 than the expected one is not kept, and one whose SHA-256
    is unknown is not fetched without --unverified. No other command downloads anything.

    Example: relocbench fetch-weights disk-lightglue-pnp
    """
    from relocbench.cli.console import print_json, reporter
    from relocbench.errors import MethodError
    from relocbench.methods import kind_of, parse_method
    from relocbench.methods.fetching import check_fetched, fetch, published_files

    files = published_files(parse_method(name, settings, kind=kind_of(name)))
    missing = {}
    for path, file in files.items():
        if path.exists() or path.is_symlink():
            check_fetched(path, file)
            typer.echo(f"{path}: is there already", err=json)
        else:
            missing[path] = file
    for path, file in missing.items():
        typer.echo(_shown(path, file), err=json)
    unknown = [file.name for file in missing.values() if file.sha256 is None]
    if unknown and not unverified:
        raise MethodError(
            f"nothing was fetched: no SHA-256 to verify {', '.join(unknown)} with (--unverified fetches without one)"
        )
    if missing and not yes and not _confirmed(len(missing), err=json):
        raise MethodError("nothing was fetched: not confirmed (--yes fetches without asking)")
    fetched = {}
    for path, file in missing.items():
        fetched[str(path)] = digest = fetch(file, path, reporter(quiet))
        standing = "as expected" if file.sha256 else "not verified"
        typer.echo(f"{path}: fetched; its SHA-256 is {digest} ({standing})", err=json)
    if json:
        counts = {"files_written": len(fetched), "skipped": len(files) - len(fetched)}
        print_json({"files": [str(path) for path in files], "fetched": fetched}, counts)


def _shown(path: Path, file: PublishedFile) -> str:
    size = "size unknown" if file.size_bytes is None else f"{file.size_bytes / 1e6:.1f} MB"
    return "\n".join(
        (
            f"{file.name} ({size})",
            f"  from       {file.address}",
            f"  published  by {file.publisher}",
            f"  licence    {file.licence}",
            f"  SHA-256    {file.sha256 or 'unknown'}",
            f"  goes to    {path}",
        )
    )


def _confirmed(count: int, *, err: bool) -> bool:
    """Whether the user agrees; no answer, as at the end of the input, is none."""
    typer.echo(f"Fetch {'it' if count == 1 else f'these {count} files'}? [y/N] ", nl=False, err=err)
    try:
        return input().strip().lower() in ("y", "yes")
    except EOFError:
        typer.echo(err=err)
        return False
