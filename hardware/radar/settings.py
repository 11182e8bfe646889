"""Settings of radar processing."""

from dataclasses import dataclass, field

import numpy as np

from hardware.errors import InputError, check_count, check_finite, check_kind, check_switch
from hardware.own_functions import OwnFunctionError
from hardware.radar.cfar_rule import Cfar
from hardware.radar.demodulation import Precision, check_precision
from hardware.radar.own_detection import Detect, OwnDetection, detection_of
from hardware.radar.range_doppler import MOST_OVERSAMPLING
from hardware.radar.windows import check_window
from hardware.waveform import C_M_PER_S


@dataclass(frozen=True)
class Processing:
    """Settings of radar processing.

    Parameters
    ----------
    window, oversampling
        See `range_doppler`.
    cfar, at_most
        Rule of detection, and largest number of detections, strongest first.
    precision
        Of demodulation and map: ``single`` takes half the time, see `Precision`. Ranges, rates
        and phases are always refined in double precision.
    leakage
        Subtract the record's leakage, where its delay is known.
    moving_only
        Subtract all static echoes, of bursts with 3 or more slots of a transmitter. What moves is
        measured beside them, see `hardware.radar.moving`.
    resolve
        Split detections into targets nearer than a cell, see `resolve`.
    per_cell
        Targets of one range and rate to resolve by angle at most, on an evenly spaced line of
        antennas, see `targets_of_cell`; 1 is plain beamforming. Range and rate are those of the
        cell.
    reference_delay_s, range_rate_m_per_s
        For carrier steps, see `stitch`. The delay is negative where the reference arrives before
        the clock's zero.
    fastest_m_per_s
        Highest speed of approaching or receding targets, up to which the Doppler ambiguity is
        resolved, or alternatives are listed, see `resolve_delay_rates`. An echo must first be
        detected on a map without compensation of its migration: a target that moves by n range
        cells within a burst is 20 log10 n dB weaker there, see `OfdmWaveform.migration_gain`.
        Beyond 64 of them rates are not tested, which a warning tells.
    detection
        A user's own detection in place of CFAR and all refinement: a function of (channel,
        waveform, image), ``file.py:function``, or an installed name, see `detection_of`.
    """

    window: str = "blackmanharris"
    oversampling: int = 1
    cfar: Cfar = field(default_factory=Cfar)
    at_most: int = 64
    precision: Precision = "single"
    leakage: bool = True
    moving_only: bool = False
    resolve: bool = False
    per_cell: int = 1
    reference_delay_s: float | None = None
    range_rate_m_per_s: float = 0.0
    fastest_m_per_s: float = 50.0
    detection: str | OwnDetection | Detect | None = None

    def __post_init__(self) -> None:
        check_window(self.window)
        check_count("oversampling", self.oversampling, most=MOST_OVERSAMPLING)
        check_kind("cfar", self.cfar, Cfar, "hardware.Cfar")
        for name in ("at_most", "per_cell"):
            check_count(name, getattr(self, name))
        check_precision(self.precision)
        for name in ("leakage", "moving_only", "resolve"):
            check_switch(name, getattr(self, name))
        check_finite("range_rate_m_per_s", self.range_rate_m_per_s, C_M_PER_S)
        if self.reference_delay_s is not None:
            check_finite("reference_delay_s", self.reference_delay_s)
        fastest: object = self.fastest_m_per_s
        is_switch = isinstance(fastest, bool)
        if is_switch or not (isinstance(fastest, int | float | np.number) and fastest >= 0):
            raise InputError(f"fastest_m_per_s: {fastest!r:.60}, expected a number from 0 on")
        if self.detection is not None:
            try:
                own = detection_of(self.detection)
            except OwnFunctionError as error:
                raise OwnFunctionError(f"detection: {error}") from error
            object.__setattr__(self, "detection", own)
