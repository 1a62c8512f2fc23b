"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args, get_origin

import typer

if TYPE_CHECKING:
    from relocbench.methods.discovery import MethodKind

_RUN = "Where and how work runs"


def split_commas(values: list[str]) -> list[str]:
    """``["a,b", "c"]`` -> ``["a", "b", "c"]``: an option that takes several names has them repeated or in one list."""
    return [part.strip() for value in values for part in value.split(",") if part.strip()]


def split_names(values: list[str]) -> list[str]:
    """The same for methods, where what has a colon, such as a command or a path, stays whole."""
    return [part for value in values for part in ([value] if ":" in value else split_commas([value]))]


def takes_several(annotation: Any) -> bool:
    """Whether an option that sets a value of this type takes several."""
    return any(get_origin(kind) is tuple for kind in (annotation, *get_args(annotation)))


Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print no progress bars and no notes, the results alone.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object, with counts, instead of tables.")]
ConfigFile = Annotated[Path | None, typer.Option(metavar="FILE", help="YAML file that sets any of these options.")]
Workers = Annotated[
    int | None,
    typer.Option(
        "--workers",
        "-j",
        metavar="N",
        min=1,
        help="Local worker processes [default: one a core].",
        rich_help_panel=_RUN,
    ),
]
AskingWorkers = Annotated[
    int | None,
    typer.Option(
        "--workers",
        "-j",
        metavar="N",
        min=0,
        help="Local worker processes [default: one a core]. With 0 methods run in this process without limits, for a "
        "debugger.",
        rich_help_panel=_RUN,
    ),
]
TimeLimit = Annotated[
    float | None,
    typer.Option(
        metavar="SECONDS",
        help="Time that a method may take for one pair or image; ten times as much to be constructed, to prepare a "
        "keyframe or gallery, and for its first call. A slower method is ended, and the pair has failed [default: "
        "300].",
        rich_help_panel=_RUN,
    ),
]
MemoryLimit = Annotated[
    str | None,
    typer.Option(
        metavar="SIZE",
        help="Memory that a worker process and its children may hold while a method works, such as 4GB. A method that "
        "holds more is ended, and the pair has failed [default: no limit].",
        rich_help_panel=_RUN,
    ),
]
OneCore = Annotated[
    bool | None,
    typer.Option(
        "--one-core",
        help="Run one pair at a time in processes that are bound to a single core, so that seconds compare (Linux).",
        rich_help_panel=_RUN,
    ),
]
Sandbox = Annotated[
    Literal["auto", "required", "none"] | None,
    typer.Option(
        metavar="WHICH",
        help="Whether a method runs where dataset, results and other processes are out of sight and only its own "
        "folders can be written to: where this system has a sandbox (auto), always (required) or never (none) "
        "[default: auto].",
        rich_help_panel=_RUN,
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS|FILE",
        help="Dask scheduler that gets the work instead of local processes (needs the extra 'cluster'): "
        "tcp://HOST:PORT, tls://HOST:PORT, or the JSON file of `dask scheduler --scheduler-file`.",
        rich_help_panel=_RUN,
    ),
]
SchedulerTlsCa = Annotated[
    Path | None,
    typer.Option(metavar="PEM", help="For tls://: the authority that signed the certificates.", rich_help_panel=_RUN),
]
SchedulerTlsCert = Annotated[
    Path | None, typer.Option(metavar="PEM", help="For tls://: this client's certificate.", rich_help_panel=_RUN)
]
SchedulerTlsKey = Annotated[
    Path | None,
    typer.Option(
        metavar="PEM", help="For tls://: its private key, if it is in a file of its own.", rich_help_panel=_RUN
    ),
]


def existing(ctx: typer.Context, path: Path | None) -> Path | None:
    """The folder of a dataset. Raises DatasetError for one that is missing before anything large is loaded."""
    if path is not None and not ctx.resilient_parsing and not path.exists():
        from relocbench.errors import DatasetError

        raise DatasetError("no such folder; expected a dataset", path)
    return path


DatasetPath = Annotated[Path, typer.Option("--dataset", "-d", metavar="FOLDER", help="The dataset.")]
Dataset = Annotated[
    Path | None,
    typer.Option(
        "--dataset", "-d", metavar="FOLDER", callback=existing, help="The dataset; required, here or in --config."
    ),
]
Results = Annotated[
    Path | None, typer.Option("--out", "-o", metavar="FOLDER", help="Where results are kept [default: results].")
]
Split = Annotated[str | None, typer.Option(metavar="NAME", help="Evaluate only the pair sets of this split.")]
PairSets = Annotated[
    list[str],
    typer.Option("--pair-set", metavar="NAME,...", callback=split_commas, help="Evaluate only these pair sets."),
]
Overwrite = Annotated[
    Literal["never", "failed", "always"] | None,
    typer.Option(
        metavar="WHICH",
        help="Answers to compute again: none (never), those that failed (failed), or all (always) [default: never].",
    ),
]
Seed = Annotated[int | None, typer.Option(min=0, metavar="N", help="Seed for methods that have one [default: 0].")]


def trackers(incomplete: str) -> list[str]:
    """The trackers that a shell offers for a word that was begun."""
    from relocbench.methods.discovery import TRACKERS

    return _offered(TRACKERS, incomplete)


def retrievers(incomplete: str) -> list[str]:
    """The retrievers that a shell offers for a word that was begun."""
    from relocbench.methods.discovery import RETRIEVERS

    return _offered(RETRIEVERS, incomplete)


def _offered(kind: MethodKind, incomplete: str) -> list[str]:
    """``LABEL=`` stays in front. Bash takes ``=`` for the end of a word: it completes no name behind a label."""
    from relocbench.errors import RelocbenchError
    from relocbench.methods.discovery import installed_methods

    label, equals, begun = incomplete.rpartition("=")
    try:
        names = installed_methods(kind)
    except RelocbenchError:  # a line that is being typed is no place for it
        return []
    return [f"{label}{equals}{name}" for name in names if name.startswith(begun)]


Methods = Annotated[
    list[str],
    typer.Option(
        "--method",
        "-m",
        metavar="NAME,...",
        autocompletion=trackers,
        callback=split_names,
        help="Installed names, package.module:Class, or 'subprocess:COMMAND'; write LABEL=NAME to keep its results "
        "under that label. Repeat it, or join installed names by commas.",
    ),
]
Settings = Annotated[
    list[str],
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Parameter of every method, or LABEL.KEY=VALUE for that of one. Repeat for several.",
    ),
]


def given(**options: object) -> dict[str, object]:
    """The options that the command line has: those that are neither None nor an empty list."""
    return {name: value for name, value in options.items() if value is not None and value != []}


def scheduler_values(
    address: str | None, tls_ca: Path | None, tls_cert: Path | None, tls_key: Path | None
) -> dict[str, object] | None:
    """What the options about a scheduler say together; None where none was given. Raises ConfigError."""
    files = {"tls_ca": tls_ca, "tls_cert": tls_cert, "tls_key": tls_key}
    given = {name: path for name, path in files.items() if path is not None}
    if address is not None:
        return {"address": address, **given}
    if given:
        from relocbench.errors import ConfigError

        raise ConfigError(f"--scheduler-{next(iter(given)).replace('_', '-')} has no effect without --scheduler")
    return None


_FIELDS = {"settings": "set", "retrievers": "retriever", "tasks": "pair_sets"}
"""arguments of commands that cannot be called as the fields of their options are"""


def chosen(arguments: Mapping[str, object]) -> dict[str, object]:
    """The options that the command line has, by the fields of the command's options.

    Args:
        arguments: all arguments of a command, as ``locals()`` has them at its beginning.
    """
    values = {_FIELDS.get(name, name): v for name, v in arguments.items() if name not in ("config", "quiet", "json")}
    parts: list[Any] = [
        values.pop(name, None) for name in ("scheduler", *(f"scheduler_tls_{part}" for part in ("ca", "cert", "key")))
    ]
    return given(**values, scheduler=scheduler_values(*parts))
