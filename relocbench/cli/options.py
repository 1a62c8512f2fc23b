"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress bars, no notes.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of tables.")]
Workers = Annotated[
    int | None, typer.Option("--workers", "-j", min=1, help="Local worker processes [default: one a core].")
]
AskingWorkers = Annotated[
    int | None,
    typer.Option(
        "--workers",
        "-j",
        min=0,
        help="Local worker processes [default: one a core]; 0 asks in this process, for a debugger, without limits.",
    ),
]
TimeLimit = Annotated[
    float | None,
    typer.Option(
        help="Seconds that a method may take for one pair or image; ten times as many to be constructed, to prepare a "
        "keyframe or gallery, and for its first call. A slower one is ended, and the pair has failed [default: 300].",
    ),
]
MemoryLimit = Annotated[
    str | None,
    typer.Option(
        metavar="SIZE",
        help="Memory that a worker process with its children may hold while a method works, such as 4GB. One that "
        "holds more is ended, and the pair has failed [default: no limit].",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS|FILE",
        help="Dask scheduler that work is sent to instead (extra 'cluster'): tcp://HOST:PORT, tls://HOST:PORT, or the "
        "JSON file of `dask scheduler --scheduler-file`.",
    ),
]
SchedulerTlsCa = Annotated[
    Path | None, typer.Option(help="For tls://: PEM file of the authority that signed the certificates.")
]
SchedulerTlsCert = Annotated[Path | None, typer.Option(help="For tls://: PEM file of this client's certificate.")]
SchedulerTlsKey = Annotated[
    Path | None, typer.Option(help="For tls://: PEM file of its private key, if it is a file of its own.")
]
DatasetPath = Annotated[Path, typer.Option("--dataset", "-d", help="Folder of the dataset.")]
Methods = Annotated[
    list[str],
    typer.Option(
        "--method",
        "-m",
        help="Installed name, package.module:Class, or 'subprocess:COMMAND'; with LABEL= in front to keep it under "
        "that label. Repeat for several.",
    ),
]
Settings = Annotated[
    list[str],
    typer.Option("--set", help="key=value for every method, or LABEL.key=value for one. Repeat for several."),
]


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

        raise ConfigError(f"--scheduler-{next(iter(given)).replace('_', '-')} means nothing without --scheduler")
    return None


def split_commas(values: list[str]) -> list[str]:
    """``["a,b", "c"]`` -> ``["a", "b", "c"]``."""
    return [part.strip() for value in values for part in value.split(",") if part.strip()]
