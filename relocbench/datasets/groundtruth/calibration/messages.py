"""The report of the calibration: lines for the user."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from relocbench.datasets.groundtruth.calibration.adjustment import Reduced
from relocbench.datasets.groundtruth.calibration.faults import Calibration
from relocbench.datasets.groundtruth.calibration.files import CalibrationFile, LidarErrors
from relocbench.datasets.groundtruth.calibration.unknowns import OBSERVED, SIZE, Sensors, unknowns_reduced


def open_kinds(reduced: Reduced, sensors: Sensors) -> dict[str, tuple[str, ...]]:
    """By ``DRIVE/LIDAR``, the kinds of errors that the drives could hide, if all lidars might be in error at once."""
    covariance = reduced.estimate(sensors.prior(sensors.causes()))[1]
    sigmas = np.sqrt(np.maximum(np.diagonal(covariance), 0.0)) * unknowns_reduced(len(sensors), sensors.enlarged)
    sigmas = sigmas.reshape(-1, SIZE)
    out = {}
    for k, (drive, lidar) in enumerate(sensors.names):
        if k not in sensors.fixed:
            hidden = tuple(kind for kind, (which, most) in OBSERVED.items() if float(sigmas[k, which].max()) > most)
            out[f"{drive}/{lidar}"] = hidden
    return out


def report_lines(file: CalibrationFile, calibration: Calibration, fits: int) -> Iterator[str]:
    """Lines that say what was found, how certainly, and what could not be seen."""
    if not fits:
        yield "calibration: too little is registered to say anything of it; it is taken as it is given"
        return
    if file.causes:
        for name, errors in file.lidars.items():
            if correction := _corrected(errors):
                yield f"calibration: {name} was {correction}; corrected"
    else:
        free = [s for k, s in enumerate(calibration.sigmas) if k not in calibration.sensors.fixed]
        position, rotation, time = (float(np.max([s[part] for s in free])) for part in (slice(0, 3), slice(3, 6), 6))
        yield (
            f"calibration: what {len(calibration.sensors)} lidars measured agrees with it, to {1e3 * time:.1f} ms, "
            f"{np.degrees(rotation):.2f} deg and {100 * position:.1f} cm (one standard deviation)"
        )
    hidden: dict[tuple[str, ...], list[str]] = {}
    for name, errors in file.lidars.items():
        if errors.open:
            hidden.setdefault(errors.open, []).append(name)
    for kinds, names in hidden.items():
        yield (
            f"calibration: an error of {' or '.join(kinds)} of {', '.join(names)} would not show on these drives, "
            "which turn and change speed too little; what is given is taken for right"
        )


def _corrected(errors: LidarErrors) -> str:
    """The errors that are larger than their uncertainty, in words; empty if there are none."""
    out = []
    if abs(errors.late_ms) > 2 * errors.late_sigma_ms:
        word = "late" if errors.late_ms > 0 else "early"
        out.append(f"{abs(errors.late_ms):.1f} ms {word} (sigma {errors.late_sigma_ms:.1f} ms)")
    for what, values, sigmas, factor, unit, digits in (
        ("turned by", errors.rotation_deg, errors.rotation_sigma_deg, 1.0, "deg", 2),
        ("off by", errors.position_m, errors.position_sigma_m, 100.0, "cm", 1),
    ):
        if any(abs(v) > 2 * s for v, s in zip(values, sigmas, strict=True)):
            # What has to be added to the given calibration is what it lacks.
            errors_listed, spread = (", ".join(f"{sign * factor * v:.{digits}f}" for v in numbers)
                            for numbers, sign in ((values, -1.0), (sigmas, 1.0)))  # fmt: skip
            out.append(f"{what} ({errors_listed}) {unit} (sigma {spread})")
    return " and ".join(out)
