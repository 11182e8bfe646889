"""Calibration over a cable of known loss and delay: power at the port per count."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.drivers.radio.interface import RadioDriver, RadioError
from hardware.drivers.radio.schedule import Schedule, acquire
from hardware.radar import channel
from hardware.records.container import Flag
from hardware.records.state import RadarFrontEnd


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibrated front end, and the differences between its carriers.

    ``gain_db`` (n_steps,): gain of each step relative to their mean. ``delay_s``: of the radio
    itself, without the cable. ``coherence`` (n_steps,): share of the power that one delay and one
    gain explain; noise, reflections and interference reduce it below 1.
    """

    front_end: RadarFrontEnd
    delay_s: float
    gain_db: NDArray[np.float64]
    coherence: NDArray[np.float64]


def calibrate(
    radio: RadioDriver,
    schedule: Schedule,
    front_end: RadarFrontEnd,
    *,
    attenuation_db: float,
    delay_s: float,
) -> Calibration:
    """Run the schedule once with a cable from the transmitter's port to the receiver's.

    Parameters
    ----------
    radio, schedule
        As in `acquire`.
    front_end
        Its ``transmit_power_w`` (from a power meter) is used; ``root_watt_per_count`` is replaced.
    attenuation_db, delay_s
        Of cable and attenuator, port to port.

    Raises RadioError where a slot is lost or saturated, or nothing comes through.
    """
    record = acquire(radio, schedule, replace(front_end, root_watt_per_count=1.0))
    for flag, what in ((Flag.OVERRUN, "lost"), (Flag.SATURATED, "saturated")):
        if (n := int(np.count_nonzero(record.flags & flag))) > 0:
            raise RadioError(f"{radio.device}: {n} slots of the calibration burst {what}")
    n_steps = len(record.carriers_hz)
    # In counts, (n_steps, n_subcarriers): the mean over slots.
    response = np.stack([channel(record, step=s).mean(axis=1) for s in range(n_steps)])
    power = np.sum(np.abs(response) ** 2, axis=1)
    if not power.min() > 0:
        raise RadioError(f"{radio.device}: nothing came through the cable")
    f = record.waveform.frequency_offsets_hz
    total_delay_s = _delay(response, record.waveform.subcarrier_spacing_hz)
    gain = (response * np.exp(2j * np.pi * f * total_delay_s)).mean(axis=1)
    amplitude = np.abs(gain)
    root_power = np.sqrt(front_end.transmit_power_w * 10 ** (-attenuation_db / 10))
    return Calibration(
        front_end=replace(
            front_end, root_watt_per_count=float(root_power / np.sqrt(np.mean(amplitude**2)))
        ),
        delay_s=float(total_delay_s - delay_s),
        gain_db=10 * np.log10(amplitude**2 / np.mean(amplitude**2)),
        coherence=amplitude**2 * response.shape[1] / power,
    )


def _delay(response: NDArray[np.complex128], spacing_hz: float) -> float:
    """Common delay of all steps, from the phase difference between neighbouring subcarriers."""
    turn = np.sum(response[:, 1:] * response[:, :-1].conj())
    return float(-np.angle(turn) / (2 * np.pi * spacing_hz))
