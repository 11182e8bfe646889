"""One-way paths between points and images of the radar, on the host, and echoes of such points."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from hardware.compiled import kernel
from twin.radar.propagation.one_way.internal_reflections import (
    InternalReflections,
    with_internal_reflections,
)
from twin.radar.propagation.one_way.motion import NEAREST_M
from twin.radar.propagation.one_way.path import TracingContext, one_way_path
from twin.radar.synthesis import Contributions
from twin.transfer import aligned, host, vector

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PointPaths:
    """Paths from images to points, (n,) or (n, 3), in the world's axes; see `path.OneWayPath`.

    ``length``: of the direct path, which sets the spreading; ``extra``: what walls and diffraction
    around obstacles add to it; ``over``: number of the obstacle around which it is diffracted, -1
    for none; ``rate``: growth of the length by that obstacle's motion, m/s; ``velocity``,
    ``acceleration`` and ``spin`` of the image; ``axes`` (n, 3, 3): the world's axes as it shows
    them.
    """

    source: NDArray[np.uint32]
    back: Array
    length: Array
    extra: Array
    departure: Array
    field: NDArray[np.complex128]
    velocity: Array
    acceleration: Array
    spin: Array
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

    def changes(self, velocity: Array, acceleration: Array) -> tuple[Array, Array, Array]:
        """How the straight paths to points, which move so, (n, 3) or (3,), change: first and second
        derivative of their lengths, (n,), m/s and m/s^2, and that of the directions from the image,
        in its own axes, (n, 3), 1/s; as `lengthening` and `turning` tell.
        """
        moving = [np.broadcast_to(x, self.back.shape) for x in (velocity, acceleration)]
        own = (self.velocity, self.acceleration, self.spin, self.axes, self.back, self.length)
        rate, faster, turn = kernel(_changes)(*map(np.ascontiguousarray, (*moving, *own)))
        return rate, faster, turn

    def take(self, which: Any) -> "PointPaths":
        """Only some of them, by index or mask."""
        own = {f.name: getattr(self, f.name)[which] for f in fields(self)[:-1]}
        return replace(
            self, ring=InternalReflections(self.ring.rho[which], self.ring.lag_m[which]), **own
        )

    @staticmethod
    def concatenate(parts: Sequence["PointPaths"]) -> "PointPaths":
        """One after the other."""

        def all_of(name: str) -> Any:
            return np.concatenate([getattr(p, name) for p in parts])

        own = {f.name: all_of(f.name) for f in fields(PointPaths)[:-1]}
        rings = [np.concatenate([getattr(p.ring, n) for p in parts]) for n in ("rho", "lag_m")]
        return PointPaths(**own, ring=InternalReflections(*rings))


def _changes(
    velocity: Array,
    acceleration: Array,
    own_velocity: Array,
    own_acceleration: Array,
    spin: Array,
    axes: Array,
    back: Array,
    length: Array,
) -> tuple[Array, Array, Array]:
    rate, faster = np.zeros((2, len(back)))
    turn, across = np.zeros(back.shape), np.empty(3)
    for i in range(len(back)):
        for k in range(3):
            rate[i] -= (velocity[i, k] - own_velocity[i, k]) * back[i, k]
        distance = max(length[i], NEAREST_M)
        for k in range(3):
            across[k] = velocity[i, k] - own_velocity[i, k] + rate[i] * back[i, k]
            faster[i] += across[k] * across[k] / distance
            faster[i] -= (acceleration[i, k] - own_acceleration[i, k]) * back[i, k]
        for k in range(3):
            m, n = (k + 1) % 3, (k + 2) % 3
            turned = across[k] / distance + spin[i, m] * back[i, n] - spin[i, n] * back[i, m]
            for axis in range(3):
                turn[i, axis] += axes[i, axis, k] * turned
    return rate, faster, turn


def paths_to_points(
    context: TracingContext,
    source: int | NDArray[np.integer],
    places: Array,
    off: Array,
    unshadowed: bool = False,
) -> PointPaths:
    """Paths from one image, or one for each, to points (n, 3), from which rays start at a distance
    ``off`` (n, 3) from the surface; ``unshadowed``: occluders are ignored.
    """
    mi, n = context.mi, len(places)
    sources = np.full(n, source, dtype=np.uint32)
    place, aside = (vector(mi, rows, "Vector3d") for rows in (places, off))
    numbers = mi.UInt32(aligned(sources))
    path = one_way_path(context, numbers, place, aside, mi.Bool(True), unshadowed=unshadowed)
    p = path.transmission
    back, length, extra, departure, re, im, clear, *rings = host(
        [path.back, path.length, p.extra, path.departure, path.field.re, path.field.im, path.clear]
        + [p.rho_re, p.rho_im, p.lag],
        n,
    )
    field = re + 1j * im
    velocity, acceleration, spin = (part[sources] for part in context.motions.on_host())
    axes = np.array(context.axes).reshape(-1, 3, 3)[sources]
    return PointPaths(
        source=sources,
        back=back,
        length=length,
        extra=extra,
        departure=departure,
        field=field,
        velocity=velocity,
        acceleration=acceleration,
        spin=spin,
        axes=axes,
        clear=clear,
        over=np.full(n, -1),
        rate=np.zeros(n),
        ring=InternalReflections.of(*rings),
    )


def between(
    forward_path: PointPaths,
    return_path: PointPaths,
    amplitude: NDArray[np.complex128],
    motion: tuple[Array, Array],
    number: NDArray[np.integer],
) -> Contributions:
    """Echoes by a forward and a return path each, with the internal reflections of walls.

    Parameters
    ----------
    amplitude
        Of each point (n,), without the spreading, which is 1 over both lengths.
    motion, number
        Velocity and acceleration of the points, (n, 3) or (3,) each, and number of the object of
        each, (n,).
    """
    paths = (forward_path, return_path)
    velocity, acceleration = motion
    (rate, faster, turn), (other_rate, other_faster, other_turn) = (
        path.changes(velocity, acceleration) for path in paths
    )
    length_m = forward_path.length + forward_path.extra + return_path.length + return_path.extra
    rate_m_per_s = rate + other_rate + forward_path.rate + return_path.rate
    once = Contributions(
        amplitude=amplitude / (forward_path.length * return_path.length),
        delay_s=length_m / speed_of_light,
        delay_rate=rate_m_per_s / speed_of_light,
        delay_acceleration_per_s=(faster + other_faster) / speed_of_light,
        departure=forward_path.departure,
        arrival=return_path.departure,
        object=np.asarray(number, dtype=np.uint32),
        source=forward_path.source,
        receiver=return_path.source,
        departure_per_s=turn,
        arrival_per_s=other_turn,
    )
    alike = forward_path.source == return_path.source
    return with_internal_reflections(once, length_m, forward_path.ring, return_path.ring, alike)
