"""Demodulation of one burst: each pair of transmitter and receiver is one wideband channel."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError, check_kind
from hardware.radar.clutter import without_leakage
from hardware.radar.demodulation import Complex, Precision, complex_samples, demodulate_samples
from hardware.radar.integrity import usable_part
from hardware.radar.phase_noise import leakage_snr, with_steady_phase, without_phase_noise
from hardware.radar.quadrature import without_faults
from hardware.radar.stitching import range_per_rate_s, scatter_per_rate, stitch, weak_reference
from hardware.waveform import OfdmWaveform

if TYPE_CHECKING:
    from hardware.records.radar import RadarRecord

Array = NDArray[np.float64]

_SEEN_IN_A_SLOT = 10.0  # times the noise: a slot's phase has an error of 0.2 rad
_SEEN = 12.0  # times the noise of the mean over slots: the highest of 64 delays of noise is 6


@dataclass(frozen=True, eq=False)
class DemodulatedBurst:
    """A coherent processing interval.

    Parameters
    ----------
    channel : (n_channels, n_subcarriers, n_slots)
        In root watts; transmitters first, then receivers.
    waveform
        Of each channel: all carrier steps together, and only the slots in which its transmitter
        sends, so that its velocity ambiguity is that of the TDM schedule.
    tdm_offset_s : (n_channels,)
        Delay of a channel's slots after the mean of all.
    transmitter_m, receiver_m : (n_channels, 3)
        Phase centres in the antenna's frame.
    relative_noise : (n_subcarriers, n_slots) or (n_subcarriers, 1)
        Mean noise by range and rate, normalised to a mean of about 1: with carrier steps from the
        differences between their slots, with one carrier from the residual phase noise beside
        strong echoes; None where it is uniform.
    leakage : (n_channels,)
        Amplitude of the leakage whose phase noise was subtracted: what is left of it, the noise
        that is uneven, has the ratios of its receivers. None where there was none.
    whole
        False when a loss of data cut the burst short; ``warnings`` say where.
    middle_ns
        Device clock in the middle of the slots, from which ``waveform`` counts their times.
    range_per_rate_s, scatter_per_rate
        Of carrier steps, see `range_per_rate_s` and `scatter_per_rate`; with one carrier 0.
    range_error_m
        Of carrier steps, see `StitchedChannel`: in the stated error of every range.
    joined_by_s
        Delay of the reference that carrier steps were joined by; NaN with one carrier.
    removed_variance
        In rad^2, of the phases of slots that were removed by the leakage: in the mean of its own
        slots each transmitter keeps them.
    """

    channel: Complex
    waveform: OfdmWaveform
    tdm_offset_s: Array
    transmitter_m: Array
    receiver_m: Array
    whole: bool
    warnings: tuple[str, ...]
    middle_ns: int
    relative_noise: Array | None = None
    leakage: Complex | None = None
    range_per_rate_s: float = 0.0
    scatter_per_rate: float = 0.0
    range_error_m: float = 0.0
    removed_variance: float = 0.0
    joined_by_s: float = float("nan")


def demodulate(
    record: "RadarRecord",
    burst: int = 0,
    *,
    waveform: OfdmWaveform | None = None,
    precision: Precision = "double",
    leakage: bool = True,
    reference_delay_s: float | None = None,
    range_rate_m_per_s: float = 0.0,
) -> DemodulatedBurst:
    """Demodulate the longest part of a burst without a loss of data, see `usable_part`.

    Parameters
    ----------
    record, burst
        The record, and the index of its burst.
    waveform
        The waveform that the caller expects; InputError when it is not the record's.
    precision
        See `Precision`. Carrier steps are always stitched in double precision.
    leakage
        Subtract the record's leakage and its phase noise, where its delay is known.
    reference_delay_s, range_rate_m_per_s
        See `stitch`; without a delay that of the record's leakage.

    Raises InputError for another waveform, for a reference delay that it cannot tell, for
    transmitters without a regular TDM schedule, or where nothing can be used.
    """
    _check(record, waveform, reference_delay_s)
    wave, leakage_s = record.waveform, record.front_end.leakage_delay_s
    leaks = leakage and bool(np.isfinite(leakage_s))
    part = usable_part(record, burst)
    sender = record.transmitter[part.slots]
    schedule = tdm_schedule(sender)
    iq = record.iq[burst, part.steps, part.slots]
    samples = without_faults([complex_samples(step, precision) for step in iq], wave)
    steady = _steadied(samples, wave, leakage_s, schedule) if leaks else _Steadied(samples)
    cube = [
        _channels(step, schedule, wave, record.front_end.root_watt_per_count)
        for step in steady.samples
    ]
    n_transmitters, n_rounds = schedule.shape
    own = replace(wave, n_slots=n_rounds, slot_period_s=wave.slot_period_s * n_transmitters)
    if len(record.carriers_hz) == 1:
        wide = _Wideband(cube[0], own, steady.relative_noise)
    else:
        wide = _of_steps(
            cube,
            own,
            record.carriers_hz[part.steps],
            1e-9 * record.device_time_ns[burst, part.steps, 0].astype(np.float64),
            leakage_s if reference_delay_s is None else reference_delay_s,
            range_rate_m_per_s=range_rate_m_per_s,
            has_reference=steady.is_seen or reference_delay_s is not None,
        )
    channel = wide.channel
    if leaks:
        channel = without_leakage(channel, wide.waveform, leakage_s)
    if wide.motion is not None:
        channel = channel * wide.motion[:, None]
    slots_s = wave.slot_times_s[schedule]
    slots_used = slice(part.slots.start, part.slots.start + int(schedule.max()) + 1)
    n_receivers = len(record.front_end.receivers_m)
    transmitter_m = record.front_end.transmitters_m[sender[schedule[:, 0]]]
    told = () if steady.is_seen else (_unseen_leakage(leakage_s, steady.snr, len(samples)),)
    return DemodulatedBurst(
        channel=channel,
        waveform=wide.waveform,
        tdm_offset_s=np.repeat(slots_s.mean(axis=1) - slots_s.mean(), n_receivers),
        transmitter_m=np.repeat(transmitter_m, n_receivers, axis=0),
        receiver_m=np.tile(record.front_end.receivers_m, (n_transmitters, 1)),
        whole=part.whole,
        warnings=(*part.warnings, *(f"burst {burst}: {text}" for text in (*told, *wide.warnings))),
        middle_ns=record.middle_ns(burst, part.steps, slots_used),
        relative_noise=wide.relative_noise,
        leakage=steady.leakage,
        range_per_rate_s=wide.range_per_rate_s,
        scatter_per_rate=wide.scatter_per_rate,
        range_error_m=wide.range_error_m,
        removed_variance=steady.removed_variance,
        joined_by_s=wide.joined_by_s,
    )


def _check(
    record: "RadarRecord", waveform: OfdmWaveform | None, reference_delay_s: float | None
) -> None:
    """Raises InputError for anything but a record of the waveform that is expected, if one is, and
    for a reference delay that it cannot tell.
    """
    from hardware.records.radar import RadarRecord

    check_kind("record", record, RadarRecord, "hardware.read_radar_record")
    if waveform is not None and waveform != record.waveform:
        raise InputError(f"waveform: {waveform} is not the record's, {record.waveform}")
    longest_s = record.waveform.max_delay_s
    if reference_delay_s is not None and not abs(reference_delay_s) < longest_s:
        raise InputError(
            f"reference_delay_s: {reference_delay_s}, expected within the waveform's unambiguous "
            f"delay, +/- {longest_s:.3g} s"
        )


class _Steadied(NamedTuple):
    """Samples of carrier steps without the leakage's phase noise, where that is seen, and what
    `DemodulatedBurst` tells of it; ``snr``: of the leakage in the mean of all slots, where it is
    not.
    """

    samples: list[Complex]
    relative_noise: Array | None = None
    leakage: Complex | None = None
    removed_variance: float = 0.0
    snr: float = np.inf

    @property
    def is_seen(self) -> bool:
        """Whether the leakage is above the noise."""
        return self.snr > _SEEN


def _steadied(
    samples: list[Complex], wave: OfdmWaveform, leakage_s: float, schedule: NDArray[np.intp]
) -> _Steadied:
    """Steps with phases that the leakage steadies, where it is seen in a slot."""
    if not leakage_snr(samples, wave, leakage_s) > _SEEN_IN_A_SLOT:
        means = [step.mean(axis=0, keepdims=True) for step in samples]
        return _Steadied(samples, snr=leakage_snr(means, wave, leakage_s))
    steps, variances = zip(
        *(with_steady_phase(step, wave, leakage_s, schedule) for step in samples), strict=True
    )
    # Steps have phases of their own, of which an echo has the mean.
    variance = float(np.mean(variances)) / len(steps)
    if len(steps) > 1:  # echoes within a step's range cell share the leakage's noise otherwise
        return _Steadied(list(steps), removed_variance=variance)
    cleaned, relative_noise, mode = without_phase_noise(steps[0], wave, leakage_s, schedule)
    return _Steadied([cleaned], relative_noise, mode.ravel(), variance)


class _Wideband(NamedTuple):
    """The channel of all carrier steps together, and what `DemodulatedBurst` tells of these;
    ``motion`` as of `StitchedChannel`, of one carrier None.
    """

    channel: Complex
    waveform: OfdmWaveform
    relative_noise: Array | None
    motion: Complex | None = None
    range_per_rate_s: float = 0.0
    scatter_per_rate: float = 0.0
    range_error_m: float = 0.0
    joined_by_s: float = float("nan")
    warnings: tuple[str, ...] = ()


def _of_steps(
    cube: list[Complex],
    own: OfdmWaveform,
    carriers_hz: Array,
    times_s: Array,
    joined_by_s: float,
    *,
    range_rate_m_per_s: float,
    has_reference: bool,
) -> _Wideband:
    """Carrier steps of one transmitter's waveform, ``own``, joined by the delay of a reference."""
    stitched = stitch(
        np.stack(cube, axis=1).astype(np.complex128),
        own,
        carriers_hz,
        joined_by_s,
        step_times_s=times_s,
        range_rate_m_per_s=range_rate_m_per_s,
        reference_seen=has_reference,
    )
    return _Wideband(
        stitched.channel,
        stitched.waveform,
        _noise_of_steps(cube),
        stitched.motion,
        range_per_rate_s(carriers_hz, times_s),
        scatter_per_rate(carriers_hz, times_s, own),
        stitched.range_error_m if has_reference else 0.0,
        joined_by_s,
        tuple(weak_reference(stitched)) if has_reference else (),
    )


def _unseen_leakage(delay_s: float, snr: float, n_steps: int) -> str:
    """Warning of leakage that is not above the noise."""
    text = (
        f"no leakage is seen at its delay of {delay_s:.3g} s ({max(snr, 0):.2g} "
        f"times the noise, expected {_SEEN:g} or more): "
    )
    if n_steps == 1:
        return text + "phases are not corrected"
    return text + "the phases of carrier steps are unknown, and echoes and ranges are wrong"


def _noise_of_steps(steps: list[Complex]) -> Array | None:
    """Mean noise (n_ranges, 1) of the stitched steps (n_channels, n_subcarriers, n_slots).

    Phase noise differs between steps and between slots, and its power is concentrated in the few
    range cells of one step: the noise of the wideband map is as uneven over range, and periodic in
    it. It is estimated from the differences between the slots of a step, in which echoes, constant
    over tens of microseconds, cancel.
    """
    n_slots = steps[0].shape[-1]
    if n_slots < 4:
        return None
    n_ranges = len(steps) * steps[0].shape[1]
    power = np.zeros(n_ranges)
    for step in steps:
        change = step - step.mean(axis=-1, keepdims=True)
        power += np.mean(np.abs(np.fft.ifft(change, n_ranges, axis=1)) ** 2, axis=(0, 2))
    mean = power.mean()
    return np.asarray(power / mean)[:, None] if power.min() > 0 else None


def tdm_schedule(transmitter: NDArray[np.uint8]) -> NDArray[np.intp]:
    """Time-division multiplexing: slots (n_transmitters, n_rounds) of each active transmitter, in
    the order of their numbers.

    A last, incomplete round is left out. Raises InputError unless every round has the same order.
    """
    names = np.unique(transmitter)
    n_rounds = len(transmitter) // len(names)
    rounds = transmitter[: n_rounds * len(names)].reshape(n_rounds, len(names))
    if (rounds != rounds[0]).any() or len(np.unique(rounds[0])) != len(names):
        raise InputError(
            f"transmitter: slots of {', '.join(map(str, names))} follow no regular TDM schedule"
        )
    return (np.arange(n_rounds)[:, None] * len(names) + np.argsort(rounds[0])).T


def _channels(
    samples: Complex, schedule: NDArray[np.intp], waveform: OfdmWaveform, root_watt_per_count: float
) -> Complex:
    """Channels (n_channels, n_subcarriers, n_rounds) of one step's samples in counts."""
    channels = []
    for slots in schedule:
        regular = slice(int(slots[0]), int(slots[-1]) + 1, len(schedule))  # a view, no copy
        for receiver in range(samples.shape[1]):
            counts = samples[regular, receiver]
            channels.append(demodulate_samples(counts, waveform, root_watt_per_count).T)
    return channels[0][None] if len(channels) == 1 else np.stack(channels)
