"""Phase noise of the leakage: estimated on the leakage itself and taken out of every receiver.

The leakage from transmitter to receiver is a strong path of known delay, so what the oscillator
does to it is measured on it, slot by slot and sample by sample. Referred to the leakage's waveform
l(t) a receiver holds 1 + j d(t) + echoes: the phase noise d is real and the same for all receivers
of one slot. A Fourier transform over samples and slots then gives it the symmetry
N(-k, -v) = -conj N(k, v) (k: range cells from the leakage, v: cells of rate), which neither an echo
nor thermal noise has. Half the difference of a cell and its mirror image holds the phase noise,
half the sum is free of it.

An echo is in both halves, and taking one away would halve it and mirror it about the leakage. So
where the half that is free of phase noise shows more than thermal noise would, the cell and its
mirror image are told apart by their own power, and the phase noise there is taken from the weaker
one. An echo straight ahead that stands below the phase noise in its own cell cannot be told from
its mirror image: there half its amplitude is left on either side.
"""

import numpy as np
from numpy.typing import NDArray

from hardware.radar.demodulation import Complex
from hardware.radar.windows import taper
from hardware.waveform import OfdmWaveform

Array = NDArray[np.float64]
Power = NDArray[np.floating]

_RARE = 1e-9  # chance that thermal noise alone passes for an echo, per cell
_BEYOND = 8.0  # times the expected power, from which a cell's own power shows an echo
_SMOOTHED = 9  # range cells over which the noise's level is averaged


def with_steady_phase(samples: Complex, waveform: OfdmWaveform, delay_s: float) -> Complex:
    """Samples (n_slots, n_receivers, n_subcarriers) less the phase that each slot shares.

    Separate oscillators for sending and receiving turn every path of a slot by the same angle. The
    phase of the path at ``delay_s`` tells it, to one part in the root of its energy over the
    noise's; of a shared oscillator next to nothing is found and nothing changes. A window keeps
    echoes a few range cells away out of it.
    """
    path = _leak(waveform, delay_s, taper("blackmanharris", waveform.n_subcarriers))
    share = np.einsum("mrt,t->mr", samples, path.conj().astype(samples.dtype))
    mean = share.mean(axis=0)
    turn = share @ mean.conj()
    if not np.all(turn):
        return samples
    return np.asarray(samples * (turn.conj() / np.abs(turn)).astype(samples.dtype)[:, None, None])


def without_phase_noise(
    samples: Complex, waveform: OfdmWaveform, delay_s: float, turns: NDArray[np.intp]
) -> Complex:
    """Samples (n_slots, n_receivers, n_subcarriers) less the leakage's phase noise within slots.

    Parameters
    ----------
    samples
        Of one carrier, in any unit.
    waveform, delay_s
        What was sent, and when the leakage arrives.
    turns : (n_transmitters, n_turns)
        Slots of each transmitter.
    """
    from scipy.fft import fft2, ifft2

    leak = _leak(waveform, delay_s, np.ones(waveform.n_subcarriers))
    modulus = np.abs(leak)
    unit = (leak / np.where(modulus > 0, modulus, 1.0)).astype(samples.dtype)
    cleaned = samples.copy()
    spectra, levels = [], []
    for slots in turns:
        sent = samples[slots]
        level = np.einsum("mrt,t->r", sent, leak.conj().astype(samples.dtype))
        level /= len(slots) * np.sum(modulus**2)
        weight = level.conj() / max(float(np.sum(np.abs(level) ** 2)), 1e-300)
        relative = np.einsum("mrt,r->mt", sent, weight.astype(samples.dtype)) * unit.conj()
        relative -= modulus.astype(relative.real.dtype)
        spectra.append(fft2(relative, norm="ortho", workers=-1))
        levels.append(level)
    noise = phase_noise(np.stack(spectra))
    for slots, level, part in zip(turns, levels, noise, strict=True):
        within = 1j * ifft2(part, norm="ortho", workers=-1).imag * unit
        cleaned[slots] -= within[:, None] * level[:, None].astype(samples.dtype)
    return cleaned


def phase_noise(spectra: Complex) -> Complex:
    """Least-squares phase noise of spectra (n_transmitters, n_rates, n_ranges), the leakage at
    the origin; the result has N(-k, -v) = -conj N(k, v).
    """
    from scipy.ndimage import uniform_filter1d
    from scipy.special import gammainccinv

    mirrored = -np.roll(spectra[:, ::-1, ::-1], (1, 1), (1, 2)).conj()
    odd, even = (spectra + mirrored) / 2, (spectra - mirrored) / 2

    def level(part: Complex) -> Array:
        """Mean noise power (n_ranges,): echoes fill few rates, so that the median skips them."""
        median = np.median(np.abs(part) ** 2, axis=(0, 1)) / np.log(2)
        smooth = uniform_filter1d(median, min(_SMOOTHED, len(median)), mode="wrap")
        return np.asarray((smooth + np.roll(smooth[::-1], 1)) / 2, dtype=np.float64)

    thermal = 2 * level(even)
    excess = np.maximum(level(odd) - thermal / 2, 0.0)
    thermal = np.maximum(thermal, 1e-300)
    found = odd * (excess / (excess + thermal / 2)).astype(odd.real.dtype)
    n = len(spectra)
    both = np.mean(np.abs(even) ** 2, axis=0)
    rates, ranges = np.nonzero(both > thermal / 2 * (gammainccinv(n, _RARE) / n))
    if len(rates):
        cell, image = spectra[:, rates, ranges], mirrored[:, rates, ranges]
        echoes = 4 * both[rates, ranges] - 2 * thermal[ranges]
        found[:, rates, ranges] = _beside_echoes(
            cell, image, echoes, thermal[ranges], excess[ranges]
        )
    return np.asarray(found)


def _beside_echoes(
    cell: Complex, image: Complex, echoes: Power, thermal: Array, excess: Array
) -> Complex:
    """Phase noise (n_transmitters, n_cells) where a cell, its mirror image or both hold an echo.

    Both are looks at the same phase noise, each with its own echo and thermal noise: the mean of
    both is weighted by what else they hold. ``echoes`` (n_cells,) is the power of both echoes.
    """
    own = [np.mean(np.abs(part) ** 2, axis=0) for part in (cell, image)]
    expected = excess + thermal
    odds = len(cell) * (own[0] - own[1]) / expected
    here = 1 / (1 + np.exp(-np.clip(odds, -60, 60)))
    weights = []
    for power, share in zip(own, (here, 1 - here), strict=True):
        certain = np.where(power > _BEYOND * expected, power, 0.0)
        weights.append(1 / (np.maximum(share * echoes, certain) + thermal))
    prior = 1 / np.maximum(excess, 1e-300)
    mean = (cell * weights[0] + image * weights[1]) / (prior + weights[0] + weights[1])
    return np.asarray(mean.astype(cell.dtype))


def _leak(waveform: OfdmWaveform, delay_s: float, weight: Array) -> Complex:
    """Samples (n_subcarriers,) of the sent symbol after a delay; the root mean square is that of
    the subcarriers' weights.
    """
    turn = np.exp(-2j * np.pi * waveform.frequency_offsets_hz * delay_s)
    spectrum = np.fft.ifftshift(waveform.sent() * turn * weight)
    return np.asarray(np.fft.ifft(spectrum) * np.sqrt(waveform.n_subcarriers))
