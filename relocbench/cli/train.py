"""``relocbench train``: train a method on datasets with correspondences."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from relocbench.cli.options import Json, Quiet

if TYPE_CHECKING:
    from relocbench.training import TrainingReport, Validate


def train(
    name: Annotated[str, typer.Argument(help="Installed trainer, or package.module:Class.")],
    dataset: Annotated[
        list[Path],
        typer.Option("--dataset", "-d", help="Dataset with a split 'train', 'validation' or both. Repeat for several."),
    ] = [],  # noqa: B006  typer copies it
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder for weights, checkpoint, log and model card.")
    ] = None,
    config: Annotated[Path | None, typer.Option(help="YAML file with any of the trainer's options.")] = None,
    settings: Annotated[
        list[str], typer.Option("--set", help="key=value, nested keys with dots. Repeat for several.")
    ] = [],  # noqa: B006
    split: Annotated[str, typer.Option(help="Whose pairs are learnt from.")] = "train",
    validation_pairs: Annotated[int, typer.Option(min=1, help="So many pairs are tracked at each validation.")] = 180,
    no_validation: Annotated[
        bool, typer.Option("--no-validation", help="Keep the last weights instead of those that track best.")
    ] = False,
    workers: Annotated[
        int | None, typer.Option("--workers", "-j", min=0, help="Background processes that read pairs [default: 1].")
    ] = None,
    device: Annotated[
        str | None, typer.Option(help="cpu, cuda, cuda:1, ... [default: a GPU where there is one].")
    ] = None,
    show_options: Annotated[
        bool, typer.Option("--show-options", help="Print the trainer's options as YAML and do nothing.")
    ] = False,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Train a method on the train split of datasets and choose its weights by tracking on their validation split.

    A killed training goes on where its last checkpoint stood when the same command is given again.

    Example: relocbench train gn-net -d town1 -d town2 -o trained --set steps=2000
    """
    from relocbench.errors import ConfigError, MethodError
    from relocbench.files import alone_in, dump_yaml
    from relocbench.methods.trainers import trainer_named, trainer_options

    trainer = trainer_named(name)
    options = trainer_options(trainer.default_options(), config, settings)
    if show_options:
        print(dump_yaml(options), end="")
        return
    if not dataset or out is None:
        raise ConfigError(f"train needs {'--dataset DIR' if not dataset else '--out DIR'}")

    from relocbench.cli.console import print_json, reporter
    from relocbench.datasets.training_pairs import DatasetPairs, without_only_validation
    from relocbench.evaluation.trial import Trial
    from relocbench.progress import Silent
    from relocbench.training import TrainingRun

    for root in dataset:
        if out.resolve().is_relative_to(root.resolve()):
            raise ConfigError("--out lies inside a dataset, which it would change; choose another folder", out)
    reports = reporter(quiet)
    data = DatasetPairs(dataset if no_validation else without_only_validation(dataset, split), split)
    # Two bars do not show at once: validation goes without.
    validate: Validate | None = None if no_validation else Trial(dataset, validation_pairs, seed=0, reporter=Silent())
    place = device or _device()
    words = ["train", name, *(f"--dataset={root}" for root in dataset), f"--out={out}"]
    words += [f"--config={config}"] if config else []
    words += [f"--set={setting}" for setting in settings]
    words += [] if split == "train" else [f"--split={split}"]
    words += ["--no-validation"] if no_validation else [f"--validation-pairs={validation_pairs}"]
    command = shlex.join(["relocbench", *words, f"--device={place}"])
    run = TrainingRun(out, name, command, 1 if workers is None else workers, place, reports)
    out.mkdir(parents=True, exist_ok=True)
    with alone_in(out, MethodError):
        report = trainer.train(data, validate, options, run)
    if json:
        print_json(_plain(report))
    elif not quiet:
        _print(report)


def _device() -> str:
    """A GPU where torch finds one."""
    import torch

    return "cuda" if torch.cuda.is_available() else "cpu"


def _plain(report: TrainingReport) -> dict[str, object]:
    scores = report.scores
    return {
        "weights": str(report.weights),
        "steps": report.steps,
        "best_step": report.best_step,
        "validation": None if scores is None else {"all": scores.together, **scores.by_conditions},
    }


def _print(report: TrainingReport) -> None:
    from relocbench.cli.console import print_table

    if report.scores is not None:
        names = list(report.scores.together)
        groups = {"all": report.scores.together, **report.scores.by_conditions}
        counts = {"all": sum(report.scores.pairs.values()), **report.scores.pairs}
        rows = [[g, str(counts[g]), *(f"{100 * v[n]:.1f} %" for n in names)] for g, v in groups.items()]
        print_table(f"validation of the weights of step {report.best_step}", ["conditions", "pairs", *names], rows)
    print(f"weights: {report.weights}")
