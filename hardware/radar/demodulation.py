"""From counts to the channel: transform and division by the sent symbols.

A record holds one symbol per slot: the front end has removed the cyclic prefix and averaged the
repeats. Transmitter and receiver share one oscillator: there is no carrier frequency offset, and an
estimator of it would remove the Doppler shift.
"""

from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from hardware.errors import check_choice, check_index, check_kind
from hardware.waveform import OfdmWaveform

if TYPE_CHECKING:
    from hardware.records.radar import RadarRecord

Complex = NDArray[np.complexfloating[Any, Any]]
#: Of the transforms. ``single`` rounds a cell of the map by up to 1e-6 of the strongest echo.
Precision = Literal["double", "single"]


def check_precision(precision: object) -> None:
    """Raise InputError unless it is a `Precision`."""
    check_choice("precision", precision, get_args(Precision))


def channel(
    record: "RadarRecord",
    *,
    burst: int = 0,
    step: int = 0,
    receiver: int = 0,
    precision: Precision = "double",
) -> Complex:
    """Channel times root transmit power, in root watts, ``(n_subcarriers, n_slots)``.

    One subcarrier carries 1/N of the power; the division by the sent symbols includes the factor
    sqrt(N), so that an echo of power P has the modulus sqrt(P) on every subcarrier.

    Raises InputError for a burst, step or receiver that the record does not have.
    """
    from hardware.records.radar import RadarRecord

    check_kind("record", record, RadarRecord, "hardware.read_radar_record")
    sizes = record.iq.shape
    for name, index, axis in (("burst", burst, 0), ("step", step, 1), ("receiver", receiver, 3)):
        check_index(name, index, sizes[axis])
    counts = complex_samples(record.iq[burst, step, :, receiver], precision)
    return demodulate_samples(counts, record.waveform, record.front_end.root_watt_per_count).T


def complex_samples(counts: NDArray[np.int16], precision: Precision = "double") -> Complex:
    """Complex samples (...) of counts (..., 2), in counts."""
    check_precision(precision)
    real = np.float64 if precision == "double" else np.float32
    return counts.astype(real, order="C").view(np.result_type(real, np.complex64))[..., 0]


def demodulate_samples(
    samples: Complex, waveform: OfdmWaveform, root_watt_per_count: float
) -> Complex:
    """Channel of samples (..., n_subcarriers) in counts, which are overwritten; subcarriers ascend
    along the last axis.
    """
    from scipy.fft import fft

    scale = root_watt_per_count / np.sqrt(waveform.n_subcarriers)
    # The sent symbols have modulus 1: dividing is multiplying with the conjugate.
    factor = (scale * waveform.sent().conj()).astype(samples.dtype)
    spectrum = fft(samples, axis=-1, overwrite_x=True, workers=-1)
    # Ascending frequencies, in the same pass.
    shifted = np.empty_like(spectrum)
    n, middle = waveform.n_subcarriers, waveform.n_subcarriers // 2
    np.multiply(spectrum[..., n - middle :], factor[:middle], out=shifted[..., :middle])
    np.multiply(spectrum[..., : n - middle], factor[middle:], out=shifted[..., middle:])
    return shifted
