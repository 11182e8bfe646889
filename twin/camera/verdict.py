"""What a record is worth: judged by its counts and flags, in the words that every page uses."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hardware.records import Flag, SpiRecord
from twin.detector import NoiseBudget
from twin.warned import CaptureWarning, Kind

#: Share of a detector's exposures at a rail from which its image is void. The all-lit exposure,
#: the brightest of all, is left out of the reckoning: it holds the mean alone.
VOID_SHARE = 0.01

#: Steps of the converter over all other noise from which rounding no longer acts as noise: a
#: normal distribution of half a step leaves 1 % of a sawtooth.
_COARSE = 2.0


def recorded(record: SpiRecord) -> Iterator[CaptureWarning]:
    """What the counts and flags of a record say against it."""
    n, top = len(record.counts), 2**record.adc_bits - 1
    high, low = record.counts == top, record.counts == 0
    flagged = (record.flags & Flag.SATURATED) != 0
    full = flagged & ~(high | low).any(axis=1)  # a full well stands below the converter's rail
    rails: tuple[tuple[Kind, NDArray[np.bool_], str], ...] = (
        ("saturated", high, "saturate the ADC: readout: its gain is too high"),
        ("black", low, "saturate the ADC: readout: adc_offset_v is too low"),
        ("saturated", full[:, None], "fill the well: readout.full_well_e"),
    )
    for kind, at_rail, text in rails:
        if hits := int(at_rail.any(axis=1).sum()):
            void = bool(_is_void(at_rail, record).all())
            yield CaptureWarning(kind, f"{hits} of {n} exposures {text}", void=void)
    if n > 1 and np.ptp(record.counts, axis=0).max() <= 1:
        text = "the counts of all exposures differ by one step at most: too little light, or gain"
        yield CaptureWarning("underexposed", text, void=True)
    flags: dict[Kind, Flag] = {"overrun": Flag.OVERRUN, "reset": Flag.RESET, "lost": Flag.LOST}
    for kind, flag in flags.items():
        if bad := int(np.count_nonzero(record.flags & flag)):
            yield CaptureWarning(kind, f"{bad} of {n} exposures are marked {kind}", void=bad == n)


def unreadable(record: SpiRecord) -> NDArray[np.bool_]:
    """Detectors (n_detectors,) so often at a rail that their image means nothing."""
    top = 2**record.adc_bits - 1
    railed = (record.counts == top) | (record.counts == 0)
    full = ((record.flags & Flag.SATURATED) != 0) & ~railed.any(axis=1)
    return _is_void(railed | full[:, None], record)


def coarse(noise: NoiseBudget) -> Iterator[CaptureWarning]:
    """A converter whose step is larger than the noise: what is smaller than a step may be lost."""
    quantisation = noise.noise_e["quantisation"]
    step = quantisation * np.sqrt(12.0)
    rest = np.sqrt(noise.total_noise_e**2 - quantisation**2)
    if step > _COARSE * rest:
        text = (
            f"the converter's step, {step:.3g} e-, is larger than all noise, {rest:.3g} e-: "
            "rounding hides what is smaller: readout.adc_bits, adc_full_scale_v or gain"
        )
        yield CaptureWarning("quantisation", text)


def _is_void(at_rail: NDArray[np.bool_], record: SpiRecord) -> NDArray[np.bool_]:
    """By detector: at a rail beyond the all-lit and the all-dark exposure, and too often."""
    allowed = max(2 * len(record.shutters), VOID_SHARE * len(at_rail))
    return np.asarray(at_rail.sum(axis=0) > allowed)
