"""What of the errors of bodies' echoes lies in the cell of a detection.

An error of a body is spread over ranges and rates. What is at another place than the detection
counts as the side lobes of the map let it through on which that is measured, see `measured_with`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hardware.radar import Detection
from hardware.radar.windows import normalised_window
from hardware.waveform import OfdmWaveform
from twin.radar.propagation.facets.body_profile import BodyProfile
from twin.radar.propagation.facets.convergence import LEAST, WITHIN, BodyEcho

Array = NDArray[np.float64]

_PER_CELL = 8  # places at which the response is known


@dataclass(frozen=True)
class ErrorsInCell:
    """Amplitudes of an error, received over sent: that 95 of 100 keep, and a bound."""

    statistical: float
    systematic: float


def errors_in_cell(
    bodies: Sequence[BodyEcho],
    detection: Detection,
    waveform: OfdmWaveform,
    windows: tuple[str, ...],
) -> ErrorsInCell:
    """Errors of all bodies at a detection's place.

    Errors that are accepted are independent of each other. What bounds say of a body's echo changes
    every part of it alike, as much as that part is of the whole; bounds of several bodies add.
    ``windows``: as of `measured_with`.
    """
    square, bound = 0.0, 0.0
    for body in bodies:
        if body.profile is None:
            level = body.level_amplitude
            square += (body.accepted_error * level) ** 2
            bound += body.systematic * level
            continue
        profile = body.profile
        weight = _response(profile, detection, waveform, windows) ** 2
        echo, error = (float(weight @ part) for part in (profile.power, profile.square))
        square += WITHIN**2 * error + LEAST**2 * echo
        whole = float(profile.power.sum())
        if whole:
            bound += body.systematic * body.level_amplitude * float(np.sqrt(echo / whole))
    return ErrorsInCell(float(np.sqrt(square)), bound)


def measured_with(detection: Detection, window: str, noise_w: float) -> tuple[str, ...]:
    """Windows that a detection may be measured with: that of the map, if its SNR is over the map's
    noise, ``noise_w``; else any, since it is measured without one, or by a method of one's own.
    """
    of_map_w = noise_w * 10 ** (detection.snr_db / 10)
    is_on_map = math.isclose(detection.power_w, of_map_w, rel_tol=1e-9)
    return (window,) if is_on_map else (window, "boxcar")


def _response(
    profile: BodyProfile, detection: Detection, waveform: OfdmWaveform, windows: tuple[str, ...]
) -> Array:
    """Amplitude with which each cell of a profile shows at a detection, (n,), at most."""
    axes = (
        (
            detection.range_m - profile.range_m,
            waveform.range_cell_m,
            waveform.n_subcarriers,
            profile.size[0],
        ),
        (
            detection.range_rate_m_per_s - profile.range_rate_m_per_s,
            waveform.velocity_cell_m_per_s,
            waveform.n_slots,
            profile.size[1],
        ),
    )
    response = np.ones(len(profile.range_m))
    for off, cell, n, size in axes:
        # A place that is not measured, or not known, may be any.
        off = np.nan_to_num(np.abs(off) % (n * cell), nan=0.0)
        beyond = np.minimum(off, n * cell - off) - size / 2
        places = _PER_CELL * np.maximum(beyond, 0.0) / cell
        envelope = np.max([_envelope(window, n) for window in windows], axis=0)
        response *= envelope[np.minimum(places.astype(np.intp), len(envelope) - 1)]
    return response


@lru_cache(maxsize=16)
def _envelope(window: str, n: int) -> Array:
    """Largest response at places from so many cells on, `_PER_CELL` to each."""
    response = np.abs(np.fft.fft(normalised_window(window, n), _PER_CELL * n)) / n
    half = response[: _PER_CELL * n // 2 + 1]
    return np.asarray(np.maximum.accumulate(half[::-1])[::-1])
