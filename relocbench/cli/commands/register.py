"""``relocbench register``: the relative pose of two point clouds, or of two folders of clouds."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from relocbench.cli.options import Json, Quiet

if TYPE_CHECKING:
    from relocbench.arrays import Array
    from relocbench.datasets.groundtruth.clouds.all_pairs import PairRegistration
    from relocbench.datasets.groundtruth.clouds.folders import Reading, Side
    from relocbench.datasets.groundtruth.clouds.register import CloudRegistration, CloudRegistrationOptions
    from relocbench.progress import Reporter

NOT_TRUSTED = 1
"""exit status of a registration that is not trusted"""
_READING, _METHOD = "How clouds are read", "How they are registered"


def register(
    a: Annotated[Path, typer.Argument(metavar="A", help="A point cloud, or a folder of them.", show_default=False)],
    b: Annotated[
        Path | None,
        typer.Argument(
            metavar="B",
            help="Another one, whose pose in A is sought. Without B, all pairs of the clouds in A are registered.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FOLDER", help="Folder for pose, covariance, evidence and pictures."),
    ] = None,
    save_cloud: Annotated[bool, typer.Option("--save-cloud", help="Also write B in the frame of A (PLY).")] = False,
    poses: Annotated[
        list[Path],
        typer.Option(
            metavar="FILE",
            help="Poses of a folder's clouds: TUM, KITTI or a graph (g2o). Given twice: of A, then of B "
            "[default: odometry from the scans].",
            rich_help_panel=_READING,
        ),
    ] = [],  # noqa: B006
    files: Annotated[
        str,
        typer.Option(
            metavar="PATTERN",
            help="Names of a folder's clouds, such as 'planes_*.bin' [default: all of known formats].",
            rich_help_panel=_READING,
        ),
    ] = "",
    columns: Annotated[
        int | None,
        typer.Option(
            min=3,
            max=6,
            metavar="N",
            help="Numbers of a point in .bin files [default: detected].",
            rich_help_panel=_READING,
        ),
    ] = None,
    dtype: Annotated[
        Literal["float32", "float64"] | None,
        typer.Option(
            metavar="float32|float64", help="Type of these numbers [default: detected].", rich_help_panel=_READING
        ),
    ] = None,
    setup: Annotated[
        list[int],
        typer.Option(
            min=0,
            metavar="N",
            help="Setup of an E57 file, from 0. Repeat for several [default: all, merged by their poses].",
            rich_help_panel=_READING,
        ),
    ] = [],  # noqa: B006
    sensor: Annotated[
        Literal["auto", "origin", "unknown"],
        typer.Option(
            metavar="auto|origin|unknown",
            help="Whether clouds were measured from the origin of their coordinates, which free space is judged by; "
            "auto asks the points.",
            rich_help_panel=_READING,
        ),
    ] = "auto",
    initial: Annotated[
        str,
        typer.Option(
            metavar="'tx ty tz qx qy qz qw'",
            help="T_A_B to start from instead of a search; it is verified like any other.",
            rich_help_panel=_METHOD,
        ),
    ] = "",
    scale: Annotated[
        float | None,
        typer.Option(
            min=1e-4,
            max=1e4,
            metavar="FACTOR",
            help="Enlarge the scene so many times to the size of a street [default: by its size and noise].",
            rich_help_panel=_METHOD,
        ),
    ] = None,
    matcher: Annotated[
        Literal["ransac", "fgr", "kiss-matcher"],
        typer.Option(
            metavar="ransac|fgr|kiss-matcher",
            help="Method of the search by features (kiss-matcher needs the extra 'registration').",
            rich_help_panel=_METHOD,
        ),
    ] = "ransac",
    icp: Annotated[
        Literal["own", "open3d", "small_gicp"],
        typer.Option(
            metavar="own|open3d|small_gicp",
            help="Implementation of ICP (small_gicp needs the extra 'registration').",
            rich_help_panel=_METHOD,
        ),
    ] = "own",
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Seed of the search.", rich_help_panel=_METHOD)] = 0,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Register two point clouds, or two folders of clouds: the pose of B in A, its covariance, and whether to trust it.

    Reads pcd, ply, las, laz, e57, bin, npy and text. The clouds of a folder are put together first. Exit status 0 when
    the pose is trusted, 1 when it is not, 2 for bad input. For all pairs, 1 if one of them is not trusted.

    Example: relocbench register summer.las winter.las --out registered

    Example: relocbench register scans --poses graph.txt
    """
    from relocbench.cli.console import print_json, reporter
    from relocbench.datasets.groundtruth.clouds.folders import Reading
    from relocbench.datasets.groundtruth.clouds.register import CloudRegistrationOptions
    from relocbench.datasets.sensors.cloud_files import CloudFormat
    from relocbench.errors import ConfigError

    if save_cloud and out is None:
        raise ConfigError("--save-cloud writes into the folder of --out, which is not given")
    if len(poses) > (1 if b is None else 2):
        raise ConfigError(f"--poses is given {len(poses)} times; expected once for each folder")
    reading = Reading(CloudFormat(dtype, columns, tuple(setup)), sensor, files)
    options = CloudRegistrationOptions(matcher, icp, seed, scale, _pose(initial) if initial else None)
    progress = reporter(quiet)
    if b is None:
        trusted = _all_pairs(a, poses, reading, options, out, initial, progress, json=json)
        raise typer.Exit(0 if trusted else NOT_TRUSTED)
    sides, found = _register_two((a, b), poses, reading, options, progress)
    written = []
    if out is not None:
        from relocbench.datasets.groundtruth.clouds.writing import write_registration
        from relocbench.files import locked_output

        with locked_output(out):
            clouds = sides[0].cloud, sides[1].cloud
            with progress.stage("writing files and pictures", 1) as advance:
                written = write_registration(out, found, *clouds, (str(a), str(b)), cloud=save_cloud)
                advance(1)
    if json:
        from relocbench.datasets.groundtruth.clouds.writing import as_values

        values = as_values(found, sides[0].cloud, sides[1].cloud)
        notes = {"notes_a": list(sides[0].notes), "notes_b": list(sides[1].notes)}
        counts = {"points_a": len(sides[0].cloud), "points_b": len(sides[1].cloud), "files_written": len(written)}
        print_json({**values, **notes}, counts)
    else:
        _tell(found, sides, quiet)
        for path in written:
            print(f"wrote {path}")
    if not found.trusted:
        raise typer.Exit(NOT_TRUSTED)


def _pose(text: str) -> Array:
    """``T_A_B`` (4, 4) of the option. Raises ConfigError."""
    from relocbench.datasets.core.pairfile import parse_pose
    from relocbench.errors import ConfigError, DatasetError

    fields = text.replace(",", " ").split()
    try:
        if len(fields) != 7:
            raise ConfigError(f"--initial: expected 'tx ty tz qx qy qz qw', found {len(fields)} numbers")
        return parse_pose(fields, Path("--initial"), 1)
    except DatasetError as bad:
        raise ConfigError(f"--initial: {bad.expected}") from None


def _register_two(
    paths: tuple[Path, Path],
    poses: list[Path],
    reading: Reading,
    options: CloudRegistrationOptions,
    progress: Reporter,
) -> tuple[tuple[Side, Side], CloudRegistration]:
    from dataclasses import replace

    from relocbench.datasets.groundtruth.clouds.folders import read_side, with_one_origin
    from relocbench.datasets.groundtruth.clouds.register import register_clouds
    from relocbench.errors import ConfigError

    folders = [path for path in paths if path.is_dir()]
    if poses and len(folders) != len(poses):
        raise ConfigError(f"--poses is given {len(poses)} times, but {len(folders)} of A and B are folders")
    left = list(poses)
    sides = [read_side(path, left.pop(0) if left and path.is_dir() else None, reading, progress) for path in paths]
    sides[1] = replace(sides[1], cloud=with_one_origin(sides[0].cloud, sides[1].cloud))
    for name, side in zip("AB", sides, strict=True):
        progress.note(f"{name}: {'; '.join(side.notes)}")
    return (sides[0], sides[1]), register_clouds(sides[0].cloud, sides[1].cloud, options, progress)


def _all_pairs(
    folder: Path,
    poses: list[Path],
    reading: Reading,
    options: CloudRegistrationOptions,
    out: Path | None,
    initial: str,
    progress: Reporter,
    *,
    json: bool,
) -> bool:
    from relocbench.cli.console import print_json, print_table
    from relocbench.datasets.groundtruth.clouds.all_pairs import register_all_pairs
    from relocbench.errors import ConfigError

    if not folder.is_dir():
        raise ConfigError("expected a second cloud: relocbench register A B; only a folder can be given alone")
    if initial or out is not None:
        raise ConfigError(f"{'--initial' if initial else '--out'} is for one pair A B, not for all pairs of a folder")
    pairs = register_all_pairs(folder, poses[0] if poses else None, reading, options, progress)
    trusted = sum(pair.found.trusted for pair in pairs)
    if json:
        print_json({"pairs": [_pair_values(pair) for pair in pairs]}, {"pairs": len(pairs), "trusted": trusted})
        return trusted == len(pairs)
    columns = ["pair", "verdict", "distance, m", "rotation, deg", "sigma, cm", "sigma, deg"]
    if poses:
        columns += ["off the poses, cm", "deg"]
    print_table("", columns, [_row(pair, folder, bool(poses)) for pair in pairs])
    print(f"{trusted} of {len(pairs)} pairs trusted")
    return trusted == len(pairs)


def _pair_values(pair: PairRegistration) -> dict[str, Any]:
    metres, degrees = pair.difference
    return {
        "a": str(pair.a),
        "b": str(pair.b),
        "T_a_b": pair.found.T_a_b.tolist(),
        "sigma_m": pair.found.sigma_m.tolist(),
        "sigma_rotation_deg": pair.found.sigma_deg,
        "information": pair.found.information.tolist(),
        "trusted": pair.found.trusted,
        "reason": pair.found.reason,
        "off_poses_m": metres,
        "off_poses_deg": degrees,
    }


def _row(pair: PairRegistration, folder: Path, compared: bool) -> list[str]:
    import numpy as np

    from relocbench.geometry import rotation_angle

    found = pair.found
    names = [str(path.relative_to(folder)) for path in (pair.a, pair.b)]
    row = [
        " - ".join(names),
        "trusted" if found.trusted else found.reason,
        f"{np.linalg.norm(found.T_a_b[:3, 3]):.2f}",
        f"{np.degrees(rotation_angle(found.T_a_b[:3, :3])):.1f}" if np.isfinite(found.T_a_b).all() else "nan",
        f"{100 * float(found.sigma_m.max()):.2g}",
        f"{found.sigma_deg:.2g}",
    ]
    if compared:
        metres, degrees = pair.difference
        row += [f"{100 * metres:.1f}", f"{degrees:.2f}"]
    return row


def _tell(found: CloudRegistration, sides: tuple[Side, Side], quiet: bool) -> None:
    """Print the result for people."""
    import numpy as np

    from relocbench.datasets.groundtruth.clouds.writing import T_files
    from relocbench.geometry import rotation_angle, transform_to_tq

    print(f"verdict: {'trusted' if found.trusted else 'not trusted: ' + found.reason}")
    print(f"rests on: {found.rests_on}")
    if found.copied:
        print(f"same points: {_share(found.copied)} of B's points are points of A. It is a copy and no second "
              "measurement, and sigma says nothing about its errors")  # fmt: skip
    if not np.isfinite(found.T_a_b).all():
        return
    translation, quaternion = transform_to_tq(found.T_a_b)
    x, y, z = translation
    angle = float(np.degrees(rotation_angle(found.T_a_b[:3, :3])))
    print(f"T_A_B maps points of B into A: translation ({x:.4f}, {y:.4f}, {z:.4f}) m, rotation {angle:.3f} deg")
    print(f"  tx ty tz qx qy qz qw: {' '.join(f'{v:.9g}' for v in [*translation, *quaternion])}")
    for line in _matrix(found.T_a_b):
        print(f"  {line}")
    if any(side.cloud.origin is not None for side in sides):
        print("  in the files' own coordinates:")
        for line in _matrix(T_files(found, sides[0].cloud, sides[1].cloud)):
            print(f"  {line}")
    said = ", ".join(_length(s) for s in found.sigma_m)
    turned = f"{found.sigma_deg:.3g} deg" if math.isfinite(found.sigma_deg) else "unknown"
    print(f"sigma along A's x, y, z, at the middle of B: {said}; of rotation {turned}")
    if found.unobservable:
        print(f"unobservable in A: {found.unobservable}")
    e = found.evidence
    print(f"overlap {_share(e.overlap_ref)} of A, {_share(e.overlap_query)} of B; "
          f"free space violated {_share(e.violations_ref)}, {_share(e.violations_query)}; "
          f"details {_share(e.detail_ref)}, {_share(e.detail_query)}; "
          f"seen {_share(e.seen_ref)}, {_share(e.seen_query)}; "
          f"residuals {_length(e.residual_ref_m)}, {_length(e.residual_query_m)}")  # fmt: skip
    if not quiet:
        print(f"scale: {found.scale.reason}")
        for name, side in zip("AB", found.sides, strict=False):
            print(f"sensor of {name}: {_SENSORS[side.sensor]}")
        if found.rival is not None:
            T, unexplained = found.rival
            at = ", ".join(f"{v:.2f}" for v in T[:3, 3])
            print(f"next best pose at ({at}) m: {_share(unexplained)} unexplained, against {_share(found.unexplained)}")
        print("information of xi = (rho, phi) in T_A_B exp(xi), metres and radians:")
        for row in found.information:
            print("  " + " ".join(f"{value:12.5g}" for value in row))


_SENSORS = {
    "known": "known",
    "supposed": "at the origin, which the points agree with",
    "refuted": "unknown, since beams from the origin would go through the cloud's own surfaces",
    "unknown": "unknown",
}


def _matrix(T: Array) -> list[str]:
    return [" ".join(f"{value:16.9f}" for value in row) for row in T]


def _share(share: float) -> str:
    return f"{100 * share:.0f} %" if math.isfinite(share) else "-"


def _length(metres: float) -> str:
    if not metres < float("inf"):
        return "unknown"
    if metres >= 1:
        return f"{metres:.3g} m"
    return f"{100 * metres:.3g} cm" if metres >= 0.01 else f"{1000 * metres:.3g} mm"
