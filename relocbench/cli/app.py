"""The commands by name."""

from __future__ import annotations

from typing import Annotated

import typer

from relocbench import version
from relocbench.cli.build_dataset import build_dataset
from relocbench.cli.check_method import check_method
from relocbench.cli.demo import demo
from relocbench.cli.evaluate import evaluate
from relocbench.cli.export import export
from relocbench.cli.inspect import inspect
from relocbench.cli.leaderboard import leaderboard
from relocbench.cli.methods import methods
from relocbench.cli.preview import preview
from relocbench.cli.probe import probe
from relocbench.cli.train import train
from relocbench.cli.validate import validate

app = typer.Typer(
    help="Can this method still say where the camera is: relocalization tracking measured across weather, light and "
    "season.",
    epilog="Start with: relocbench demo",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
)


def _print_version(value: bool) -> None:
    if value:
        print(f"relocbench {version.__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    pass


app.command()(demo)
app.add_typer(build_dataset, name="build-dataset")
app.command()(preview)
app.command()(evaluate)
app.command()(probe)
app.command()(leaderboard)
app.command()(train)
app.command()(inspect)
app.command()(validate)
app.command()(methods)
app.command("check-method")(check_method)
app.command()(export)
