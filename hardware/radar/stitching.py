"""One wideband channel from carrier steps: compensates timing and phase of every retune.

A retune leaves a random phase and may delay the receiver by some samples. Both are estimated from a
path of known delay: the leakage from transmitter to receiver, or a reference target. Within one
step other echoes are in the same delay cell as that path; the phase of their sum would halve every
echo and mirror it about the path. So the wideband channel is modelled as the path and later echoes,
and phases and model are estimated in alternation.

Stepped-carrier OFDM: Schweizer et al., IEEE Trans. Microw. Theory Techn. 66, 2018
(doi 10.1109/TMTT.2017.2751463).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.waveform import C_M_PER_S, OfdmWaveform

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Phase errors of steps, rms, over the amplitude of the strongest echo relative to the reference:
#: what the model of later echoes leaves, measured with single echoes 0.1 to 0.4 of it at 2 to 5 m.
_LEFT_BY_ECHOES = 0.03
#: Errors of a single echo near the reference, whose fit takes a part of it, and with it phases of
#: steps: of its range in cells at one cell from it, and of its power over that; up to how many
#: cells they are as large, and by how they fall beyond. Measured with 1800 single echoes 10 to 30
#: dB below it at 1 to 6 cells, of which each tenth of a cell keeps them.
_RANGE_AT_A_CELL, _RANGE_FALLS = 0.12, 1.5
_POWER_AT_A_CELL, _POWER_FALLS = 0.24, 2.0
_AS_LARGE = 1.8
#: All that is nearer appears 0.8 to 1 cells from it, 1 to 23 dB too weak.
_NEARER = 3**-0.5, 5.0
#: Range cells of one step before the path, which repeats every symbol, in which the model has no
#: echoes: with one at any delay, phases of steps could be any. Of 1, 2 and 3 levels are the same.
_FREE_BEFORE = 2.0
_LEAST_OVER_ECHOES_DB = 6.5  # with eight echoes about as strong, 1 of 20 records is wrong


@dataclass(frozen=True, eq=False)
class StitchedChannel:
    """A wide channel (n_channels, n_steps n_subcarriers, n_slots) and the waveform it belongs to.

    Multiplication by ``motion`` (n_steps n_subcarriers,) compensates the motion of an echo relative
    to the burst's middle; the reference does not move and must be subtracted first. ``phase_rad``
    and ``late_samples`` (n_steps,), in the order of time: the compensated phase and delay.
    ``over_echoes``: power of the reference over that of the strongest later echo.
    """

    channel: Complex
    waveform: OfdmWaveform
    motion: Complex
    phase_rad: Array
    late_samples: NDArray[np.int64]
    over_echoes: float

    @property
    def range_error_m(self) -> float:
        """Standard error of all ranges, by phases that the model of echoes leaves wrong."""
        spread_hz = float(np.std(self.waveform.frequency_offsets_hz))
        phase_rad = _LEFT_BY_ECHOES / np.sqrt(self.over_echoes)
        return float(C_M_PER_S / (4 * np.pi * spread_hz) * phase_rad)


def stitch(
    steps: Complex,
    waveform: OfdmWaveform,
    carriers_hz: Array,
    reference_delay_s: float,
    *,
    step_times_s: Array | None = None,
    range_rate_m_per_s: float = 0.0,
    iterations: int = 200,
    reference_seen: bool = True,
) -> StitchedChannel:
    """Stitch carrier steps to one wideband channel.

    Parameters
    ----------
    steps : (n_channels, n_steps, n_subcarriers, n_slots)
        Demodulated, each relative to its own carrier, in the order of time. All channels share
        the oscillator: one phase per step.
    waveform, carriers_hz
        Of one step, and what the radio was tuned to, (n_steps,); sorted, the steps must touch.
    reference_delay_s
        Of the leakage or reference path. It arrives first; echoes less than one cell of the wide
        band later cannot be distinguished from it.
    step_times_s : (n_steps,)
        Start of each step, for Doppler between them; only used with a range rate.
    range_rate_m_per_s
        Of the echoes, for their motion between steps. In one burst of ascending steps rate and
        range are coupled: rate r shifts the range by r fc / (df/dt); so the rate must be known,
        from a track or the vehicle's own motion.
    iterations
        Largest number; each reduces the error that echoes cause in the phases by a factor of about
        2.
    reference_seen
        False: steps are stitched without correction, since phases fitted to noise create false
        echoes.

    Raises InputError for steps with gaps or overlap, or for an unknown reference delay.
    """
    order = np.argsort(carriers_hz)
    wide = _wideband_waveform(waveform, carriers_hz[order])
    if not np.isfinite(reference_delay_s):
        raise InputError(
            "leakage_delay_s: unknown; carrier steps cannot be stitched without the delay of the "
            "leakage or of a reference target"
        )
    n = waveform.n_subcarriers
    f = waveform.frequency_offsets_hz
    still = steps.mean(axis=-1)
    late = np.zeros(len(order), dtype=np.int64)
    if reference_seen:
        late[:] = [
            _timing_offset(still[:, s], waveform, reference_delay_s) for s in range(len(order))
        ]
    timing = np.exp(2j * np.pi * np.outer(late, f) / waveform.bandwidth_hz)
    centre = float(wide.carrier_hz)
    absolute = carriers_hz[:, None] + f
    motion = np.ones_like(absolute, dtype=np.complex128)
    if range_rate_m_per_s and step_times_s is not None:
        moved = 2 * range_rate_m_per_s / C_M_PER_S * (step_times_s - step_times_s.mean())
        motion = np.exp(2j * np.pi * absolute * moved[:, None])
    path = np.exp(-2j * np.pi * (absolute - centre) * reference_delay_s)
    unsorted = np.zeros(len(order))
    if reference_seen:
        aligned = (still * timing)[:, order]
        unsorted[order] = _phases(
            aligned, path[order], motion[order], wide, reference_delay_s, iterations
        )
    turn = timing * np.exp(-1j * unsorted)[:, None]
    wide_channel = (steps * turn[..., None])[:, order]
    shape = (len(steps), len(order) * n, steps.shape[-1])
    return StitchedChannel(
        wide_channel.reshape(shape),
        wide,
        motion[order].ravel(),
        unsorted,
        late,
        _over_echoes(wide_channel.mean(axis=-1), path[order]),
    )


def errors_beside_reference(cells: float) -> tuple[float, float]:
    """Standard errors of the range, in cells, and of the power, over it, of an echo so many cells
    from the reference.
    """
    away = abs(cells)
    if away < 1:
        return _NEARER
    if away < _AS_LARGE:
        return _RANGE_AT_A_CELL, _POWER_AT_A_CELL
    return _RANGE_AT_A_CELL / away**_RANGE_FALLS, _POWER_AT_A_CELL / away**_POWER_FALLS


def _over_echoes(still: Complex, path: Complex) -> float:
    """Power of the reference ``path`` (n_steps, n) over that of the strongest later echo of the
    stitched steps ``still`` (n_channels, n_steps, n).

    Echoes are also searched step by step, since they have no peak where the phases are wrong.
    """
    along = still * path.conj()
    by_step = along.mean(axis=-1)
    reference_w = np.mean(np.abs(by_step.mean(axis=-1)) ** 2)
    later = along - by_step[..., None], along - by_step.mean(axis=-1)[:, None, None]
    wide = later[1].reshape(len(still), 1, -1)
    strongest_w = max(
        np.mean(np.abs(np.fft.ifft(rest, 2 * rest.shape[-1], axis=-1)) ** 2, axis=(0, 1)).max()
        for rest in (later[0], wide)
    )
    return float(reference_w / (4 * strongest_w)) if strongest_w else float("inf")


def weak_reference(stitched: StitchedChannel) -> list[str]:
    """Warnings that an echo may have been taken for the reference."""
    warnings = []
    over_db = 10 * np.log10(stitched.over_echoes)
    if over_db < _LEAST_OVER_ECHOES_DB:
        warnings.append(
            f"carrier steps: the reference is {over_db:.1f} dB above the strongest echo (expected "
            f"{_LEAST_OVER_ECHOES_DB:g} dB or more): phases of steps, and with them echoes and "
            "ranges, may be wrong"
        )
    late = stitched.late_samples
    if len(late) > 1 and np.ptp(late) <= 1 and np.abs(late).min() > 0:
        warnings.append(
            f"carrier steps: the strongest path arrives {np.median(late):.0f} samples after the "
            "reference in every step: unless the receiver was late in each, it is an echo, and "
            "echoes and ranges are wrong"
        )
    return warnings


def range_per_rate_s(carriers_hz: Array, step_times_s: Array) -> float:
    """Range by which carrier steps (n_steps,) at their times shift an echo, m for each m/s of its
    range rate: fc / (df/dt) for steps one after the other, little for steps in random order.
    """
    f, t = carriers_hz - carriers_hz.mean(), step_times_s - step_times_s.mean()
    spread = float(f @ f)
    return float(carriers_hz.mean() * (f @ t) / spread) if spread else 0.0


def scatter_per_rate(carriers_hz: Array, step_times_s: Array, waveform: OfdmWaveform) -> float:
    """Phase errors over the wide band, rms, rad for each m/s of an echo's range rate: what carrier
    steps leave of its motion beside a shift in range. They smear it over ranges, as side lobes.
    """
    f = (carriers_hz[:, None] + waveform.frequency_offsets_hz).ravel()
    t = np.repeat(step_times_s - step_times_s.mean(), waveform.n_subcarriers)
    phase = 4 * np.pi / C_M_PER_S * f * t
    off = f - f.mean()
    spread = float(off @ off)
    return float(np.std(phase - off * (off @ phase / spread))) if spread else 0.0


def _wideband_waveform(waveform: OfdmWaveform, carriers: Array) -> OfdmWaveform:
    """The waveform of all steps together, with the carrier at its subcarrier N // 2."""
    gaps = np.diff(carriers) / waveform.bandwidth_hz
    if np.any(np.abs(gaps - 1) > 1e-6):
        at = int(np.argmax(np.abs(gaps - 1)))
        raise InputError(
            f"carriers_hz: {carriers[at]:.9g} and {carriers[at + 1]:.9g} are not one step of "
            f"{waveform.bandwidth_hz:g} Hz apart"
        )
    n = len(carriers) * waveform.n_subcarriers
    lowest = carriers[0] + waveform.frequency_offsets_hz[0]
    carrier = float(lowest + n // 2 * waveform.subcarrier_spacing_hz)
    return waveform.over(carrier, n)


def _timing_offset(still: Complex, waveform: OfdmWaveform, delay_s: float) -> int:
    """Whole samples by which a step (n_channels, n_subcarriers) lags the known path."""
    ahead = np.exp(2j * np.pi * waveform.frequency_offsets_hz * delay_s)
    profile = np.sum(np.abs(np.fft.ifft(still * ahead, axis=-1)) ** 2, axis=0)
    peak = int(np.argmax(profile))
    return peak if peak <= len(profile) // 2 else peak - len(profile)


def _phases(
    still: Complex,
    path: Complex,
    motion: Complex,
    wide: OfdmWaveform,
    delay_s: float,
    iterations: int,
) -> Array:
    """Phase of every step (n_steps,), ascending carriers; the arrays are (..., n_steps, n).

    The path is static; ``motion`` is that of the echoes.
    """
    phase = np.asarray(np.angle(np.einsum("csn,sn->cs", still, path.conj())[0]))
    if len(phase) == 1:
        return np.zeros(1)
    free_s = _FREE_BEFORE * len(phase) / wide.bandwidth_hz
    before_next_s = delay_s + wide.max_delay_s - free_s
    last = max(min(wide.prefix_s, before_next_s), delay_s + 4 / wide.bandwidth_hz)
    merged = _subcarriers_per_block(still.shape[-1], wide.subcarrier_spacing_hz * last)
    f = wide.frequency_offsets_hz.reshape(-1, merged)
    echoes = _later_echoes(f.tobytes(), merged, delay_s, last, wide.bandwidth_hz)
    still, path, motion = (
        a.reshape(*a.shape[:-1], -1, merged).mean(axis=-1) for a in (still, path, motion)
    )
    turn = np.exp(-1j * phase)
    model = _model(still, path, motion, echoes.reshape(*path.shape, -1))
    for _ in range(iterations):
        before, turn = turn, np.exp(1j * np.angle(model @ turn))
        if np.abs(turn - before).max() < 1e-9:
            break
    return np.asarray(-np.angle(turn))


def _model(still: Complex, path: Complex, motion: Complex, echoes: Complex) -> Complex:
    """Matrix M (n_steps, n_steps) of the model for steps multiplied by phasors v: (M v)_s has the
    phase by which step s should be rotated.

    The path is fitted to the rotated steps, and ``echoes`` (n_steps, n, rank) to the residual: all
    of it is linear in v, so that phases are estimated among n_steps numbers instead of all
    subcarriers.
    """
    power = np.vdot(path, path).real
    by_path = np.einsum("snr,sn->r", echoes.conj(), motion * path)
    matrix = np.zeros((len(path), len(path)), dtype=np.complex128)
    for channel in still:
        leak = np.einsum("sn,sn->s", path.conj(), channel) / power
        by_step = np.einsum("snr,sn->rs", echoes.conj(), motion * channel)
        matrix += power * np.outer(leak.conj(), leak)
        matrix += by_step.conj().T @ (by_step - np.outer(by_path, leak))
    return matrix


def _subcarriers_per_block(n: int, turns: float) -> int:
    """Number of neighbouring subcarriers over which no delay changes the phase by half a cycle."""
    return max(m for m in range(1, n + 1) if n % m == 0 and (m == 1 or m * turns <= 0.5))


@lru_cache(maxsize=4)
def _later_echoes(
    frequencies: bytes, merged: int, delay_s: float, last_s: float, bandwidth_hz: float
) -> Complex:
    """Orthonormal basis (n_frequencies, rank) of delays from one cell after the path to the last.

    Echoes beyond the last are not in this model.
    """
    f = np.frombuffer(frequencies).reshape(-1, merged)
    delays = np.arange(delay_s + 1 / bandwidth_hz, last_s, 0.5 / bandwidth_hz)
    atoms = np.zeros((len(f), len(delays)), dtype=np.complex128)
    for column in f.T:
        atoms += np.exp(-2j * np.pi * np.outer(column, delays)) / merged
    # Delays half a cell apart overlap: directions that noise would dominate are left out.
    left, values, _ = np.linalg.svd(atoms, full_matrices=False)
    return np.asarray(left[:, values > 1e-2 * values[0]])
