"""Echoes of points: legs between them and every image of the radar, brought to the host."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from twin.radar.propagation.one_way.internal_reflections import (
    InternalReflections,
    with_internal_reflections,
)
from twin.radar.propagation.one_way.motion import lengthening, turning
from twin.radar.propagation.one_way.path import TracingContext, leg
from twin.radar.synthesis import Contributions
from twin.transfer import aligned, host, vector

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PointPaths:
    """Legs from images to points, (n,) or (n, 3), in the world's axes; see `path.OneWayPath`.

    ``length`` is that of the straight way, which spreading follows; ``extra`` what walls and ways
    round obstacles add; ``over`` the number of the obstacle, -1 for none, and ``rate`` what its
    motion adds to the length per second; ``axes`` (n, 3, 3) are the world's as the image shows
    them.
    """

    source: NDArray[np.uint32]
    back: Array
    length: Array
    extra: Array
    departure: Array
    field: NDArray[np.complex128]
    velocity: Array
    axes: Array
    clear: NDArray[np.bool_]
    over: NDArray[np.int64]
    rate: Array
    ring: InternalReflections

    @property
    def level(self) -> Array:
        """Amplitude of the field (n,), without its spreading."""
        level: Array = np.linalg.norm(self.field, axis=1)
        return level

    def chosen(self, which: Any) -> "PointPaths":
        """Only some of them, by index or mask."""
        own = {f.name: getattr(self, f.name)[which] for f in fields(self)[:-1]}
        return replace(
            self, ring=InternalReflections(self.ring.rho[which], self.ring.lag_m[which]), **own
        )

    @staticmethod
    def joined(parts: Sequence["PointPaths"]) -> "PointPaths":
        """One after the other."""

        def all_of(name: str) -> Any:
            return np.concatenate([getattr(p, name) for p in parts])

        own = {f.name: all_of(f.name) for f in fields(PointPaths)[:-1]}
        rings = [np.concatenate([getattr(p.ring, n) for p in parts]) for n in ("rho", "lag_m")]
        return PointPaths(**own, ring=InternalReflections(*rings))


def paths_to_points(
    s: TracingContext,
    source: int | NDArray[np.integer],
    places: Array,
    off: Array,
    unshadowed: bool = False,
) -> PointPaths:
    """Legs from one image, or one for each, to points (n, 3), from which rays start at a distance
    ``off`` (n, 3); ``unshadowed`` as if nothing stood in between.
    """
    mi, n = s.mi, len(places)
    sources = np.full(n, source, dtype=np.uint32)
    place, aside = (vector(mi, rows, "Vector3d") for rows in (places, off))
    numbers = mi.UInt32(aligned(sources))
    way = leg(s, numbers, place, aside, mi.Bool(True), unshadowed=unshadowed)
    p = way.passage
    back, length, extra, departure, re, im, clear, *rings = host(
        [way.back, way.length, p.extra, way.departure, way.field.re, way.field.im, way.clear]
        + [p.rho_re, p.rho_im, p.lag],
        n,
    )
    field, velocity = re + 1j * im, np.array(s.velocities).reshape(-1, 3)[sources]
    axes = np.array(s.axes).reshape(-1, 3, 3)[sources]
    return PointPaths(
        source=sources,
        back=back,
        length=length,
        extra=extra,
        departure=departure,
        field=field,
        velocity=velocity,
        axes=axes,
        clear=clear,
        over=np.full(n, -1),
        rate=np.zeros(n),
        ring=InternalReflections.of(*rings),
    )


def between(
    out: PointPaths,
    home: PointPaths,
    amplitude: NDArray[np.complex128],
    velocity: Array,
    number: NDArray[np.integer],
) -> Contributions:
    """Echoes out by one leg and home by another, walls' internal echoes included.

    Parameters
    ----------
    amplitude
        Of each point (n,), but for the spreading, 1 over both lengths.
    velocity, number
        Of the points, (n, 3) or (3,), and of the objects that they belong to, (n,).
    """
    legs = (out, home)
    moved = [(velocity - leg.velocity, -leg.back, leg.length) for leg in legs]
    ways = [lengthening(*motion) for motion in moved]
    turns = [
        np.einsum("nij,nj->ni", leg.axes, turning(*motion))
        for leg, motion in zip(legs, moved, strict=True)
    ]
    length_m = out.length + out.extra + home.length + home.extra
    rate_m_per_s = ways[0][0] + ways[1][0] + out.rate + home.rate
    once = Contributions(
        amplitude=amplitude / (out.length * home.length),
        delay_s=length_m / speed_of_light,
        delay_rate=rate_m_per_s / speed_of_light,
        delay_acceleration_per_s=(ways[0][1] + ways[1][1]) / speed_of_light,
        departure=out.departure,
        arrival=home.departure,
        object=np.asarray(number, dtype=np.uint32),
        source=out.source,
        receiver=home.source,
        departure_per_s=turns[0],
        arrival_per_s=turns[1],
    )
    alike = out.source == home.source
    return with_internal_reflections(once, length_m, out.ring, home.ring, alike)
