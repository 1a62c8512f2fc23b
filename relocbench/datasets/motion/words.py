"""What is implausible about the poses of a drive, in words: for notes of importers and faults of datasets alike."""

from __future__ import annotations

from collections.abc import Callable

from relocbench.datasets.motion.holes import Hole
from relocbench.datasets.motion.jumps import Jump
from relocbench.datasets.motion.outliers import Outlier


def outlier_words(one: Outlier, row: Callable[[int], str]) -> str:
    """How far poses are off, said of the first of them.

    Args:
        row: names the pose of a row, such as ``line 7``.
    """
    poses = "this pose is" if one.first == one.last else f"{one.last - one.first + 1} poses, to {row(one.last)}, are"
    ends = [row(end) for end in (one.before, one.after) if end is not None]
    way = f"the way between those of {' and '.join(ends)}" if len(ends) == 2 else f"the way from that of {ends[0]}"
    angle = f" and {one.degrees:.0f} deg" if one.degrees >= 1 else ""
    return f"{poses} {distance(one.metres)}{angle} off {way}"


def jump_words(jump: Jump) -> str:
    """How far poses jump, said of the pose after it."""
    return f"the poses jump by {distance(jump.metres)} and {jump.degrees:.1f} deg here"


def hole_words(hole: Hole) -> str:
    """How long there are no poses, said of the pose after it."""
    return (
        f"there is no pose in the {hole.seconds:.3g} s and {distance(hole.metres)} before this one, and most steps "
        f"take {hole.usual_s:.2g} s"
    )


def distance(metres: float) -> str:
    """Metres, or kilometres, with three digits."""
    return f"{metres / 1000:,.0f} km" if metres >= 10_000 else f"{metres:.3g} m"
