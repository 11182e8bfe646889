"""The plane of the virtual array, in which directions are measured.

A plane wave tells an array in one plane the two cosines of its direction along that plane, and a
line the one along it. What is across the plane follows from these but for its sign: a direction and
its mirror image by the plane look alike. Of a line, the direction is taken as level, or of a line
that is more upright than level, as straight ahead.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.radar.burst import DemodulatedBurst

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]

FLAT = 0.1  # wavelengths: extent along which nothing is told of a direction
_EXACT = 1e-3  # wavelengths: extent ahead that leaves an array straight ahead
_STEEPEST = 0.5  # cosine: turned farther, most directions ahead are seen with their mirror images
_AHEAD, _LEFT, _UP = np.eye(3)


@dataclass(frozen=True, eq=False)
class ArrayPlane:
    """Where channels are, (n_channels, 2), along two axes in wavelengths, and of which of these
    they have an extent, ``seen`` (2,); the ``axes`` and the plane's normal in the antenna's frame,
    (3, 3) in rows; how far channels are before the plane, ``ahead`` (n_channels,), in wavelengths.
    The axes are left and up where the array faces straight ahead.
    """

    places: Array
    seen: Flags
    axes: Array
    ahead: Array

    @staticmethod
    def of(burst: DemodulatedBurst) -> "ArrayPlane | None":
        """That of a burst's channels; None of those that tell no direction: within a tenth of a
        wavelength they are in one place, or in no plane that faces ahead within 60 degrees.
        """
        places = virtual_array(burst) / burst.waveform.wavelength_m
        centred = places - places.mean(axis=0)
        faces_ahead = extents(places)[0] <= _EXACT
        if faces_ahead:
            centred[:, 0] = 0.0
        across = np.linalg.svd(centred)[2]  # by extent, the largest first
        extent = extents(centred @ across.T)
        if extent[0] <= FLAT:
            return None
        if extent[1] <= FLAT:
            axes, seen = _of_line(across[0])
        elif extent[2] > FLAT:
            return None
        else:
            axes, seen = _of_plane(_AHEAD if faces_ahead else across[2]), np.array([True, True])
        if seen.all() and axes[2] @ _AHEAD < _STEEPEST:
            return None
        return ArrayPlane(places @ axes[:2].T, seen, axes, centred @ axes[2])

    @property
    def is_flat(self) -> bool:
        """Whether all channels are in the plane."""
        return bool(np.ptp(self.ahead) <= _EXACT)

    def flattened(self, amplitude: Complex, cosines: Array) -> Complex:
        """Amplitudes of a plane wave from about these cosines (2,) as if all channels were in the
        plane.
        """
        across = np.sqrt(max(1 - float(cosines @ cosines), 0.0))
        return np.asarray(amplitude * np.exp(-2j * np.pi * self.ahead * across))

    @property
    def faces_ahead(self) -> bool:
        """Whether no direction ahead has its mirror image ahead too."""
        return bool(self.axes[2] @ _AHEAD > 1 - 1e-12)

    def directions(self, cosines: Array) -> Array:
        """Unit vectors (n, 2, 3) in the antenna's frame of cosines (n, 2) along the axes: the one
        on the side of the normal, and its mirror image.
        """
        along = np.clip(1 - np.sum(cosines**2, axis=1), 0.0, None)
        across = np.sqrt(along)[:, None] * self.axes[2]
        in_plane = cosines @ self.axes[:2]
        return np.stack([in_plane + across, in_plane - across], axis=1)

    def is_ahead(self, cosines: Array) -> Flags:
        """Which cosines (n, 2) are those of a direction ahead, (n,)."""
        if self.faces_ahead:
            return np.ones(len(cosines), dtype=bool)
        return np.asarray((self.directions(cosines)[..., 0] > 0).any(axis=1))

    def slopes(self, cosines: Array) -> Array:
        """By how much the direction cosines to the left and up change with those (2,) along the
        axes, (2, 2).
        """
        across = np.sqrt(max(1 - float(cosines @ cosines), 1e-12))
        change = self.axes[:2] - np.outer(cosines, self.axes[2]) / across
        return np.asarray(change[:, 1:].T)


def virtual_array(burst: DemodulatedBurst) -> Array:
    """Positions of the virtual array, the sum of each pair's, (n_channels, 3), in metres."""
    return burst.transmitter_m + burst.receiver_m


def extents(places: Array) -> Array:
    """Extent along each axis."""
    return np.asarray(np.ptp(places, axis=0))


def _of_line(along: Array) -> tuple[Array, Flags]:
    """Axes and normal for a line, and which axis is along it, as far as it is level or upright."""
    ahead, left, up = along
    if np.hypot(ahead, left) >= abs(up):
        first = np.array([ahead, left, 0.0]) / np.hypot(ahead, left)
        first *= -1.0 if first[1] < 0 else 1.0
        axes, seen = (first, _UP), [True, False]
    else:
        second = np.array([ahead, 0.0, up]) / np.hypot(ahead, up)
        second *= np.sign(second[2])
        axes, seen = (_LEFT, second), [False, True]
    return np.stack([*axes, np.cross(*axes)]), np.array(seen)


def _of_plane(normal: Array) -> Array:
    """Axes and normal for a plane: the first is level, the normal ahead."""
    normal = normal * (-1.0 if normal[0] < 0 else 1.0)
    level = np.cross(_UP, normal)
    size = float(np.linalg.norm(level))
    first = level / size if size > 1e-9 else _LEFT
    return np.stack([first, np.cross(normal, first), normal])
