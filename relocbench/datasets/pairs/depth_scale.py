"""The factor between the unit of depth images and that of the poses, from the depth of posed neighbours.

If depth is a factor s too small, a pixel p of frame i with the depth D_i(p) is the point ``s D_i(p) K^-1 p``. Moved by
the true pose into frame j, it has the depth z(s) there and is seen by the pixel u(s), which wanders along a line as s
varies. At the right s, the surface that frame j measured is the same:

    s D_j(u(s)) = z(s)

The share of pixels that agree, as a function of s, has one peak if the camera moved enough for the distance of what it
saw and the surfaces are not alike at every scale, as a plane along the motion is. Where there is no such peak, nothing
is told: for large s motion does not count and neighbours agree whatever s is, for small s they see nothing in common.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from relocbench.arrays import Array, Floats
from relocbench.datasets.pairs.visibility import lift, sample_depth
from relocbench.geometry import Camera, apply, invert

_LARGEST = 3000.0
"""factor up to which scales are tried, either way: that of metres and millimetres, and more"""
_STEP = 0.05
"""between the logarithms of scales"""
_AGREES = 0.03
"""difference of the logarithms of two depths from which they do not agree at all; agreement falls linearly up to it"""
_POINTS = 300
"""pixels of a frame that are compared"""
_FEWEST_POINTS = 40
_ANCHORS, _DISTANCES = 5, 8
"""frames, and distances to others, of which pairs are made"""
_NEAREST = 1e-3
"""shortest distance as a share of the longest"""
_SAME_VIEW = float(np.cos(np.radians(30.0)))
"""of the angle between two optical axes"""
_MOST_PAIRS = 30
_ENOUGH = 4
"""pairs that agree, after which no more are looked at"""
_FEWEST_PAIRS = 3
_ALIKE = 0.2
"""greatest difference of the logarithms of two factors that are alike"""
_MOST_UNLIKE = 0.25
"""share of pairs whose factor may be another one"""
_DECIDED = 0.1
"""difference of the agreement at two factors from which a pair speaks for one of them"""
_CLEAR = 0.3
"""agreement that a peak must have"""
_SHOULDER, _WIDEST = 0.75, float(np.log(2.2))
"""all scales with this share of the peak's height lie within this width, or there is no peak"""
_TOP = 0.9
"""share of the height from which the middle of a peak is taken"""
_NOTICED = float(np.log(1.25))
"""logarithm of a factor from which depth contradicts the poses; the depth of some sensors is wrong by some percent"""
_BETTER = 1.5
"""times that agreement must be that as given"""
_UNITS = {
    **{"1 m": 1.0, "1 cm": 0.01, "1/256 m": 1 / 256, "1 mm": 1e-3, "1/4000 m": 1 / 4000, "1/5000 m": 1 / 5000},
    "1/6553.5 m": 1 / 6553.5,
}
"""units that depth images have"""
_MIXED = {
    "millimetres taken for metres?": 1e-3,
    "poses in millimetres?": 1e3,
    "poses in centimetres?": 1e2,
    "depth in feet?": 0.3048,
    "poses in feet?": 1 / 0.3048,
}
"""factors of units that are confused"""
_LIKE = 0.08
"""difference of the logarithms of a factor and that of a known unit"""
_IN_VIEW = 0.25
"""share of pixels in the other frame's view from which their agreement counts in full"""
_USEFUL_BASELINE = 0.2
"""of the distance of what is seen; pairs near it are tried first"""


@dataclass(frozen=True, eq=False)
class DepthFrame:
    """A posed frame whose depth can be read."""

    camera: Camera
    """pinhole"""
    T_world_cam: Array
    """(4, 4)"""
    read: Callable[[], Floats]
    """depth (H, W) along z, 0 where unknown"""


@dataclass(frozen=True)
class DepthScale:
    """What the depth of posed neighbours says of its scale."""

    factor: float
    """by which depth has to be multiplied to be in the unit of the poses"""
    pairs: int
    """pairs of frames that agree about it"""
    agreement: float
    """median share of pixels whose depth agrees at this factor"""
    agreement_as_given: float
    """that at the factor 1"""

    @property
    def contradicts(self) -> bool:
        """Whether depth cannot be in the unit of the poses."""
        return abs(float(np.log(self.factor))) > _NOTICED and self.agreement > _BETTER * self.agreement_as_given

    def words(self, what: str, metres_per_unit: float = 1.0) -> str:
        """What contradicts the poses, and which unit would not.

        Args:
            what: what says the unit of depth.
            metres_per_unit: the unit that it says.
        """
        size, way = max(self.factor, 1 / self.factor), "small" if self.factor > 1 else "large"
        hints = []
        unit = metres_per_unit * self.factor
        if metres_per_unit != 1.0:
            hints += [f"{name} a unit?" for name, metres in _UNITS.items() if abs(np.log(unit / metres)) < _LIKE]
        hints += [words for words, factor in _MIXED.items() if abs(np.log(self.factor / factor)) < _LIKE]
        return (
            f"{what} looks {size:.3g} times too {way} for the poses{f' ({chr(32).join(hints)})' if hints else ''}: so "
            f"scaled, the depth of {self.pairs} pairs of neighbouring frames agrees by {100 * self.agreement:.0f} %, "
            f"as it is by {100 * self.agreement_as_given:.0f} %"
        )


def depth_scale(frames: Sequence[DepthFrame]) -> DepthScale | None:
    """Estimate the factor by which depth is too small for the poses; None if it cannot be told.

    Reads the depth of at most some tens of frames.

    Raises:
        DatasetError: a depth image is damaged.
    """
    known: dict[int, Floats] = {}

    def depth(index: int) -> Floats:
        if index not in known:
            known[index] = frames[index].read()
        return known[index]

    told: list[tuple[float, Array]] = []
    looked: list[Array] = []
    for number, (i, j) in enumerate(_pairs(frames, depth)):
        if number == _MOST_PAIRS:
            break
        curve = _agreement(frames[i], depth(i), frames[j], depth(j))
        looked.append(curve)
        factor = _peak(curve)
        if factor is None:
            continue
        told.append((factor, curve))
        alike = _alike([factor for factor, _ in told])
        if len(alike) >= _ENOUGH and len(alike) == len(told):
            break
    if not told:
        return None
    alike = _alike([factor for factor, _ in told])
    if len(alike) < _FEWEST_PAIRS or len(alike) < (1 - _MOST_UNLIKE) * len(told):
        return None
    factor = float(np.exp(np.median(np.log([told[k][0] for k in alike]))))
    at = int(np.argmin(np.abs(_LOGS - np.log(factor))))
    better = np.array([_near(curve, at) - _near(curve, _AS_GIVEN) for curve in looked])
    decided = better[np.abs(better) > _DECIDED]
    if len(decided) and np.mean(np.sign(decided)) < 1 - 2 * _MOST_UNLIKE:
        return None
    return DepthScale(
        factor,
        len(alike),
        float(np.median([_near(told[k][1], at) for k in alike])),
        float(np.median([_near(told[k][1], _AS_GIVEN) for k in alike])),
    )


_LOGS: Array = np.arange(-np.ceil(np.log(_LARGEST) / _STEP), np.ceil(np.log(_LARGEST) / _STEP) + 1) * _STEP
_AS_GIVEN = len(_LOGS) // 2
"""place of the factor 1 among the scales"""


def _near(curve: Array, at: int) -> float:
    """The agreement at a scale, or beside it."""
    return float(curve[max(0, at - 1) : at + 2].max())


def _pairs(frames: Sequence[DepthFrame], depth: Callable[[int], Floats]) -> Iterator[tuple[int, int]]:
    """Pairs of frames that look alike, at distances of all orders, those of a useful baseline first."""
    places = np.array([frame.T_world_cam[:3, 3] for frame in frames]).reshape(-1, 3)
    axes = np.array([frame.T_world_cam[:3, 2] for frame in frames]).reshape(-1, 3)
    found: dict[tuple[int, int], float] = {}
    for i in np.unique(np.linspace(0, len(frames) - 1, _ANCHORS).astype(int)).tolist() if frames else []:
        apart = np.linalg.norm(places - places[i], axis=1)
        near = np.flatnonzero((axes @ axes[i] >= _SAME_VIEW) & (apart > 0) & np.isfinite(apart))
        seen = depth(i)
        seen = seen[seen > 0]
        if not near.size or len(seen) < _FEWEST_POINTS:
            continue
        longest = float(apart[near].max())
        useful = _USEFUL_BASELINE * float(np.median(seen))
        for distance in np.geomspace(longest * _NEAREST, longest, _DISTANCES):
            j = int(near[np.argmin(np.abs(np.log(apart[near] / distance)))])
            if (j, i) not in found:  # which would tell the same once more
                found.setdefault((i, j), abs(float(np.log(apart[j] / useful))))
    yield from sorted(found, key=lambda pair: found[pair])


def _agreement(one: DepthFrame, depth_one: Floats, other: DepthFrame, depth_other: Floats) -> Array:
    """The share of pixels of a frame whose depth agrees with that of another, for each of the scales."""
    v, u = np.nonzero(depth_one)
    chosen = np.unique(np.linspace(0, len(u) - 1, _POINTS).astype(int)) if len(u) else np.zeros(0, dtype=int)
    points, valid = lift(one.camera, np.column_stack([u, v])[chosen], depth_one[v, u][chosen])
    points = points[valid]
    if len(points) < _FEWEST_POINTS:
        return np.zeros(len(_LOGS))
    T_other_one = invert(other.T_world_cam) @ one.T_world_cam
    scaled = np.exp(_LOGS)[:, None, None] * points
    moved = apply(T_other_one, scaled.reshape(-1, 3))
    pixels, inside = other.camera.project(moved)
    inside &= other.camera.contains(pixels, border=-1e-6) & (moved[:, 2] > 0)
    rows = np.flatnonzero(inside)
    smooth, around, known = sample_depth(depth_other, pixels[rows])
    with np.errstate(invalid="ignore", divide="ignore"):
        expected = np.log(moved[rows, 2] / np.repeat(np.exp(_LOGS), len(points))[rows])
        surface = np.where(np.isfinite(smooth)[:, None], smooth[:, None], around)
        apart = np.nanmin(np.abs(np.log(surface) - expected[:, None]), axis=1, initial=_AGREES)
    in_view, agreeing = np.zeros(len(inside), dtype=bool), np.zeros(len(inside))
    in_view[rows], agreeing[rows] = known, 1.0 - apart / _AGREES
    shape = len(_LOGS), len(points)
    compared = in_view.reshape(shape).sum(axis=1)
    return np.asarray(agreeing.reshape(shape).sum(axis=1) / np.maximum(compared, _IN_VIEW * len(points)))


def _peak(curve: Array) -> float | None:
    """The scale at which pixels agree, if they do at one scale only."""
    if curve.max() < _CLEAR:
        return None
    high = np.flatnonzero(curve >= _SHOULDER * curve.max())
    if _LOGS[high[-1]] - _LOGS[high[0]] > _WIDEST:
        return None
    weight = np.maximum(curve - _TOP * curve.max(), 0.0)
    return float(np.exp(np.sum(weight * _LOGS) / np.sum(weight)))


def _alike(factors: Sequence[float]) -> list[int]:
    """Which factors are like their median."""
    logs = np.log(factors)
    return np.flatnonzero(np.abs(logs - np.median(logs)) <= _ALIKE).tolist()
