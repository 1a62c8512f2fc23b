"""``relocbench export``: predictions or ground truth in other people's formats."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Literal

import typer

from relocbench.cli.options import DatasetPath, Json, Quiet, split_commas

_TOP = 20


def export(
    dataset: DatasetPath,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="PATH", help="Folder to write; for mlad, the zip file.")],
    format: Annotated[
        Literal["tum", "kitti", "colmap", "kapture", "hloc", "mlad", "blind", "blind-images"],
        typer.Option(
            "--format",
            "-f",
            metavar="NAME",
            help="tum (TUM trajectory), kitti (KITTI poses), colmap (COLMAP text model), kapture (kapture "
            "folders mapping and query), hloc (named poses and pairs; with --retriever its lists), mlad (MLAD "
            "submission), blind (the dataset without truth, times and order, for somebody else's tracker) or "
            "blind-images (the images that retrievers are asked about, without names and order).",
        ),
    ],
    results: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Results folder that holds the predictions of --method or rankings of --retriever [default: results].",
        ),
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(
            "--method", "-m", metavar="LABEL", help="Method whose predictions are exported [default: the ground truth]."
        ),
    ] = None,
    retriever: Annotated[
        str | None,
        typer.Option(
            "--retriever",
            "-r",
            metavar="LABEL",
            help="With --format hloc: the retriever whose rankings are exported in place of poses.",
        ),
    ] = None,
    top: Annotated[
        int | None,
        typer.Option(metavar="K", min=1, help="Keyframes of each query in a retriever's list [default: 20]."),
    ] = None,
    pair_set: Annotated[
        list[str], typer.Option(metavar="NAME,...", callback=split_commas, help="Export only these pair sets.")
    ] = [],  # noqa: B006
    relocalization_files: Annotated[
        list[str],
        typer.Option(
            metavar="FILE,...",
            callback=split_commas,
            help="Pair files of a challenge: the MLAD zip gets their names and the order of their lines.",
        ),
    ] = [],  # noqa: B006
    edition: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            min=1,
            max=999_999_999,
            help="With --format blind and blind-images: exports of other editions have other keys for the same images "
            "[default: 1].",
        ),
    ] = None,
    radius: Annotated[
        float | None,
        typer.Option(
            metavar="METRES",
            min=0.0,
            help="With --format blind-images, of drives: distance within which an image is right, which the export "
            "does not tell and answers are scored by [default: 25].",
        ),
    ] = None,
    salt_file: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="With --format blind and blind-images: file with random text that only you have (openssl rand -hex "
            "32), which keys are drawn from and answers are read back with; that of a rendered dataset.",
        ),
    ] = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Write predictions, the ground truth, or rankings, as other tools read them; or the dataset, blind.

    Example: relocbench export -d D --method dso --format mlad --out submission.zip
    """
    from relocbench.cli.console import print_json, reporter
    from relocbench.datasets.core.dataset import Dataset
    from relocbench.errors import ConfigError
    from relocbench.evaluation.common.opening import check_outside
    from relocbench.evaluation.retrieval.exports import export_lists
    from relocbench.evaluation.tracking.exports import export_poses
    from relocbench.files import locked_output

    if results is not None and method is None and retriever is None:
        raise ConfigError("--results without --method or --retriever; name one, or leave --results out for the truth")
    results = results or Path("results")
    if retriever is None and top is not None:
        raise ConfigError("--top is the length of a retriever's lists; name the retriever: --retriever LABEL")
    if retriever is not None and (format != "hloc" or method is not None):
        raise ConfigError("--retriever exports lists of images for hloc: give --format hloc and no --method")
    if edition is not None and not format.startswith("blind"):
        raise ConfigError("--edition chooses the keys of a blind export; it goes with --format blind or blind-images")
    if radius is not None and format != "blind-images":
        raise ConfigError("--radius chooses a retrieval set; it goes with --format blind-images")
    if format == "blind" or format == "blind-images":
        if method is not None or pair_set or relocalization_files:
            raise ConfigError("a blind export holds all pair sets and no answers; --method and --pair-set do not apply")
        if salt_file is None:
            raise ConfigError("--salt-file must be given: the keys of a blind export are drawn from it")
        numbered = 1 if edition is None else edition
        if format == "blind":
            _export_pairs(dataset, out, salt_file, numbered, quiet=quiet, json=json)
        else:
            _export_images(dataset, out, salt_file, numbered, radius, quiet=quiet, json=json)
        return
    if salt_file is not None:
        raise ConfigError("--salt-file is what the keys of a blind export are drawn from; it goes with --format blind")
    opened = Dataset(dataset)
    check_outside(out, dataset)
    if retriever is not None:
        asked = [opened.pair_set(name).name for name in pair_set]
        with locked_output(out):
            lists = export_lists(opened, asked, out, results, retriever, _TOP if top is None else top)
        if json:
            counts = {"files_written": len(lists), "queries": sum(one.queries for one in lists)}
            files = [str(one.path) for one in lists]
            print_json({"files": files}, {**counts, "unanswered": sum(one.unanswered for one in lists)})
            return
        for one in lists:
            typer.echo(str(one.path))
            if one.unanswered:
                typer.echo(f"{one.path}: {one.unanswered} of {one.queries} queries have no line", err=True)
        return
    names = [opened.pair_set(name).name for name in pair_set] or opened.pair_set_names
    # The zip appears whole in one step: nothing is shared with whoever writes beside it.
    with nullcontext() if format == "mlad" else locked_output(out):
        challenge = [Path(file) for file in relocalization_files]
        written = export_poses(opened, names, format, out, results, method, challenge, reporter(quiet))
    if json:
        print_json({"files": [str(path) for path in written]}, {"files_written": len(written), "pair_sets": len(names)})
        return
    for path in written:
        typer.echo(str(path))


def _export_pairs(dataset: Path, out: Path, salt_file: Path, edition: int, *, quiet: bool, json: bool) -> None:
    from relocbench.cli.console import print_json, reporter
    from relocbench.cli.counts import of_dataset
    from relocbench.datasets.core.dataset import Dataset
    from relocbench.datasets.core.salt import read_salt
    from relocbench.evaluation.common.opening import check_outside
    from relocbench.evaluation.tracking.blind_export import export_blind
    from relocbench.evaluation.tracking.blind_keys import BlindKeys
    from relocbench.files import locked_output

    progress = reporter(quiet)
    keys = BlindKeys(Dataset(dataset), read_salt(salt_file, [dataset, out], progress), edition)
    check_outside(out, dataset)
    with locked_output(out):
        blind = export_blind(keys, out, progress)
    if json:
        print_json({"dataset": str(out), "name": blind.name, "fingerprint": blind.fingerprint}, of_dataset(blind))
    else:
        typer.echo(blind.name)


def _export_images(
    dataset: Path, out: Path, salt_file: Path, edition: int, radius: float | None, *, quiet: bool, json: bool
) -> None:
    from relocbench.cli.console import print_json, reporter
    from relocbench.datasets.core.salt import read_salt
    from relocbench.errors import ConfigError
    from relocbench.evaluation.retrieval.blind_export import BlindImages, export_blind_images
    from relocbench.evaluation.retrieval.opening import SetOptions, open_set
    from relocbench.files import locked_output

    if radius == 0:
        raise ConfigError("--radius is 0, expected metres")
    progress = reporter(quiet)
    asked = open_set(dataset, out, SetOptions(radius_m=radius), progress)
    keys = BlindImages(asked, read_salt(salt_file, [dataset, out], progress), edition)
    with locked_output(out):
        file = export_blind_images(keys, out, progress)
    if json:
        queries = sum(task.queries for task in file.tasks.values())
        print_json({"name": file.name, "fingerprint": file.fingerprint}, {"tasks": len(file.tasks), "queries": queries})
    else:
        typer.echo(file.name)
