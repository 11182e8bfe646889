"""Echoes that run to and fro within the walls on the way, as contributions of their own."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from twin.radar.synthesis import Contributions

Array = NDArray[np.float64]

_MOST_TRIPS = 8  # within a wall
_FAINTEST = 3e-3  # of the first: 0.03 dB


@dataclass(frozen=True, eq=False)
class InternalReflections:
    """The internal echoes of the wall on a path, each (n,): one over the one before, and how much
    longer its path is; 0 where there is no wall.
    """

    rho: NDArray[np.complex128]
    lag_m: Array

    @staticmethod
    def of(rho_re: Array, rho_im: Array, lag_m: Array) -> "InternalReflections":
        """From what paths tell of it (`walls.SlabTransmission`)."""
        return InternalReflections(rho_re + 1j * rho_im, lag_m)


def with_internal_reflections(
    once: Contributions,
    length_m: Array,
    on_forward: InternalReflections,
    on_return: InternalReflections,
    alike: NDArray[np.bool_],
) -> Contributions:
    """Contributions with those that run to and fro within walls, each one by itself.

    ``length_m`` (n,): path lengths of ``once``, which is not rounded as its delays are. Of
    ``alike`` ones both paths are the same: p round trips in all come p + 1 times.
    """
    rows, amplitudes = [np.arange(len(once))], [once.amplitude]
    lengths = [length_m]
    strongest = float(
        max(np.abs(on_forward.rho).max(initial=0.0), np.abs(on_return.rho).max(initial=0.0))
    )
    for trips in range(1, _MOST_TRIPS + 1):
        if (trips + 1) * strongest**trips < _FAINTEST:
            break
        for p in range(trips + 1):
            q = trips - p
            rings = (on_forward.lag_m > 0) | (p == 0), (on_return.lag_m > 0) | (q == 0)
            active_rows = np.flatnonzero(rings[0] & rings[1] & (~alike | (q == 0)))
            times = np.where(alike[active_rows], trips + 1, 1)
            weaker = on_forward.rho[active_rows] ** p * on_return.rho[active_rows] ** q
            rows.append(active_rows)
            amplitudes.append(once.amplitude[active_rows] * times * weaker)
            lengths.append(
                length_m[active_rows]
                + (p * on_forward.lag_m[active_rows] + q * on_return.lag_m[active_rows])
            )
    if sum(map(len, rows)) == len(once):
        return once
    return replace(
        once.take(np.concatenate(rows)),
        amplitude=np.concatenate(amplitudes),
        delay_s=np.concatenate(lengths) / speed_of_light,
    )
