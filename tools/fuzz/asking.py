"""Readers as a user meets them: commands of the command line."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from command_line import relocbench

from fuzz.parser import Place, Read, RefusedError


def command(*words: object) -> list[str]:
    """Run a command; the lines that it said.

    Raises:
        RefusedError: it ended with the status of a user's mistake; the message is what it said.
        AssertionError: it ended otherwise than commands do, or without saying why.
    """
    outcome = relocbench(*words)
    said = [line for line in outcome.err.split("\n") if line]
    if outcome.status == 0:
        return [*said, *outcome.out.split("\n")]
    assert outcome.status in (1, 2), f"exit status {outcome.status}: {outcome.err[-2000:]}"
    start = next((i for i, line in enumerate(said) if line.startswith("relocbench: ")), None)
    if start is None:  # what was found wrong is what was asked for
        assert outcome.out, f"exit status {outcome.status} without a word: {outcome.err[-2000:]}"
        return [*said, *outcome.out.split("\n")]
    # A complaint of several lines is one text, which the judge will not take.
    raise RefusedError("\n".join(said[start:]))


def asks(*words: object) -> Read:
    """A reader that is a command; ``{root}``, ``{out}`` and ``{target}`` stand for the input's paths."""

    def read(place: Place) -> Iterable[str]:
        paths = {"root": place.root, "out": place.out, "target": place.target}
        return command(*(str(word).format(**paths) for word in words))

    return read


def write(path: Path, *lines: str) -> None:
    """A small text file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(f"{line}\n" for line in lines))
