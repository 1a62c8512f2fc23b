"""What methods and trainers are given: configuration files, settings, weights, checkpoints, programs' answers."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch

from fuzz.asking import command, write
from fuzz.parser import Parser, Place, RefusedError

_SETTINGS = ("features=500", "orb-pnp.features=500", "seed=3", "orb-pnp.reprojection_threshold_px=2.5")
_MOST_LINES = 20
_ID = "@ID@"
_PROGRAM = r"""
exec 3< "$0"
while read -r question; do
  case $question in *'"id": '*) id=${question#*\"id\": }; id=${id%%[,\}]*};; *) id=null;; esac
  read -r answer <&3 || break
  case $answer in
    *'"@ID@"'*) printf '%s%s%s\n' "${answer%%\"@ID@\"*}" "$id" "${answer#*\"@ID@\"}";;
    *) printf '%s\n' "$answer";;
  esac
done
"""
"""answers each question with the next line of a file"""
_TRAINING = ("steps=5", "learning_rate=1e-3", "network.dim=8", "loss.contrastive.margin=0.5")


def write_configurations(root: Path) -> None:
    """Configuration files of commands, and settings of a method, a line each."""
    folder = root / "configurations"
    write(
        folder / "evaluate.yaml",
        "dataset: ds",
        "methods: [identity, orb-pnp]",
        "set: [orb-pnp.features=500]",
        "out: r",
        "workers: 2",
    )
    write(
        folder / "synthetic.yaml",
        "seed: 3",
        "correspondences: 10",
        "pair_step: [1, 2]",
        "name: town",
        "licence: CC0-1.0",
    )
    write(folder / "kitti.yaml", "sequence: ['06']", "depth: stereo", "pair_step: [1, 2]", "max_depth: 60.0")
    write(root / "settings" / "method.txt", *_SETTINGS)


def write_training(root: Path) -> None:
    """Configuration files and settings of trainers."""
    from relocbench.files import dump_yaml
    from relocbench.methods.trainers import trainer_named

    folder = root / "configurations"
    folder.mkdir()
    for name in ("gn-net", "lpn"):
        (folder / f"{name}.train.yaml").write_text(dump_yaml(dict(trainer_named(name).default_options())))
    write(root / "settings" / "gn-net.txt", *_TRAINING)
    write(root / "settings" / "lpn.txt", "size=64", "batch=4", "network.width=16")


def write_weights(root: Path) -> None:
    """Weights of narrow networks, a checkpoint and the log of a training."""
    import torch
    from made_places import NarrowResNet
    from safetensors.torch import save_file

    from baselines.gn_net.network import FeatureNet
    from baselines.gn_net.options import NetworkOptions as GnOptions
    from baselines.gn_net.weights import save_weights as save_gn
    from baselines.lpn.network import LpnNetwork
    from baselines.lpn.options import NetworkOptions as LpnOptions
    from baselines.lpn.weights import About
    from baselines.lpn.weights import save_weights as save_lpn
    from baselines.place_networks.dinov2 import VitShape
    from baselines.place_networks.megaloc import MegaLocNetwork
    from baselines.training.checkpoint import Checkpoint, save_checkpoint
    from baselines.training.log import Table

    folder = root / "weights"
    folder.mkdir()
    torch.manual_seed(0)
    small = FeatureNet(GnOptions(widths=(4, 4), dim=2, levels=2))
    save_gn(folder / "gn.safetensors", small, {"data": "made up"})
    with _narrow():
        network = LpnNetwork(2, LpnOptions(backbone="resnet18", width=8))
        save_lpn(folder / "lpn.safetensors", network, About("lpn", 64, "drawn", ("drone", "satellite")))
    state = dict(NarrowResNet().state_dict())
    save_file(state, folder / "backbone.safetensors")
    torch.save(state, folder / "backbone.pth")
    places = MegaLocNetwork(VitShape(64, 8, 1, 2, 3), hidden=8, clusters=2, features=4, token=4, dimensions=8)
    drawn = {name: torch.randn(value.shape) for name, value in places.state_dict().items()}
    save_file(drawn, folder / "megaloc.safetensors")
    torch.save({"epoch": 1, "state_dict": drawn}, folder / "megaloc.pth")
    states = {name: tensor.clone() for name, tensor in small.state_dict().items()}
    optimiser = torch.optim.Adam(small.parameters()).state_dict()
    save_checkpoint(
        folder / "checkpoint.pt", Checkpoint({"seed": 0}, 3, states, optimiser, None, {"loss": 1.5}, 1, 2.5, None, [])
    )
    table = Table(folder / "log.csv", 0)
    for step in range(1, 4):
        table.add({"step": step, "loss": 0.5 * step, "seconds": 1.0})


def write_answers(root: Path) -> None:
    """What a program may answer: a line a question, whose own id the program puts in."""
    good = {"type": "result", "id": _ID, "pose": [0, 0, 1.5, 0, 0, 0, 1], "confidence": 2, "message": "fine"}
    lines = [
        {"type": "ready", "id": _ID},
        {"type": "ready", "id": _ID},
        {**good, "info": {"n": [1, 2]}},
        {"type": "result", "id": _ID, "pose": None, "message": "lost"},
    ]
    write(root / "program" / "answers.jsonl", *map(json.dumps, lines))


@contextmanager
def _narrow() -> Iterator[None]:
    """Backbones of a few kilobytes in the place of torchvision's."""
    from made_places import NarrowResNet

    import baselines.lpn.backbone  # noqa: F401  is patched

    with patch("baselines.lpn.backbone.resnet18", NarrowResNet):
        yield


def _configuration(place: Place) -> None:
    """As the commands read them, up to where the work would begin."""
    from relocbench.cli.configuration import merged
    from relocbench.datasets.importers import KINDS, options_of
    from relocbench.evaluation.tracking.evaluate import EvaluateOptions

    kind = place.target.name.split(".")[0]
    if kind == "evaluate":
        merged(EvaluateOptions, place.target, {})
    else:
        merged(options_of(kind), place.target, {})
    assert kind in {*KINDS, "evaluate"}


def _training(place: Place) -> None:
    name = place.target.name.split(".")[0]
    command("train", name, "--config", place.target, "--show-options")
    _train(name, "--config", place.target)


def _train(name: str, *words: object) -> None:
    """A trainer checks its options before it looks at data; that there is no data is then its complaint."""
    try:
        command("train", name, *words, "--dataset", "nowhere", "--out", "nothing")
    except RefusedError as refusal:
        if "nowhere" not in str(refusal):
            raise


def _method_settings(place: Place) -> None:
    from relocbench.methods import parse_method

    for line in _lines(place.target):
        parse_method("orb-pnp", [line]).create()


def _trainer_settings(place: Place) -> None:
    from relocbench.methods.trainers import chosen_options, trainer_named

    trainer = trainer_named(place.target.stem if place.target.stem in ("gn-net", "lpn") else "gn-net")
    for line in _lines(place.target):
        chosen_options(trainer, None, [line])


def _lines(path: Path) -> list[str]:
    """Words of a command line: they hold no NUL."""
    if not path.is_file() or path.is_symlink():
        return []
    return [line.replace("\0", "") for line in path.read_text(encoding="utf-8", errors="replace").split("\n") if line][
        :_MOST_LINES
    ]


def _weights(place: Place) -> None:
    import torch

    from baselines.gn_net.weights import load_weights as load_gn
    from baselines.gn_net.weights import read_card
    from baselines.lpn.backbone import make_backbone
    from baselines.lpn.backbone_weights import load_backbone
    from baselines.lpn.weights import load_weights as load_lpn
    from baselines.place_networks.megaloc import load_megaloc

    readers: Mapping[str, Callable[[Path], object]] = {
        "gn": lambda path: (load_gn(path), read_card(path)),
        "lpn": load_lpn,
        "megaloc": load_megaloc,
        "backbone": lambda path: load_backbone(path, make_backbone("resnet18", 1, torch.Generator())),
    }
    with _narrow():
        readers[place.target.name.split(".")[0]](place.target)


def _checkpoint(place: Place) -> None:
    from baselines.training.checkpoint import load_checkpoint

    load_checkpoint(place.target, {"seed": 0})


def _log(place: Place) -> None:
    from baselines.training.log import Table

    Table(place.target, 10)


def _program(place: Place) -> None:
    import numpy as np

    from relocbench.geometry import Camera
    from relocbench.methods.subprocess_tracker import SubprocessTracker
    from relocbench.tracking import Query, Reference

    image = np.zeros((6, 8), dtype=np.uint8)
    camera = Camera("pinhole", 8, 6, 8.0, 8.0, 3.5, 2.5)
    words = ["sh", "-c", _PROGRAM, str(place.target)]
    tracker = SubprocessTracker(shlex.join(words), time_limit_s=1.0, start_limit_s=1.0)
    try:
        reference = tracker.prepare(
            Reference(key="a", timestamp_ns=0, image=image, camera=camera, sparse_points=None, depth=None)
        )
        for _ in range(2):
            answer = tracker.track(reference, Query(key="b", timestamp_ns=1, image=image, camera=camera))
            assert answer.T_query_ref is None or np.isfinite(answer.T_query_ref).all()
    finally:
        tracker.close()


SEEDS = {
    "configurations": write_configurations,
    "training": write_training,
    "weights": write_weights,
    "program": write_answers,
}
_CONFIGURATIONS = tuple(f"configurations/{name}.yaml" for name in ("evaluate", "synthetic", "kitti"))
PARSERS = (
    Parser("configuration", "configurations", _CONFIGURATIONS, _configuration, text=True),
    Parser("trainer-configuration", "training", ("configurations/*.train.yaml",), _training, text=True, brief=False),
    Parser("method-settings", "configurations", ("settings/method.txt",), _method_settings, text=True),
    Parser(
        "trainer-settings",
        "training",
        ("settings/gn-net.txt", "settings/lpn.txt"),
        _trainer_settings,
        text=True,
        brief=False,
    ),
    Parser("weights", "weights", ("weights/gn*", "weights/lpn*"), _weights, brief=False),
    Parser("backbone", "weights", ("weights/backbone.*",), _weights, brief=False),
    Parser("place-networks", "weights", ("weights/megaloc.*",), _weights, brief=False),
    Parser("checkpoint", "weights", ("weights/checkpoint.pt",), _checkpoint, brief=False),
    Parser("training-log", "weights", ("weights/log.csv",), _log, text=True, brief=False),
    Parser("program", "program", ("program/*",), _program, text=True),
)
