"""``relocbench build-dataset KIND [SOURCE...] --out DIR``: one sub-command a kind, made from the importer's options."""

from __future__ import annotations

import inspect
import typing
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from relocbench.cli.command import Command, Group
from relocbench.cli.options import (
    Json,
    Quiet,
    Scheduler,
    SchedulerTlsCa,
    SchedulerTlsCert,
    SchedulerTlsKey,
    Workers,
    given,
    scheduler_values,
    takes_several,
)

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from relocbench.datasets.core.schema import Strict
    from relocbench.execution import Run

_NO_SOURCE = ("synthetic", "edition", "cross-view")
_EXAMPLES = {
    "kitti": "relocbench build-dataset kitti odometry/dataset --sequence 06 --pair-step 1,2,4,8 --out D",
    "tum-rgbd": "relocbench build-dataset tum-rgbd rgbd_dataset_freiburg1_xyz --pair-step 1,2,4 --out D",
    "four-seasons": "relocbench build-dataset four-seasons recording_2020-10-07_14-47-51 recording_... --out D",
    "robotcar": "relocbench build-dataset robotcar 2014-11-18-13-20-12 2014-12-02-15-30-08 --out D",
    "kitti-lidar": "relocbench build-dataset kitti-lidar odometry/dataset --sequence 00,01 --out D",
    "generic-lidar": "relocbench build-dataset generic-lidar summer winter --out D",
    "rosbag": "relocbench build-dataset rosbag summer.bag winter.bag --out D",
    "boreas": "relocbench build-dataset boreas boreas-2021-01-26-11-22 boreas-2021-08-05-13-34 --out D",
    "mulran": "relocbench build-dataset mulran DCC01 DCC02 --out D",
    "helipr": "relocbench build-dataset helipr KAIST04 KAIST05 --lidars Ouster --out D",
    "clouds": "relocbench build-dataset clouds summer winter --out D",
    "nclt": "relocbench build-dataset nclt 2012-01-08 2012-08-20 --out D",
    "kitti-360": "relocbench build-dataset kitti-360 KITTI-360 --sequence 0000,0002 --out D",
    "complex-urban": "relocbench build-dataset complex-urban urban28 urban38 --out D",
    "ford-av": "relocbench build-dataset ford-av 2017-08-04/V2/Log1 2017-10-26/V2/Log1 --out D",
    "generic": "relocbench build-dataset generic summer winter --max-distance 3 --out D",
    "colmap": "relocbench build-dataset colmap sparse/0 --images images --queries 'night/*' --out D",
    "kapture": "relocbench build-dataset kapture 7scenes/stairs/mapping 7scenes/stairs/query --out D",
    "poses": "relocbench build-dataset poses summer.txt winter.txt --max-distance 3 --out D",
    "pair-files": "relocbench build-dataset pair-files summer__winter__cam0.txt --sigma 0.02 --out D",
    "photographs": "relocbench build-dataset photographs streets parks --licence CC0-1.0 --out D",
    "synthetic": "relocbench build-dataset synthetic --preset demo --conditions Sunny,Rain,Snow --out D",
    "edition": "relocbench build-dataset edition 2026.1 --split validation --tier hard --out E",
    "cross-view": "relocbench build-dataset cross-view --places 60 --drone-views 12 --conditions Sunny,Overcast,Rain "
    "--out D",
}
_MADE = {
    "synthetic": "the dataset, or the recordings,",
    "edition": "a folder for each tier, with a dataset for each district,",
    "cross-view": "the places",
}
"""what a kind makes, if it is not a dataset"""
_SOURCES = {
    "photographs": "Folders of photographs, PNG or JPEG; folders in them are searched too.",
    "rosbag": "Bags: .bag, .mcap or .db3 files, folders of ROS 2, or folders of the files of one drive; the first is "
    "the reference.",
    "ford-av": "Folders of logs, each with its bag and folders of images, or the bags; the first is the reference.",
    "poses": "Trajectories in one world, the first of them the reference; a single one is paired with itself.",
    "pair-files": "Files of pairs: ref_ts query_ts tx ty tz qx qy qz qw, one for each pair set.",
}
"""what a kind is made from, if it is not recordings"""
_OF_FILES = ("poses", "pair-files")
_NAME = "edition"
"""the option that is no flag but the word behind the kind"""
_PANELS = {
    "DatasetOptions": "The dataset",
    "ImportOptions": "The dataset",
    "LinkingOptions": "The dataset",
    "PairingOptions": "Which images make a pair",
    "PhotoOptions": "Photo collections",
    "FieldOptions": "From lidar to true poses",
}
"""headings of the options that kinds share, by the class that declares them"""
_SETS = {
    "kitti": "pair_step: [1, 2]",
    "tum-rgbd": "pair_step: [1, 2]",
    "four-seasons": "max_distance: 3",
    "robotcar": "cameras: [stereo_left]",
    "kitti-lidar": "sequence: ['00', '01']",
    "generic-lidar": "query_distance: 2",
    "rosbag": "odometry: /odom",
    "boreas": "query_distance: 2",
    "mulran": "odometry: poses",
    "helipr": "lidars: [Ouster]",
    "clouds": "motion: distorted",
    "nclt": "cameras: [Cam5]",
    "kitti-360": "sequence: ['0000', '0002']",
    "complex-urban": "lidars: [VLP_left, VLP_right]",
    "ford-av": "lidars: [red, blue]",
    "generic": "max_distance: 3",
    "colmap": "queries: ['night/*']",
    "kapture": "max_distance: 3",
    "poses": "max_distance: 3",
    "pair-files": "sigma: 0.02",
    "photographs": "changes: [exposure, night]",
    "synthetic": "conditions: [Sunny, Rain]",
    "edition": "tier: hard",
    "cross-view": "conditions: [Sunny, Rain]",
}
"""an option of each kind as a YAML file sets it"""


class _Kinds(Group):
    """Loads an importer when its own help or its work is asked for, and no sooner."""

    def list_commands(self, ctx: Any) -> list[str]:
        from relocbench.datasets.importers import KINDS

        return list(KINDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        from relocbench.datasets.importers import KINDS

        return _command(cmd_name) if cmd_name in KINDS else None

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        from relocbench.datasets.importers import KINDS
        from relocbench.errors import available, quoted

        if args[0] not in KINDS and not args[0].startswith("-"):
            ctx.fail(f"no kind {quoted(args[0])}{available(args[0], KINDS)}")
        return super().resolve_command(ctx, args)


build_dataset = typer.Typer(
    cls=_Kinds,
    no_args_is_help=True,
    subcommand_metavar="KIND [FOLDER]... --out FOLDER",
    help="Make a dataset from recordings, or render one. `relocbench build-dataset KIND --help` has the options.",
    rich_markup_mode="markdown",
)


@build_dataset.callback()
def _build_dataset() -> None:
    pass


@cache
def _command(kind: str) -> TyperCommand:
    """The sub-command of one kind; its options are the fields of the importer's ``Options``."""
    from relocbench.datasets.importers import KINDS, options_of

    options = options_of(kind)
    fields = {name: field for name, field in options.model_fields.items() if _is_option(field)}

    def run(**values: Any) -> None:
        _build(kind, options, values)

    run.__doc__ = f"{KINDS[kind][0].upper()}{KINDS[kind][1:]}."
    parameters = {
        **_common(kind),
        **{name: _annotation(name, field, _panel(kind, options, name)) for name, field in fields.items()},
    }
    run.__annotations__ = {**parameters, "return": None}
    run.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [
            inspect.Parameter(
                name,
                inspect.Parameter.KEYWORD_ONLY,
                annotation=annotation,
                default=_DEFAULTS.get(name, inspect.Parameter.empty if name in ("sources", "out", _NAME) else None),
            )
            for name, annotation in parameters.items()
        ]
    )
    single = typer.Typer(rich_markup_mode="markdown", pretty_exceptions_enable=False, add_completion=False)
    single.command(kind, cls=Command, epilog=f"Example: {_EXAMPLES[kind]}")(run)
    return typing.cast(TyperCommand, typer.main.get_command(single))


_DEFAULTS: dict[str, Any] = {"quiet": False, "json": False}


def _common(kind: str) -> dict[str, Any]:
    what = _SOURCES.get(kind, "Recordings; the first is the reference.")
    metavar = "FILE" if kind in _OF_FILES else "FOLDER"
    sources = Annotated[list[Path], typer.Argument(metavar=metavar, help=what, show_default=False)]
    common: dict[str, Any] = {} if kind in _NO_SOURCE else {"sources": sources}
    return common | {
        "out": Annotated[
            Path,
            typer.Option("--out", "-o", metavar="FOLDER", help=f"Folder to write {_MADE.get(kind, 'the dataset')} to."),
        ],
        "config": Annotated[
            Path | None,
            typer.Option(metavar="FILE", help=f"YAML file that sets any of these options ({_SETS[kind]})."),
        ],
        "workers": Workers,
        "scheduler": Scheduler,
        "scheduler_tls_ca": SchedulerTlsCa,
        "scheduler_tls_cert": SchedulerTlsCert,
        "scheduler_tls_key": SchedulerTlsKey,
        "quiet": Quiet,
        "json": Json,
    }


def _is_option(field: FieldInfo) -> bool:
    return typing.get_origin(field.annotation) is not dict


def _panel(kind: str, options: type[Strict], name: str) -> str:
    """The heading of an option: that of the most general class that declares it."""
    declaring = [of.__name__ for of in options.__mro__ if name in inspect.get_annotations(of)]
    return _PANELS.get(declaring[-1], f"Options of {kind}")


def _annotation(name: str, field: FieldInfo, panel: str) -> Any:
    """A flag for a bool; for the rest a word, or several, that pydantic will understand."""
    flag = "--" + name.replace("_", "-")
    text = field.description or ""
    if name == _NAME:
        return Annotated[str, typer.Argument(metavar="NAME", help=text, show_default=False)]
    if field.annotation is bool:
        both = f"{flag}/--no-{flag[2:]}"
        return Annotated[bool | None, typer.Option(both, help=text, show_default=False, rich_help_panel=panel)]
    default = "" if field.is_required() or field.default in (None, "", ()) else f" [default: {_words(field.default)}]"
    metavar = _metavar(field.annotation)
    option = typer.Option(flag, help=text + default, metavar=metavar, show_default=False, rich_help_panel=panel)
    return Annotated[list[str] | None if takes_several(field.annotation) else str | None, option]


def _kinds_with(key: str) -> str:
    """The other kinds that have an option, for a message."""
    from relocbench.cli.usage import listed
    from relocbench.datasets.importers import KINDS, options_of

    found = [kind for kind in KINDS if key in options_of(kind).model_fields]
    return f"build-dataset {listed(found)}" if found else ""


def _words(value: Any) -> str:
    return ",".join(map(str, value)) if isinstance(value, tuple) else str(value)


def _metavar(annotation: Any) -> str:
    arguments = [a for a in typing.get_args(annotation) if a is not type(None) and typing.get_origin(a) is not dict]
    if typing.get_origin(annotation) is Annotated:
        return _metavar(arguments[0])
    if typing.get_origin(annotation) is tuple:
        return f"{_metavar(arguments[0])},..." if arguments else "LIST"
    if typing.get_origin(annotation) is typing.Literal:
        return "|".join(map(str, arguments))
    if arguments:
        return "|".join(map(_metavar, arguments))
    return {int: "INT", float: "FLOAT", Path: "PATH"}.get(annotation, "TEXT")


def _build(kind: str, options: type[Strict], values: dict[str, Any]) -> None:
    from relocbench.cli.configuration import Where, merged
    from relocbench.errors import DatasetError
    from relocbench.execution import Run, default_workers
    from relocbench.files import locked_output

    sources, out = values.pop("sources", []), values.pop("out")
    config, quiet, as_json = values.pop("config"), values.pop("quiet"), values.pop("json")
    tls = (values.pop(f"scheduler_tls_{name}") for name in ("ca", "cert", "key"))
    place = {"workers": values.pop("workers"), "scheduler": scheduler_values(values.pop("scheduler"), *tls)}
    chosen = merged(
        options,
        config,
        {name: ",".join(v) if isinstance(v, list) else v for name, v in given(**values).items()},
        Where,
        elsewhere=_kinds_with,
    )
    where = merged(Where, config, given(**place), options)
    if where.scheduler is not None:
        # Workers of a cluster start in folders of their own.
        sources, out = [source.absolute() for source in sources], out.absolute()
    run = Run(where.workers or default_workers(), where.scheduler).with_shared_folders(out, *sources)
    for source in sources:
        if out.resolve().is_relative_to(source.resolve()):  # not even a folder is made there
            raise DatasetError(f"lies inside the recording {source}, which is never written to", out)
    with locked_output(out):
        _make(kind, chosen, sources, out, run, quiet, as_json)


def _make(kind: str, chosen: Strict, sources: Sequence[Path], out: Path, run: Run, quiet: bool, as_json: bool) -> None:
    from relocbench.cli.console import print_json, reporter
    from relocbench.cli.counts import of_dataset, of_places, of_recording
    from relocbench.cli.summaries import print_edition, print_places, print_recording, print_summary
    from relocbench.datasets.core.build_options import DatasetOptions
    from relocbench.datasets.importers import importer, place_importer, recorder
    from relocbench.datasets.importers.marks import check_recordings

    check_recordings(kind, sources)
    places = place_importer(kind)
    if places is not None:
        made = places.build_places(list(sources), chosen, out, reporter(quiet), run)
        if as_json:
            print_json({"dataset": str(out), "name": made.name, "fingerprint": made.fingerprint}, of_places(made))
        else:
            print_places(made)
        return
    if kind == "edition":
        from relocbench.datasets.importers.edition.dataset import Options, build_edition

        assert isinstance(chosen, Options)
        edition = build_edition(chosen, out, reporter(quiet), run)
        if as_json:
            print_json(edition.to_dict(), {"pairs": sum(edition.pairs.values())})
        else:
            print_edition(edition)
        return
    assert isinstance(chosen, DatasetOptions)
    records = recorder(kind)
    recorded = records.record(list(sources), chosen, out, reporter(quiet), run) if records else None
    if recorded is not None:
        if as_json:
            print_json(recorded.to_dict(), of_recording(recorded))
        else:
            print_recording(recorded)
        return
    dataset = importer(kind).build(list(sources), chosen, out, reporter(quiet), run)
    if as_json:
        values = {"dataset": str(out), "name": dataset.name, "fingerprint": dataset.fingerprint}
        print_json(values, of_dataset(dataset))
    else:
        print_summary(dataset)
