"""How often right trajectories are doubted, and which share of planted faults is found in them.

    python benchmarks/truth/implausible_motion.py TRAJECTORY ... [--wxyz] [--seeds N]

Each trajectory is a file of poses, or KITTI's without times (10 Hz), and right except for what it is known for. It is
judged as it is and thinned (1, 2, 5, 20 poses become one), and in stretches of 6 to 1000 poses. Then faults are planted
at drawn places. A fault is found if exactly the poses that are off are left out; a jump if it is told and both sides
stay; a hole if it is told.
"""

from __future__ import annotations

import argparse
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from relocbench.arrays import Array, Times
from relocbench.datasets.motion.judging import judge
from relocbench.datasets.motion.orientation import doubts_of_axes, likely_order
from relocbench.datasets.motion.worlds import doubt_of_world
from relocbench.datasets.sensors.matrices import parse_matrix
from relocbench.datasets.sensors.pose_tables import read_trajectory
from relocbench.errors import DatasetError
from relocbench.files import read_rows
from relocbench.geometry import invert, make_transform, so3_exp

THINNED = (1, 2, 5, 20)
LENGTHS = (6, 10, 20, 60, 200, 1000)
FIVE = 5


def read(path: Path, order: str) -> tuple[Times, Array]:
    """The times and poses of a trajectory, without those that are outliers as it is."""
    rows = list(read_rows(path, "poses", DatasetError))
    if len(rows[0][1]) == 12:
        poses = np.array([parse_matrix(fields, path, line) for line, fields in rows])
        return np.arange(len(poses), dtype=np.int64) * 100_000_000, poses
    table = read_trajectory(path, order)  # type: ignore[arg-type]
    return table.times_ns, table.transforms


def alarms(times: Times, T: Array, order: str) -> list[str]:
    """What is told of a trajectory, by kind."""
    motion = judge(times, T)
    told = ["outlier"] * len(motion.outliers) + ["jump"] * len(motion.jumps) + ["hole"] * len(motion.holes)
    told += ["refused"] * bool(motion.hopeless) + ["axes"] * len(doubts_of_axes(times, T))
    return told + ["quaternions"] * (len(T) > 5 and likely_order(T, order) != order)  # type: ignore[arg-type]


def shifted(T: Array, first: int, count: int, offset: Array) -> Array:
    """The poses with some of them moved by an offset (3,), or one for each."""
    out = T.copy()
    out[first : first + count, :3, 3] += offset
    return out


def left_out(times: Times, T: Array) -> list[int]:
    return np.flatnonzero(~judge(times, T).kept).tolist()


def planted(times: Times, T: Array, order: str, rng: np.random.Generator) -> Iterator[tuple[str, bool]]:
    """Each fault, planted at a place that is drawn, and whether it is found."""
    count = len(T)
    at = int(rng.integers(3, count - 8))
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    for metres in (3.36e9, 1000.0, 50.0, 10.0, 3.0):
        yield f"one pose {metres:g} m off", left_out(times, shifted(T, at, 1, metres * direction)) == [at]
    for metres in (1000.0, 30.0, 10.0):
        rows = list(range(at, at + FIVE))
        yield f"five poses {metres:g} m off", left_out(times, shifted(T, at, FIVE, metres * direction)) == rows
    scattered = shifted(T, at, FIVE, 1000.0 * rng.normal(size=(FIVE, 3)))
    yield "five poses scattered over 1 km", left_out(times, scattered) == list(range(at, at + FIVE))
    for where, row in (("first", 0), ("last", count - 1)):
        for metres in (3.36e9, 30.0):
            yield f"the {where} pose {metres:g} m off", left_out(times, shifted(T, row, 1, metres * direction)) == [row]
    lost = min(40, count // 5)
    first = min(at, count - lost - 2)
    if min(np.linalg.norm(T[first, :3, 3]), np.linalg.norm(T[first + lost, :3, 3])) > 20.0:
        out = T.copy()
        out[first : first + lost] = np.eye(4)
        yield "identity for up to 40 poses", left_out(times, out) == list(range(first, first + lost))
    some = np.sort(rng.choice(count, max(1, count // 50), replace=False))
    out = T.copy()
    out[some, :3, 3] += rng.normal(size=(len(some), 3)) * 500.0
    yield "2 % of the poses 500 m off", left_out(times, out) == some.tolist()
    out = T.copy()
    out[at, :3, :3] = out[at, :3, :3] @ so3_exp(np.radians(120.0) * direction)
    yield "one rotation 120 deg off", left_out(times, out) == [at]
    if 10 < at < count - 10:
        for metres in (200.0, 10.0, 3.0):
            motion = judge(times, shifted(T, at, count, metres * direction))
            told = at in [jump.index for jump in motion.jumps]
            yield f"all poses from one on {metres:g} m off (told, kept)", told and not motion.outliers
    gap = count // 10
    if gap > 20:
        rows = np.delete(np.arange(count), np.arange(min(at, count - gap - 3), min(at, count - gap - 3) + gap))
        found = judge(times[rows], T[rows])
        yield "a tenth of the poses missing", min(at, count - gap - 3) in found.breaks
    yield "poses in a drawn order", bool(judge(times, T[rng.permutation(count)]).hopeless)
    fast = T.copy()
    fast[:, :3, 3] *= 1000.0
    yield "millimetres for metres", bool(judge(times, fast).hopeless)


def of_vehicles(times: Times, T: Array, order: str, rng: np.random.Generator) -> Iterator[tuple[str, bool]]:
    """Faults that only drives of vehicles show."""
    other = "xyzw" if order == "wxyz" else "wxyz"
    from scipy.spatial.transform import Rotation

    quaternions = Rotation.from_matrix(T[:, :3, :3]).as_quat()
    turned = T.copy()
    turned[:, :3, :3] = Rotation.from_quat(quaternions[:, [3, 0, 1, 2]]).as_matrix()
    yield "quaternions in another order", likely_order(turned, "xyzw") == "wxyz" or other == order
    yield "poses inverted", any("inverted" in doubt for doubt in doubts_of_axes(times, invert(T)))
    own = make_transform(so3_exp([0.0, 0.0, np.radians(30.0)]), rng.normal(size=3) * 5.0) @ T
    query = dict(zip(times.tolist(), own, strict=True))
    yield "a world turned by 30 deg", bool(doubt_of_world(dict(zip(times.tolist(), T, strict=True)), query))
    at = int(rng.integers(10, max(11, len(T) * 3 // 4)))
    out = T.copy()
    out[at : at + len(T) // 20, :3, :3] = out[at : at + len(T) // 20, :3, :3] @ so3_exp(np.radians([0.0, 90.0, 0.0]))
    told = bool(doubts_of_axes(times, out)) or bool(judge(times, out).jumps or judge(times, out).outliers)
    yield "a twentieth of the rotations 90 deg off", told


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("trajectories", nargs="+", type=Path)
    parser.add_argument("--wxyz", action="store_true", help="quaternions have their real part first")
    parser.add_argument("--vehicle", action="store_true", help="the trajectories are those of a vehicle")
    parser.add_argument("--seeds", type=int, default=5)
    asked = parser.parse_args()
    order = "wxyz" if asked.wxyz else "xyzw"
    shares: dict[str, list[bool]] = defaultdict(list)
    rng = np.random.default_rng(0)
    for path in asked.trajectories:
        times, T = read(path, order)
        for thin in THINNED:
            told = alarms(times[::thin], T[::thin], order)
            print(f"{path.name}, every {thin}: {len(times[::thin])} poses, alarms: {', '.join(told) or 'none'}")
        kept = judge(times, T).kept
        times, T = times[kept], T[kept]
        before: Counter[str] = Counter()
        stretches = 0
        for length in (n for n in LENGTHS if n <= len(T)):
            for start in rng.integers(0, len(T) - length + 1, 20):
                stretches += 1
                rows = slice(start, start + length)
                before.update(set(alarms(times[rows], T[rows], order)))
        kinds_told = ", ".join(f"{kind} in {count}" for kind, count in before.items())
        print(f"{path.name}: alarms in {stretches} stretches: {kinds_told or 'none'}")
        kinds: list[Callable[..., Iterator[tuple[str, bool]]]] = [planted, *([of_vehicles] if asked.vehicle else [])]
        for thin in THINNED[:3]:
            if len(times[::thin]) < 40 or judge(times[::thin], T[::thin]).breaks:
                continue
            for _ in range(asked.seeds):
                for kind in kinds:
                    for name, found in kind(times[::thin], T[::thin], order, rng):
                        shares[name].append(found)
    print("\n| planted | found |\n|---|---|")
    for name, found in shares.items():
        print(f"| {name} | {sum(found)} of {len(found)} |")


if __name__ == "__main__":
    main()
