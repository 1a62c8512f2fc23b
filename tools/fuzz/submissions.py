"""Readers of submissions: the card, the answers beside it, and the commands that take them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from fuzz.asking import asks
from fuzz.parser import Parser, Place


def write_submissions(root: Path) -> None:
    """A dataset, a blind export of it, and submissions to both; one of lists."""
    from small_dataset import ACROSS, make_small_dataset
    from submissions import blind_export, submit

    dataset = make_small_dataset(root / "ds", frames=3, size=(24, 18))
    submit(root / "real", dataset)
    submit(root / "blind", blind_export(dataset, root / "export"))
    submit(root / "lists", dataset, task="retrieval")
    times = {name: dataset.traversal(name).timestamps("cam0") for name in ("summer", "winter")}
    names = {name: [f"traversals/{name}/images/cam0/{t}.png" for t in found] for name, found in times.items()}
    for path in (root / "lists" / dataset.name).iterdir():
        path.unlink()
    lines = [f"{query} {image}\n" for query in names["winter"] for image in names["summer"]]
    (root / "lists" / dataset.name / f"{ACROSS}.txt").write_text("".join(lines))


def _card(place: Place) -> None:
    from relocbench.evaluation.submission.card import load_card

    load_card(place.target)


def _check(place: Place, submission: str) -> Iterable[str]:
    from submissions import salt

    from relocbench.evaluation.retrieval.opening import SetOptions
    from relocbench.evaluation.submission.check import check_submission
    from relocbench.evaluation.submission.contract import SubmissionOptions
    from relocbench.progress import Silent

    options = SubmissionOptions((place.root / "ds",), retrieval=SetOptions(radius_m=0.2), salt=salt())
    found = check_submission(place.root / submission, options, Silent())
    return [*(str(finding) for finding in (*found.found.faults, *found.found.notes)), *found.suspicions]


def _real(place: Place) -> Iterable[str]:
    return _check(place, "real")


def _blind(place: Place) -> Iterable[str]:
    return _check(place, "blind")


def _lists(place: Place) -> Iterable[str]:
    return _check(place, "lists")


_ADD = ("leaderboard", "add", "{root}/real", "--to", "{out}/r", "-d", "{root}/ds", "-q")
SEEDS = {"submissions": write_submissions}
PARSERS = (
    Parser("card.yaml", "submissions", ("real/card.yaml",), _card, text=True),
    Parser("submission", "submissions", ("real/card.yaml", "real/*/*"), _real, names=True),
    Parser("submission-blind", "submissions", ("blind/card.yaml", "blind/*/*"), _blind, names=True),
    Parser("submission-lists", "submissions", ("lists/card.yaml", "lists/*/*"), _lists, names=True),
    Parser("submission-command", "submissions", ("real/card.yaml", "real/*/*"), asks(*_ADD), names=True, brief=False),
)
