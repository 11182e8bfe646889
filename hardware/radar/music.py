"""MUSIC: several targets of one range and rate, resolved by angle (Schmidt, IEEE Trans. AP 1986).

Echoes in one snapshot are coherent; spatial smoothing over shifted parts of the array, forward and
backward (Shan, Wax and Kailath 1985; Pillai and Kwon 1989), decorrelates them. It needs an evenly
spaced linear array.
"""

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.radar.array_plane import extents, virtual_array
from hardware.radar.burst import DemodulatedBurst

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


def music(
    amplitude: Complex, burst: DemodulatedBurst, n_targets: int, part: int | None = None
) -> Array:
    """Azimuths (n_targets,) in radians, ascending, positive to the left.

    Parameters
    ----------
    amplitude : (n_channels,) or (n_channels, n_snapshots)
        Compensated for the transmitters' TDM offsets, see `compensate_motion`.
    burst
        Its channels must form an evenly spaced line to the left.
    n_targets
        Number of targets.
    part
        Length of the shifted parts; default two thirds of the line. Longer parts have more
        resolution, shorter ones more averaging.

    Raises InputError for another array, or for more targets than it can resolve.
    """
    places = virtual_array(burst) / burst.waveform.wavelength_m
    line, spacing = _even_line(places)
    size = part or _part(len(line))
    if not 0 < n_targets < size or size + n_targets > len(line) + n_targets * (n_targets > 1):
        raise InputError(
            f"n_targets: {n_targets} of a line of {len(line)} places in parts of {size}"
        )
    on_line = np.stack([amplitude[at].mean(axis=0) for at in line]).reshape(len(line), -1)
    noise = _noise_space(on_line, size, n_targets)
    return _roots(noise, n_targets, spacing)


def most_targets(burst: DemodulatedBurst) -> int:
    """Number of targets of one cell that `music` resolves at most."""
    return _part(len(_even_line(virtual_array(burst) / burst.waveform.wavelength_m)[0])) - 1


def line_spacing(burst: DemodulatedBurst) -> float:
    """Of the places of its evenly spaced line, in wavelengths."""
    return _even_line(virtual_array(burst) / burst.waveform.wavelength_m)[1]


def _part(n_places: int) -> int:
    """Length of the shifted parts by default."""
    return -(-2 * n_places // 3)


def _even_line(places: Array) -> tuple[list[NDArray[np.intp]], float]:
    """Channels at each place of an evenly spaced line, left-most last, and its spacing."""
    left = np.round(places[:, 1] - places[:, 1].min(), 6)
    spots = np.unique(left)
    gaps = np.diff(spots)
    if len(spots) < 2 or np.ptp(gaps) > 1e-3 * gaps.mean() or extents(places)[[0, 2]].max() > 1e-3:
        raise InputError("burst: its channels are no evenly spaced line to the left")
    return [np.nonzero(left == spot)[0] for spot in spots], float(gaps.mean())


def _noise_space(on_line: Complex, size: int, n_targets: int) -> Complex:
    """Noise subspace (size, size - n_targets) of the smoothed covariance."""
    covariance = np.zeros((size, size), dtype=np.complex128)
    for start in range(len(on_line) - size + 1):
        shifted = on_line[start : start + size]
        covariance += shifted @ shifted.conj().T
    covariance += covariance[::-1, ::-1].conj()
    return np.asarray(np.linalg.eigh(covariance)[1][:, : size - n_targets])


def _roots(noise: Complex, n_targets: int, spacing: float) -> Array:
    """Azimuths from the noise polynomial's roots nearest to the unit circle (Barabell 1983)."""
    size = len(noise)
    projector = noise @ noise.conj().T
    polynomial = np.array([np.trace(projector, offset) for offset in range(size - 1, -size, -1)])
    roots = np.roots(polynomial)
    inside = roots[np.abs(roots) < 1]
    nearest = inside[np.argsort(-np.abs(inside))[:n_targets]]
    return np.sort(np.arcsin(np.clip(np.angle(nearest) / (2 * np.pi * spacing), -1, 1)))
