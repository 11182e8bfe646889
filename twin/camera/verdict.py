"""Quality of an image of a record, judged by the record's counts and flags, and its warnings."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.formatting import number
from hardware.records import Flag, SpiRecord
from twin.accuracy import Interval
from twin.camera.backscatter_ranging import BackscatterRangeError
from twin.camera.distortion import Distortion, Distortions
from twin.detector import NoiseBudget
from twin.warned import CaptureWarning, Kind, is_void

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Share of saturated exposures above which an image is void: the median response then has no slope.
#: `Distortion` covers smaller shares.
VOID_SHARE = 0.5

#: A cell counts as lit above this share of the brightest one: rounding leaves less than that.
LIT = 1e-6

#: Step of the converter over all other noise above which rounding no longer acts as noise: with
#: noise of half a step, 1 % of the sawtooth of rounding errors remains.
_COARSE = 2.0

#: Error over noise per pixel that is negligible (it adds half a percent), and loss of signal below
#: which no warning is given.
_HIDDEN, _LOST = 0.1, 0.01


@dataclass(frozen=True)
class ImageVerdict:
    """Quality of an image of a record.

    ``snr_median``, ``snr_best``: signal over noise and distortion per pixel, over the lit cells
    (`lit_cells`); nan where the record is void. ``lit_share``: share of lit cells.
    ``above_noise_share``: share of the lit cells whose signal exceeds their noise.
    ``void_because``: the warnings that make the record void. ``range_error``: error of distances
    due to backscatter. ``not_within``: warnings of light whose error is more than its tolerance.
    ``snr_interval``: the median with the error of the model, where it is known.
    """

    snr_median: float
    snr_best: float
    lit_share: float
    above_noise_share: float
    void_because: tuple[CaptureWarning, ...] = ()
    range_error: BackscatterRangeError | None = None
    not_within: tuple[CaptureWarning, ...] = ()
    snr_interval: Interval | None = None

    @property
    def void(self) -> bool:
        """Whether no image can be reconstructed from the record."""
        return bool(self.void_because)

    @property
    def short(self) -> str:
        """The result in a few words, for titles."""
        if self.void:
            return f"void ({self.void_because[0].kind})"
        return f"median SNR {_two_digits(self.snr_median)}"

    def __str__(self) -> str:
        """The result in one sentence."""
        if self.void:
            return "void: " + "; ".join(self.void_because)
        ranging = f"; {self.range_error}" if self.range_error and self.range_error.matters else ""
        which = "cells" if self.lit_share == 1 else f"{self.lit_share:.0%} of cells that are lit"
        snr = _two_digits(self.snr_median) if self.snr_interval is None else self.snr_interval
        return (
            f"SNR per pixel {snr} (median of the {which}; "
            f"{self.above_noise_share:.0%} of them above their noise){ranging}"
            + "".join(f"; {warning}" for warning in self.not_within)
        )


def lit_cells(cells_e: Array, albedo: Array) -> Bools:
    """Whether each cell is lit: it shows a surface (``albedo``, the truth's), and has light.

    Of cells that show none, in which blur puts faint light, paths find more the more there are:
    they count only where no cell with a surface has light. All of one shape.
    """
    with_light = cells_e > LIT * cells_e.max(initial=0.0)
    lit = with_light & (albedo > 0)
    return lit if lit.any() else with_light


def judge(
    lit: Bools,
    snr: Array,
    warnings: Sequence[CaptureWarning],
    range_error: BackscatterRangeError | None = None,
) -> ImageVerdict:
    """Verdict on an image from the SNR of its cells and which of them are ``lit``, and the warnings
    of its record.
    """
    void = tuple(w for w in warnings if w.void)
    share = float(lit.mean())
    if is_void(warnings) or not lit.any():
        return ImageVerdict(np.nan, np.nan, share, 0.0, void)
    seen = snr[lit]
    return ImageVerdict(
        snr_median=float(np.median(seen)),
        snr_best=float(seen.max()),
        lit_share=share,
        above_noise_share=float(np.mean(seen >= 1)),
        range_error=range_error,
        not_within=tuple(w for w in warnings if w.kind == "tolerance"),
    )


def warnings_of_record(
    record: SpiRecord,
    clipping: Distortion | None = None,
    noise_e: Array | None = None,
    own: str = "",
) -> Iterator[CaptureWarning]:
    """Warnings from the counts and flags of a record.

    ``clipping``, ``noise_e`` (n_detectors,): distortion of the image by clipping, and its noise per
    pixel, where known. ``own``: name of a user's own detector, whose flags alone say what is
    saturated: 0 may be a good count.
    """
    n, rails = len(record.counts), _Rails(record, own)
    blinded = bool((rails.blind_high | rails.blind_low).all())
    hidden, cost = np.zeros(record.counts.shape[1], np.bool_), ""
    if clipping is not None and noise_e is not None:
        hidden = clipping.hides(noise_e)
        if _matters(clipping, noise_e) and not rails.blind_high.all():
            cost = f"; {_cost(clipping, noise_e)}"
    high = rails.blind_high | hidden
    too_high = f"saturate the ADC: readout: its gain is too high{cost}"
    too_low = "read 0: readout: adc_offset_v is too low, or the converter's step too coarse"
    full = f"fill the well: readout.full_well_e{cost}"
    if own:
        full = f"are marked saturated by {own}{cost}"
    causes: tuple[tuple[Kind, Bools, Bools, str], ...] = (
        ("saturated", rails.high, high, too_high),
        ("saturated", rails.full, high, full),
        ("black", rails.low, rails.blind_low, too_low),
    )
    for kind, at_rail, lost, text in causes:
        if hits := int(at_rail.any(axis=1).sum()):
            of = _on_detectors(at_rail)
            yield CaptureWarning(kind, f"{hits} of {n} exposures{of} {text}", void=bool(lost.all()))
    if n > 1 and not blinded and np.ptp(record.counts, axis=0).max() <= (0 if own else 1):
        differ = "are the same" if own else "differ by one step at most"
        text = f"the counts of all exposures {differ}: too little light, or gain"
        yield CaptureWarning("underexposed", text, void=True)
    flags: dict[Kind, Flag] = {"overrun": Flag.OVERRUN, "reset": Flag.RESET, "lost": Flag.LOST}
    for kind, flag in flags.items():
        if bad := int(np.count_nonzero(record.flags & flag)):
            yield CaptureWarning(kind, f"{bad} of {n} exposures are marked {kind}", void=bad == n)


def lag_warnings(
    lag: Distortion, noise_e: Array, lag_shares: dict[str, float]
) -> Iterator[CaptureWarning]:
    """Warning of lag between exposures above the noise per pixel (n_detectors,).

    ``lag_shares``: share of the exposures before in each exposure, by the fields that cause it.
    """
    hidden = bool(lag.hides(noise_e).all())
    if not hidden and not _matters(lag, noise_e):
        return
    shares = ", ".join(f"{100 * share:.3g} % ({field})" for field, share in lag_shares.items())
    text = f"of the exposures before {shares} is left in each one; {_cost(lag, noise_e)}"
    yield CaptureWarning("lag", text, void=hidden)


def combined_warnings(
    distortion: Distortions, noise_e: Array, hidden: Bools, warnings: Sequence[CaptureWarning]
) -> Iterator[CaptureWarning]:
    """Warning where lag and clipping hide the images of all detectors (n_detectors,) together,
    though neither does alone.
    """
    if hidden.all() and not is_void(warnings):
        text = f"lag and rails together hide the image: {_cost(distortion.total, noise_e)}"
        yield CaptureWarning("lag", text, void=True)


def saturated_detectors(record: SpiRecord, own: str = "") -> Bools:
    """Detectors (n_detectors,) saturated in so many exposures that they carry no information;
    ``own`` as in `warnings_of_record`.
    """
    rails = _Rails(record, own)
    return np.asarray(rails.blind_high | rails.blind_low)


def quantisation_warnings(noise: NoiseBudget) -> Iterator[CaptureWarning]:
    """Warning of a converter whose step is larger than the noise: smaller signals may be lost."""
    quantisation = noise.noise_e.get("quantisation", 0.0)
    step = quantisation * np.sqrt(12.0)
    rest = np.sqrt(noise.total_noise_e**2 - quantisation**2)
    if step > _COARSE * rest:
        text = (
            f"the converter's step, {step:.3g} e-, is larger than all noise, {rest:.3g} e-: "
            "rounding hides smaller signals: readout.adc_bits, adc_full_scale_v or gain"
        )
        yield CaptureWarning("quantisation", text)


def _matters(distortion: Distortion, noise_e: Array) -> bool:
    lost = bool((np.abs(distortion.signal_factor - 1) > _LOST).any())
    return lost or distortion.over(noise_e) > _HIDDEN


def _cost(distortion: Distortion, noise_e: Array) -> str:
    signal = max(float(distortion.signal_factor.mean()), 0)
    return (
        f"the image keeps {100 * signal:.3g} % of its signal, and false signal is "
        f"{distortion.over(noise_e):.2g} times its noise"
    )


def _on_detectors(at_rail: Bools) -> str:
    n, hit = at_rail.shape[1], int(at_rail.any(axis=0).sum())
    return f" of {hit} of {n} detectors" if n > 1 else ""


def _two_digits(value: float) -> str:
    return f"{value:.0f}" if value >= 10 else number(value, 2)


class _Rails:
    """Exposures (n_exposures, n_detectors) at the converter's rails or with a full well, and the
    detectors (n_detectors,) whose images are void because of them.
    """

    def __init__(self, record: SpiRecord, own: str = "") -> None:
        counts = record.counts
        self.high = (counts == 2**record.adc_bits - 1) & (not own)
        self.low = (counts == 0) & (not own)
        flagged = (record.flags & Flag.SATURATED) != 0
        # A full well is below the converter's rail; the flag does not say which detector's it is.
        alone = flagged & ~(self.high | self.low).any(axis=1)
        self.full = np.repeat(alone[:, None], counts.shape[1], axis=1)
        self.blind_high = (self.high | self.full).sum(axis=0) > VOID_SHARE * len(counts)
        self.blind_low = self.low.sum(axis=0) > VOID_SHARE * len(counts)
