"""Signal of a real emitter for each pattern: finite contrast, slow switching, fluctuation."""

import math

import numpy as np
from numpy.typing import NDArray

from twin.system import System

Array = NDArray[np.float64]


#: Share of an error of the exposure before, up to which levels are told from exposures.
_STEADY = 0.95


def ideal_signal(system: System, cells_w: Array) -> Array:
    """Signal power of every exposure, (n_exposures, n_shutters, n_detectors), W, of an emitter that
    switches at once and does not fluctuate.

    ``cells_w`` (n_shutters, n_detectors, n_cells): power of each cell, lit alone.
    """
    ideal = system.patterns.signal(np.moveaxis(cells_w, -1, 0))
    dark = dark_share(system)
    return np.asarray((1 - dark) * ideal + dark * cells_w.sum(axis=-1) if dark else ideal)


def mean_signal(system: System, cells_w: Array) -> Array:
    """The same with the emitter's switching time: the patterns before decay while the shutters of
    the next one are open.
    """
    signal = ideal_signal(system, cells_w)
    left_over = residual_share(system)
    if not left_over:
        return signal
    kept = _kept(system, _switching_s(system))
    turns = np.zeros(signal.shape[1]) if system.gates_at_once else np.arange(signal.shape[1])
    light = settled(signal, kept ** (turns[-1] + 1), np.zeros_like(signal[0]))
    before = np.concatenate([np.zeros_like(light[:1]), light[:-1]])
    return np.asarray(signal + left_over * kept ** turns[:, None] * (before - signal))


def fading(system: System, signal_w: Array) -> Array:
    """Light of the patterns before at the beginning of each exposure, over that of its own pattern,
    (n_exposures, n_shutters, n_detectors), of a signal that `mean_signal` gave.

    The exposures say what the emitter's levels are: each holds its own and a known share of the
    light before. Of a decay about as long as a period and longer, behind several shutters, this
    would let rounding grow, and 0 is taken.
    """
    left_over, kept = residual_share(system), _kept(system, _switching_s(system))
    lasting = np.zeros_like(signal_w)
    n = signal_w.shape[1]
    whole = kept if system.gates_at_once else kept**n
    for shutter in range(1 if system.gates_at_once else n):
        since = kept**shutter
        share = left_over * since
        grows = (whole - share) / (1 - share)
        if abs(grows) > _STEADY:
            continue
        signal = signal_w[:, shutter]
        dark = np.zeros_like(signal[0])
        before = np.concatenate([dark[None], settled(signal, grows, dark)[:-1]])
        lasting[:, shutter] = since * (before - signal) / (1 - share)
    return lasting


def settled(levels: Array, kept: float, start: Array) -> Array:
    """Where a decay has come to at the end of each of a series of levels, (n, ...), of which it
    keeps the share ``kept`` of what was before, from ``start`` on.
    """
    from scipy.signal import lfilter  # takes 0.3 s to import

    return np.asarray(lfilter([1 - kept], [1, -kept], levels, axis=0, zi=kept * start[None])[0])


def frame_signal(
    system: System,
    cells_w: Array,
    *,
    rng: np.random.Generator | None,
    mean_w: Array | None = None,
) -> Array:
    """The same of one frame, with the emitter's fluctuation; without ``rng`` there is none.

    ``mean_w``: the result of `mean_signal`, if already computed.
    """
    signal = mean_signal(system, cells_w) if mean_w is None else mean_w
    noise = system.emitter.intensity_noise
    if rng is not None and noise is not None and noise.value:
        signal = signal * (1 + rng.normal(0, noise.value, (*signal.shape[:2], 1)))
    return np.maximum(signal, 0)


def dark_share(system: System) -> float:
    """Radiant intensity of a dark cell over that of a lit one."""
    contrast = system.emitter.contrast_ratio
    return 1 / contrast.value if contrast else 0.0


def residual_share(system: System) -> float:
    """Share of an exposure's light that belongs to the patterns before, the first after them."""
    decay_s = _switching_s(system)
    return system.acquisition.residue(decay_s) if decay_s else 0.0


def amplifier_residue(system: System) -> float:
    """Share of an exposure's charge that belongs to the exposures before, of light that changes at
    once: the amplifier's single pole decays with tau = 1 / (2 pi bandwidth).
    """
    decay_s = _amplifier_s(system)
    return system.acquisition.residue(decay_s) if decay_s else 0.0


def switched_residue(system: System) -> float:
    """Share of an exposure's charge, where the pattern has changed before it, that belongs to the
    preceding exposure: of the emitter's and the amplifier's decay together.
    """
    switching_s, amplifier_s = _switching_s(system), _amplifier_s(system)
    if not switching_s or not amplifier_s:
        return residual_share(system) + amplifier_residue(system)
    return system.acquisition.residue_of_two(switching_s, amplifier_s)


def amplifier_lag(system: System) -> tuple[float, float]:
    """Share of what `fading` tells, beyond the exposure's own, in the amplifier's mean over the
    exposure; and how much more than at once it is worth for the amplifier's output at the end.
    """
    switching_s, amplifier_s = _switching_s(system), _amplifier_s(system)
    if not switching_s or not amplifier_s:
        return 0.0, 0.0
    acquisition = system.acquisition
    mean = acquisition.residue_of_two(switching_s, amplifier_s) - acquisition.residue(amplifier_s)
    period_s = acquisition.pattern_period_s.value
    end = acquisition.kept_of_two(switching_s, amplifier_s) / -math.expm1(-period_s / amplifier_s)
    return mean, end


def amplifier_keeps(system: System) -> float:
    """Share of its output that the amplifier keeps over a period."""
    return _kept(system, _amplifier_s(system))


def _kept(system: System, decay_s: float) -> float:
    """Share that a decay leaves over a period."""
    return math.exp(-system.acquisition.pattern_period_s.value / decay_s) if decay_s else 0.0


def _switching_s(system: System) -> float:
    """After a switch the light decays with exp(-t / tau), tau = t_10-90 / ln 9."""
    switching = system.emitter.switching_time_s
    return switching.value / math.log(9) if switching else 0.0


def _amplifier_s(system: System) -> float:
    bandwidth = system.readout.bandwidth_hz
    return 1 / (2 * math.pi * bandwidth.value) if bandwidth else 0.0
