"""Negative pairs, of different places, without a right pose: two pairs far apart exchange their queries.

Methods see which images come repeatedly. Of two pairs that exchange queries, each keyframe and each query comes twice,
once at its own place and once at the other, and nothing but pixels says which is which.
True poses are known and are written like those of the other pairs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.core.build_options import PairingOptions
from relocbench.datasets.core.pairfile import ELSEWHERE, Pair
from relocbench.datasets.pairs.posed_frames import PosedFrames, relative_pose
from relocbench.errors import DatasetError

_STREAM = 10
"""of random numbers, apart from those of a rendered dataset's other draws"""


def with_different_places(
    pairs: Sequence[Pair], reference: PosedFrames, query: PosedFrames, options: PairingOptions, where: Path | None
) -> list[Pair]:
    """The pairs, followed by ``options.elsewhere`` pairs of different places.

    No pair exchanges its query again before all that can have done so. The draws follow from the seed and from when the
    drives begin, and from nothing else: the other pairs stay as they are, and a larger number begins with the same.

    Args:
        pairs: those of one place, which have a source and sigmas in common; one at least.
        where: the recording's folder, for messages.

    Raises:
        DatasetError: too few keyframes and queries are ``options.elsewhere_distance`` apart.
    """
    T_world_ref, T_world_query = (
        np.array([poses[t] for t in times]).reshape(-1, 4, 4)
        for poses, times in (
            (_poses(reference), [p.ref_timestamp_ns for p in pairs]),
            (_poses(query), [p.query_timestamp_ns for p in pairs]),
        )
    )
    starts = (frames.timestamps[0] % 2**64 for frames in (reference, query))
    rng = np.random.default_rng([options.seed, _STREAM, *starts])
    centres = T_world_ref[:, :3, 3], T_world_query[:, :3, 3]
    draws = _exchanges(pairs, *centres, options.elsewhere_distance, rng)
    found = [
        replace(
            pairs[r],
            query_timestamp_ns=pairs[q].query_timestamp_ns,
            T_query_ref=relative_pose(T_world_query[q], T_world_ref[r]),
            group=ELSEWHERE,
        )
        for r, q in islice(draws, options.elsewhere)
    ]
    if len(found) < options.elsewhere:
        farthest = max(float(np.linalg.norm(centres[0] - centre, axis=1).max()) for centre in centres[1])
        raise DatasetError(
            f"--elsewhere {options.elsewhere} negative pairs: only {len(found)} pairs can exchange queries "
            f"over --elsewhere-distance {options.elsewhere_distance:g} m, the farthest are {farthest:.3g} m apart; it "
            "takes a longer road, or a smaller number or distance",
            where,
        )
    return [*pairs, *found]


def _exchanges(
    pairs: Sequence[Pair], ref_centres: Array, query_centres: Array, distance_m: float, rng: np.random.Generator
) -> Iterator[tuple[int, int]]:
    """Yield rows (of the keyframe, of the query) of pairs that are not there yet, two for each exchange.

    Args:
        ref_centres, query_centres: (N, 3) of the pairs' cameras in the world.
    """
    taken = {p.key for p in pairs}

    def new(r: int, q: int) -> bool:
        return (pairs[r].ref_timestamp_ns, pairs[q].query_timestamp_ns) not in taken

    found = True
    while found:
        found = False
        left = rng.permutation(len(pairs))
        while len(left) > 1:
            one, left = int(left[0]), left[1:]
            far = np.linalg.norm(ref_centres[one] - query_centres[left], axis=1) >= distance_m
            far &= np.linalg.norm(ref_centres[left] - query_centres[one], axis=1) >= distance_m
            able = [place for place in np.flatnonzero(far) if new(one, left[place]) and new(left[place], one)]
            if not able:
                continue
            place = able[int(rng.integers(len(able)))]
            other, left, found = int(left[place]), np.delete(left, place), True
            for r, q in ((one, other), (other, one)):
                taken.add((pairs[r].ref_timestamp_ns, pairs[q].query_timestamp_ns))
                yield r, q


def _poses(frames: PosedFrames) -> dict[int, Array]:
    return dict(zip(frames.timestamps, frames.T_world_cam, strict=True))
