"""Pairing of keyframes and queries by rule, from camera poses alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from relocbench.arrays import Array, Indices
from relocbench.datasets.core.build_options import PairingOptions
from relocbench.datasets.core.pairfile import Pair
from relocbench.datasets.pairs.different_places import with_different_places
from relocbench.datasets.pairs.posed_frames import PosedFrames, pair_of, relative_pose
from relocbench.errors import ConfigError, DatasetError
from relocbench.geometry import rotation_angle

_MOST_ASKED = 500
"""queries that the message on missing pairs looks at"""


def make_pairs(
    reference: PosedFrames,
    query: PosedFrames,
    options: PairingOptions,
    *,
    same_traversal: bool,
    source: str,
    where: Path | None = None,
    sigma_translation_m: float | None = None,
    sigma_rotation_deg: float | None = None,
    revisit_ns: int | None = None,
) -> list[Pair]:
    """Pairs by the rule of the options, by default ``step`` within one traversal and ``nearest`` across two.

    Pairs of different places follow them if the options want any.

    Args:
        source: how the poses were obtained, stored with each pair.
        where: the recording's folder, for messages.
        sigma_translation_m, sigma_rotation_deg: one standard deviation of ``T_query_ref``, if known.
        revisit_ns: within one traversal, the least age of a keyframe at the time of its query, so that pairs by the
            nearest rule are revisits; None: a keyframe may be any other frame, before or after the query.

    Raises:
        DatasetError: there is no pair, and the message says how near the nearest candidates were; or the road is too
            short for pairs of different places.
        ConfigError: the step rule is used across two traversals.
    """
    rule = options.pair_rule or ("step" if same_traversal else "nearest")
    if rule == "step" and not same_traversal:
        raise ConfigError("--pair-rule step counts frames within one traversal; use nearest for two recordings")
    if not reference.keyframe_rows:
        raise DatasetError("no keyframe: no frame has both depth and a pose", where)
    if not query.timestamps:
        raise DatasetError("no query: no query frame has a pose", where)
    if rule == "step":
        found = step_matches(reference, options.pair_step)
    else:
        limits = options.max_distance, options.max_angle
        found = nearest_matches(reference, query, *limits, same_traversal=same_traversal, revisit_ns=revisit_ns)
    if not found:
        why = (
            _why_no_step(reference, options.pair_step)
            if rule == "step"
            else _why_none_near(reference, query, options, same_traversal, revisit_ns)
        )
        raise DatasetError(why, where)
    pairs = [
        replace(
            pair_of(reference, r, query, q),
            group=group,
            source=source,
            sigma_translation_m=sigma_translation_m,
            sigma_rotation_deg=sigma_rotation_deg,
        )
        for r, q, group in found
    ]
    return with_different_places(pairs, reference, query, options, where) if options.elsewhere else pairs


def step_matches(frames: PosedFrames, steps: Sequence[int]) -> list[tuple[int, int, str]]:
    """Matches (reference row, query row, group ``step_k``) of keyframe number i with frame number i + k.

    If frame number i + k is missing, there is no match, and none between pieces of the drive.
    """
    row_of = {number: row for row, number in enumerate(frames.numbers)}
    keyframes = frames.keyframe_rows
    return [
        (r, q, f"step_{k}")
        for k in steps
        for r in keyframes
        if (q := row_of.get(frames.numbers[r] + k)) is not None and frames.pieces[q] == frames.pieces[r]
    ]


def steps_left_out(frames: PosedFrames, options: PairingOptions) -> str:
    """Which pairs of the step rule are missing because nobody knows the way from one frame to the next; or nothing."""
    apart = np.flatnonzero(np.diff(frames.pieces))
    if not len(apart) or options.pair_rule == "nearest":
        return ""
    seconds = np.diff(np.array(frames.timestamps, dtype=np.int64)) / 1e9
    worst = int(apart[np.argmax(seconds[apart])])
    metres = float(np.linalg.norm(frames.T_world_cam[worst + 1, :3, 3] - frames.T_world_cam[worst, :3, 3]))
    places = "the hole or jump" if len(apart) == 1 else f"any of the {len(apart)} holes and jumps"
    return (
        f"--pair-rule step pairs no frames across {places} of the poses{', the longest' * (len(apart) > 1)} of "
        f"{seconds[worst]:.3g} s and {metres:.3g} m from {frames.timestamps[worst]} to {frames.timestamps[worst + 1]} "
        f"ns, where most steps take {np.median(seconds):.3g} s"
    )


def nearest_matches(
    reference: PosedFrames,
    query: PosedFrames,
    max_distance: float,
    max_angle: float,
    *,
    same_traversal: bool,
    revisit_ns: int | None = None,
) -> list[tuple[int, int, str]]:
    """Matches (reference row, query row, group ``nearest``) of each query frame with the nearest admissible keyframe.

    Within the same traversal a frame is never paired with itself. Of equally near keyframes the earlier is taken.

    Args:
        max_distance: greatest distance between the camera centres, metres.
        max_angle: greatest angle of the relative rotation, degrees.
        revisit_ns: within the same traversal, the least age of a keyframe at the time of its query.
    """
    rows = reference.keyframe_rows
    found = []
    for q, near, distances, angles in _within(reference, query, max_distance, same_traversal, revisit_ns):
        admissible = angles <= max_angle
        if np.any(admissible):
            best = near[admissible][np.argmin(distances[admissible])]
            found.append((rows[best], q, "nearest"))
    return found


def _within(
    reference: PosedFrames, query: PosedFrames, max_distance: float, same_traversal: bool, revisit_ns: int | None
) -> Iterator[tuple[int, Indices, Array, Array]]:
    """For each query row, the keyframes within reach (as positions in ``keyframe_rows``), distances and angles."""
    rows = reference.keyframe_rows
    keys = reference.T_world_cam[rows]
    key_times = np.array([reference.timestamps[r] for r in rows], dtype=np.int64)
    from scipy.spatial import cKDTree  # imported late: loading takes half a second, too long before an input error

    tree = cKDTree(keys[:, :3, 3])
    for q, T_world_query in enumerate(query.T_world_cam):
        centre = T_world_query[:3, 3]
        near = np.array(tree.query_ball_point(centre, max_distance, return_sorted=True), dtype=np.int64)
        if same_traversal and revisit_ns is not None:
            near = near[key_times[near] <= query.timestamps[q] - revisit_ns]
        elif same_traversal:
            near = near[key_times[near] != query.timestamps[q]]
        if near.size:
            distances = np.linalg.norm(keys[near, :3, 3] - centre, axis=1)
            yield q, near, distances, _angles_deg(T_world_query, keys[near])


def _angles_deg(T_world_query: Array, T_world_ref: Array) -> Array:
    """Angles (N,) in degrees between one camera and (N, 4, 4) others."""
    relative = np.swapaxes(T_world_query[:3, :3], -1, -2) @ T_world_ref[..., :3, :3]
    return np.degrees(np.asarray(rotation_angle(relative)))


def _why_none_near(
    reference: PosedFrames,
    query: PosedFrames,
    options: PairingOptions,
    same_traversal: bool,
    revisit_ns: int | None,
) -> str:
    limits = f"--max-distance is {options.max_distance:g} m, --max-angle {options.max_angle:g} deg"
    within = [
        (a, d)
        for _, _, ds, angles in _within(reference, query, options.max_distance, same_traversal, revisit_ns)
        for a, d in zip(angles.round(6), ds, strict=True)
    ]
    if within:
        angle, distance = min(within)
        return (
            f"no pair: the best aligned keyframe within reach of a query is {distance:.3g} m and "
            f"{angle:.3g} deg away; {limits}: increase --max-angle"
        )
    some = _evenly(query, _MOST_ASKED)
    everywhere = [
        (float(d.min()), float(a[d.argmin()]))
        for _, _, d, a in _within(reference, some, np.inf, same_traversal, revisit_ns)
    ]
    if not everywhere and revisit_ns is not None:
        return f"no pair: the whole drive is shorter than {revisit_ns / 1e9:g} s, the least age of a keyframe"
    if not everywhere:
        return f"no pair: the only keyframe is the only query ({limits})"
    distance, angle = min(everywhere)
    to_increase = "--max-distance" if angle <= options.max_angle else "--max-distance and --max-angle"
    return (
        f"no pair: the nearest keyframe to any query is {distance:.3g} m and {angle:.3g} deg away; {limits}: "
        f"increase {to_increase}{'' if same_traversal else ', or has each drive a world of its own?'}"
    )


def _evenly(frames: PosedFrames, count: int) -> PosedFrames:
    """Up to ``count`` frames, evenly in their order: comparing all with all takes minutes where there are many."""
    rows = np.unique(np.linspace(0, len(frames.timestamps) - 1, min(count, len(frames.timestamps))).astype(int))
    times = tuple(frames.timestamps[row] for row in rows)
    return PosedFrames(times, frames.T_world_cam[rows], frames.keyframes & frozenset(times))


def _why_no_step(frames: PosedFrames, steps: Sequence[int]) -> str:
    numbers = np.array(frames.numbers)
    nearest: tuple[int, int] | None = None
    for row in frames.keyframe_rows:
        for other in (row - 1, row + 1):
            if 0 <= other < len(numbers):
                step = int(numbers[other] - numbers[row])
                if nearest is None or abs(step) < abs(nearest[1]):
                    nearest = row, step
    asked = ",".join(map(str, steps))
    span = f"frames {frames.numbers[0]} to {frames.numbers[-1]}, {len(frames.keyframe_rows)} of them keyframes"
    if nearest is None:
        return f"no pair at --pair-step {asked}: there is only one posed frame"
    row, step = nearest
    other = frames.numbers.index(frames.numbers[row] + step)
    T_query_ref = relative_pose(frames.T_world_cam[other], frames.T_world_cam[row])
    return (
        f"no pair at --pair-step {asked} ({span}); the nearest frame to a keyframe is {step:+d} frames away "
        f"({np.linalg.norm(T_query_ref[:3, 3]):.3g} m, {np.degrees(rotation_angle(T_query_ref[:3, :3])):.3g} deg): "
        f"try --pair-step {step}"
    )
