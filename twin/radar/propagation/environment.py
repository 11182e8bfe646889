"""Single paths in the scene of physical optics: mirror images of the radar, and declared points.

The same legs as every other echo's, in float64; Sionna RT's image method is what they are tested
against.
"""

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from hardware.waveform import C_M_PER_S
from twin.radar.propagation.legs import Leg, Station, leg
from twin.radar.scattering.kernel import turned
from twin.scene import Target

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


def mirror_echoes(s: Station) -> tuple[NDArray[np.intp], Complex, Array, Array, Array, Array]:
    """Images in which the radar sees itself, with amplitude (n,) without gains, length and its
    rate, departure and arrival (n, 3) in the world's axes.

    Over the images of even and odd order alike: wall, wall and ground, and so on.
    """
    mi = s.mi
    if s.n_sources < 2:
        empty = np.zeros(0)
        none = np.zeros((0, 3))
        return np.zeros(0, dtype=np.intp), empty.astype(complex), empty, empty, none, none
    source = dr.arange(mi.UInt32, 1, s.n_sources)
    place = s.place + dr.zeros(mi.Vector3d, s.n_sources - 1)
    way = leg(s, source, place, dr.zeros(mi.Vector3d, 1), mi.Bool(True), traced=False)
    heard = turned(s.vertical, -s.boresight, way.back)
    wavelength_free = 1 / (4 * np.pi * np.array(way.length))
    amplitude = wavelength_free * (
        np.array(dr.dot(way.field, heard)) + 1j * np.array(dr.dot(way.field_im, heard))
    )
    seen = np.flatnonzero(np.array(way.clear))
    return (
        seen + 1,
        amplitude[seen],
        np.array(way.length + way.passage.extra)[seen],
        np.array(way.rate)[seen],
        np.array(way.departure).T[seen],
        np.array(way.back).T[seen],
    )


class PointEchoes:
    """Legs from every image to every declared point, found at once."""

    def __init__(self, s: Station, targets: Sequence[Target], anchor_m: Array) -> None:
        mi, n = s.mi, len(targets)
        places = np.array([t.position_m for t in targets]).reshape(-1, 3) - anchor_m
        self.shape = (s.n_sources, n)
        source = mi.UInt32(np.repeat(np.arange(s.n_sources, dtype=np.uint32), n))
        place = mi.Vector3d(*(mi.Float64(np.tile(places[:, i], s.n_sources)) for i in range(3)))
        way: Leg = leg(s, source, place, dr.zeros(mi.Vector3d, 1), mi.Bool(True))
        self.clear = self._table(way.clear)
        self.length = self._table(way.length)
        self.extra = self._table(way.passage.extra)
        self.ring = 1 / (1 - self._ringing(way, s))
        self.rate = self._table(way.rate)
        self.back, self.departure = self._vectors(way.back), self._vectors(way.departure)
        self.field = self._vectors(way.field) + 1j * self._vectors(way.field_im)

    def _table(self, value: Any) -> Any:
        return np.broadcast_to(np.array(value), self.shape[0] * self.shape[1]).reshape(self.shape)

    def _ringing(self, way: Leg, s: Station) -> Any:
        """The internal echo of a wall over the one before it, at the carrier."""
        p = way.passage
        turn = 2 * np.pi * (self._table(p.lag) / float(s.wavelength[0]) % 1.0)
        rho = self._table(p.rho_re) + 1j * self._table(p.rho_im)
        return rho * np.exp(-1j * turn)

    def _vectors(self, value: Any) -> Any:
        flat = np.array(value)
        flat = np.broadcast_to(flat, (3, self.shape[0] * self.shape[1]))
        return flat.T.reshape(*self.shape, 3)

    def echo(
        self, i: int, j: int, number: int, target: Target
    ) -> tuple[complex, float, float, Array, Array] | None:
        """From image i over a point to image j: amplitude per wavelength without gains, delay,
        its rate, departure, arrival.
        """
        if not (self.clear[i, number] and self.clear[j, number]):
            return None
        length = sum(self.length[n, number] + self.extra[n, number] for n in (i, j))
        spread = (4 * np.pi) ** 1.5 * self.length[i, number] * self.length[j, number]
        amplitude = np.sqrt(target.rcs_m2) / spread
        amplitude = amplitude * (self.field[i, number] @ self.field[j, number])
        amplitude = amplitude * self.ring[i, number] * self.ring[j, number]
        across = self.back[i, number] + self.back[j, number]
        moving = -np.asarray(target.velocity_m_per_s) @ across
        rate = self.rate[i, number] + self.rate[j, number] + moving
        return (
            complex(amplitude),
            float(length / C_M_PER_S),
            float(rate / C_M_PER_S),
            self.departure[i, number],
            self.departure[j, number],
        )
