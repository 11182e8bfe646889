"""Contributions of the scene's ways out and back, with those that run to and fro within walls."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Distances are taken to be no shorter where something is divided by them.
NEAREST_M = 1e-12

_MOST_TRIPS = 8  # within a wall
_FAINTEST = 3e-3  # of the first: 0.03 dB


@dataclass(frozen=True, eq=False)
class Rays:
    """Contributions, each (n,), in order: amplitude without the antenna's gain, path length with
    its first and second derivative in time, in m, m/s and m/s^2; departure and arrival (n, 3) as
    seen from the radar, in the world's axes; object that is met last, and the images by which the
    wave goes out and back. ``departure_per_s`` and ``arrival_per_s`` (n, 3): derivatives of both
    directions in time, 1/s; default: 0. ``falloff``: over the band the amplitude goes as the
    carrier over the frequency to this power; default: 0. ``first``: number of the facet that is met
    first, of what facets scatter; default: 0.
    """

    amplitude: NDArray[np.complex128]
    length_m: Array
    rate_m_per_s: Array
    acceleration_m_per_s2: Array
    departure: Array
    arrival: Array
    object: NDArray[np.uint32]
    source: NDArray[np.uint32]
    receiver: NDArray[np.uint32]
    departure_per_s: Array = None  # type: ignore[assignment]
    arrival_per_s: Array = None  # type: ignore[assignment]
    falloff: Array = None  # type: ignore[assignment]
    first: NDArray[np.uint32] = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        n = len(self.length_m)
        defaults = {
            "departure_per_s": np.zeros((n, 3)),
            "arrival_per_s": np.zeros((n, 3)),
            "falloff": np.zeros(n),
            "first": np.zeros(n, dtype=np.uint32),
        }
        for name, values in defaults.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, values)

    def chosen(self, which: Any) -> "Rays":
        """Only some of them, by index or mask."""
        return Rays(*(getattr(self, f.name)[which] for f in fields(Rays)))

    @staticmethod
    def joined(parts: Sequence["Rays"]) -> "Rays":
        """One after the other."""
        if len(some := [part for part in parts if len(part.length_m)]) == 1:
            return some[0]
        return Rays(
            amplitude=np.concatenate([np.zeros(0, complex), *(p.amplitude for p in parts)]),
            length_m=np.concatenate([np.zeros(0), *(p.length_m for p in parts)]),
            rate_m_per_s=np.concatenate([np.zeros(0), *(p.rate_m_per_s for p in parts)]),
            acceleration_m_per_s2=np.concatenate(
                [np.zeros(0), *(p.acceleration_m_per_s2 for p in parts)]
            ),
            falloff=np.concatenate([np.zeros(0), *(p.falloff for p in parts)]),
            **{
                name: np.concatenate([np.zeros((0, 3)), *(getattr(p, name) for p in parts)])
                for name in ("departure", "arrival", "departure_per_s", "arrival_per_s")
            },
            **{
                name: np.concatenate(
                    [np.zeros(0, dtype=np.uint32), *(getattr(p, name) for p in parts)]
                )
                for name in ("object", "source", "receiver", "first")
            },
        )


def lengthening(velocity: Array, direction: Array, length_m: Array | float) -> tuple[Any, Any]:
    """First and second derivative in time of the distance between two points that move uniformly.

    ``velocity`` (..., 3) of one relative to the other, ``direction`` (..., 3) the unit vector from
    the other to it, ``length_m`` (...) their distance: v . d in m/s, and |v - (v . d) d|^2 / r in
    m/s^2, both (...).
    """
    rate = np.sum(velocity * direction, axis=-1)
    across = velocity - rate[..., None] * direction
    return rate, np.sum(across**2, axis=-1) / np.maximum(length_m, NEAREST_M)


def turning(velocity: Array, direction: Array, length_m: Array | float) -> Array:
    """Derivative in time of ``direction`` (..., 3), in 1/s; parameters as of `lengthening`."""
    across = velocity - np.sum(velocity * direction, axis=-1, keepdims=True) * direction
    found: Array = across / np.maximum(length_m, NEAREST_M)[..., None]
    return found


@dataclass(frozen=True, eq=False)
class InternalReflections:
    """The internal echoes of the wall on a leg, each (n,): one over the one before, and how much
    longer its path is; 0 where there is no wall.
    """

    rho: NDArray[np.complex128]
    lag_m: Array

    @staticmethod
    def of(rho_re: Array, rho_im: Array, lag_m: Array) -> "InternalReflections":
        """From what legs tell of it (`walls.SlabTransmission`)."""
        return InternalReflections(rho_re + 1j * rho_im, lag_m)


def with_internal_reflections(
    rays: Rays, out: InternalReflections, home: InternalReflections, alike: NDArray[np.bool_]
) -> Rays:
    """Rays with the echoes that run to and fro within walls, each one a contribution of its own.

    Of ``alike`` rays both legs are the same: p round trips in all come p + 1 times.
    """
    found = [rays]
    strongest = float(max(np.abs(out.rho).max(initial=0.0), np.abs(home.rho).max(initial=0.0)))
    for trips in range(1, _MOST_TRIPS + 1):
        if (trips + 1) * strongest**trips < _FAINTEST:
            break
        for p in range(trips + 1):
            q = trips - p
            rings = (out.lag_m > 0) | (p == 0), (home.lag_m > 0) | (q == 0)
            chosen = np.flatnonzero(rings[0] & rings[1] & (~alike | (q == 0)))
            times = np.where(alike[chosen], trips + 1, 1)
            some = rays.chosen(chosen)
            weaker = out.rho[chosen] ** p * home.rho[chosen] ** q
            later = p * out.lag_m[chosen] + q * home.lag_m[chosen]
            found.append(
                replace(
                    some,
                    amplitude=some.amplitude * times * weaker,
                    length_m=some.length_m + later,
                )
            )
    return Rays.joined(found)


def and_reversed(one: Rays) -> Rays:
    """The same ways walked the other way round, too, unless they end where they began."""
    back = one.source != one.receiver
    if not back.any():
        return one
    some = one.chosen(back)
    reverse = replace(
        some,
        departure=some.arrival,
        arrival=some.departure,
        departure_per_s=some.arrival_per_s,
        arrival_per_s=some.departure_per_s,
        source=some.receiver,
        receiver=some.source,
    )
    return Rays.joined([one, reverse])
