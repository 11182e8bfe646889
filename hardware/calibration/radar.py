"""Calibration of a radar: the echo of a target of known cross-section tells the delay of the cables
and what the two antennas gain, less all losses.
"""

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from hardware.calibration.target import CalibrationTarget, Warned, check_device, distinct
from hardware.errors import InputError, check_finite, check_positive
from hardware.formatting import quantity_text, si
from hardware.radar import Detection
from hardware.radar.detection import with_cross_section
from hardware.radar.integrity import saturation
from hardware.radar.process import Frame
from hardware.records import RadarFrontEnd, RadarRecord
from hardware.waveform import OfdmWaveform

Array = NDArray[np.float64]

#: The target's echo is looked for within this distance of where it stands.
_NEAR_M = 1.0
#: Carriers this much apart are the calibrated one: the received power of antennas of a fixed gain
#: changes with 1 / f^2, of a fixed aperture with f^2, by 0.17 dB between the two.
_SAME_CARRIER = 0.01
#: Standard error of the level from which on a calibration is warned of, decibels.
_WEAK_DB = 0.5
#: Chance of bursts that scatter so much by their own errors alone.
_BY_CHANCE = 1e-3
#: Settings of a front end that a two-way gain is relative to, where they are known.
_DECLARED = ("antenna_gain_dbi", "losses_db")
_DB = 10 / math.log(10)


@dataclass(frozen=True, eq=False)
class RadarCalibration(Warned):
    """What the radar made of the target.

    Parameters
    ----------
    device, made_ns
        Which radar, and when (Unix time).
    range_offset_m, range_offset_error_m
        Measured minus true range, and its standard error.
    two_way_gain_db, two_way_gain_error_db
        Of the transmitter's and the receiver's antenna, less all losses: what the radar equation
        lacks beside transmit power and wavelength, P = Pt g wavelength^2 sigma / ((4 pi)^3 R^4).
    carrier_hz
        Where it holds.
    antenna_gain_dbi, losses_db
        What the calibrated record's front end declares, NaN where unknown: where another record's
        declares more or less, the difference counts.
    target
    warnings
        What was wrong with the echoes of the target, for whoever uses them.
    """

    device: str
    made_ns: int
    range_offset_m: float
    range_offset_error_m: float
    two_way_gain_db: float
    two_way_gain_error_db: float
    carrier_hz: float
    antenna_gain_dbi: float
    losses_db: float
    target: CalibrationTarget
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("range_offset_m", "two_way_gain_db"):
            check_finite(name, getattr(self, name))
        check_positive("carrier_hz", self.carrier_hz)

    @classmethod
    def of(
        cls, bursts: Iterable[tuple[int, RadarRecord, Frame]], target: CalibrationTarget
    ) -> Self:
        """From the strongest echo near the target in every burst: the mean. ``bursts``: with the
        number of the record, by which warnings name it, from 1.

        Of a burst that lost slots the part that was processed counts, each sample as much as one of
        a whole burst. Bursts that differ by more than their noise are warned of, and their scatter
        is the error then: what moved them moves the next one as far.

        Raises InputError for bursts of unlike radars, for saturated ones, which lack power, and
        where no burst has an echo near the target.
        """
        echoes, first = _Echoes(target), None
        for number, record, frame in bursts:
            first = first or record
            _check_alike(first, record)
            echoes.add(number, record, frame)
        if first is None or not echoes.offset_m:
            raise InputError(echoes.none)
        offset_m, offset_error_m = echoes.combined(echoes.offset_m, "range offsets", "m")
        gain_db, gain_error_db = echoes.combined(echoes.gain_db, "two-way gains", "dB")
        if gain_error_db > _WEAK_DB:
            echoes.warnings.append(
                f"the target's echo is weak: the level's standard error is {gain_error_db:.2g} dB, "
                f"expected {_WEAK_DB:g} dB at most; all cross-sections corrected by it share it"
            )
        return cls(
            device=first.device,
            made_ns=time.time_ns(),
            range_offset_m=offset_m,
            range_offset_error_m=offset_error_m,
            two_way_gain_db=gain_db,
            two_way_gain_error_db=gain_error_db,
            carrier_hz=first.waveform.carrier_hz,
            **{name: getattr(first.front_end, name) for name in _DECLARED},
            target=target,
            warnings=distinct(echoes.told),
        )

    def check(self, record: RadarRecord) -> None:
        """Raise InputError for a record that this does not hold for: of another device or another
        carrier, or of a front end that declares what the calibrated one did not know.
        """
        check_device(self.device, record.device)
        _check_carrier(self.carrier_hz, record)
        for name in _DECLARED:
            known, declared = getattr(self, name), getattr(record.front_end, name)
            if math.isfinite(known) != math.isfinite(declared):
                raise InputError(
                    f"{name}: calibrated {known:g}, measured {declared:g}: expected both known or "
                    "both unknown"
                )

    def corrected(
        self, detection: Detection, waveform: OfdmWaveform, front_end: RadarFrontEnd
    ) -> Detection:
        """Detection with its true range, and the cross-section that its power says from there, with
        errors that hold the calibration's own. This part is common to all that is corrected by it.

        For a target in the direction that the reference stood in. What averaging over a slot takes
        from a moving target's echo is put back; ``waveform`` is the one that was processed.
        """
        placed = replace(
            detection,
            range_m=detection.range_m - self.range_offset_m,
            range_error_m=math.hypot(detection.range_error_m, self.range_offset_error_m),
        )
        gain_db = self.two_way_gain_db
        for name, sign in zip(_DECLARED, (2, -1), strict=True):
            more_db = getattr(front_end, name) - getattr(self, name)
            gain_db += sign * more_db if math.isfinite(more_db) else 0.0
        measured = with_cross_section(
            placed, waveform, front_end.transmit_power_w, gain_db / 2, losses_db=0.0
        )
        own_m2 = measured.rcs_m2 * self.two_way_gain_error_db / _DB
        return replace(measured, rcs_error_m2=math.hypot(measured.rcs_error_m2, own_m2))


@dataclass
class _Echoes:
    """Range offset and two-way gain by the target's echo in one burst after another, each with its
    standard error, and warnings: ``of_records`` with the number of the record.
    """

    target: CalibrationTarget
    offset_m: list[tuple[float, float]] = field(default_factory=list)
    gain_db: list[tuple[float, float]] = field(default_factory=list)
    n_samples: list[int] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    of_records: list[tuple[int, str]] = field(default_factory=list)
    last_record: int = 0
    is_empty: bool = True
    is_whole: bool = True

    @property
    def told(self) -> list[str]:
        """All warnings; those of one record name it where there are several."""
        if self.last_record <= 1:
            return [*(text for _, text in self.of_records), *self.warnings]
        named = (f"record {number}: {text}" for number, text in self.of_records)
        return [*named, *self.warnings]

    @property
    def none(self) -> str:
        """Why there is no calibration."""
        if self.is_empty:
            return "no burst of a radar in it that can be used"
        away = quantity_text(self.target.distance_m, "m")
        told = f"detections: none within {_NEAR_M:g} m of the target at {away}"
        return told if self.is_whole else "; ".join([told, *distinct(self.told)])

    def add(self, number: int, record: RadarRecord, frame: Frame) -> None:
        """A burst of the record of that number. Raises InputError for a saturated one."""
        self.is_empty = False
        self.is_whole &= frame.whole
        if told := saturation(record, frame.burst):
            raise InputError(
                f"{told}: expected none in a calibration; take it anew with less gain, or a "
                "smaller or more distant target"
            )
        self.last_record = max(self.last_record, number)
        burst = f"burst {frame.burst}"
        self.of_records += [(number, warning) for warning in frame.warnings]
        away_m = self.target.distance_m
        near = [one for one in frame.detections if abs(one.range_m - away_m) < _NEAR_M]
        near.sort(key=lambda one: -one.power_w)
        if not near:
            told = f"{burst}: left out, no echo within {_NEAR_M:g} m of the target"
            self.of_records.append((number, told))
            return
        if len(near) > 1:
            self.of_records.append((number, f"{burst}: {_several(near)}"))
        self._measure(near[0], record, frame.waveform)
        self.n_samples.append(frame.waveform.n_subcarriers * frame.waveform.n_slots)

    def _measure(self, best: Detection, record: RadarRecord, waveform: OfdmWaveform) -> None:
        away_m = self.target.distance_m
        # At the true distance, of antennas without gain: what is left of the power is the gain.
        bare = with_cross_section(
            replace(best, range_m=away_m, range_error_m=0.0),
            waveform,
            record.front_end.transmit_power_w,
            antenna_gain_dbi=0.0,
            losses_db=0.0,
        )
        self.offset_m.append((best.range_m - away_m, best.range_error_m))
        gain_db = _DB * math.log(bare.rcs_m2 / self.target.size)
        self.gain_db.append((gain_db, _DB * bare.rcs_error_m2 / bare.rcs_m2))

    def combined(
        self, measured: Sequence[tuple[float, float]], what: str, unit: str
    ) -> tuple[float, float]:
        """Mean of a quantity over the bursts, by the number of their samples, and its standard
        error. Weights by errors would favour echoes that noise makes stronger.
        """
        from scipy.special import chdtri

        values, errors = np.array(measured).T
        n = len(values)
        weights = np.array(self.n_samples) / sum(self.n_samples)
        mean, error = float(weights @ values), float(np.linalg.norm(weights * errors))
        if n == 1:
            return mean, error
        certain = np.maximum(errors, np.finfo(float).tiny ** 0.5)
        middle = np.average(values, weights=certain**-2)
        if np.sum(((values - middle) / certain) ** 2) <= chdtri(n - 1, _BY_CHANCE):
            return mean, error
        ends = (quantity_text(float(end), unit) for end in (values.min(), values.max()))
        self.warnings.append(
            f"{what} of {n} bursts go from {' to '.join(ends)}, by more than their errors "
            f"({quantity_text(float(np.sqrt(np.mean(errors**2))), unit, 2)}): target or radar "
            "changed; their scatter is taken for the error"
        )
        return float(values.mean()), float(values.std(ddof=1))


def _several(near: Sequence[Detection]) -> str:
    places = [f"{one.range_m:.3f} m ({10 * math.log10(1e3 * one.power_w):.1f} dBm)" for one in near]
    return (
        f"{len(near)} echoes within {_NEAR_M:g} m of the target, at "
        f"{', '.join(places)}: the strongest counts, whatever it is of"
    )


def _check_alike(first: RadarRecord, record: RadarRecord) -> None:
    """Raise InputError unless one calibration holds for both."""
    check_device(first.device, record.device)
    _check_carrier(first.waveform.carrier_hz, record)
    for name in _DECLARED:
        one, other = (getattr(each.front_end, name) for each in (first, record))
        if one != other and not (math.isnan(one) and math.isnan(other)):
            raise InputError(f"{name}: {one:g} in the first record, {other:g} in another")


def _check_carrier(calibrated_hz: float, record: RadarRecord) -> None:
    measured_hz = record.waveform.carrier_hz
    if abs(measured_hz / calibrated_hz - 1) > _SAME_CARRIER:
        raise InputError(
            f"carrier_hz: calibrated {si(calibrated_hz, 'Hz', 4)}, measured "
            f"{si(measured_hz, 'Hz', 4)}: expected the same within {_SAME_CARRIER:.0%}, gains are "
            "not known at others"
        )
