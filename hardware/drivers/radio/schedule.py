"""The stepped-carrier schedule: tune, settle, one burst per step; acquisition of a record."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from hardware.drivers.radio import samples
from hardware.drivers.radio.interface import Fault, RadioDriver, RadioError, Reception, Tuned
from hardware.errors import InputError
from hardware.records.radar import RadarRecord
from hardware.records.state import AT_ORIGIN, QuaternionPose, RadarFrontEnd
from hardware.waveform import OfdmWaveform

Order = Literal["ascending", "descending", "shuffled"]

_MOST_OFF_HZ = 1e3  # of the carrier: 0.004 rad of phase at 100 m


@dataclass(frozen=True)
class Schedule:
    """Times of all carrier steps.

    Parameters
    ----------
    waveform
        Of every step; its carrier is that of the first.
    carriers_hz
        In the order of time.
    step_period_s
        From the start of one burst to the start of the next: slots, retuning and settling.
    settling_s
        Between the report that the oscillator has locked and the burst.
    lead_s
        Between the command and the first burst, for the latency of the device.
    level
        Root mean square of the samples sent, of full scale.
    """

    waveform: OfdmWaveform
    carriers_hz: tuple[float, ...]
    step_period_s: float
    settling_s: float = 1e-3
    lead_s: float = 10e-3
    level: float = 0.5

    def __post_init__(self) -> None:
        if not self.carriers_hz or self.carriers_hz[0] != self.waveform.carrier_hz:
            raise InputError(f"carriers_hz: {self.carriers_hz} does not begin at the waveform's")
        for name in ("settling_s", "lead_s"):
            if not 0 <= getattr(self, name) < 3600:
                raise InputError(f"{name}: {getattr(self, name)} is not between 0 and 3600 s")
        least = self.burst_s + self.settling_s
        if not least <= self.step_period_s < 3600:
            raise InputError(
                f"step_period_s: {self.step_period_s:g} s is shorter than burst and settling "
                f"({least:g} s)"
            )

    @property
    def burst_s(self) -> float:
        """Length of one burst."""
        return self.waveform.n_slots * self.waveform.slot_period_s

    @property
    def sweep_s(self) -> float:
        """Duration of one sweep over all carriers."""
        return len(self.carriers_hz) * self.step_period_s

    def starts_ns(self, first_ns: int) -> list[int]:
        """Start of each step."""
        return [
            first_ns + round(1e9 * k * self.step_period_s) for k in range(len(self.carriers_hz))
        ]


def carriers(
    center_hz: float, spacing_hz: float, n_steps: int, order: Order = "ascending", *, seed: int = 0
) -> tuple[float, ...]:
    """Carriers ``spacing_hz`` apart around a centre, in the order of time.

    ``shuffled``: without the range-Doppler coupling of a ramp.
    """
    if order not in get_args(Order):
        raise InputError(f"order: {order!r} is none of {', '.join(get_args(Order))}")
    steps = center_hz + (np.arange(n_steps) - (n_steps - 1) / 2) * spacing_hz
    if order == "descending":
        steps = steps[::-1]
    elif order == "shuffled":
        steps = np.random.default_rng(seed).permutation(steps)
    return tuple(steps.tolist())


def acquire(
    radio: RadioDriver,
    schedule: Schedule,
    front_end: RadarFrontEnd,
    *,
    bursts: int = 1,
    pose: QuaternionPose | Sequence[QuaternionPose] = AT_ORIGIN,
) -> RadarRecord:
    """Run the schedule ``bursts`` times.

    Parameters
    ----------
    radio, schedule, front_end
        Radio, schedule and calibration; ``transmit_power_w`` refers to the schedule's ``level``.
    bursts
        Sweeps over all carriers.
    pose
        Of the antenna: one, or one for each burst.

    Lost slots, late bursts and bursts without samples are zeros in the record with `Flag.OVERRUN`.
    Raises RadioError where the radio does not answer or tunes to another carrier, InputError where
    schedule, front end and radio do not fit.
    """
    wave = schedule.waveform
    _check(radio, schedule, front_end)
    sent = samples.burst(wave, schedule.level)
    poses = (pose,) * bursts if isinstance(pose, QuaternionPose) else tuple(pose)
    shape = (bursts, len(schedule.carriers_hz), wave.n_slots)
    iq = np.empty((*shape, radio.n_receivers, wave.n_subcarriers, 2), dtype=np.int16)
    times = np.empty(shape, dtype=np.int64)
    flags = np.empty(shape, dtype=np.uint8)
    slots = np.rint(np.arange(wave.n_slots) * wave.slot_period_s * 1e9).astype(np.int64)
    tuned = np.empty(shape[:2])
    for burst in range(bursts):
        starts: list[int] = []
        for step, carrier in enumerate(schedule.carriers_hz):
            tuned[burst, step], locked_ns = _tune(radio, carrier)
            settled = locked_ns + round(1e9 * schedule.settling_s)
            starts = starts or schedule.starts_ns(settled + round(1e9 * schedule.lead_s))
            if settled <= starts[step]:
                reception = radio.burst(sent, starts[step])
            else:  # sent later, it would not fit the times of the sweep
                n = radio.n_receivers
                reception = Reception.nothing(n, len(sent), starts[step], Fault.LATE)
            iq[burst, step], flags[burst, step] = samples.counts(reception, wave)
            times[burst, step] = reception.start_ns + slots
    return RadarRecord(
        iq=iq,
        device_time_ns=times,
        flags=flags,
        carriers_hz=tuned[0],
        transmitter=np.zeros(wave.n_slots, dtype=np.uint8),
        waveform=replace(wave, carrier_hz=float(tuned[0, 0])),
        front_end=front_end,
        device=radio.device,
        pose=poses,
    )


def _tune(radio: RadioDriver, carrier_hz: float) -> Tuned:
    tuned = radio.tune(carrier_hz)
    if not abs(tuned.carrier_hz - carrier_hz) <= _MOST_OFF_HZ:
        raise RadioError(
            f"{radio.device}: tuned to {tuned.carrier_hz:.0f} Hz, asked for {carrier_hz:.0f} Hz"
        )
    return tuned


def _check(radio: RadioDriver, schedule: Schedule, front_end: RadarFrontEnd) -> None:
    bandwidth = schedule.waveform.bandwidth_hz
    if abs(radio.sample_rate_hz - bandwidth) > 1e-6 * bandwidth:
        raise InputError(
            f"{radio.device}: {radio.sample_rate_hz:g} samples/s, expected the waveform's "
            f"{bandwidth:g}"
        )
    if len(front_end.transmitters_m) != 1:
        raise InputError(f"transmitters_m: {len(front_end.transmitters_m)}, the radio has 1")
    if len(front_end.receivers_m) != radio.n_receivers:
        raise InputError(
            f"receivers_m: {len(front_end.receivers_m)}, the radio has {radio.n_receivers}"
        )
