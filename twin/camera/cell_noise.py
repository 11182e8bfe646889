"""Noise of every cell of an image, all shutters together, from the noise budget."""

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import RasterScan
from hardware.reconstruction.gating import bounds, echo
from twin.camera.chain import Chain, Powers
from twin.detector.flicker import by_cell

Array = NDArray[np.float64]

#: Noise over an echo's electrons with which its delay is looked for in noise-free gates.
_FAINT = 1e-3


def cells_noise_e(chain: Chain, power: Powers, signal_w: Array) -> Array:
    """Noise of each cell, (n_detectors, n_cells), in electrons of all shutters.

    Hadamard patterns share the noise of all light; ``signal_w`` is that of their exposures as
    `Chain.measure_frame` gives it. Of a raster scan each cell has the noise of its own exposures,
    and behind gates that of an echo of unknown delay over an unknown background.
    """
    patterns, n_shutters = chain.patterns, len(chain.shutters)
    if not isinstance(patterns, RasterScan):
        budgets = chain.noise_by_detector(signal_w, power.sun_w)
        times = chain.exposure_times
        by_shutter = np.array(
            [by_cell(b, patterns, times) if times else b.cells_noise_e(patterns) for b in budgets]
        )
        return np.asarray(np.sqrt(n_shutters) * by_shutter)
    if chain.system.time_of_flight is not None and chain.system.time_of_flight.gate_delays_s:
        return echo_noise(chain, power)[0][None]
    return np.asarray(np.sqrt(_variance(chain, power).sum(axis=0)))[None]


def echo_noise(chain: Chain, power: Powers) -> tuple[Array, Array]:
    """Noise of the amplitude, electrons, and of the delay, s, of each cell's echo in the gates of a
    raster scan, both (n_cells,): their Cramer-Rao bounds.
    """
    tof = chain.system.time_of_flight
    assert tof is not None  # only called for gates
    assert tof.pulse_width_s is not None
    pulse_s = tof.pulse_width_s.value
    gates = np.array([(s.recorded.gate_delay_s, s.recorded.gate_width_s) for s in chain.shutters])
    electrons = power.cells_w[:, 0] * chain.front_end.electrons_per_watt
    faint = np.full_like(electrons, _FAINT * max(float(electrons.max()), 1e-300))
    found = echo(electrons, faint, gates, pulse_s)
    plain = chain.patterns.mode == "plain"
    return bounds(
        electrons.sum(axis=0),
        found.delay_s,
        _variance(chain, power),
        gates,
        pulse_s,
        background=plain,
    )


def _variance(chain: Chain, power: Powers) -> Array:
    """Of the electrons of each cell behind each shutter, (n_shutters, n_cells), of a differential
    scan with the exposure in the dark.

    The budget's variance is taken as quadratic in the signal and linear in the sun, as that of a
    photodiode is.
    """
    scan = chain.patterns
    assert isinstance(scan, RasterScan)
    signal_w = power.cells_w[:, 0]
    sun_w = power.sun_w if power.sun_of_cells_w is None else power.sun_of_cells_w
    sun_w = chain.open_share[:, None] * np.broadcast_to(sun_w, (scan.n_cells,))
    most_w, sun_most_w = (max(float(each.max()), 1e-30) for each in (signal_w, sun_w))

    def variance(signal: float, sun: float) -> float:
        return chain.noise(np.array([signal]), np.array([sun])).total_noise_e ** 2

    dark, middle, bright = (variance(share * most_w, 0.0) for share in (0.0, 0.5, 1.0))
    by_sun = (variance(0.0, sun_most_w) - dark) / sun_most_w
    share = signal_w / most_w
    # Newton's form through three points.
    curve = 2 * (bright - 2 * middle + dark)
    lit = dark + (2 * (middle - dark) - curve / 2) * share + curve * share**2
    unlit = dark + by_sun * sun_w if scan.mode == "differential" else 0.0
    return np.asarray(lit + by_sun * sun_w + unlit)
