"""``card.yaml`` of a submission: what a reader must know of predictions that were made elsewhere."""

from __future__ import annotations

import datetime
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import AfterValidator, BaseModel, BeforeValidator, Field, ValidationError

from relocbench.datasets.checks.faults import Findings, single_errors
from relocbench.datasets.core.schema import Fingerprint, JoinedName, Label, Strict
from relocbench.errors import PredictionError, available, quoted
from relocbench.files import YamlFault, YamlPlaces, first_fault, parse_yaml, read_bytes, read_text, yaml_line

CARD = "card.yaml"
MAX_CARD_BYTES = 64 * 2**10
"""a card is a page of text"""
_UNFILLED = "FILL IN"
_URL = re.compile(r"https?://[A-Za-z0-9._~:/?#\[\]@!$&()*+,;=%-]{3,300}")
_LONGEST = 1000
RESERVED = ("identity", "clock")
"""labels of the trivial baselines, which every other row is read against"""
_WHAT = "the card of a submission"
_TEMPLATE_WRITER = "`relocbench submit-check --new FOLDER` writes one to fill in"


def _filled(text: str) -> str:
    if _UNFILLED in text:
        raise ValueError("is still the template's text; fill it in")
    if not text.strip():
        raise ValueError("is blank; expected words")
    if not text.isprintable() or len(text) > _LONGEST:
        raise ValueError(f"expected printable text without line ends, of at most {_LONGEST} characters")
    return text


def _own_label(label: str) -> str:
    if label.lower() in RESERVED:
        raise ValueError(f"{quoted(label)} is the label of a trivial baseline; choose another")
    return label


def _url(text: str) -> str:
    if _UNFILLED in text:
        raise ValueError("is still the template's text; fill it in")
    if not _URL.fullmatch(text):
        raise ValueError(f"{quoted(text, 60)} is not an address; expected https://...")
    return text


Text = Annotated[str, AfterValidator(_filled)]
Date = Annotated[Text, BeforeValidator(lambda value: str(value) if isinstance(value, datetime.date) else value)]
"""free text; YAML takes some dates for more than text"""
Url = Annotated[str, AfterValidator(_url)]


class Weights(Strict):
    """What the method has learnt, and from what."""

    files: Text
    """which, or that there are none"""
    trained_on: Text
    splits_seen: tuple[Text, ...] = Field(max_length=100)
    """splits of the answered datasets, or of others of this project, that training or tuning has seen"""


class Answered(Strict):
    """One dataset that was answered."""

    fingerprint: Fingerprint
    asked_once: bool
    """whether it was evaluated once, by the finished method"""
    note: Text | None = None


class Card(Strict):
    """The content of ``card.yaml``."""

    format_version: Literal[1]
    label: Annotated[Label, AfterValidator(_own_label)]
    """the row's name"""
    task: Literal["tracking", "retrieval"]
    method: Text
    what: Text
    """in one sentence"""
    authors: tuple[Text, ...] = Field(min_length=1, max_length=100)
    contact: Text
    links: tuple[Url, ...] = Field(max_length=20)
    """code, paper"""
    weights: Weights
    uses_times: bool
    """whether the method looked at the times of images"""
    hardware: Text
    seconds: Text
    """how they were measured"""
    date: Date
    licence: Text
    """of the predictions"""
    datasets: dict[JoinedName, Answered] = Field(min_length=1, max_length=1000)
    """by the name of the dataset or blind export, which is also that of the folder with the answers"""


def read_card(folder: Path, found: Findings) -> tuple[Card | None, YamlPlaces | None]:
    """The card of a submission and where its parts stand; where it is not valid None, and a fault for each key."""
    path = folder / CARD
    if not path.exists():
        found.fault(f"missing; expected {_WHAT}: {_TEMPLATE_WRITER}", path)
        return None, None
    with found.catching():
        text = read_text(path, _WHAT, PredictionError, MAX_CARD_BYTES)
        try:
            values, places = parse_yaml(text), YamlPlaces(text)
        except YamlFault as bad:
            raise PredictionError(f"not valid YAML ({bad.problem}); expected {_WHAT}", path, bad.line) from None
        if not isinstance(values, dict):
            raise PredictionError(f"expected keys and values: {_WHAT}", path, 1)
        try:
            return Card.model_validate(values), places
        except ValidationError as bad:
            for message, location in _faults(bad):
                found.fault(message, path, yaml_line(places, location))
    return None, None


def load_card(path: Path) -> Card:
    """A card that was checked before. Raises PredictionError for the first fault."""
    found = Findings()
    card, _ = read_card(path.parent, found)
    if card is None:
        raise PredictionError(found.faults[0].message, path, found.faults[0].line)
    return card


def card_bytes(folder: Path) -> bytes:
    """The card as it was handed in. Raises PredictionError where it cannot be read."""
    return read_bytes(folder / CARD, _WHAT, PredictionError, MAX_CARD_BYTES)


def _faults(bad: ValidationError) -> Iterator[tuple[str, tuple[str | int, ...]]]:
    places = {tuple(error["loc"]) for error in bad.errors(include_url=False)}
    for one in single_errors(bad):
        message, location = first_fault(one)
        if one.errors()[0]["type"] == "too_short":
            if any(len(place) > len(location) and place[: len(location)] == location for place in places):
                continue  # what it holds is reported
            message = f"key '{'.'.join(map(str, location))}': is empty, expected at least one"
        if message.startswith("unknown key"):
            message += _suggestion(location)
        yield message, location


def _suggestion(location: tuple[str | int, ...]) -> str:
    """What follows a key that is not known: the key that was probably meant, and all that are allowed there."""
    model: Any = Card
    for part in location[:-1]:
        field = model.model_fields.get(part) if _is_model(model) else None
        inner = [a for a in get_args(field.annotation) if _is_model(a)] if field is not None else []
        if field is not None:
            model = inner[0] if inner else field.annotation
    known = list(model.model_fields) if _is_model(model) else []
    return available(str(location[-1])[:100], known)


def _is_model(thing: Any) -> bool:
    return isinstance(thing, type) and issubclass(thing, BaseModel)


TEMPLATE = f"""\
# The card of a submission: what a reader of the leaderboard must know of predictions that were made elsewhere.
# Every text that begins with '{_UNFILLED}' is to be replaced; `relocbench submit-check` says what is missing.
format_version: 1

# The row's name: letters a to z and A to Z, digits, and . _ + -
label: my-method
# tracking (poses, PAIRSET.txt) or retrieval (lists of images, TASK.txt)
task: tracking

method: '{_UNFILLED}: its full name'
what: '{_UNFILLED}: what it is, in one sentence'
authors:
- '{_UNFILLED}: a name'
contact: '{_UNFILLED}: a mail address or page for questions'
# Code or paper; [] if there is neither
links:
- '{_UNFILLED}: https://...'

weights:
  files: '{_UNFILLED}: which weights, and where they are from; or none'
  trained_on: '{_UNFILLED}: the data that training and tuning have seen; or nothing'
  # Splits of the datasets below, or of others of relocbench, that training or tuning has seen; [] if none
  splits_seen:
  - '{_UNFILLED}: such as town, train'

# Whether the method looked at the times of images; such a row has no rank. Blind exports have no times: false
uses_times: false
hardware: '{_UNFILLED}: processor, GPU'
seconds: '{_UNFILLED}: how seconds were measured, or not measured'
date: '{_UNFILLED}: when the answers were made'
# Of the predictions, which are published with the leaderboard
licence: CC-BY-4.0

# A folder of this submission for each, with PAIRSET.txt or TASK.txt files, under the dataset's name and with its
# fingerprint (both stand in its dataset.yaml; of a blind export of images, in blind.yaml). asked_once: the finished
# method answered once, and nothing was changed after a score was seen. A note may say more.
datasets:
  NAME:
    fingerprint: '0'
    asked_once: false
    # note: 'asked again after a crash; no score had been seen'
"""
