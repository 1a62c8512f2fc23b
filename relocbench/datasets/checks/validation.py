"""Validation of a dataset on disk: every fault, with file and line."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np

from relocbench.datasets.checks.faults import Findings, check_points, read_intrinsics_table, read_pose_table, read_yaml
from relocbench.datasets.checks.motion import check_motion
from relocbench.datasets.checks.pair_sets import CheckedTraversal, check_pair_sets, check_version
from relocbench.datasets.core import fingerprint, images
from relocbench.datasets.core.layout import IMAGE_SUFFIXES, DatasetLayout
from relocbench.datasets.core.names import read_names
from relocbench.datasets.core.pairfile import PairKey, PoseLine
from relocbench.datasets.core.schema import INTRINSICS_VERSION, POSES_VERSION, DatasetFile, TraversalFile
from relocbench.datasets.pairs.depth_scale import DepthFrame, depth_scale
from relocbench.errors import DatasetError, RelocbenchError, available
from relocbench.execution import default_workers
from relocbench.files import load_yaml_values, sha256_file, whole_number, yaml_line
from relocbench.progress import Reporter


def is_dataset_folder(path: Path) -> bool:
    """Whether a folder is a finished or unfinished dataset (a results folder also has a ``dataset.yaml``)."""
    layout = DatasetLayout(path)
    return layout.build_yaml.exists() or layout.manifest.exists() or layout.traversals.is_dir()


def validate_dataset(root: Path, reporter: Reporter, *, quick: bool = False) -> Findings:
    """Check everything in a dataset folder.

    Args:
        quick: neither hash nor decode images; descriptions, poses, points and pairs are checked nevertheless.
    """
    findings = Findings()
    layout = DatasetLayout(root)
    if not layout.dataset_yaml.exists() and layout.build_yaml.exists():
        findings.fault("the build was not finished; run the same `relocbench build-dataset` again", root)
        return findings
    file = read_yaml(layout.dataset_yaml, DatasetFile, "a dataset description", findings)
    digests: dict[str, str] = {}
    if not quick and layout.manifest.exists():
        with findings.catching():
            digests = {name: digest for name, (_, digest) in fingerprint.read_manifest(layout).items()}
    drives = _check_traversals(layout, findings)
    version = None if file is None else file.format_version
    _check_versions(drives, version, findings)
    _check_content(layout, drives, digests, findings, reporter, quick)
    if not quick:
        _check_depth_scale(drives, findings)
    pair_sets = check_pair_sets(layout, drives, findings, reporter, version)
    check_motion(layout, drives, pair_sets, findings)
    _check_correspondences(layout, pair_sets, digests, findings, reporter, quick)
    if file is not None:
        _check_splits(layout, file, pair_sets, findings)
        _check_manifest(layout, file, findings)
    return findings


def _check_traversals(layout: DatasetLayout, findings: Findings) -> dict[str, CheckedTraversal]:
    folders = sorted(p for p in layout.traversals.iterdir() if p.is_dir()) if layout.traversals.is_dir() else []
    if not folders:
        findings.fault("holds no traversal", layout.traversals)
    drives = {}
    for folder in folders:
        traversal = layout.traversal(folder.name)
        file = read_yaml(traversal.traversal_yaml, TraversalFile, "a traversal description", findings)
        if file is not None and file.name != folder.name:
            findings.fault(f"key 'name' is '{file.name}', expected the folder's name", traversal.traversal_yaml)
        drive = CheckedTraversal(traversal, file, read_pose_table(traversal.poses, findings))
        with findings.catching():
            read_names(traversal.names)
        for path in sorted((traversal.root / "intrinsics").glob("*")):
            if path.suffix == ".csv":
                drive.intrinsics[path.stem] = read_intrinsics_table(path, findings)
            else:
                findings.fault("expected a file CAMERA.csv", path)
        drives[folder.name] = drive
    return drives


def _check_versions(drives: dict[str, CheckedTraversal], version: int | None, findings: Findings) -> None:
    """Programs that know only earlier formats would take one camera for every image, or look for images of frames."""
    for drive in drives.values():
        for camera in drive.intrinsics:
            what, table = "images have intrinsics of their own", drive.layout.intrinsics(camera)
            check_version(version, INTRINSICS_VERSION, what, findings, table)
        if drive.file is not None and drive.file.frames:
            what = f"has frames without images ({', '.join(drive.file.frames)})"
            check_version(version, POSES_VERSION, what, findings, drive.layout.traversal_yaml)


def _check_content(
    layout: DatasetLayout,
    drives: dict[str, CheckedTraversal],
    digests: dict[str, str],
    findings: Findings,
    reporter: Reporter,
    quick: bool,
) -> None:
    """List, decode and hash the images, depth and points of every traversal."""
    checks: list[Callable[[], Findings]] = []
    for drive in drives.values():
        for kind in ("images", "depth", "points"):
            for path in sorted((drive.layout.root / kind).glob("*/*")):
                if path.name.startswith(".") and ".part" in path.name:
                    findings.note("is left over from a killed build", path)
                elif _listed_time(drive, kind, path, findings) and (not quick or kind == "points"):
                    digest = digests.get(path.relative_to(layout.root).as_posix(), "")
                    checks.append(partial(_check_file, drive, kind, path, digest))
        _check_cameras(drive, findings)
        _check_intrinsics(drive, findings)
    # Decoding and hashing release the interpreter's lock, so threads suffice and nothing is copied.
    with ThreadPoolExecutor(default_workers()) as pool, reporter.stage("reading images", len(checks)) as advance:
        for result in pool.map(lambda check: check(), checks):
            findings.faults += result.faults
            advance(1)


def _check_depth_scale(drives: dict[str, CheckedTraversal], findings: Findings) -> None:
    """Report depth that contradicts the poses."""
    for drive in drives.values():
        for camera, entry in drive.file.cameras.items() if drive.file is not None else ():
            own = drive.intrinsics.get(camera, {})
            frames = [
                DepthFrame(
                    own.get(time, entry.camera),
                    drive.poses[time] @ entry.T_rig_cam.matrix,
                    partial(images.read_depth, drive.layout.depth(camera, time)),
                )
                for time in sorted(drive.times.get(("depth", camera), ()))
                if time in drive.poses
            ]
            with suppress(DatasetError):  # of a damaged file, which has been reported
                found = depth_scale(frames)
                if found is not None and found.contradicts:
                    findings.fault(found.words("depth"), drive.layout.root / "depth" / camera)


def _listed_time(drive: CheckedTraversal, kind: str, path: Path, findings: Findings) -> bool:
    """Whether a file has the name that the format expects; if so, its time is added to the drive's times."""
    suffixes = {"images": IMAGE_SUFFIXES, "depth": (".png",), "points": (".csv",)}[kind]
    if path.suffix not in suffixes or whole_number(path.stem) is None:
        findings.fault(f"expected a file TIMESTAMP{' or '.join(suffixes)}, the timestamp in nanoseconds", path)
        return False
    camera, time = path.parent.name, int(path.stem)
    if kind == "images" and time in drive.times[kind, camera]:
        findings.fault(f"is a second image of camera '{camera}' at {time}", path)
    drive.times[kind, camera].add(time)
    return True


def _check_cameras(drive: CheckedTraversal, findings: Findings) -> None:
    if drive.file is None:
        return
    for kind, camera in sorted(drive.times):
        if camera not in drive.file.cameras:
            message = f"no camera '{camera}' in traversal.yaml{available(camera, drive.file.cameras)}"
            if camera in drive.file.frames:
                message = f"'{camera}' is a frame without images in traversal.yaml; expected no files of it"
            findings.fault(message, drive.layout.root / kind / camera)
    for camera in drive.file.cameras:
        if not drive.times.get(("images", camera)):
            findings.fault(f"holds no image of camera '{camera}'", drive.layout.root / "images" / camera)


def _check_intrinsics(drive: CheckedTraversal, findings: Findings) -> None:
    """Check that intrinsics are of a camera and of images that there are."""
    for camera, cameras in drive.intrinsics.items():
        path = drive.layout.intrinsics(camera)
        if drive.file is not None and camera not in drive.file.cameras:
            findings.fault(f"no camera '{camera}' in traversal.yaml{available(camera, drive.file.cameras)}", path)
        for time in sorted(cameras.keys() - drive.times.get(("images", camera), set())):
            findings.fault(f"has intrinsics of an image at {time}, and camera '{camera}' has no such image", path)


def _check_file(drive: CheckedTraversal, kind: str, path: Path, digest: str) -> Findings:
    """Check one file; ``digest`` is the SHA-256 of its original content, or empty if unknown."""
    findings = Findings()
    entry = drive.file.cameras.get(path.parent.name) if drive.file else None
    own = drive.intrinsics.get(path.parent.name, {}).get(int(path.stem))
    camera = own or (entry.camera if entry else None)
    with findings.catching():
        if kind == "points":
            depths = check_points(path, camera, findings)
        else:
            read = images.read_image if kind == "images" else images.read_depth
            size = None if camera is None else images.ExpectedSize(camera.size, f"camera '{path.parent.name}'")
            depths = int(np.count_nonzero(read(path, size)))
        if kind != "images" and depths == 0:
            drive.without_depth.add((path.parent.name, int(path.stem)))
        _check_digest(path, digest, findings)
    return findings


def _check_digest(path: Path, digest: str, findings: Findings) -> None:
    """Report a file that was changed but is still readable."""
    if digest and path not in findings.faulty_files and sha256_file(path) != digest:
        findings.fault("content was changed after the dataset was made", path)


def _check_correspondences(
    layout: DatasetLayout,
    pair_sets: dict[str, dict[PairKey, PoseLine]],
    digests: dict[str, str],
    findings: Findings,
    reporter: Reporter,
    quick: bool,
) -> None:
    files = sorted(layout.correspondences.glob("[!.]*")) if layout.correspondences.is_dir() else []
    with reporter.stage("checking correspondences", len(files)) as advance:
        for path in files:
            if path.suffix != ".parquet" or path.stem not in pair_sets:
                findings.fault("expected REF__QUERY__CAM.parquet of one of the pair sets", path)
            elif quick:
                with findings.catching():
                    _check_parquet_columns(path)
            else:
                with findings.catching():
                    _check_rows(path, pair_sets[path.stem], findings)
                    _check_digest(path, digests.get(path.relative_to(layout.root).as_posix(), ""), findings)
            advance(1)


def _check_parquet_columns(path: Path) -> None:
    from relocbench.datasets.pairs.correspondence_file import check_rows, open_correspondences  # needs pyarrow

    with open_correspondences(path) as file:
        for group in range(file.num_row_groups):
            check_rows(file, group, path)


def _check_rows(path: Path, lines: dict[PairKey, PoseLine], findings: Findings) -> None:
    unknown: set[PairKey] = set()
    wrong, first, before = 0, -1, 0
    from relocbench.datasets.pairs.correspondence_file import iterate_correspondences  # needs pyarrow

    for rows in iterate_correspondences(path):
        keys = np.unique(np.column_stack([rows.ref_timestamp_ns, rows.query_timestamp_ns]), axis=0)
        unknown |= {(ref, query) for ref, query in keys.tolist()} - lines.keys()
        finite = np.isfinite(rows.uv_ref).all(axis=1) & np.isfinite(rows.uv_query).all(axis=1)
        bad = np.nonzero(~(finite & (rows.depth_ref > 0)))[0]
        if bad.size and first < 0:
            first = before + int(bad[0])
        wrong, before = wrong + bad.size, before + len(rows)
    for ref, query in sorted(unknown):
        findings.fault(f"holds pair {ref} {query}, which is not in the pair set", path)
    if wrong:
        findings.fault(f"{wrong} rows lack finite pixels or positive depth; the first is row {first}", path)


def _check_splits(
    layout: DatasetLayout, file: DatasetFile, pair_sets: dict[str, dict[PairKey, PoseLine]], findings: Findings
) -> None:
    _, node = load_yaml_values(layout.dataset_yaml, "a dataset description", DatasetError)
    for split, names in file.splits.items():
        for index, name in enumerate(names):
            if name not in pair_sets:
                line = yaml_line(node, ("splits", split, index))
                findings.fault(f"split '{split}' names pair set '{name}', which is missing", layout.dataset_yaml, line)


def _check_manifest(layout: DatasetLayout, file: DatasetFile, findings: Findings) -> None:
    """Report files that are missing, added or changed, unless an earlier check has reported them."""
    with findings.catching():
        fingerprint.check_manifest(layout, file)
    if not layout.manifest.exists():
        return
    known = findings.faulty_files
    try:
        for fault in fingerprint.faults(layout, content="text"):
            if fault.path not in known:
                findings.fault(fault.expected, fault.path, fault.line)
    except RelocbenchError as bad:
        if bad.path not in known:
            findings.fault(bad.expected, bad.path, bad.line)
