"""Validation of a dataset's pair sets."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.checks.faults import Findings, TableRow, read_pair_lines, read_pair_table
from relocbench.datasets.core.layout import DatasetLayout, TraversalLayout, pair_set_parts
from relocbench.datasets.core.pairfile import ELSEWHERE, PairKey, PoseLine
from relocbench.datasets.core.schema import CAMERAS_VERSION, ELSEWHERE_VERSION, TraversalFile
from relocbench.errors import available
from relocbench.geometry import Camera, invert, rotation_angle
from relocbench.progress import Reporter

POSE_TOLERANCE_M = 1e-3
POSE_TOLERANCE_DEG = 0.01
"""greatest difference between a pair's pose and the traversals' poses that it was made from"""
_TABLE_TOLERANCE = 1e-6
"""relative; the table is rounded to nine decimals"""


@dataclass
class CheckedTraversal:
    """A traversal whose text files have been checked, with its files by time."""

    layout: TraversalLayout
    file: TraversalFile | None
    poses: dict[int, Array]
    times: dict[tuple[str, str], set[int]] = field(default_factory=lambda: defaultdict(set))
    """(images, depth or points; camera) -> timestamps"""
    without_depth: set[tuple[str, int]] = field(default_factory=set)
    """(camera, timestamp) of depth or points files without any depth"""
    intrinsics: dict[str, dict[int, Camera]] = field(default_factory=dict)
    """camera -> the cameras of images with intrinsics of their own"""


def check_pair_sets(
    layout: DatasetLayout,
    drives: dict[str, CheckedTraversal],
    findings: Findings,
    reporter: Reporter,
    version: int | None = None,
) -> dict[str, dict[PairKey, PoseLine]]:
    """Check every pair set and return the valid lines of each.

    Args:
        version: ``format_version`` of the dataset, if it is known; pairs of different places need the second.
    """
    names = sorted({p.stem for p in layout.pairs.glob("*") if p.suffix in (".txt", ".csv") and p.name[0] != "."})
    if not names:
        findings.fault("holds no pair set (REF__QUERY__CAM.txt)", layout.pairs)
    out = {}
    with reporter.stage("checking pairs", len(names)) as advance:
        for name in names:
            pair_file, table = layout.pair_file(name), layout.pair_table(name)
            lines = read_pair_lines(pair_file, findings)
            rows = read_pair_table(table, findings) if table.exists() else {}
            if name.count("__") > 2:
                check_version(version, CAMERAS_VERSION, "names two cameras", findings, pair_file)
            check = _PairSetCheck(name, pair_file, table, lines, rows, findings)
            if table.exists():
                check.table_agrees()
                check.negative_pairs(version)
            check.frames(layout, drives)
            out[name] = lines
            advance(1)
    return out


def check_version(
    version: int | None, needed: int, what: str, findings: Findings, path: Path, line: int | None = None
) -> None:
    """Check that a dataset's ``format_version``, if it is known, may have what the file holds."""
    if version is not None and version < needed:
        findings.fault(f"{what}, which format_version {needed} has; this dataset's is {version}", path, line)


@dataclass(frozen=True, eq=False)
class _PairSetCheck:
    """One pair set: what was read of it, and where its faults go."""

    name: str
    path: Path
    """the pair file"""
    table: Path
    lines: dict[PairKey, PoseLine]
    rows: dict[PairKey, TableRow]
    """of the table"""
    findings: Findings

    def table_agrees(self) -> None:
        """Check that the pair file and its table agree."""
        for key, row in self.rows.items():
            line = self.lines.get(key)
            if row.accepted != (line is not None):
                where = "is missing from" if row.accepted else "was rejected but is listed in"
                self.findings.fault(f"pair {key[0]} {key[1]} {where} {self.path.name}", self.table, row.line)
            elif line is not None and line.T_query_ref is not None:
                values = {
                    "distance_m": (row.distance_m, float(np.linalg.norm(line.T_query_ref[:3, 3]))),
                    "angle_deg": (row.angle_deg, float(np.degrees(rotation_angle(line.T_query_ref[:3, :3])))),
                }
                for column, (stated, posed) in values.items():
                    if stated is not None and abs(stated - posed) > _TABLE_TOLERANCE * max(1.0, posed):
                        what = f"{column} is {stated:.6g}, but {posed:.6g} by the pose in {self.path.name}"
                        self.findings.fault(what, self.table, row.line)
        for key, line in self.lines.items():
            if key not in self.rows:
                self.findings.fault(f"pair {key[0]} {key[1]} is missing from {self.table.name}", self.path, line.line)

    def negative_pairs(self, version: int | None) -> None:
        """Check that the dataset may have pairs of different places, and hides them where truth is withheld."""
        negative = [row for row in self.rows.values() if row.group == ELSEWHERE]
        if negative:
            what = f"the group '{ELSEWHERE}' is that of negative pairs"
            check_version(version, ELSEWHERE_VERSION, what, self.findings, self.table, negative[0].line)
        for row in negative:
            if (line := self.lines.get(row.key)) is not None and line.T_query_ref is None:
                what = "the truth is withheld, but the group says that it is a negative pair"
                self.findings.fault(what, self.table, row.line)

    def frames(self, layout: DatasetLayout, drives: dict[str, CheckedTraversal]) -> None:
        """Check that the pairs' images and depth exist, or their poses, and that these agree with the traversals'."""
        try:
            parts = pair_set_parts(self.name)
        except ValueError as bad:
            self.findings.fault(str(bad), self.path)
            return
        unknown = [part for part in parts[:2] if part not in drives]
        if unknown:
            self.findings.fault(f"no traversal '{unknown[0]}'{available(unknown[0], drives)}", self.path)
            return
        reference, query = drives[parts[0]], drives[parts[1]]
        sides = (reference, parts[2]), (query, parts[3])
        for drive, camera in sides:
            if drive.file is not None and camera not in {**drive.file.cameras, **drive.file.frames}:
                self.findings.fault(f"traversal '{drive.layout.root.name}' has no camera '{camera}'", self.path)
                return
        bare = [drive.file is not None and camera in drive.file.frames for drive, camera in sides]
        if all(bare):
            self._poses_exist(reference, query)
        elif any(bare):
            message = "has images in one of the two traversals and poses alone in the other; expected the same in both"
            self.findings.fault(f"'{parts[bare.index(True) + 2]}' {message}", self.path)
            return
        else:
            self._images_exist(layout, *sides)
        self._poses_agree(*sides)

    def _images_exist(self, layout: DatasetLayout, *sides: tuple[CheckedTraversal, str]) -> None:
        """Check that there are the images of all pairs, and the depth of their keyframes."""
        reference, of_keyframes = sides[0]
        for key, line in self.lines.items():
            for (drive, camera), time in zip(sides, key, strict=True):
                if time not in drive.times["images", camera]:
                    missing = drive.layout.image(camera, time).relative_to(layout.root)
                    self.findings.fault(f"no image {missing}", self.path, line.line)
            if key[0] not in reference.times["depth", of_keyframes] | reference.times["points", of_keyframes]:
                self.findings.fault(f"keyframe {key[0]} has neither depth nor points", self.path, line.line)
            elif (of_keyframes, key[0]) in reference.without_depth:
                self.findings.fault(f"keyframe {key[0]} has no pixel with depth", self.path, line.line)

    def _poses_exist(self, reference: CheckedTraversal, query: CheckedTraversal) -> None:
        """Check that pairs of poses alone that were made from traversals' poses have them; note what others lack."""
        unposed = 0
        for key, line in self.lines.items():
            missing = [(d, time) for d, time in ((reference, key[0]), (query, key[1])) if time not in d.poses]
            if missing and self._from_poses(key):
                drive, time = missing[0]
                message = f"traversal '{drive.layout.root.name}' has no pose at {time}, from which the pair was made"
                self.findings.fault(f"{message} ('{self.rows[key].source}')", self.path, line.line)
            unposed += key[0] not in reference.poses
        if unposed:
            what = f"{unposed} of {len(self.lines)} keyframes have no pose in poses.csv, and so no place on a map"
            self.findings.note(what, self.path)

    def _from_poses(self, key: PairKey) -> bool:
        """Whether a pair was made from the poses of its traversals, as its source tells."""
        return key in self.rows and "poses" in self.rows[key].source.lower().split()

    def _poses_agree(self, *sides: tuple[CheckedTraversal, str]) -> None:
        """Compare the pairs' poses with those of the traversals.

        A pair whose source contains the word 'poses' was made from the traversals' poses and must agree with them;
        other pairs may differ.
        """
        (reference, _), (query, _) = sides
        mounts = [drive.file.T_rig(camera) for drive, camera in sides if drive.file is not None]
        if len(mounts) < 2:
            return
        T_rig_ref, T_rig_query = mounts
        others = []
        for key, line in self.lines.items():
            if line.T_query_ref is None or key[0] not in reference.poses or key[1] not in query.poses:
                continue
            T_query_ref = invert(query.poses[key[1]] @ T_rig_query) @ reference.poses[key[0]] @ T_rig_ref
            offset = invert(T_query_ref) @ line.T_query_ref
            metres = float(np.linalg.norm(offset[:3, 3]))
            degrees = float(np.degrees(rotation_angle(offset[:3, :3])))
            if metres <= POSE_TOLERANCE_M and degrees <= POSE_TOLERANCE_DEG:
                continue
            if self._from_poses(key):
                source = self.rows[key].source
                what = f"pose differs by {metres:.4g} m and {degrees:.4g} deg from poses.csv, its source ('{source}')"
                self.findings.fault(what, self.path, line.line)
            else:
                others.append((metres, degrees))
        if others:
            metres, degrees = np.median(others, axis=0)
            self.findings.note(
                f"{len(others)} pairs, which have another source, differ from poses.csv "
                f"(median {metres:.4g} m, {degrees:.4g} deg)",
                self.path,
            )
