"""Bursts of the radar: IQ per burst, carrier step, slot, receiver and sample."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.described import Described
from hardware.errors import InputError
from hardware.records import container
from hardware.records.container import Flag
from hardware.records.state import QuaternionPose, RadarFrontEnd
from hardware.waveform import OfdmWaveform, waveform_of

#: Counts of I and Q, of either sign, from which on a sample stands at the converter's rail.
RAIL = 32767


@dataclass(frozen=True, eq=False, repr=False)
class RadarRecord(Described):
    """Raw IQ of one or more bursts; one burst is one coherent processing interval at one pose.

    Parameters
    ----------
    iq : (n_bursts, n_steps, n_slots, n_receivers, n_subcarriers, 2) int16
        In-phase and quadrature counts, one symbol per slot (the mean of its repeats). A radar that
        does not step its carrier has one step.
    device_time_ns : (n_bursts, n_steps, n_slots) int64
        Device clock at the start of each slot.
    flags : (n_bursts, n_steps, n_slots) uint8
        Bits of `Flag`.
    carriers_hz : (n_steps,) float64
        What the radio was tuned to at each step, in the order of time.
    transmitter : (n_slots,) uint8
        Which transmitter sends in each slot.
    waveform
        What was sent in each step; its carrier is that of the first.
    front_end
        Calibration, antennas and their places.
    device
        Identification, as the device reports it.
    pose
        Antenna in the world in the middle of each burst, n_bursts of them.
    """

    iq: NDArray[np.int16]
    device_time_ns: NDArray[np.int64]
    flags: NDArray[np.uint8]
    carriers_hz: NDArray[np.float64]
    transmitter: NDArray[np.uint8]
    waveform: OfdmWaveform
    front_end: RadarFrontEnd
    device: str
    pose: tuple[QuaternionPose, ...]

    def __post_init__(self) -> None:
        arrays = {"iq": np.ndarray, "carriers_hz": np.ndarray}
        container.check_types(
            self, front_end=RadarFrontEnd, waveform=OfdmWaveform, device=str, **arrays
        )
        container.check_tuples(self, pose=QuaternionPose)
        wave, end = self.waveform, self.front_end
        n_bursts, n_steps = len(self.iq), len(self.carriers_hz)
        shape = (n_bursts, n_steps, wave.n_slots)
        shapes: dict[str, tuple[int, ...]] = {
            "iq": (*shape, len(end.receivers_m), wave.n_subcarriers, 2),
            "device_time_ns": shape,
            "flags": shape,
            "carriers_hz": (n_steps,),
            "transmitter": (wave.n_slots,),
        }
        container.check_shapes(self, shapes)
        if self.iq.dtype != np.int16:
            raise InputError(f"iq: dtype {self.iq.dtype}, expected int16")
        if n_steps == 0 or self.carriers_hz[0] != wave.carrier_hz:
            raise InputError(f"carriers_hz: {self.carriers_hz} does not begin at the waveform's")
        if len(self.pose) != n_bursts:
            raise InputError(f"pose: {len(self.pose)}, expected one for each of {n_bursts} bursts")
        if self.transmitter.max(initial=0) >= len(end.transmitters_m):
            raise InputError(
                f"transmitter: {self.transmitter.max(initial=0)}, but transmitters_m holds "
                f"{len(end.transmitters_m)}"
            )
        if not (np.isfinite(self.carriers_hz).all() and (self.carriers_hz > 0).all()):
            raise InputError("carriers_hz: a value is no positive number")
        if not np.isfinite(self.pose).all():
            raise InputError("pose: a value is no number")

    @property
    def wave(self) -> NDArray[np.complex128]:
        """Received wave in root watts, (n_bursts, n_steps, n_slots, n_receivers, n_subcarriers)."""
        counts = self.iq.astype(np.float64) * self.front_end.root_watt_per_count
        return counts[..., 0] + 1j * counts[..., 1]

    @property
    def n_at_rail(self) -> int:
        """Slots with samples at an end of the converter's range that are not marked saturated."""
        if max(self.iq.max(initial=0), -int(self.iq.min(initial=0))) < RAIL:
            return 0
        at_rail = ((self.iq >= RAIL) | (self.iq <= -RAIL)).any(axis=(3, 4, 5))
        return int(np.count_nonzero(at_rail & ((self.flags & Flag.SATURATED) == 0)))

    def middle_ns(self, burst: int, steps: slice = slice(None), slots: slice = slice(None)) -> int:
        """Device clock in the middle of a burst, or of some slots of some of its steps: what is
        measured of ranges and rates is that of then.
        """
        times = self.device_time_ns[burst, steps, slots]
        slot_ns = round(1e9 * self.waveform.slot_period_s)
        return (int(times[0, 0]) + int(times[-1, -1]) + slot_ns) // 2


def _poses(rows: NDArray[np.float64]) -> tuple[QuaternionPose, ...]:
    return tuple(map(QuaternionPose.from_numbers, rows.tolist()))


LAYOUT = container.Layout(
    format="ugv-radar-record",
    version=3,
    settings=(
        "root_watt_per_count",
        "transmit_power_w",
        "antenna_gain_dbi",
        "losses_db",
        "leakage_delay_s",
        "device",
    ),
    arrays={
        "iq": (
            np.int16,
            "counts, (bursts, steps, slots, receivers, subcarriers, I and Q)",
        ),
        "device_time_ns": (np.int64, "device clock at the start of each slot, ns"),
        "flags": (np.uint8, "1 saturated, 2 overrun, 4 reset, 8 lost"),
        "carriers_hz": (np.float64, "tuned carrier of each step, Hz"),
        "transmitter": (np.uint8, "which transmitter sends in each slot"),
        "transmitters_m": (np.float64, "phase centres: x ahead, y left, z up, m"),
        "receivers_m": (np.float64, "phase centres: x ahead, y left, z up, m"),
        "pose": (np.float64, "antenna in the world, mid-burst: x y z (m), quaternion w x y z"),
    },
    added={"digest": 3, "own_symbols": 3}
    | dict.fromkeys(
        (
            "antenna_gain_dbi",
            "losses_db",
            "leakage_delay_s",
            "carriers_hz",
            "transmitter",
            "transmitters_m",
            "receivers_m",
        ),
        2,
    ),
    parts={"front_end": RadarFrontEnd},
    objects={"pose": _poses},
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
        "digest",
    ),
    group_arrays={"own_symbols": np.float64},
    make_group=waveform_of,
)


def write_radar_record(record: RadarRecord, path: str | Path) -> None:
    """Write a record to one HDF5 file, whole or not at all; same record, same bytes."""
    container.write(LAYOUT, record, path)


def read_radar_record(path: str | Path) -> RadarRecord:
    """Read a record written by `write_radar_record`.

    Raises FileNotFoundError; InputError for a file that is no radar record, of another schema
    version, or incomplete.
    """
    fields, parameters = container.read(LAYOUT, path)
    try:
        waveform = waveform_of(**parameters)
        if "carriers_hz" not in fields:
            fields = _from_version_1(fields, waveform)
        return RadarRecord(waveform=waveform, **LAYOUT.arguments(fields))
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: {error}") from error


def _from_version_1(fields: dict[str, Any], waveform: OfdmWaveform) -> dict[str, Any]:
    """One burst of one transmitter and one receiver at the same place; gain and losses unknown."""
    one_place = np.zeros((1, 3))
    return {
        **fields,
        "iq": fields["iq"][None, :, :, None],
        **{name: fields[name][None] for name in ("device_time_ns", "flags", "pose")},
        "carriers_hz": np.full(len(fields["iq"]), waveform.carrier_hz),
        "transmitter": np.zeros(waveform.n_slots, dtype=np.uint8),
        "transmitters_m": one_place,
        "receivers_m": one_place,
        **dict.fromkeys(("antenna_gain_dbi", "losses_db", "leakage_delay_s"), float("nan")),
    }
