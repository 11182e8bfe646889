"""Aspects of a mesh: directions and polarisations of the transmitter and the receiver."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.radar.scattering.wave import Polarization, Radar

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Aspects:
    """One row each, in the frame of the mesh.

    ``source`` and ``receiver`` (n, 3): unit vectors from the mesh's origin; ``distance_m`` (n,) of
    both, infinite for plane waves; ``sent`` (n, m, 3), one or two, and ``received`` (n, 2, 3):
    polarisations at the origin.
    """

    source: Array
    receiver: Array
    distance_m: Array
    sent: Array
    received: Array

    def __len__(self) -> int:
        return len(self.source)

    def part(self, which: slice) -> "Aspects":
        """Only some of them."""
        columns = (self.source, self.receiver, self.distance_m, self.sent, self.received)
        return Aspects(*(column[which] for column in columns))

    @property
    def are_monostatic(self) -> NDArray[np.bool_]:
        """Whether receiver and transmitter are one, (n,)."""
        is_same: NDArray[np.bool_] = (self.source == self.receiver).all(axis=1)
        return is_same

    @staticmethod
    def monostatic(radars: "list[Radar]", polarization: Polarization) -> "Aspects":
        """To radars and back, received in V and H."""
        received = np.array([radar.polarizations for radar in radars]).reshape(-1, 2, 3)
        direction = np.array([radar.direction for radar in radars]).reshape(-1, 3)
        distance = np.array([radar.distance_m for radar in radars], dtype=np.float64)
        sent = received[:, :1] if polarization == "V" else received[:, 1:]
        return Aspects(direction, direction, distance, sent, received)
