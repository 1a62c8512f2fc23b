"""The unknowns of calibration: for each lidar of each drive, the error of its extrinsics and of its clock.

``T_rig_lidar`` is off by a twist: the right one is ``se3_exp(epsilon) @ T_rig_lidar``. A lidar that is late by
``delta`` stamps its beams with times that are larger by ``delta`` than those of the odometry's clock. What it measured
at p, in the frame of a rig that moves with the twist ``xi`` a second, belongs to ``p + u_rho + u_phi x p`` with
``u = epsilon - delta xi``: a late lidar looks like one whose extrinsics change with speed and turn.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from relocbench.arrays import Array
from relocbench.datasets.sensors.recording import FieldRecording

SIZE = 7
"""unknowns of one lidar: translation (3, metres), rotation (3, radians), time offset (seconds)"""
RIG = "all lidars"
EVERY = "all drives/"
KINDS = ("extrinsics", "time")

OBSERVED = {
    "time": (slice(6, 7), 0.015),
    "rotation": (slice(3, 6), float(np.radians(0.5))),
    "position": (slice(0, 3), 0.05),
}
"""unknowns of a lidar, and the standard deviation up to which they count as observed if nothing is known before"""


@dataclass(frozen=True)
class Sigmas:
    """Standard deviations of the errors of calibration."""

    position_m: float
    rotation_rad: float
    time_s: float

    def variances(self, kind: str, enlarged: float = 1.0) -> Array:
        """(6,) of extrinsics, or (1,) of a time offset, in metres that are enlarged so many times."""
        extrinsics = np.repeat([self.position_m * enlarged, self.rotation_rad], 3) ** 2
        return extrinsics if kind == "extrinsics" else np.array([self.time_s**2])

    def times(self, factors: Sigmas) -> Sigmas:
        """Each multiplied by a factor."""
        return Sigmas(
            self.position_m * factors.position_m, self.rotation_rad * factors.rotation_rad, self.time_s * factors.time_s
        )


NOMINAL = Sigmas(0.005, float(np.radians(0.05)), 0.003)
"""of a calibration that is as good as it should be"""
STEADY = Sigmas(0.001, float(np.radians(0.01)), 0.00025)
"""of its changes from drive to drive"""
FAULTY = Sigmas(0.10, float(np.radians(2.0)), 0.10)
"""of one that is not"""
SLIGHT = Sigmas(0.02, float(np.radians(0.4)), 0.01)
"""of one that is off by little"""


@dataclass(frozen=True, order=True)
class Cause:
    """An error that one or several lidars share."""

    of: str
    """:data:`RIG` (of all drives), ``all drives/LIDAR``, the name of a drive (all its lidars), or ``DRIVE/LIDAR``"""
    kind: str
    """one of :data:`KINDS`"""

    def __str__(self) -> str:
        return f"{self.kind} of {self.of}"

    @property
    def nominal(self) -> Sigmas:
        """Standard deviations of this error if the calibration is as good as it should be."""
        return NOMINAL if self.of == RIG or self.of.startswith(EVERY) else STEADY


@dataclass(frozen=True)
class DriveLidars:
    """The lidars of one drive."""

    drive: str
    lidars: tuple[str, ...]
    odometry: str = ""
    """the lidar that the drive's odometry was computed from: it has its clock, and its pose defines the rig's"""

    @classmethod
    def of(cls, recording: FieldRecording) -> DriveLidars:
        return cls(recording.name, tuple(lidar.name for lidar in recording.lidars), recording.odometry_lidar)


@dataclass(frozen=True)
class Sensors:
    """The lidars of several drives in one numbering, drive after drive."""

    drives: tuple[DriveLidars, ...]
    enlarged: float = 1.0
    """how many times the drives' metres are enlarged; errors of mounting do not shrink with the scene, so that what is
    known of them before is enlarged as well"""

    @cached_property
    def names(self) -> tuple[tuple[str, str], ...]:
        """(drive, lidar) of each."""
        return tuple((d.drive, lidar) for d in self.drives for lidar in d.lidars)

    @cached_property
    def fixed(self) -> frozenset[int]:
        """Lidars without an error, since their drive's odometry was computed from them."""
        given = {(d.drive, d.odometry) for d in self.drives}
        return frozenset(k for k, name in enumerate(self.names) if name in given)

    def __len__(self) -> int:
        return len(self.names)

    @property
    def unknowns(self) -> int:
        """Number K of unknowns."""
        return SIZE * len(self)

    def number(self, drive: str, lidar: int) -> int:
        """The number of a lidar of a drive."""
        return [name for name, _ in self.names].index(drive) + lidar

    def causes(self) -> list[Cause]:
        """What may be in error: the rig, a drive, or a single lidar; a drive's only lidar is the drive.

        Lidars that odometry was computed from have no error relative to it.
        """
        free = [d for d in self.drives if not d.odometry]
        out = [Cause(RIG, "extrinsics")] if len(free) > 1 else []
        if len(free) > 1:
            common = [name for name in free[0].lidars if all(name in d.lidars and len(d.lidars) > 1 for d in free)]
            out += [Cause(f"{EVERY}{lidar}", kind) for lidar in common for kind in KINDS]
        for one in self.drives:
            if not one.odometry:
                out += [Cause(one.drive, kind) for kind in KINDS]
            if len(one.lidars) > 1:
                others = [lidar for lidar in one.lidars if lidar != one.odometry]
                out += [Cause(f"{one.drive}/{lidar}", kind) for lidar in others for kind in KINDS]
        return out

    def spread(self, cause: Cause) -> Array:
        """(K, 6) or (K, 1): how the unknowns of a cause enter those of all lidars."""
        rows = np.arange(6) if cause.kind == "extrinsics" else np.array([6])
        out = np.zeros((self.unknowns, len(rows)))
        for k, (drive, lidar) in enumerate(self.names):
            if k not in self.fixed and cause.of in (RIG, f"{EVERY}{lidar}", drive, f"{drive}/{lidar}"):
                out[SIZE * k + rows, np.arange(len(rows))] = 1.0
        return out

    def prior(self, faulty: Iterable[Cause] = (), slight: Cause | None = None, better: Sigmas | None = None) -> Array:
        """(K, K) covariance of all unknowns, if some causes are in error, one of them slightly so, and the others as
        good as they should be.

        Args:
            better: factors of the standard deviations of what is as good as it should be.
        """
        bad = set(faulty)
        out = np.zeros((self.unknowns, self.unknowns))
        for cause in self.causes():
            spread = self.spread(cause)
            sigmas = SLIGHT if cause == slight else FAULTY if cause in bad else cause.nominal
            if better is not None and sigmas is cause.nominal:
                sigmas = sigmas.times(better)
            out += spread @ (sigmas.variances(cause.kind, self.enlarged)[:, None] * spread.T)
        return out


def moves(twist_per_s: Array) -> Array:
    """(..., 6, 7) ``u`` as a function of a lidar's unknowns, for the rig's twists (..., 6) a second."""
    twist = np.asarray(twist_per_s)
    eye = np.broadcast_to(np.eye(6), (*twist.shape[:-1], 6, 6))
    return np.concatenate([eye, -twist[..., None]], axis=-1)


def unknowns_reduced(count: int, factor: float) -> Array:
    """(7 S,) by what the unknowns of S lidars in metres enlarged by ``factor`` are multiplied to be in metres."""
    return np.tile(np.repeat([1 / factor, 1.0], [3, 4]), count)
