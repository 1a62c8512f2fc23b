"""Parts of ``ground_truth.py`` about single stages: starts, ablation, speed and long roads."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from ground_truth_drives import EXTENT_M, T_RIG_CAM, Leg, Spoken, read_legs, record_legs
from ground_truth_judging import WRONG_DEG, WRONG_M, Exact, Judged, figures, table
from ground_truth_plain import AloneUnit, open3d_chain, open3d_pairs, own_pairs
from ground_truth_work import (
    CutUnit,
    Decided,
    DecideUnit,
    Registered,
    RegisterUnit,
    Spent,
    StartUnit,
    by_registrations_alone,
    cut,
    decide,
    part_of,
    register_drive,
    start,
    without_gnss,
)
from ground_truth_world import OPTIONS, DrivePair, World, apart, judge, rounded, say

from relocbench.arrays import Array
from relocbench.datasets.groundtruth.alignment.two_drives import FirstPose, RegistrationUnit
from relocbench.datasets.groundtruth.pairs.outcome import PairOutcome
from relocbench.datasets.groundtruth.pairs.pairing import CameraFrames
from relocbench.datasets.groundtruth.recipe.chain import ChainUnit
from relocbench.geometry import invert, make_transform, so3_exp

ABLATED: tuple[DrivePair, ...] = ((0, 3), (5, 6), (0, 8))
START_PAIRS: tuple[DrivePair, DrivePair] = ((0, 3), (5, 6))
"""a common street, and repeating facades"""
ALONE = 8
"""number of single pairs of each drive in the ablation"""
PLAIN = 4
"""number of pairs of the plain recipe, on the first drive of the ablation"""
CHAINED = 5
"""every so many query images are paired by the plain recipe along a drive"""
LONG_M = (1000, 4000)
_START_NODES = 50


@dataclass(frozen=True, eq=False)
class Start:
    """One kind of start."""

    title: str
    pair: DrivePair
    gnss: bool
    T_wrong: Array | None = None
    """(4, 4) error, in the reference's axes, of a pose that is given by hand; the identity is a correct pose"""

    @property
    def is_wrong(self) -> bool:
        return self.T_wrong is not None and not np.array_equal(self.T_wrong, np.eye(4))


def start_cases(period_m: float) -> list[Start]:
    """The starts without a given pose, and with correct and wrong ones."""
    common, repeating = START_PAIRS
    turned = make_transform(so3_exp(np.array([0.0, 0.0, np.pi])), np.zeros(3))
    further, period = (make_transform(np.eye(3), [metres, 0.0, 0.0]) for metres in (15.0, period_m))
    return [
        Start("nothing known", common, False),
        Start("nothing known, repeating facades", repeating, False),
        Start("right by hand, no GNSS", common, False, np.eye(4)),
        Start("15 m along the street by hand", common, True, further),
        Start("turned by 180 deg by hand", common, True, turned),
        Start("a period along by hand, repeating facades", repeating, True, period),
    ]


def _start_unit(world: World, case: Start) -> StartUnit:
    """The middle 100 m of the query's drive, where its route differs from the others."""
    ref, query = case.pair
    a, b = world.drives[ref], world.drives[query]
    middle = len(b.nodes) // 2
    part = part_of(b, middle - _START_NODES // 2, middle + _START_NODES // 2)
    first: FirstPose | None = None
    if case.T_wrong is not None:
        query_ns = int(part.nodes.times_ns[_START_NODES // 2])
        ref_ns = world.exact(ref, query).overlap(query_ns)[2]
        first = ref_ns, query_ns, case.T_wrong @ world.true_pose(ref, query, ref_ns, query_ns)
    return StartUnit(case.title, a if case.gnss else without_gnss(a), part, first, OPTIONS.alignment)


def starts(world: World, period_m: float) -> list[dict[str, Any]]:
    """Print whether registrations begin at the right place, without and with given poses."""
    cases = start_cases(period_m)
    units = [_start_unit(world, case) for case in cases]
    rows = []
    for case, unit, (found, messages, spent) in zip(
        cases, units, world.all_of(start, units, "starts to try"), strict=True
    ):
        times = unit.reference.nodes.times_ns, unit.query.nodes.times_ns
        off = [
            apart(r.T_ref_query, world.true_pose(*case.pair, int(times[0][r.ref]), int(times[1][r.query])))
            for r in found
            if r.trusted
        ]
        refused = any("does not hold" in message for message in messages)
        right = bool(off) and max(off)[0] <= WRONG_M and max(degrees for _, degrees in off) <= WRONG_DEG
        rows.append(
            {
                "case": case.title, "tried": len(found), "trusted": len(off),
                "largest_m": round(max(off)[0], 3) if off else None, "refused_by_hand": refused,
                "as_it_should": right and refused == case.is_wrong, "cpu_s": round(spent.cpu_s, 1),
            }
        )  # fmt: skip
    say("\n| start | trusted | largest error | prior by hand | as it should | CPU |\n|---|---|---|---|---|---|")
    for case, row in zip(cases, rows, strict=True):
        by_hand = "-" if case.T_wrong is None else "refused" if row["refused_by_hand"] else "taken"
        say(
            f"| {row['case']} | {row['trusted']} of {row['tried']} | {row['largest_m']} m | {by_hand} | "
            f"{'yes' if row['as_it_should'] else 'NO'} | {row['cpu_s']} s |"
        )
    return rows


def ablation(
    world: World,
    registered: dict[DrivePair, Registered],
    decided: dict[DrivePair, Decided],
    plain: Sequence[Judged],
) -> dict[str, Any]:
    """Print the results of one stage after the other on the same pairs."""
    pairs = [p for p in ABLATED if p in decided]
    loose = world.all_of(register_drive, [world.register_unit(*p, verified=False) for p in pairs], "without verifying")
    units = [AloneUnit(world.drives[r], world.drives[q], tuple(world.node_pairs(r, q, ALONE)), OPTIONS.alignment)
             for r, q in pairs]  # fmt: skip
    alone = world.all_of(own_pairs, units, "drives with pairs on their own")
    chains = world.all_of(open3d_chain, [chain_unit(world, *p) for p in pairs], "drives by --recipe open3d")
    stages: dict[str, list[Judged]] = {
        "pairs on their own, plain Open3D": list(plain),
        "pair after pair, plain Open3D (--recipe open3d)": [],
        "pairs on their own": [],
        "+ propagation": [],
        "+ verification": [],
        "+ pose graph": [],
        "+ local edges (the builder)": [],
    }
    for p, unit, answers, unchecked, (chained, _) in zip(pairs, units, alone, loose, chains, strict=True):
        drives = world.drives[p[0]], world.drives[p[1]]
        asked = [(o.ref_timestamp_ns, o.query_timestamp_ns) for o in decided[p].outcomes]
        stages["pair after pair, plain Open3D (--recipe open3d)"] += judge(world, p, chained)
        stages["pairs on their own"] += judge(world, p, at_nodes(unit, [T for T, _, _ in answers]))
        for name, found in (("+ propagation", unchecked), ("+ verification", registered[p])):
            said = by_registrations_alone(*drives, found.registrations, asked, OPTIONS.limits_at(1.0))
            stages[name] += judge(world, p, said)
        stages["+ pose graph"] += judge(world, p, decided[p].without_local)
        stages["+ local edges (the builder)"] += judge(world, p, decided[p].outcomes)
    told = {name: figures(rows) for name, rows in stages.items() if rows}
    titles = "; ".join(world.taken[q].leg.title for _, q in pairs)
    say(f"\n{table(f'stage ({titles})', told.items())}")
    seconds, count = sum(spent.cpu_s for _, spent in chains), sum(len(chained) for chained, _ in chains)
    say(f"\n--recipe open3d: {seconds / count:.2f} s of processor time a pair")
    return {name: rounded(f) for name, f in told.items()}


def chain_unit(world: World, ref: int, query: int) -> ChainUnit:
    """The plain recipe on a part of the images of two drives."""
    times = world.taken[ref].image_ns, world.taken[query].image_ns[::CHAINED]
    recordings = [world.drives[n].recording for n in (ref, query)]
    return ChainUnit(
        recordings[0], recordings[1], CameraFrames("front", T_RIG_CAM, T_RIG_CAM, *times),
        OPTIONS.submap, OPTIONS.max_distance, OPTIONS.max_angle,
    )  # fmt: skip


def at_nodes(unit: AloneUnit, poses: Sequence[Array]) -> list[PairOutcome]:
    """Answers ``T_ref_query`` between nodes, as pairs of cameras."""
    out = []
    for (ref, query), T in zip(unit.nodes, poses, strict=True):
        T_query_ref = invert(T @ T_RIG_CAM) @ T_RIG_CAM if np.isfinite(T).all() else None
        ref_ns, query_ns = int(unit.reference.nodes.times_ns[ref]), int(unit.query.nodes.times_ns[query])
        reason = "" if T_query_ref is not None else "nothing found"
        out.append(PairOutcome(ref_ns, query_ns, T_query_ref, None, None, None, None, None, reason))
    return out


def speed(
    world: World, registered: dict[DrivePair, Registered], decided: dict[DrivePair, Decided],
    rows: dict[DrivePair, list[Judged]],
) -> tuple[dict[str, Any], list[Judged]]:  # fmt: skip
    """Print the processor seconds per pair of all stages of the builder and of the plain recipe."""
    pair = next((p for p in ABLATED if p in decided), next(iter(decided)))
    nodes = world.node_pairs(*pair, PLAIN)
    units = [AloneUnit(world.drives[pair[0]], world.drives[pair[1]], (n,), OPTIONS.alignment) for n in nodes]
    answers = [answer for found in world.all_of(open3d_pairs, units, "pairs by the plain recipe") for answer in found]
    whole = replace(units[0], nodes=tuple(nodes))
    plain = judge(world, pair, at_nodes(whole, [T for T, _, _ in answers]))
    same = [min((r for r in rows[pair] if r.accepted), key=lambda r: abs(r.query_ns - p.query_ns)) for p in plain]
    plain_s = float(np.mean([spent.cpu_s for _, spent, _ in answers]))
    say("\n| CPU seconds a pair | blocks of both drives | registration | graph and outcomes | all | pairs |")
    say("|---|---|---|---|---|---|")
    each = {}
    for p in rows:
        parts = cost_parts(world.cut_spent[p[0]], world.cut_spent[p[1]], registered[p].spent, decided[p].spent)
        count = len(decided[p].outcomes)
        each[world.taken[p[1]].leg.title] = sum(parts) / count
        cells = " | ".join(f"{v / count:.2f}" for v in (*parts, sum(parts)))
        say(f"| {world.taken[p[1]].leg.title} | {cells} | {count} |")
    ours = each[world.taken[pair[1]].leg.title]
    reg = registered[pair]
    per_registration = (ours * len(decided[pair].outcomes)) / len(reg.registrations)
    say(f"\n| {world.taken[pair[1]].leg.title} | CPU a pair | median | largest |\n|---|---|---|---|")
    for name, cost, judged in (("plain Open3D", plain_s, plain), ("the builder, same places", ours, same)):
        m, d = [r.error_m for r in judged], [r.error_deg for r in judged]
        middle, most = f"{np.median(m):.3f} m, {np.median(d):.3f} deg", f"{max(m):.3f} m, {max(d):.3f} deg"
        say(f"| {name} | {cost:.2f} s | {middle} | {most} |")
    points = np.mean([count for _, _, count in answers])
    say(
        f"\n{plain_s / ours:.1f} times as fast a pair; {plain_s / per_registration:.1f} times a registered submap "
        f"({per_registration:.2f} s); plain recipe on {points:.0f} points of two submaps"
    )
    spent = [*world.cut_spent.values(), *(r.spent for r in registered.values()), *(d.spent for d in decided.values())]
    return {
        "cpu_s_a_pair": round(ours, 3), "plain_cpu_s_a_pair": round(plain_s, 2), "ratio": round(plain_s / ours, 1),
        "ratio_a_registration": round(plain_s / per_registration, 1),
        "plain_median_m": round(float(np.median([r.error_m for r in plain])), 4),
        "median_m": round(float(np.median([r.error_m for r in same])), 4),
        "each": {k: round(v, 3) for k, v in each.items()}, "peak_mib": round(max(s.peak_mib for s in spent)),
    }, plain  # fmt: skip


def cost_parts(ref: Spent, query: Spent, register: Spent, decide: Spent) -> tuple[float, float, float]:
    return ref.cpu_s + query.cpu_s, register.cpu_s, decide.cpu_s


def long_road(work: Path, split: str, seed: int, workers: int, spoken: Spoken) -> list[dict[str, Any]]:
    """Print time and memory for two lengths of road, with every stage in a new process.

    The district has about 4 km of streets, so that the longer drive passes some of them more than once.
    """
    rows: list[dict[str, Any]] = []
    legs = (Leg(0, "Sunny", "common"), Leg(1, "Snow", "common"))
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), max_tasks_per_child=1) as pool:
        for metres in LONG_M:
            at = work / f"long-{metres}"
            folders = record_legs(legs, at / "recording", split, seed, 2 * metres, EXTENT_M, spoken, workers)
            taken = read_legs(legs, folders)
            units = [CutUnit(t.recording, at / "blocks" / t.recording.name, OPTIONS.alignment) for t in taken.values()]
            spoken.note(f"{metres} m: cutting")
            (a, cut_a), (b, cut_b) = pool.map(cut, units)
            spoken.note(f"{metres} m: registering")
            path = at / "registrations" / f"{a.name}__{b.name}.csv"
            found = pool.submit(register_drive, RegisterUnit(RegistrationUnit(a, b, OPTIONS.alignment), path)).result()
            spoken.note(f"{metres} m: solving")
            unit = DecideUnit(a, b, found.registrations, taken[0].image_ns, taken[1].image_ns, OPTIONS.alignment,
                              OPTIONS.limits_at(1.0), OPTIONS.max_angle)  # fmt: skip
            answers = pool.submit(decide, unit).result()
            exact = Exact(taken[0], taken[1], OPTIONS.max_distance, OPTIONS.max_angle)
            told = figures([exact.judge(o) for o in answers.outcomes])
            parts = cost_parts(cut_a, cut_b, found.spent, answers.spent)
            peaks = [max(cut_a.peak_mib, cut_b.peak_mib), found.spent.peak_mib, answers.spent.peak_mib]
            count = len(answers.outcomes)
            row = {
                "metres": metres,
                "pairs": count,
                "cpu_s_a_pair": round(sum(parts) / count, 3),
                "parts": [round(v / count, 3) for v in parts],
                "peak_mib": [round(p) for p in peaks],
            }
            rows.append(rounded(told) | row)
    say("\n| road | pairs | CPU s a pair: blocks, registration, graph | all | peak MiB | accepted | 95 % | wrong |")
    say("|---|---|---|---|---|---|---|---|")
    for r in rows:
        say(
            f"| {r['metres']} m | {r['pairs']} | {r['parts']} | {r['cpu_s_a_pair']} s | {r['peak_mib']} | "
            f"{r['accepted_of_overlapping']} % | {r['p95_m']} m | {r['wrong']} |"
        )
    return rows
