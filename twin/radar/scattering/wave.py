"""The radar as the target sees it: where it stands, how its field is polarised."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from twin.errors import InputError

Array = NDArray[np.float64]
Polarization = Literal["V", "H"]


@dataclass(frozen=True, eq=False)
class Radar:
    """Transmitter and receiver in one point, isotropic, looking at the target's origin.

    direction
        From the origin to the radar, (3,), of length 1.
    distance_m
        From the origin; infinite for a plane wave.

    Polarisation is Ludwig's third definition (IEEE Trans. AP 21, 1973): on boresight V lies in the
    vertical plane and H across it, elsewhere they are turned with the ray.
    """

    direction: Array
    distance_m: float = np.inf

    def __post_init__(self) -> None:
        if not self.distance_m > 0:
            raise InputError(f"distance_m: {self.distance_m}: expected above 0")

    @classmethod
    def at(
        cls, azimuth_deg: float, elevation_deg: float = 0.0, distance_m: float = np.inf
    ) -> "Radar":
        """In the direction (cos el cos az, cos el sin az, sin el)."""
        azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
        flat = np.cos(elevation)
        up = np.sin(elevation)
        return cls(np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), up]), distance_m)

    @property
    def inverse_distance(self) -> float:
        """0 for a plane wave: every formula below holds for both."""
        return 1 / self.distance_m

    @property
    def polarizations(self) -> Array:
        """Unit vectors of V and H at the target's origin, (2, 3): -theta and phi."""
        x, y, _ = self.direction
        flat = np.hypot(x, y)
        # Straight above or below azimuth has no meaning; 0 is taken.
        h = np.array([-y, x, 0.0]) / flat if flat > 1e-9 else np.array([0.0, 1.0, 0.0])
        return np.array([np.cross(self.direction, h), h])

    def wave_at(self, points_m: Array, polarization: Polarization) -> "Wave":
        """The incident wave at points (n, 3)."""
        u, q = self.direction, self.inverse_distance
        towards = u - q * points_m
        scale = np.maximum(np.linalg.norm(towards, axis=1), 1e-12)
        detour = (q * np.sum(points_m**2, axis=1) - 2 * points_m @ u) / (1 + scale)
        direction = -towards / scale[:, None]
        e = self.polarizations[0 if polarization == "V" else 1]
        turned = e - (direction @ e / np.maximum(1 - direction @ u, 1e-9))[:, None] * (
            direction - u
        )
        return Wave(direction, turned, scale, detour)


@dataclass(frozen=True, eq=False)
class Wave:
    """A spherical or plane wave at n points, as it compares to the target's origin.

    ``direction`` of travel and real polarisation (n, 3); ``scale`` the distance from the radar over
    that of the origin, ``detour_m`` the same as a difference, both (n,).
    """

    direction: Array
    field: Array
    scale: Array
    detour_m: Array
