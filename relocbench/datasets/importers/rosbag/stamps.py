"""The times of messages: by the stamps of their headers, or by when they were received where stamps cannot be right."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np

from relocbench.arrays import Array, Times
from relocbench.datasets.importers.rosbag.motion import in_order
from relocbench.datasets.motion.jumps import LEAST
from relocbench.datasets.motion.words import distance
from relocbench.errors import DatasetError
from relocbench.progress import Reporter

Stamps = Literal["header", "receive"]
_MOST_BACKWARDS, _FEW_BACKWARDS = 0.01, 2
"""share and number of stamps earlier than the one before that messages which overtook each other explain"""
_ONE_CLOCK_NS = 1_000_000_000
"""sensors on one clock are received within this time of each other after their stamps"""

_SILENT_NS, _SILENT_SHARE, _SILENT_PERIODS = 2e9, 0.05, 20
"""a topic is silent for more than these nanoseconds, this share of the recording at its ends, so many of its periods"""


def times_of(
    stamps_ns: Times, received_ns: Times, what: str, how: Stamps, reporter: Reporter
) -> tuple[Times, Times, bool]:
    """Times (M,) strictly increasing, the indices (M,) of their messages, and whether they are stamps of headers.

    Stamps of headers are used, unless all are zero, or more than one in a hundred (and more than two) is earlier than
    the one before, or one by more than a second, as where a second run begins: then the times of receipt are. Of
    messages with equal times the first is used; those with a stamp of zero are left out.
    """
    count = len(stamps_ns)
    by_header = how == "header"
    if by_header and count and not stamps_ns.any():
        reporter.note(f"{what}: all stamps are zero; times of receipt are used")
        by_header = False
    steps = np.diff(stamps_ns[stamps_ns != 0])
    backwards = int((steps < 0).sum())
    if by_header and (backwards > max(_FEW_BACKWARDS, _MOST_BACKWARDS * count) or (steps < -_ONE_CLOCK_NS).any()):
        farthest = f", by {-float(steps.min()) / 1e9:.3g} s at most"
        reporter.note(f"{what}: {backwards} of {count} stamps run backwards{farthest}; times of receipt are used")
        by_header = False
    times = stamps_ns if by_header else received_ns
    kept = in_order(times)
    if by_header:
        kept = kept[times[kept] != 0]
    if len(kept) < count:
        reporter.note(f"{what}: {count - len(kept)} of {count} messages are left out: time zero or that of another one")
    return times[kept], kept, by_header


def check_one_run(stamps_ns: Times, received_ns: Times, what: str, source: Path) -> None:
    """Check that the stamps of a topic do not jump between those of several runs, or of several publishers.

    Raises:
        DatasetError: more than one in a hundred, and more than two, jump back by more than a second, and as many
            forth: a recording that is looped goes back, and not forth.
    """
    known = stamps_ns != 0
    steps, received = np.diff(stamps_ns[known]), received_ns[known]
    back, forth = steps < -_ONE_CLOCK_NS, steps - np.diff(received) > _ONE_CLOCK_NS
    if min(back.sum(), forth.sum()) > max(_FEW_BACKWARDS, _MOST_BACKWARDS * len(stamps_ns)):
        raise DatasetError(
            f"{what}: {back.sum()} of {len(stamps_ns)} stamps jump back by up to {-steps.min() / 1e9:.4g} s and forth "
            f"again, the first in the message received at {received[1:][back][0]} ns: several runs or publishers are "
            "mixed in it; keep one of them, or take the times of receipt by --stamps receive",
            source,
        )


def check_one_pose_a_time(stamps_ns: Times, values: Array, what: str, source: Path) -> None:
    """Check that the poses (N, 7) of a topic, or positions (N, 3), are not those of several runs or publishers.

    Raises:
        DatasetError: at more than one in a hundred of the times, and more than two, there are two that are far apart.
    """
    order = np.argsort(stamps_ns, kind="stable")
    again = (np.diff(stamps_ns[order]) == 0) & (stamps_ns[order][1:] != 0)
    apart = np.where(again, np.linalg.norm(np.diff(values[order, :3], axis=0), axis=1), 0.0)
    far = apart > LEAST[0]
    if far.sum() > max(_FEW_BACKWARDS, _MOST_BACKWARDS * len(stamps_ns)):
        raise DatasetError(
            f"{what}: {far.sum()} of {len(stamps_ns)} poses are up to {distance(float(apart.max()))} from another one "
            f"at the same time, the first at {stamps_ns[order][1:][far][0]} ns: several runs or publishers are mixed "
            "in it; keep one of them",
            source,
        )


def silences(received_ns: Mapping[str, Times]) -> list[str]:
    """Where topics of one recording hold no messages while others do, in words.

    Args:
        received_ns: topic -> times of receipt (N,) of its messages.
    """
    filled = {topic: np.sort(times) for topic, times in received_ns.items() if len(times) > 1}
    if not filled:
        return []
    begin, end = min(int(t[0]) for t in filled.values()), max(int(t[-1]) for t in filled.values())
    edge = max(_SILENT_NS, _SILENT_SHARE * (end - begin))
    found = []
    for topic, times in filled.items():
        steps = np.diff(times)
        longest = int(np.argmax(steps))
        if times[0] - begin > edge:
            found.append(f"{topic} begins {(times[0] - begin) / 1e9:.1f} s after the recording")
        if end - times[-1] > edge:
            found.append(f"{topic} ends {(end - times[-1]) / 1e9:.1f} s before the recording")
        if steps[longest] > max(_SILENT_NS, _SILENT_PERIODS * float(np.median(steps))):
            gap = f"{steps[longest] / 1e9:.1f} s after {times[longest]} ns"
            found.append(f"{topic} has no message for {gap}")
    return found


def check_clocks(lags_ns: Mapping[str, float], source: Path) -> None:
    """Check that the stamps of all topics come from one clock.

    Args:
        lags_ns: topic -> median time from stamp to receipt.

    Raises:
        DatasetError: two topics differ by more than a second.
    """
    if not lags_ns:
        return
    first, last = min(lags_ns, key=lambda t: lags_ns[t]), max(lags_ns, key=lambda t: lags_ns[t])
    if lags_ns[last] - lags_ns[first] > _ONE_CLOCK_NS:
        raise DatasetError(
            f"stamps are of different clocks: {last} is received {lags_ns[last] / 1e9:.1f} s after its stamps, {first} "
            f"{lags_ns[first] / 1e9:.1f} s; --stamps receive takes the times of receipt for all",
            source,
        )
