"""Spellings of options that commands understand beside those that their help shows.

One idea has one name on every command. Understood are also its earlier names, singular and plural (``--condition`` for
``--conditions``), and ``--dataset`` and ``--method`` where the dataset or method is the command's argument.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

_ARGUMENT = ""
"""in place of a name: what follows the option is the command's argument"""
_HAVE_NO_PICTURES = "pages in Markdown have no pictures; relocbench report draws the curves"
REMOVED: Mapping[tuple[str, str], str] = {
    ("evaluate", "--task"): "the other tasks have commands of their own: relocbench evaluate-retrieval and relocbench "
    "evaluate-relocalization",
    ("leaderboard", "--plots"): _HAVE_NO_PICTURES,
    ("leaderboard", "--no-plots"): _HAVE_NO_PICTURES,
}
"""command and option of an earlier version -> what to use instead"""
_DATASET = {"--dataset": _ARGUMENT, "-d": _ARGUMENT}
_METHOD = {"--method": _ARGUMENT, "-m": _ARGUMENT}
OTHER_NAMES: Mapping[str, Mapping[str, str]] = {
    "preview": {"--steps": "--sweep-steps", "--cameras": "--drawn-cameras", "-c": "--conditions"},
    "inspect": _DATASET,
    "view": {**_DATASET, "--limit": "--pairs"},
    "methods": _METHOD,
    "check-method": _METHOD,
    "fetch-weights": _METHOD,
    "leaderboard add": {"--to": "--results"},
    "four-seasons": {"--calibration": "--calibration-folder"},
    "generic-lidar": {"--max-gap": "--max-pose-gap"},
    "rosbag": {"--max-gap": "--max-pose-gap"},
    "tum-rgbd": {"--max-pose-gap": "--max-truth-gap"},
}
"""command or kind of dataset -> other name of an option -> the name that help shows"""


def as_shown(args: Sequence[str], known: Collection[str], others: Mapping[str, str]) -> list[str]:
    """The words of a command line with each option under the name that help shows.

    Args:
        args: the words, without those of the command.
        known: the names of the command's options.
        others: other name -> name that help shows, as in :data:`OTHER_NAMES`.
    """
    out: list[str] = []
    for place, word in enumerate(args):
        if word == "--":
            return [*out, *args[place:]]
        name, equals, value = word.partition("=")
        shown = name
        if name.startswith("-") and name not in known:
            shown = others.get(name, other_number(name, known))
        if shown != _ARGUMENT:
            out.append(f"{shown}{equals}{value}")
        elif equals:
            out.append(value)
    return out


def other_number(name: str, known: Collection[str]) -> str:
    """A name in the singular for one in the plural, or the other way round, if only that is known."""
    other = name.removesuffix("s") if name.endswith("s") else f"{name}s"
    return other if name not in known and other in known else name
