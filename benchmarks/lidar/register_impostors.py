"""Attacks on the verdict of ``relocbench register``: how many wrong poses are trusted, and how many right ones refused.

``search``: pairs of clouds with known poses are registered. ``perturbed``: the registration starts at the true pose
moved by 0.3, 1 and 3 m, by one period of 4.8 m along and across, and turned by 180 degrees, and may end wherever its
refinement leads. ``impostors``: clouds of different places, which no pose is right for.

The pairs are those of ``register_clouds.py``, and scans of KITTI 00 a few metres apart, of which one is turned around,
has every second point only, and lost one side, as a scan of the way back does.

A pose within 0.3 m and 1 deg is right, in scenes smaller than a street within 3 cm and 1 deg; of KITTI 00, whose
reference has no rotation, within 0.3 m and 3 deg.

    python benchmarks/lidar/register_impostors.py [--seeds 7101,7102] [--parts street,...] [--data DIR]

A table goes to standard error; the last line of standard output is JSON. A wrong pose that is trusted is named, and the
exit code is then 1.
"""

# ruff: noqa: E402  (the number of threads must be set before numpy is imported)
from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1"  # so that the order of sums does not depend on the machine

import argparse
import json
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from register_clouds import DATA, SIMULATED, say
from register_real import real_pairs
from register_scenes import Pair

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.clouds.cloud import Cloud, cloud_of_file
from relocbench.datasets.groundtruth.clouds.judging import free_space_known
from relocbench.datasets.groundtruth.clouds.preparing import PreparedCloud, prepare
from relocbench.datasets.groundtruth.clouds.search import SearchOptions, search
from relocbench.datasets.groundtruth.registration.global_registration import pose_difference
from relocbench.datasets.groundtruth.registration.scene_scale import SceneScale, scale_of, scene_size
from relocbench.datasets.sensors.cloud_files import read_cloud
from relocbench.geometry import apply, invert, make_transform, so3_exp

SIMULATED_PARTS = ("street", "reverse", "periodic", "submaps", "room", "merged")
REAL_PARTS = ("kitti 00", "newer college", "kitti 07", "tum rgbd")
_ALONG_M = (0.0, 0.689, 1.382, 2.100, 2.832, 3.576)
"""metres along the x axis of scans 0 to 5 of KITTI 00, see real_clouds_kitti.py"""


class Judged:
    """A pair that is prepared once, to be registered from several starts."""

    def __init__(self, pair: Pair, loose: bool = False) -> None:
        self.pair, self.loose = pair, loose
        self.scale: SceneScale = scale_of([scene_size(cloud.points) for cloud in (pair.a, pair.b)])
        a, b = (prepare(cloud, self.scale).prepared for cloud in (pair.a, pair.b))
        self.sides: tuple[PreparedCloud, PreparedCloud] = (a, b)
        if not (a.sees and b.sees):
            self.sides = a.judged_by_points(), b.judged_by_points()

    def verdict(self, start: Array | None = None) -> tuple[str, str]:
        """``trusted`` or ``refused`` and ``right`` or ``wrong``, and the reason; by a search, or from a start."""
        a, b = self.sides
        options = SearchOptions(initial=None if start is None else self._to_nodes(start))
        result = search(a, b, self.scale, free_space_known(a.sees, b.sees), options)
        said = "refused" if result.reason else "trusted"
        return f"{said} {'right' if result.best is not None and self._right(result.best.T_a_b) else 'wrong'}", (
            result.reason
        )

    def _to_nodes(self, T_a_b: Array) -> Array:
        a, b = self.sides
        return np.asarray(invert(a.T_cloud_node) @ self.scale.enlarged(T_a_b) @ b.T_cloud_node)

    def _right(self, T_nodes: Array) -> bool:
        if not np.isfinite(self.pair.T_a_b).all():
            return False
        metres, degrees = pose_difference(self._to_nodes(self.pair.T_a_b), T_nodes)
        limit_m = 0.3 if self.scale.factor <= 2 else 0.03
        return metres / self.scale.factor <= limit_m and degrees <= (3.0 if self.loose else 1.0)


def perturbed(pair: Pair, seed: int, size: float) -> Iterator[tuple[str, Array]]:
    """The true pose moved by distances of a street, times ``size``, and turned around."""
    rng = np.random.default_rng(seed)
    for metres in (0.3, 1.0, 3.0):
        turn = rng.uniform(0, 2 * np.pi)
        yield f"{metres:g} m", moved(pair, [metres * np.cos(turn), metres * np.sin(turn), 0], size)
    yield "period along", moved(pair, [4.8, 0, 0], size)
    yield "period across", moved(pair, [0, -4.8, 0], size)
    yield "turned", pair.T_a_b @ make_transform(so3_exp([0, 0, np.pi]), np.zeros(3))


def moved(pair: Pair, by: list[float], size: float) -> Array:
    return np.asarray(make_transform(np.eye(3), size * np.array(by)) @ pair.T_a_b)


def kitti_00(data: Path) -> Iterator[tuple[str, Pair]]:
    """Scans as they are, and as on the way back: turned around, thinned, and without what lay on the right."""
    files = sorted((data / "kitti_odometry" / "sequences" / "00" / "velodyne").glob("*.bin"))
    clouds = [cloud_of_file(read_cloud(file)) for file in files]
    around = make_transform(so3_exp([0, 0, np.pi]), np.zeros(3))
    for i, j in ((0, 3), (0, 5), (2, 5), (1, 4)):
        T = make_transform(np.eye(3), [_ALONG_M[j] - _ALONG_M[i], 0, 0])
        yield f"{i}-{j}", Pair(clouds[i], clouds[j], T)
        points = clouds[j].points[::2]
        points = points[points[:, 1] > -0.3 * np.abs(points[:, 0]) - 4.0]
        back = Cloud("back", apply(around, points), np.zeros_like(points), supposed=True)
        yield f"{i}-{j} back", Pair(clouds[i], back, np.asarray(T @ around))


def pairs_of(part: str, seeds: list[int], data: Path) -> list[tuple[str, Pair]]:
    if part in SIMULATED:
        return [(str(seed), SIMULATED[part](seed)) for seed in seeds]
    if part == "kitti 00":
        return list(kitti_00(data)) if (data / "kitti_odometry").is_dir() else []
    return list(real_pairs(part, data) or [])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the real recordings")
    parser.add_argument("--seeds", default="7101,7102", help="seeds of the simulated scenes")
    parser.add_argument("--parts", default=",".join([*SIMULATED_PARTS, *REAL_PARTS]), help="parts to run")
    arguments = parser.parse_args()
    seeds = [int(seed) for seed in arguments.seeds.split(",")]
    counts: dict[str, Counter[str]] = {kind: Counter() for kind in ("search", "perturbed", "impostors")}

    def count(kind: str, name: str, judged: Judged, start: Array | None = None) -> None:
        verdict, reason = judged.verdict(start)
        counts[kind][verdict] += 1
        say(f"{kind:10s} {name:34s} {verdict:14s} {reason}")

    firsts: list[tuple[str, str, Pair]] = []
    for part in arguments.parts.split(","):
        pairs = pairs_of(part, seeds, arguments.data)
        firsts += [(part, name, pair) for name, pair in pairs[:2]]
        for k, (name, pair) in enumerate(pairs):
            judged = Judged(pair, part == "kitti 00")
            count("search", f"{part} {name}", judged)
            if k < 2 and np.isfinite(pair.T_a_b).all():
                for how, start in perturbed(pair, k, 1.0 if judged.scale.factor <= 2 else 1 / judged.scale.factor):
                    count("perturbed", f"{part} {name} {how}", judged, start)
    for (one, first, a), (other, second, b) in zip(firsts, firsts[1:] + firsts[:1], strict=True):
        if one != other:  # two pairs of one part may show the same place
            judged = Judged(Pair(a.a, b.b, np.full((4, 4), np.nan)))
            count("impostors", f"{one} {first} - {other} {second}", judged)
    table = {kind: dict(sorted(counter.items())) for kind, counter in counts.items()}
    for kind, row in table.items():
        say(f"{kind:10s} " + ", ".join(f"{verdict} {n}" for verdict, n in row.items()))
    print(json.dumps({"benchmark": "register_impostors", "seeds": seeds, **table}))
    return int(any(counter["trusted wrong"] for counter in counts.values()))


if __name__ == "__main__":
    sys.exit(main())
