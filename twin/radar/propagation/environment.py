"""Single paths in the scene of physical optics: mirror images of the radar, and declared points.

The same legs as every other echo's, in float64; Sionna RT's image method is what they are tested
against.
"""

from collections.abc import Sequence

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.radar.propagation.legs import Station, leg
from twin.radar.propagation.points import between, point_legs
from twin.radar.propagation.rays import Rays
from twin.radar.scattering.kernel import turned
from twin.scene import Target

Array = NDArray[np.float64]


def mirror_echoes(s: Station) -> Rays:
    """Images in which the radar sees itself: amplitude per wavelength, no object.

    Over the images of even and odd order alike: wall, wall and ground, and so on.
    """
    if s.n_sources < 2:
        return Rays.joined([])
    mi = s.mi
    source = dr.arange(mi.UInt32, 1, s.n_sources)
    place = s.place + dr.zeros(mi.Vector3d, s.n_sources - 1)
    way = leg(s, source, place, dr.zeros(mi.Vector3d, 1), mi.Bool(True), traced=False)
    heard = turned(s.vertical, -s.boresight, way.back)
    wavelength_free = 1 / (4 * np.pi * np.array(way.length))
    amplitude = wavelength_free * (
        np.array(dr.dot(way.field, heard)) + 1j * np.array(dr.dot(way.field_im, heard))
    )
    none = np.zeros(s.n_sources - 1, dtype=np.uint32)
    return Rays(
        amplitude=amplitude,
        length_m=np.array(way.length + way.passage.extra),
        rate_m_per_s=np.array(way.rate),
        departure=np.array(way.departure).T,
        arrival=np.array(way.back).T,
        object=none,
        source=np.array(source),
        receiver=none,
    ).chosen(np.flatnonzero(np.array(way.clear)))


def point_echoes(s: Station, targets: Sequence[Target], anchor_m: Array) -> Rays:
    """Declared points over every pair of images: amplitude per wavelength; ``object`` counts the
    targets.
    """
    places = np.array([t.position_m for t in targets]).reshape(-1, 3) - anchor_m
    velocity = np.array([t.velocity_m_per_s for t in targets]).reshape(-1, 3)
    strength = np.sqrt([t.rcs_m2 for t in targets]) / (4 * np.pi) ** 1.5
    legs = [point_legs(s, i, places, np.zeros_like(places)) for i in range(s.n_sources)]
    found = []
    for out in legs:
        for home in legs:
            at = np.flatnonzero(out.clear & home.clear)
            one, other = out.chosen(at), home.chosen(at)
            amplitude = strength[at] * np.sum(one.field * other.field, axis=1)
            found.append(between(one, other, amplitude, velocity[at], at))
    return Rays.joined(found)
