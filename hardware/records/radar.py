"""One coherent processing interval of the radar: IQ per carrier step, slot and sample."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hardware.radar.waveform import OfdmWaveform
from hardware.records import container


@dataclass(frozen=True, eq=False)
class RadarRecord:
    """Raw IQ of one interval.

    Parameters
    ----------
    iq : (n_steps, n_slots, n_subcarriers, 2) int16
        In-phase and quadrature counts, one symbol per slot (the mean of its repeats). A radar that
        does not step its carrier has one step.
    device_time_ns : (n_steps, n_slots) int64
        Device clock at the start of each slot.
    flags : (n_steps, n_slots) uint8
        Bits of `Flag`.
    waveform
        What was sent; its carrier is that of the first step.
    root_watt_per_count
        The front end's calibration: one count is this wave amplitude at the antenna's port.
    transmit_power_w
        At the antenna's port.
    device
        Identification, as the device reports it.
    pose : (7,) float64
        Antenna in the world: x, y, z in metres, unit quaternion w, x, y, z (REP 103).
    """

    iq: NDArray[np.int16]
    device_time_ns: NDArray[np.int64]
    flags: NDArray[np.uint8]
    waveform: OfdmWaveform
    root_watt_per_count: float
    transmit_power_w: float
    device: str
    pose: NDArray[np.float64]

    def __post_init__(self) -> None:
        shape = (len(self.iq), self.waveform.n_slots)
        samples = self.waveform.n_subcarriers
        shapes = {"iq": (*shape, samples, 2), "device_time_ns": shape, "flags": shape}
        container.check_shapes(self, {**shapes, "pose": (7,)})
        if self.iq.dtype != np.int16:
            raise ValueError(f"iq: dtype {self.iq.dtype}, expected int16")
        container.check_positive(self, "root_watt_per_count", "transmit_power_w")

    @property
    def wave(self) -> NDArray[np.complex128]:
        """Received wave in root watts, (n_steps, n_slots, n_subcarriers)."""
        counts = self.iq.astype(np.float64) * self.root_watt_per_count
        return counts[..., 0] + 1j * counts[..., 1]


LAYOUT = container.Layout(
    format="ugv-radar-record",
    version=1,
    settings=("root_watt_per_count", "transmit_power_w", "device"),
    arrays={
        "iq": (np.int16, "counts, (n_steps, n_slots, n_subcarriers, in-phase and quadrature)"),
        "device_time_ns": (np.int64, "device clock at the start of each slot, ns"),
        "flags": (np.uint8, "1 saturated, 2 overrun, 4 reset"),
        "pose": (np.float64, "antenna in the world: x y z (m), quaternion w x y z"),
    },
    group="waveform",
    parameters=(
        "carrier_hz",
        "n_subcarriers",
        "subcarrier_spacing_hz",
        "n_slots",
        "slot_period_s",
        "repeats",
        "prefix_s",
        "symbols",
    ),
)


def write_radar_record(record: RadarRecord, path: str | Path) -> None:
    """Write a record to one HDF5 file, whole or not at all; same record, same bytes."""
    container.write(LAYOUT, record, path)


def read_radar_record(path: str | Path) -> RadarRecord:
    """Read a record written by `write_radar_record`.

    Raises FileNotFoundError; ValueError for a file that is no radar record, of another schema
    version, or incomplete.
    """
    fields, waveform = container.read(LAYOUT, path)
    try:
        return RadarRecord(waveform=OfdmWaveform(**waveform), **fields)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error
