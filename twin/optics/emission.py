"""Emission matrix of a real emitter: lobes, blur and unequal cells.

Row i is the light that cell i, lit alone, sends into each cell of the field, per radiant intensity
of the ideal cell. Behind a perfect lens the matrix M is the identity. Measurements of a scene x
with patterns P are y = P M x.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import special

from twin.system import Emitter

Array = NDArray[np.float64]


def lobe_exponent(viewing_angle_deg: float) -> float:
    """M of cos^m with half its intensity at half the viewing angle."""
    return math.log(0.5) / math.log(math.cos(math.radians(viewing_angle_deg) / 2))


def cell_gains(emitter: Emitter) -> Array:
    """Radiant intensity of each cell over the nominal one, (n_cells,), mean 1.

    Drawn from a normal distribution cut at zero, the same for the same seed.
    """
    n = emitter.rows.value * emitter.columns.value
    if emitter.intensity_spread is None or n == 1:
        return np.ones(n)
    seed = emitter.intensity_seed.value if emitter.intensity_seed else 0
    gains = np.maximum(np.random.default_rng(seed).normal(1, emitter.intensity_spread.value, n), 0)
    return np.asarray(gains / gains.mean())


def emission_matrix(emitter: Emitter, distance_m: float) -> Array:
    """M (n_cells, n_cells) of the emitter on a plane at ``distance_m``, which only bare LEDs need.

    It includes the fall of the lobe across the field, which the ideal cell does not have.
    """
    gains = cell_gains(emitter)[:, None]
    if not emitter.has_lens:
        return gains * _bare_led_lobes(emitter, distance_m)
    tan = math.tan(math.radians(emitter.field_of_view_deg.value) / 2)
    sigma = 0.0
    if emitter.blur_rms_deg is not None:
        sigma = math.tan(math.radians(emitter.blur_rms_deg.value)) / tan
    up, across = (_blur_matrix(n.value, sigma) for n in (emitter.rows, emitter.columns))
    return gains * np.kron(up, across) * field_lobe(emitter)


def field_lobe(emitter: Emitter) -> Array:
    """Radiant intensity in the middle of each cell over that on the axis, (n_cells,)."""
    tan = math.tan(math.radians(emitter.field_of_view_deg.value) / 2)
    return _lobe(emitter, *_directions(emitter, tan)).ravel()


def independent_patterns(matrix: Array, floor: float = 1e-2) -> int:
    """Number of singular values above ``floor`` times the largest: the images that a measurement of
    SNR 1/floor can distinguish.
    """
    values = np.linalg.svd(matrix, compute_uv=False)
    return int(np.count_nonzero(values > floor * values[0]))


def _blur_matrix(n: int, sigma: float) -> Array:
    """Share of cell i's light in cell j of a row of ``n`` cells, blurred by sigma half-fields."""
    if sigma == 0:
        return np.eye(n)
    # The integral of the error function over both cells: second differences of this.
    distance = 2 / n * np.arange(-n, n + 1)
    z = distance / (math.sqrt(2) * sigma)
    twice = distance * special.erf(z) + math.sqrt(2 / math.pi) * sigma * np.exp(-(z**2))
    second = (twice[2:] - 2 * twice[1:-1] + twice[:-2]) / 2 / (2 / n)
    index = np.arange(n)
    return np.asarray(second[index[None, :] - index[:, None] + n - 1])


def _directions(emitter: Emitter, tan: float) -> tuple[Array, Array]:
    """Middle of each cell on the plane at distance 1: left and up, (rows, columns)."""
    rows, columns = emitter.rows.value, emitter.columns.value
    up = tan * (1 - (2 * np.arange(rows) + 1) / rows)
    left = tan * (1 - (2 * np.arange(columns) + 1) / columns)
    return np.broadcast_to(left, (rows, columns)), np.broadcast_to(up[:, None], (rows, columns))


def _lobe(emitter: Emitter, left: Array, up: Array) -> Array:
    if emitter.viewing_angle_deg is None:
        return np.ones_like(left)
    m = lobe_exponent(emitter.viewing_angle_deg.value)
    return np.asarray((1 + left**2 + up**2) ** (-m / 2))


def _bare_led_lobes(emitter: Emitter, distance_m: float) -> Array:
    """Lobes of LEDs side by side, each with an equal share; they differ by the pitch alone."""
    assert emitter.pitch_m is not None  # an Emitter without a lens has one
    rows, columns = emitter.rows.value, emitter.columns.value
    tan = math.tan(math.radians(emitter.field_of_view_deg.value) / 2)
    left, up = (x.ravel() for x in _directions(emitter, tan))
    pitch = emitter.pitch_m.value / distance_m
    row, column = np.divmod(np.arange(rows * columns), columns)
    from_left = pitch * ((columns - 1) / 2 - column)
    from_up = pitch * ((rows - 1) / 2 - row)
    lobe = _lobe(emitter, left - from_left[:, None], up - from_up[:, None])
    return lobe / (rows * columns)
