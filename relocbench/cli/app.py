"""The commands by name."""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any

import typer
from typer.exceptions import TyperException

from relocbench import version
from relocbench.cli.command import Command, Group
from relocbench.cli.commands.build_dataset import build_dataset
from relocbench.cli.commands.check_method import check_method
from relocbench.cli.commands.demo import demo
from relocbench.cli.commands.evaluate import evaluate
from relocbench.cli.commands.evaluate_relocalization import evaluate_relocalization
from relocbench.cli.commands.evaluate_retrieval import evaluate_retrieval
from relocbench.cli.commands.export import export
from relocbench.cli.commands.fetch_weights import fetch_weights
from relocbench.cli.commands.inspect import inspect
from relocbench.cli.commands.leaderboard import leaderboard, report
from relocbench.cli.commands.methods import methods
from relocbench.cli.commands.preview import preview
from relocbench.cli.commands.probe import probe
from relocbench.cli.commands.register import register
from relocbench.cli.commands.submit import leaderboard_add, submit_check
from relocbench.cli.commands.train import train
from relocbench.cli.commands.validate import validate
from relocbench.cli.commands.view import view
from relocbench.cli.usage import usage_fault
from relocbench.errors import USER_ERROR

app = typer.Typer(
    cls=Group,
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


app.command(cls=Command)(demo)
app.add_typer(build_dataset, name="build-dataset")
app.command(cls=Command)(preview)
app.command(cls=Command)(evaluate)
app.command("evaluate-retrieval", cls=Command)(evaluate_retrieval)
app.command("evaluate-relocalization", cls=Command)(evaluate_relocalization)
app.command(cls=Command)(probe)
app.command(cls=Command)(register)
app.command(cls=Command)(leaderboard)
app.command(cls=Command)(report)
app.command("leaderboard add", cls=Command)(leaderboard_add)
app.command("submit-check", cls=Command)(submit_check)
app.command(cls=Command)(train)
app.command(cls=Command)(inspect)
app.command(cls=Command)(view)
app.command(cls=Command)(validate)
app.command(cls=Command)(methods)
app.command("check-method", cls=Command)(check_method)
app.command("fetch-weights", cls=Command)(fetch_weights)
app.command(cls=Command)(export)


@cache
def _commands() -> Any:
    """All commands with their options, which takes typer longer to make than many a command takes."""
    return typer.main.get_command(app)


def run() -> int:
    """Run what the command line says and return the exit status. What is raised passes through."""
    try:
        return int(_commands()(prog_name="relocbench", standalone_mode=False) or 0)
    except TyperException as bad:
        if bad.format_message():  # without one, the help was shown since no command was given
            typer.echo(f"relocbench: {usage_fault(bad)}", err=True)
        return USER_ERROR
