"""Near-copies of a published method, over the published errors of twelve districts."""

from __future__ import annotations

import tarfile
from itertools import combinations

import numpy as np
import pytest
from repository import ROOT

from relocbench.arrays import Array
from relocbench.metrics import rank_with_ties, same_answers

ERRORS = ROOT / "leaderboard" / "weather" / "errors"
BASELINES = ("identity", "clock")


def published() -> dict[str, list[Array]]:
    """(2, N) metres and degrees of each pair set across conditions, by method, districts in their order."""
    out: dict[str, list[Array]] = {}
    for archive in sorted(ERRORS.glob("*/*.tar.xz")):
        method = archive.name.removesuffix(".tar.xz")
        if method in BASELINES:
            continue
        with tarfile.open(archive) as tar:
            for name in sorted(name for name in tar.getnames() if name.endswith(".errors.csv")):
                reference, query, _ = name.rsplit("/", 1)[1].split("__")
                if reference != query:
                    stream = tar.extractfile(name)
                    assert stream is not None
                    header, *rows = (line.split(",") for line in stream.read().decode().splitlines())
                    at = {column: header.index(column) for column in header}
                    kept = sorted((row for row in rows if row[at["group"]] != "elsewhere"), key=lambda row: row[:2])
                    columns = [at["translation_error_m"], at["rotation_error_deg"]]
                    out.setdefault(method, []).append(np.array([[float(row[c]) for row in kept] for c in columns]))
    return out


@pytest.mark.thorough
def test_five_copies_of_a_published_method_move_nobody_else() -> None:
    """By copies without one pair a set, a method that is 9 points behind once came to share rank 1."""
    errors = published()
    districts = [district for district in range(12) for _ in range(6)]
    rng = np.random.default_rng(1)
    copies: dict[str, list[Array]] = {}
    for c in range(5):
        copies[f"a-copy-{c}"] = of_copy = [e.copy() for e in errors["aliked-pnp"]]
        for e in of_copy:
            e[:, rng.integers(e.shape[1])] = np.inf
    ranks = []
    for methods in (errors, {**errors, **copies}):
        right = {name: [((e[0] <= 0.25) & (e[1] <= 2)).astype(float) for e in of] for name, of in methods.items()}
        ranks.append(rank_with_ties(right, np.random.default_rng(0), methods, roads=districts))
    before, after = ranks
    assert len(before) == 15
    near = {(a, b) for a in errors for b in errors if a < b and same_answers(errors[a], errors[b])}
    ends = ("gn-net", "gn-net-from-aliked-pnp", "gn-net-from-prior", "gn-net-one-start")
    assert near == {*combinations(ends, 2), ("dso-from-gn-net-pnp", "dso-from-orb-pnp")}, "the same alignment each"
    assert before["gn-net"] == before["aliked-pnp"] == 1
    assert (before["sift-pnp"] or 0) > 1
    assert {name: after[name] for name in before} == before
